"""The paper's five ways to choose a look on a planar map (section 3.1), and variants of its fifth.

All rate the same finite sample of candidates, positions that can be reached times a cycle of
headings, by Eqs. 22 and 23; they differ in what NI is:

- `random`: no rating, any candidate by lot;
- `raster`: no rating, the next position row by row, to and fro, where no look was taken yet;
- `max-new`: unmapped cells in view, known obstacles accounted for, unknown ones not;
- `min-old`: the frontier strategy: as few mapped cells in view as possible, and something new;
- `information`: Eq. 8, the paper's own, over Markov estimates of unknown cells, which also hide;
- `information-entropy`: Eq. 6 over the stretched probabilities of Eq. 7;
- `information-voxel`: the sum of h(p) over the cells in view, which Eq. 8 was meant to be.

A cell that was expected and not measured loses interest (Eq. 9), for all of them alike: else
the first cell that can't be seen would hold a robot for ever. All stop by one measure too: when no
candidate is expected to map `min_gain_cells` cells.
"""

import math
from abc import ABC, abstractmethod
from typing import Protocol

import numpy as np

from agents.geometry import Bools, Floats, Ints, Pose
from agents.planar.casting import Star, first_ray, gains, tallies, visibility, windows
from agents.planar.scene import Means, Scene
from agents.planar.view import PlanarLook, PlanarView
from agents.planning.information import Interest, binary_entropy, plogp, stretched
from agents.planning.rating import rate

BINS = 33
"""Bins of the histograms of Eqs. 6 and 8."""
RINGS = 8
"""Distances at which Eq. 7 is told apart."""
CLAIM_AHEAD = 0.6
"""A claim's disc lies this share of the range ahead of the camera ..."""
CLAIM_RADIUS = 0.5
"""... and has this share of it as radius."""


class PlanarMethod(Protocol):
    """Chooses looks for one robot."""

    def choose(self, view: PlanarView, rng: np.random.Generator) -> PlanarLook | None:
        """Return the next look, or None when no look is expected to map enough."""
        ...


class Memory:
    """What a robot remembers of its looks: the cells that it expected and did not get (Eq. 9)."""

    def __init__(self, beta: float, *, sure: float = 1.0) -> None:
        """Begin with full interest; of the chances that are expected the power `sure` counts."""
        self._beta = beta
        self._sure = sure
        self._interest: Interest | None = None
        self._expected: Floats | None = None
        self._before: Floats | None = None

    def interest(self, view: PlanarView) -> Floats:
        """Return every cell's interest, the last look's outcome taken in."""
        if self._interest is None:
            self._interest = Interest(view.frame.shape, self._beta)
        if self._expected is not None and self._before is not None:
            got = view.mapped | (view.log_odds != self._before)
            self._interest.update(self._expected, got)
            self._expected = None
        return self._interest.share

    def expect(self, scene: Scene, cell: tuple[int, int], first: int) -> None:
        """Note what the look that was chosen should show."""
        self.expect_seen(scene.view, seen_by(scene, cell, first))

    def expect_seen(self, view: PlanarView, seen_p: Floats) -> None:
        """Note each cell's chance (rows, cols) of being seen by the look that was chosen."""
        self._expected = seen_p**self._sure
        self._before = view.log_odds


def seen_by(scene: Scene, cell: tuple[int, int], first: int) -> Floats:
    """Return each cell's chance (rows, cols) of being seen by one look."""
    eye = np.array(cell, dtype=np.int64)
    return visibility(scene.through, scene.rays, eye, first, related=scene.related)


def look_at(scene: Scene, cell: tuple[int, int], yaw_rad: float, gain: float) -> PlanarLook:
    """Return the look from a cell's centre, with the way there and what team-mates are told."""
    path_m = scene.path_m(cell)
    x_m, y_m = (float(v) for v in path_m[-1])
    range_m = scene.means.sensor.range_m
    ahead_m = CLAIM_AHEAD * range_m
    claim = (
        x_m + ahead_m * math.cos(yaw_rad),
        y_m + ahead_m * math.sin(yaw_rad),
        CLAIM_RADIUS * range_m,
    )
    return PlanarLook(Pose(x_m, y_m, 0.0, yaw_rad), path_m, gain, claim)


def expected_cells(scene: Scene, eyes: Ints) -> Floats:
    """Return how many cells' worth of log-odds (E, B) looks from these cells add, by first ray."""
    by_bearing = gains(scene.through, scene.lacking, scene.worth, scene.rays, eyes)
    return windows(by_bearing, scene.rays.width)


class _Sampled(ABC):
    """What the paper's methods share: candidates, stop and memory."""

    def __init__(self, means: Means) -> None:
        self._means = means
        self._memory = Memory(means.planner.beta)

    def choose(self, view: PlanarView, rng: np.random.Generator) -> PlanarLook | None:
        """Return the next look, or None when no look is expected to map enough."""
        scene = Scene(view, self._means, self._memory.interest(view))
        count = self._means.planner.headings
        yaws = 2.0 * math.pi * np.arange(count) / count
        firsts = np.array([first_ray(float(yaw), scene.rays.width) for yaw in yaws])
        eyes = scene.candidates(rng)
        cells = expected_cells(scene, eyes)[:, firsts]
        least = max(self._means.planner.min_gain_cells, 1e-9)
        if float(cells.max()) < least:  # the lattice may have stepped over a passage
            eyes = scene.sampled(scene.everywhere(), rng)
            cells = expected_cells(scene, eyes)[:, firsts]
        if float(cells.max()) < least:
            return None
        place, heading = self._pick(scene, eyes, firsts, cells, rng)
        cell = (int(eyes[place, 0]), int(eyes[place, 1]))
        self._memory.expect(scene, cell, int(firsts[heading]))
        gain = float(cells[place, heading])
        return look_at(scene, cell, float(yaws[heading]), gain)

    @abstractmethod
    def _pick(
        self, scene: Scene, eyes: Ints, firsts: Ints, cells: Floats, rng: np.random.Generator
    ) -> tuple[int, int]:
        """Return which position and heading, of those that map so many cells (E, H)."""


class _Rated(_Sampled):
    """Those that take the look that Eq. 23 likes best; they differ in its NI."""

    def _pick(
        self, scene: Scene, eyes: Ints, firsts: Ints, cells: Floats, rng: np.random.Generator
    ) -> tuple[int, int]:
        worth = self._worth(scene, eyes, firsts)
        worthy = (cells >= self._means.planner.min_gain_cells) & (worth > 0)
        if not worthy.any():
            worthy, worth = cells >= self._means.planner.min_gain_cells, cells
        rating = np.where(worthy, rated(scene, eyes, worth), -np.inf)
        place, heading = np.unravel_index(int(np.argmax(rating)), rating.shape)
        return int(place), int(heading)

    @abstractmethod
    def _worth(self, scene: Scene, eyes: Ints, firsts: Ints) -> Floats:
        """Return NI (E, H) of Eq. 23."""


def rated(scene: Scene, eyes: Ints, worth: Floats) -> Floats:
    """Return RF (E, H) of Eq. 23 for a worth NI (E, H) of looks."""
    planner, drive = scene.means.planner, scene.means.drive
    way_m = scene.way_m[eyes[:, 0], eyes[:, 1]]
    variance = scene.view.variance
    sigma_m = np.sqrt(variance[0] + variance[1] + (drive.odometry_sigma * way_m) ** 2)
    unsafe = scene.occupancy_p[eyes[:, 0], eyes[:, 1]]
    unsafe[0] = 0.0
    return rate(
        worth,
        way_m[:, None],
        sigma_m[:, None],
        unsafe[:, None],
        best_bits=float(worth.max()),
        range_m=scene.means.sensor.range_m,
        cell_m=scene.view.frame.cell_m,
        planner=planner,
    )


class Random(_Sampled):
    """Method (i): any candidate, all equally likely."""

    def _pick(
        self, scene: Scene, eyes: Ints, firsts: Ints, cells: Floats, rng: np.random.Generator
    ) -> tuple[int, int]:
        return int(rng.integers(len(eyes))), int(rng.integers(len(firsts)))


class Raster(_Sampled):
    """Method (ii): the next free position in raster order where no look was taken yet."""

    def __init__(self, means: Means) -> None:
        """Begin where the robot stands."""
        super().__init__(means)
        self._been: list[tuple[float, float]] = []
        self._turns = -1

    def _pick(
        self, scene: Scene, eyes: Ints, firsts: Ints, cells: Floats, rng: np.random.Generator
    ) -> tuple[int, int]:
        frame, range_m = scene.view.frame, scene.means.sensor.range_m
        apart_m = 0.5 * range_m
        band = eyes[:, 0] // max(1, round(apart_m / frame.cell_m))
        along = np.where(band % 2 == 0, eyes[:, 1], -eyes[:, 1])
        place = 0
        for n in np.lexsort((along, band)):
            x, y = frame.centre_of(int(eyes[n, 0]), int(eyes[n, 1]))
            if all(math.hypot(x - a, y - b) >= apart_m for a, b in self._been):
                place = int(n)
                break
        else:
            self._been.clear()
        self._been.append(frame.centre_of(int(eyes[place, 0]), int(eyes[place, 1])))
        self._turns += 1
        return place, self._turns % len(firsts)


def _whole_rings(rays: Star) -> Ints:
    return np.zeros(rays.range_m.shape, dtype=np.int64)


def _most_cells(scene: Scene) -> float:
    """Return N: how many cells a look could show at most."""
    sensor = scene.means.sensor
    reach = sensor.range_m / scene.view.frame.cell_m
    return 0.5 * math.radians(sensor.fov_deg) * reach * reach + 4.0 * reach


class MaxNew(_Rated):
    """Method (iii): the largest expected unmapped region, known occlusions accounted for."""

    def _worth(self, scene: Scene, eyes: Ints, firsts: Ints) -> Floats:
        return _new_and_old(scene, eyes, firsts)[0]


class MinOld(_Rated):
    """Method (iv), the frontier strategy: the smallest mapped region in view."""

    def _worth(self, scene: Scene, eyes: Ints, firsts: Ints) -> Floats:
        new, old = _new_and_old(scene, eyes, firsts)
        return np.where(new > 0, new / np.maximum(new + old, 1.0), 0.0)


def _new_and_old(scene: Scene, eyes: Ints, firsts: Ints) -> tuple[Floats, Floats]:
    """Return how many unmapped and mapped cells are in view if unknown ones hide nothing."""
    through = np.where(scene.view.log_odds > 0, 0.0, 1.0)
    classes = scene.view.mapped.astype(np.int64)[None]
    # Cells that proved not to be visible are neither new nor old (Eq. 9).
    classes[0][~scene.view.mapped & (scene.interest < 0.5)] = 2
    rings = _whole_rings(scene.rays)
    counts = tallies(through, classes, rings, scene.rays, eyes, firsts, 3)
    return counts[..., 0], counts[..., 1]


class Histogrammed(_Rated):
    """Method (v): Eq. 8, bins of p weighted by their own entropy, known and unknown apart."""

    def _worth(self, scene: Scene, eyes: Ints, firsts: Ints) -> Floats:
        share = self._shares(scene, eyes, firsts)
        weight = np.tile(binary_entropy(np.arange(BINS) / (BINS - 1)), 2)
        return (weight * plogp(share)).sum(axis=-1)

    def _shares(self, scene: Scene, eyes: Ints, firsts: Ints) -> Floats:
        """Return q (E, H, 2 BINS): known bins, then unknown ones."""
        bins = np.rint(scene.occupancy_p * (BINS - 1)).astype(np.int64)
        classes = np.where(scene.measured, bins, bins + BINS)
        classes[_dull(scene)] = 0
        counts = tallies(
            scene.through, classes[None], _whole_rings(scene.rays), scene.rays, eyes, firsts,
            2 * BINS,
        )  # fmt: skip
        return counts / _most_cells(scene)


def _dull(scene: Scene) -> Bools:
    """Return the cells (rows, cols) that proved not to be visible (Eq. 9, as a yes or no)."""
    return ~scene.view.mapped & (scene.interest < 0.5)


class Stretched(_Rated):
    """Method (v) by Eq. 6, over probabilities stretched by certainty and distance (Eq. 7)."""

    def _worth(self, scene: Scene, eyes: Ints, firsts: Ints) -> Floats:
        range_m = scene.means.sensor.range_m
        reference_m = 0.5 * range_m
        ring_m = (np.arange(RINGS) + 0.5) / RINGS * range_m
        p = stretched(scene.occupancy_p[None], ring_m[:, None, None], reference_m)
        bins = np.rint(p * (BINS - 1)).astype(np.int64)
        classes = np.where(scene.measured[None], bins, bins + BINS)
        classes[:, _dull(scene)] = 0
        rings = np.minimum((scene.rays.range_m / range_m * RINGS).astype(np.int64), RINGS - 1)
        counts = tallies(scene.through, classes, rings, scene.rays, eyes, firsts, 2 * BINS)
        return plogp(counts / _most_cells(scene)).sum(axis=-1)


class Voxel(Histogrammed):
    """Method (v) as it was meant: the sum of h(p) over the cells in view, by N."""

    def _worth(self, scene: Scene, eyes: Ints, firsts: Ints) -> Floats:
        share = self._shares(scene, eyes, firsts)
        weight = np.tile(binary_entropy(np.arange(BINS) / (BINS - 1)), 2)
        return (weight * share).sum(axis=-1)
