"""What a look may show on a partly unknown map: rays cast through cells that let them pass or not.

From each eye (the centre of a cell) a star of rays is walked cell by cell. A ray reaches cell n
with the probability that all cells before it let it pass:

    P_n = prod over j < n of through_j

which is Sujan & Meggiolaro, Eq. 5, in the plane: 1 through free cells, 0 through solid ones, and
in between where nothing was measured. A cell that several rays cross is seen with the greatest of
their probabilities. Whatever is summed is booked to the bearing whose ray shows it, so that every
heading's look is a window of one sum.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from agents.geometry import Floats, Ints
from agents.planar.rays import star
from agents.planar.sensing import evidence
from agents.settings import SensorSettings
from comms import kernels
from comms.kernels import kernel

BEARINGS = 360
"""Rays of a star: a multiple of every sensible number of headings."""
HALF = 0.6
"""What it counts to make a cell surer that is not mapped after all; the rest when it is."""
CLOSED = 1e-6
"""What lets rays pass with a smaller chance lets none pass."""
LEAST = 0.02
"""A ray whose chance of coming so far is less is not followed."""


@dataclass(frozen=True)
class Star:
    """The rays of one sensor on one cell size."""

    steps: Ints
    """(B, M, 2) rows and columns from the eye's cell."""
    counts: Ints
    """(B,) cells that each ray crosses."""
    range_m: Floats
    """(B, M) distance of each cell's centre."""
    sure: Floats
    """(B, M) log-odds by which a look moves a cell there."""
    width: int
    """Rays that fit in the sensor's field of view."""

    @cached_property
    def narrow_steps(self) -> np.ndarray:
        """(B, M, 2) steps in 16 bits."""
        return self.steps.astype(np.int16)

    @cached_property
    def narrow_sure(self) -> np.ndarray:
        """(B, M) sure in 32 bits."""
        return self.sure.astype(np.float32)


def star_of(sensor: SensorSettings, cell_m: float) -> Star:
    """Return the rays of a sensor."""
    return _star_of(sensor.model_dump_json(), cell_m)


@lru_cache(maxsize=16)
def _star_of(told: str, cell_m: float) -> Star:
    sensor = SensorSettings.model_validate_json(told)
    steps, _, counts = star(sensor.range_m / cell_m, BEARINGS)
    range_m = np.hypot(steps[..., 0], steps[..., 1]) * cell_m
    sure = evidence(np.minimum(range_m, sensor.range_m), cell_m, sensor)
    width = max(1, round(sensor.fov_deg / 360.0 * BEARINGS))
    return Star(steps, counts, range_m, sure, width)


def first_ray(yaw_rad: float, width: int) -> int:
    """Return the first of the `width` rays that a look at this yaw holds."""
    return round(yaw_rad / (2.0 * math.pi) * BEARINGS - 0.5 * width) % BEARINGS


def yaw_of(ray: Ints, width: int) -> Floats:
    """Return the yaw of looks whose first ray is this."""
    return (np.asarray(ray) + 0.5 * width) / BEARINGS * 2.0 * math.pi


def windows(by_bearing: Floats, width: int) -> Floats:
    """Return, for every first ray, the sum over its window of `width`: (..., B) to (..., B)."""
    ringed = np.concatenate((by_bearing, by_bearing[..., : width - 1]), axis=-1)
    total = np.cumsum(ringed, axis=-1)
    before = np.concatenate((np.zeros((*total.shape[:-1], 1)), total[..., :-width]), axis=-1)
    return total[..., width - 1 :] - before


@kernel
def onward(p: float, passing: float, related: bool) -> float:
    """Return the chance of a ray that came through a cell, of its chance `p` before it.

    Independent chances multiply. If cells stand or fall together, odds against coming on add up:
    that is a common frailty of unit variance, and what has come far through the unknown is the
    likelier to come farther; of a single cell both say the same.
    """
    if not related:
        return p * passing
    if passing < CLOSED:
        return 0.0
    return 1.0 / (1.0 / p + 1.0 / passing - 1.0)


@kernel
def _gains(
    through: np.ndarray,
    lacking: np.ndarray,
    worth: np.ndarray,
    steps: np.ndarray,
    counts: np.ndarray,
    sure: np.ndarray,
    eyes: np.ndarray,
    half: float,
    related: bool,
    trust: np.ndarray,
    out: np.ndarray,
) -> None:
    rows, cols = through.shape
    stamp = np.full((rows, cols), -1, dtype=np.int32)
    best = np.zeros((rows, cols), dtype=np.float32)
    fine = len(trust) - 1
    for e in range(len(eyes)):
        row, col = eyes[e, 0], eyes[e, 1]
        for b in range(len(counts)):
            p = 1.0
            total = 0.0
            for n in range(counts[b]):
                i, j = row + steps[b, n, 0], col + steps[b, n, 1]
                if i < 0 or j < 0 or i >= rows or j >= cols:
                    break
                value = worth[i, j]
                if value > 0.0:
                    if stamp[i, j] != e:
                        stamp[i, j] = e
                        best[i, j] = 0.0
                    held = trust[int(p * fine + 0.5)] if related else p
                    more = held - best[i, j]
                    if more > 0.0:
                        total += more * (value if sure[b, n] >= lacking[i, j] else half * value)
                        best[i, j] = held
                if n > 0:
                    p = onward(p, float(through[i, j]), related)
                    if p < LEAST:
                        break
            out[e, b] = total


@kernel
def _tallies(
    through: np.ndarray,
    classes: np.ndarray,
    rings: np.ndarray,
    steps: np.ndarray,
    counts: np.ndarray,
    eyes: np.ndarray,
    firsts: np.ndarray,
    width: int,
    out: np.ndarray,
) -> None:
    rows, cols = through.shape
    stamp = np.full((rows, cols), -1, dtype=np.int32)
    best = np.zeros((rows, cols), dtype=np.float32)
    bearings = len(counts)
    tally = np.zeros((bearings, out.shape[2]))
    for e in range(len(eyes)):
        row, col = eyes[e, 0], eyes[e, 1]
        tally[:] = 0.0
        for b in range(bearings):
            p = 1.0
            for n in range(counts[b]):
                i, j = row + steps[b, n, 0], col + steps[b, n, 1]
                if i < 0 or j < 0 or i >= rows or j >= cols:
                    break
                if stamp[i, j] != e:
                    stamp[i, j] = e
                    best[i, j] = 0.0
                more = p - best[i, j]
                if more > 0.0:
                    tally[b, classes[rings[b, n], i, j]] += more
                    best[i, j] = p
                if n > 0:
                    p *= through[i, j]
                    if p < LEAST:
                        break
        for h in range(len(firsts)):
            for k in range(width):
                out[e, h] += tally[(firsts[h] + k) % bearings]


@kernel
def _visibility(
    through: np.ndarray,
    steps: np.ndarray,
    counts: np.ndarray,
    eye: np.ndarray,
    first: int,
    width: int,
    related: bool,
    out: np.ndarray,
) -> None:
    rows, cols = through.shape
    for k in range(width):
        b = (first + k) % len(counts)
        p = 1.0
        for n in range(counts[b]):
            i, j = eye[0] + steps[b, n, 0], eye[1] + steps[b, n, 1]
            if i < 0 or j < 0 or i >= rows or j >= cols:
                break
            out[i, j] = max(out[i, j], p)
            if n > 0:
                p = onward(p, float(through[i, j]), related)
                if p < LEAST:
                    break


def gains(
    through: Floats,
    lacking: Floats,
    worth: Floats,
    rays: Star,
    eyes: Ints,
    *,
    trust: Floats | None = None,
) -> Floats:
    """Return how many cells looks are expected to map, by bearing.

    Args:
        through: (rows, cols) probability that a ray passes a cell.
        lacking: (rows, cols) log-odds that a cell falls short of being mapped.
        worth: (rows, cols) what it counts, in cells, if a look makes it mapped; a look after which
            it still falls short counts `HALF` of that.
        rays: of the sensor.
        eyes: (E, 2) cells from whose centres is looked.
        trust: what chances are to be taken for (`trust.Trust.table`) where cells along a ray stand
            or fall together (`onward`); None: they don't, and chances are what they are.

    Returns:
        (E, B): for each bearing the sum over the cells that its ray shows.
    """
    out = np.zeros((len(eyes), len(rays.counts)))
    # Half as wide: what rays walk over stays in the processor's cache.
    passing, short, value = (np.asarray(v, dtype=np.float32) for v in (through, lacking, worth))
    _gains(
        passing,
        short,
        value,
        rays.narrow_steps,
        rays.counts,
        rays.narrow_sure,
        eyes,
        HALF,
        trust is not None,
        np.zeros(1) if trust is None else trust,
        out,
    )
    return out


def tallies(
    through: Floats, classes: Ints, rings: Ints, rays: Star, eyes: Ints, firsts: Ints, kinds: int
) -> Floats:
    """Return how many cells of each class looks are expected to show.

    Args:
        through: (rows, cols) probability that a ray passes a cell.
        classes: (R, rows, cols) the class, 0 to kinds - 1, of a cell seen at ring R.
        rings: (B, M) ring of each step of the star.
        rays: of the sensor.
        eyes: (E, 2) cells from whose centres is looked.
        firsts: (H,) first rays of the headings.
        kinds: number of classes.

    Returns:
        (E, H, kinds) expected numbers of cells.
    """
    out = np.zeros((len(eyes), len(firsts), kinds))
    _tallies(through, classes, rings, rays.steps, rays.counts, eyes, firsts, rays.width, out)
    return out


def visibility(
    through: Floats, rays: Star, eye: Ints, first: int, *, related: bool = False
) -> Floats:
    """Return each cell's probability (rows, cols) of being seen by one look."""
    out = np.zeros(through.shape)
    _visibility(through, rays.steps, rays.counts, eye, first, rays.width, related, out)
    return out


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    rays = star_of(SensorSettings(range_m=2.0), 1.0)
    through = np.ones((6, 6))
    eyes = np.array([[3, 3]])
    gains(through, through, through, rays, eyes)
    classes = np.zeros((1, 6, 6), dtype=np.int64)
    rings = np.zeros(rays.range_m.shape, dtype=np.int64)
    tallies(through, classes, rings, rays, eyes, np.array([0]), 2)
    visibility(through, rays, eyes[0], 0)
