"""The paper's five ways to choose a look on a voxel map (section 3.1), and variants of its fifth.

They are those of `agents.planar.methods` in space: all rate the same finite sample of candidates
(places on the known floor that can be reached, times a cycle of headings and tilts) by Eqs. 22 and
23, and all stop when no look is expected to map `min_gain_cells` cells.

- `random`: no rating, any candidate by lot;
- `raster`: no rating, the next place row by row, to and fro, where no look was taken yet;
- `max-new`: unmapped cells in view, known obstacles accounted for, unknown ones not;
- `min-old`: the frontier strategy: as few mapped cells in view as possible, and something new;
- `information`: Eq. 8, over Markov estimates of unknown cells;
- `information-entropy`: Eq. 6 over the stretched probabilities of Eq. 7;
- `information-voxel`: the sum of h(p) over the cells in view, which Eq. 8 was meant to be.
"""

import math
from abc import ABC, abstractmethod
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Floats, Ints
from agents.planar.sensing import MAPPED
from agents.planning.information import binary_entropy, plogp, stretched
from agents.planning.rating import rate
from agents.voxel.casting import DISTANCES, Kinds, cast, first_bearing
from agents.voxel.scene import Scene
from agents.voxel.view import Means, VoxelChoice, VoxelView

BINS = 17
"""Bins of the histograms of Eqs. 6 and 8."""
DULL = 0.5
"""A cell of less interest proved not to be visible (Eq. 9, as a yes or no)."""
CLAIM_AHEAD, CLAIM_RADIUS = 0.5, 0.5
"""A claim's disc lies this share of the range ahead of the camera, and has this radius."""


class VoxelMethod(Protocol):
    """Chooses looks for one robot."""

    def choose(self, view: VoxelView, rng: np.random.Generator) -> VoxelChoice | None:
        """Return the next look, or None when no look is expected to map enough."""
        ...


def chosen_look(
    scene: Scene, place: int, yaw_rad: float, tilt_rad: float, gain: float
) -> VoxelChoice:
    """Return the look from a place, with the way there and what team-mates are told."""
    way = scene.way(place)
    path_m = scene.path_m(way)
    range_m = scene.means.sensor.range_m
    claim = (
        float(path_m[-1, 0]) + CLAIM_AHEAD * range_m * math.cos(yaw_rad),
        float(path_m[-1, 1]) + CLAIM_AHEAD * range_m * math.sin(yaw_rad),
        CLAIM_RADIUS * range_m,
    )
    return VoxelChoice(path_m, way, yaw_rad, tilt_rad, gain, claim)


class _Sampled(ABC):
    """What all share: candidates and stop. Cells are told apart as new (0), old (1)."""

    def __init__(self, means: Means) -> None:
        self._means = means

    def choose(self, view: VoxelView, rng: np.random.Generator) -> VoxelChoice | None:
        """Return the next look, or None when no look is expected to map enough."""
        scene, planner = Scene(view, self._means), self._means.planner
        yaws = 2.0 * math.pi * np.arange(planner.headings) / planner.headings
        firsts = np.array([first_bearing(float(yaw), scene.star.width) for yaw in yaws])
        tilts = [math.radians(tilt) for tilt in planner.tilts_deg]
        least = max(planner.min_gain_cells, 1e-9)
        places = scene.candidates(rng)
        cells, seen = self._rays(scene, places, firsts, tilts)
        if float(cells.max()) < least:  # the sample may have left out the last one
            places = scene.everywhere()
            cells, seen = self._rays(scene, places, firsts, tilts)
        if float(cells.max()) < least:
            return None
        at = self._pick(scene, places, seen, cells, rng)
        return chosen_look(
            scene, int(places[at[0]]), float(yaws[at[1]]), tilts[at[2]], float(cells[at])
        )

    def _rays(
        self, scene: Scene, places: Ints, firsts: Ints, tilts: list[float]
    ) -> tuple[Floats, Floats]:
        """Return how many cells looks are expected to map (E, H, T), and to show of each class."""
        star = scene.star
        gain, tally = cast(scene.matter, self._kinds(scene), star, scene.eyes(places))
        tally = tally.astype(np.float64)
        cells = [star.window(gain, tilt)[:, firsts] for tilt in tilts]
        seen = [star.window(tally, tilt)[:, firsts] for tilt in tilts]
        return np.stack(cells, axis=2) / MAPPED, np.stack(seen, axis=2)

    def _kinds(self, scene: Scene) -> Kinds:
        """Return how cells are told apart."""
        of = np.where(scene.mapped, 1, np.where(scene.interest < DULL, 2, 0)).astype(np.uint8)
        return Kinds(of, 0, np.tile(np.arange(3, dtype=np.int64), (DISTANCES, 1)), 3)

    @abstractmethod
    def _pick(
        self, scene: Scene, places: Ints, seen: Floats, cells: Floats, rng: np.random.Generator
    ) -> tuple[int, int, int]:
        """Return which place, heading and tilt, of those that map so many cells (E, H, T)."""


class _Rated(_Sampled):
    """Those that take the look that Eq. 23 likes best; they differ in its NI."""

    def _pick(
        self, scene: Scene, places: Ints, seen: Floats, cells: Floats, rng: np.random.Generator
    ) -> tuple[int, int, int]:
        worth = self._worth(scene, seen)
        worthy = (cells >= self._means.planner.min_gain_cells) & (worth > 0)
        if not worthy.any():
            worthy, worth = cells >= self._means.planner.min_gain_cells, cells
        rating = np.where(worthy, rated(scene, places, worth), -np.inf)
        place, heading, tilt = np.unravel_index(int(np.argmax(rating)), rating.shape)
        return int(place), int(heading), int(tilt)

    @abstractmethod
    def _worth(self, scene: Scene, seen: Floats) -> Floats:
        """Return NI (E, H, T) of Eq. 23, of the cells of each class in view (E, H, T, classes)."""


def rated(scene: Scene, places: Ints, worth: Floats) -> Floats:
    """Return RF (E, H, T) of Eq. 23 for a worth NI of looks. Places are known to be free."""
    planner, drive, variance = scene.means.planner, scene.means.drive, scene.view.variance
    way_m = scene.way_to_m(places)
    sigma_m = np.sqrt(variance[0] + variance[1] + (drive.odometry_sigma * way_m) ** 2)
    return rate(
        worth,
        way_m[:, None, None],
        sigma_m[:, None, None],
        np.zeros((1, 1, 1)),
        best_bits=float(worth.max()),
        range_m=scene.means.sensor.range_m,
        cell_m=scene.view.frame.cell_m,
        planner=planner,
    )


class Random(_Sampled):
    """Method (i): any candidate, all equally likely."""

    def _pick(
        self, scene: Scene, places: Ints, seen: Floats, cells: Floats, rng: np.random.Generator
    ) -> tuple[int, int, int]:
        place, heading, tilt = (int(rng.integers(n)) for n in cells.shape)
        return place, heading, tilt


class Raster(_Sampled):
    """Method (ii): the next place in raster order where no look was taken yet."""

    def __init__(self, means: Means) -> None:
        """Begin where the robot stands."""
        super().__init__(means)
        self._been: list[tuple[float, float]] = []
        self._turns = 0

    def _pick(
        self, scene: Scene, places: Ints, seen: Floats, cells: Floats, rng: np.random.Generator
    ) -> tuple[int, int, int]:
        apart_m = 0.5 * scene.means.sensor.range_m
        spots = scene.view.frame.centres_m(scene.eyes(places))[:, :2]
        band = spots[:, 1] // apart_m
        along = np.where(band % 2 == 0, spots[:, 0], -spots[:, 0])
        place = 0
        for n in np.lexsort((along, band)):
            if all(math.hypot(*(spots[n] - been)) >= apart_m for been in np.array(self._been)):
                place = int(n)
                break
        else:
            self._been.clear()
        self._been.append((float(spots[place, 0]), float(spots[place, 1])))
        self._turns += 1
        heading, tilt = self._turns % cells.shape[1], self._turns % cells.shape[2]
        return place, heading, tilt


class MaxNew(_Rated):
    """Method (iii): the largest expected unmapped region, known occlusions accounted for."""

    def _worth(self, scene: Scene, seen: Floats) -> Floats:
        return seen[..., 0]


class MinOld(_Rated):
    """Method (iv), the frontier strategy: the smallest mapped region in view."""

    def _worth(self, scene: Scene, seen: Floats) -> Floats:
        new, old = seen[..., 0], seen[..., 1]
        return np.where(new > 0, new / np.maximum(new + old, 1.0), 0.0)


class Histogrammed(_Rated):
    """Method (v): Eq. 8, bins of p weighted by their own entropy, known and unknown apart."""

    def _kinds(self, scene: Scene) -> Kinds:
        return _binned(scene, np.tile(np.arange(BINS, dtype=np.int64), (DISTANCES, 1)))

    def _worth(self, scene: Scene, seen: Floats) -> Floats:
        share = seen / scene.star.most_cells
        return (_weights() * plogp(np.minimum(share, 1.0))).sum(axis=-1)


def _weights() -> Floats:
    return np.tile(binary_entropy(np.arange(BINS) / (BINS - 1)), 2)


def _binned(scene: Scene, bins: Ints) -> Kinds:
    """Tell cells apart by p and by whether they were measured; `bins` (DISTANCES, BINS)."""
    number = np.rint(scene.occupancy_p * (BINS - 1)).astype(np.uint8)
    of = np.where(scene.log_odds != 0, number, number + BINS).astype(np.uint8)
    of[~scene.mapped & (scene.interest < DULL)] = 0
    classes: NDArray[np.int64] = np.concatenate((bins, bins + BINS), axis=1)
    return Kinds(of, BINS + BINS // 2, classes, 2 * BINS)


class Stretched(_Rated):
    """Method (v) by Eq. 6, over probabilities stretched by certainty and distance (Eq. 7)."""

    def _kinds(self, scene: Scene) -> Kinds:
        range_m = scene.means.sensor.range_m
        away_m = (np.arange(DISTANCES) + 0.5) / DISTANCES * range_m
        p = np.arange(BINS) / (BINS - 1)
        new = stretched(np.tile(p, (DISTANCES, 1)), away_m[:, None], 0.5 * range_m)
        return _binned(scene, np.rint(new * (BINS - 1)).astype(np.int64))

    def _worth(self, scene: Scene, seen: Floats) -> Floats:
        return plogp(np.minimum(seen / scene.star.most_cells, 1.0)).sum(axis=-1)


class Voxel(Histogrammed):
    """Method (v) as it was meant: the sum of h(p) over the cells in view, by N."""

    def _worth(self, scene: Scene, seen: Floats) -> Floats:
        return (_weights() * seen).sum(axis=-1) / scene.star.most_cells
