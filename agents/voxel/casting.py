"""What looks may show in a partly unknown space: a star of rays, each of which stands for its cone.

From each eye rays go out over all bearings and all heights that the camera can be tilted to. A ray
reaches a cell with the probability that all cells before it let it pass (Sujan & Meggiolaro,
Eq. 5, in space: 1 through free cells, 0 through solid ones, in between where nothing was measured).
On its way from r1 to r2 through a cell it stands for the volume

    dOmega (r2^3 - r1^3) / 3

of its cone, which is how many cells it shows there: so sums over a star's rays are integrals over
the space in view, and no cell has to be remembered. A window of rays is a look.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Floats, Ints, Singles
from agents.planar.sensing import evidence
from agents.settings import PlannerSettings, SensorSettings
from agents.voxel.rays import crossings, most_crossed
from comms import kernels
from comms.kernels import kernel

BEARINGS = 72
"""Rays of a ring."""
RING_RAD = math.radians(5.0)
LEAST = 0.02
"""A ray whose chance of coming so far is less is not followed."""
DISTANCES = 8
"""Distances that Eq. 7 tells apart."""


@dataclass(frozen=True)
class Star:
    """The rays of one sensor on one cell size; ray e * BEARINGS + b is of ring e and bearing b."""

    heights_rad: Floats
    """(E,) of the rings."""
    steps: NDArray[np.int16]
    """(R, M, 3) layers, rows and columns from the eye's cell."""
    counts: Ints
    """(R,) cells that each ray crosses."""
    shown: Singles
    """(R, M) cells' worth of volume that each step stands for."""
    sure: Singles
    """(R, M) log-odds by which a look moves a cell there."""
    distance: NDArray[np.uint8]
    """(R, M) which of `DISTANCES` each step has."""
    width: int
    """Bearings that fit in the sensor's field of view."""
    half_rad: float
    """Half of its vertical field of view."""
    most_cells: float
    """N of Eq. 6: cells that a look could show at most."""

    def ring(self, by_ray: Floats, tilt_rad: float) -> Floats:
        """Return the sums (E, B, ...) of by_ray (E, R, ...) over a tilted look's rays, by bearing.

        Bearings are all round, whatever the look's field of view.
        """
        inside = np.abs(self.heights_rad - tilt_rad) < self.half_rad
        ringed = by_ray.reshape(len(by_ray), len(self.heights_rad), BEARINGS, *by_ray.shape[2:])
        return ringed[:, inside].sum(axis=1)

    def window(self, by_ray: Floats, tilt_rad: float) -> Floats:
        """Return the sums (E, B, ...) of by_ray (E, R, ...) over looks at each first bearing."""
        rows = self.ring(by_ray, tilt_rad)
        total = np.cumsum(np.concatenate((rows, rows[:, : self.width]), axis=1), axis=1)
        first = np.zeros_like(total[:, :1])
        padded = np.concatenate((first, total), axis=1)
        return padded[:, self.width : self.width + BEARINGS] - padded[:, :BEARINGS]


def first_bearing(yaw_rad: float, width: int) -> int:
    """Return the first of the `width` bearings that a look at this yaw holds."""
    return round(yaw_rad / (2.0 * math.pi) * BEARINGS - 0.5 * width) % BEARINGS


def star_of(sensor: SensorSettings, planner: PlannerSettings, cell_m: float) -> Star:
    """Return the star of a sensor that is tilted as the planner tilts it."""
    return _star_of(sensor.model_dump_json(), tuple(planner.tilts_deg), cell_m)


@lru_cache(maxsize=8)
def _star_of(told: str, tilts_deg: tuple[float, ...], cell_m: float) -> Star:
    sensor = SensorSettings.model_validate_json(told)
    half = 0.5 * math.radians(sensor.fov_vertical_deg)
    low = max(math.radians(min(tilts_deg)) - half, -math.pi / 2)
    high = min(math.radians(max(tilts_deg)) + half, math.pi / 2)
    rings = max(1, math.ceil((high - low) / RING_RAD))
    edges = np.linspace(low, high, rings + 1)
    heights = 0.5 * (edges[1:] + edges[:-1])
    bearing = 2.0 * math.pi * (np.arange(BEARINGS) + 0.5) / BEARINGS
    flat = np.repeat(np.cos(heights), BEARINGS)
    turned = np.tile(bearing, rings)
    up = np.repeat(np.sin(heights), BEARINGS)
    rays = np.column_stack((up, flat * np.sin(turned), flat * np.cos(turned)))
    reach = sensor.range_m / cell_m
    most = most_crossed(reach)
    steps = np.zeros((len(rays), most, 3), dtype=np.int16)
    entry = np.full((len(rays), most + 1), reach)
    counts = _star(rays, reach, steps, entry)
    cone = np.repeat(np.diff(np.sin(edges)), BEARINGS) * 2.0 * math.pi / BEARINGS
    shown = cone[:, None] * np.diff(np.minimum(entry, reach) ** 3, axis=1) / 3.0
    range_m = np.sqrt((steps.astype(np.float64) ** 2).sum(axis=2)) * cell_m
    inside_m = np.minimum(range_m, sensor.range_m)
    sure = evidence(inside_m, cell_m, sensor)
    distance = np.minimum((inside_m / sensor.range_m * DISTANCES), DISTANCES - 1)
    view = math.radians(sensor.fov_deg) * 2.0 * math.sin(min(half, math.pi / 2))
    return Star(
        heights,
        steps,
        counts,
        shown.astype(np.float32),
        sure.astype(np.float32),
        distance.astype(np.uint8),
        min(BEARINGS, max(1, round(sensor.fov_deg / 360.0 * BEARINGS))),
        half,
        view * reach**3 / 3.0,
    )


@kernel
def _star(rays: np.ndarray, reach: float, steps: np.ndarray, entry: np.ndarray) -> np.ndarray:
    start = np.full(3, 0.5)
    cells, at = np.empty((steps.shape[1], 3), dtype=np.int64), np.empty(steps.shape[1])
    counts = np.empty(len(rays), dtype=np.int64)
    for k in range(len(rays)):
        counts[k] = crossings(start, rays[k], reach, cells, at)
        for n in range(counts[k]):
            steps[k, n] = cells[n]
            entry[k, n] = at[n]
    return counts


@kernel
def _cast(
    index: np.ndarray,
    room: np.ndarray,
    cells: tuple[np.ndarray, np.ndarray, np.ndarray],
    absent: tuple[float, float, int],
    classes: np.ndarray,
    rays: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    eyes: np.ndarray,
    gain: np.ndarray,
    tally: np.ndarray,
) -> None:
    through, lacking, kinds = cells
    steps, counts, shown, sure, distance = rays
    for e in range(len(eyes)):
        for r in range(len(counts)):
            p = 1.0
            total = 0.0
            for n in range(counts[r]):
                i = eyes[e, 0] + steps[r, n, 0]
                j = eyes[e, 1] + steps[r, n, 1]
                k = eyes[e, 2] + steps[r, n, 2]
                if min(i, j, k) < 0 or i >= room[0] or j >= room[1] or k >= room[2]:
                    break
                block = index[i >> 4, j >> 4, k >> 4]
                passes, lack, kind = absent
                if block >= 0:
                    passes = through[block, i & 15, j & 15, k & 15]
                    lack = lacking[block, i & 15, j & 15, k & 15]
                    kind = kinds[block, i & 15, j & 15, k & 15]
                weight = p * shown[r, n]
                if lack > 0.0:
                    total += weight * min(lack, sure[r, n])
                tally[e, r, classes[distance[r, n], kind]] += weight
                if n > 0:
                    p *= passes
                    if p < LEAST:
                        break
            gain[e, r] = total


@dataclass(frozen=True)
class Matter:
    """What rays meet: arrays (blocks, 16, 16, 16), and what a cell in no block is."""

    index: NDArray[np.int32]
    room: tuple[int, int, int]
    """(layers, rows, cols): beyond there is nothing."""
    through: Singles
    """Probability that a ray passes."""
    lacking: Singles
    """Log-odds that a cell may still take in; 0 where it is of no worth."""
    absent: tuple[float, float]
    """The same two of a cell in no block."""


@dataclass(frozen=True)
class Kinds:
    """How cells are told apart: a number per cell, and the class that it is at each distance."""

    of: NDArray[np.uint8]
    """(blocks, 16, 16, 16)."""
    absent: int
    """Of a cell in no block."""
    classes: Ints
    """(DISTANCES, numbers)."""
    count: int
    """How many classes there are."""


def cast(matter: Matter, kinds: Kinds, star: Star, eyes: Ints) -> tuple[Floats, Singles]:
    """Return what the rays of a star show from eyes (E, 3), by ray.

    Returns:
        (E, R) log-odds that looks are expected to add; (E, R, kinds.count) expected cells of each
        class.
    """
    gain = np.zeros((len(eyes), len(star.counts)))
    tally = np.zeros((len(eyes), len(star.counts), kinds.count), dtype=np.float32)
    _cast(
        matter.index,
        np.array(matter.room, dtype=np.int64),
        (matter.through, matter.lacking, kinds.of),
        (float(matter.absent[0]), float(matter.absent[1]), int(kinds.absent)),
        kinds.classes,
        (star.steps, star.counts, star.shown, star.sure, star.distance),
        eyes,
        gain,
        tally,
    )
    return gain, tally


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    star = star_of(SensorSettings(range_m=2.0), PlannerSettings(), 1.0)
    cells = np.ones((1, 16, 16, 16), dtype=np.float32)
    index = np.zeros((1, 1, 1), dtype=np.int32)
    matter = Matter(index, (16, 16, 16), cells, cells, (0.9, 1.0))
    classes = np.zeros((DISTANCES, 1), dtype=np.int64)
    kinds = Kinds(np.zeros(cells.shape, dtype=np.uint8), 0, classes, 1)
    cast(matter, kinds, star, np.array([[8, 8, 8]]))
