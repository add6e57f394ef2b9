"""`team-information` on voxel maps: several looks chosen together, by what they map per second.

It differs from the paper's fifth method in four ways:

- what a look is worth are the cells that it should map, and what it costs is time: the way, the
  turns and the looking;
- looks are chosen together: the best one, two, ... that lie side by side at a place, and then the
  best second place from there; the robot takes the first look of the best pair of places, and then
  chooses anew;
- the place is refined to single cells, and the heading to single bearings;
- looks count less where team-mates said they will look, or stand nearer. Nobody leads: a team-mate
  that falls silent drops out of the view, and with it what it claimed.
"""

import math
from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, Ints
from agents.planar.looksets import look_sets
from agents.planar.sensing import MAPPED
from agents.voxel.casting import BEARINGS, DISTANCES, Kinds, cast
from agents.voxel.methods import CLAIM_AHEAD, CLAIM_RADIUS, chosen_look
from agents.voxel.scene import Scene
from agents.voxel.view import Means, VoxelChoice, VoxelView

MOST_LOOKS = 4
"""Looks that are chosen together at one place."""
LOOKS: Floats = np.arange(1, MOST_LOOKS + 1, dtype=np.float64)
FIRSTS = 6
"""So many of the best places are tried as the first of two."""
REFINED_M = 0.6
"""How far about the best place a better one is looked for."""
TURN_RAD = 1.0
"""What a look makes a robot turn, about."""
CLAIMED = 0.1
"""What a look counts that shows what a team-mate said it will look at."""
THEIRS = 0.5
"""What a look counts into what a team-mate stands nearer to."""


@dataclass(frozen=True)
class Sets:
    """The best sets of looks at places (E,): of 1, ..., `MOST_LOOKS`."""

    cells: Floats
    """(E, M) that a whole set is expected to map."""
    best: Floats
    """(E,) that the best single look is."""
    first: Ints
    """(E,) first bearing of that look."""
    tilt: Ints
    """(E,) which of the planner's tilts it has."""


class TeamInformation:
    """Ours; see above."""

    def __init__(self, means: Means) -> None:
        """Take what the robot has."""
        self._means = means

    def choose(self, view: VoxelView, rng: np.random.Generator) -> VoxelChoice | None:
        """Return the next look, or None when no look is expected to map enough."""
        scene, least = Scene(view, self._means), self._means.planner.min_gain_cells
        places = scene.candidates(rng)
        sets = self._sets(scene, places)
        if float(sets.best.max()) < max(least, 1e-9):  # the sample may have left out the last one
            places = scene.everywhere()
            sets = self._sets(scene, places)
        if float(sets.best.max()) < max(least, 1e-9):
            return None
        place = int(places[self._first_of_two(scene, places, sets)])
        around = self._around(scene, place)
        refined = self._sets(scene, around)
        at = int(np.argmax(self._rate(refined, scene.way_to_m(around))))
        width = scene.star.width
        yaw_rad = (float(refined.first[at]) + 0.5 * width) / BEARINGS * 2.0 * math.pi
        tilt_rad = math.radians(self._means.planner.tilts_deg[int(refined.tilt[at])])
        return chosen_look(scene, int(around[at]), yaw_rad, tilt_rad, float(refined.best[at]))

    def _sets(self, scene: Scene, places: Ints) -> Sets:
        """Return the best sets of looks at places (E,); looks of too little count nothing."""
        star, least = scene.star, max(self._means.planner.min_gain_cells, 1e-9)
        by_ray, _ = cast(scene.matter, alike(scene), star, scene.eyes(places))
        share = not_theirs(scene, places)
        found: list[tuple[Floats, Ints]] = []
        for tilt_deg in self._means.planner.tilts_deg:
            ring = star.ring(by_ray, math.radians(tilt_deg)) * share
            found.append(look_sets(ring / MAPPED, star.width, MOST_LOOKS))
        gain = np.stack([part for part, _ in found])
        first = np.stack([part for _, part in found])
        cells = np.where(gain >= least, gain, 0.0).sum(axis=3)
        tilt = np.argmax(gain[:, :, 0, 0], axis=0)
        each = np.arange(len(places))
        return Sets(
            cells.max(axis=0),
            gain[tilt, each, 0, 0],
            first[tilt, each, 0, 0].astype(np.int64),
            tilt.astype(np.int64),
        )

    def _seconds(self, way_m: Floats, looks: Floats) -> Floats:
        drive, sensor = self._means.drive, self._means.sensor
        turning_s = TURN_RAD / drive.turn_rate_radps
        return way_m / drive.speed_mps + looks * (sensor.look_s + turning_s)

    def _rate(self, sets: Sets, way_m: Floats) -> Floats:
        """Return the most cells per second (E,) that a place's sets map."""
        return (sets.cells / self._seconds(way_m[:, None], LOOKS)).max(axis=1)

    def _first_of_two(self, scene: Scene, places: Ints, sets: Sets) -> int:
        """Return which place begins the pair that maps the most cells per second."""
        way_m = scene.way_to_m(places)
        alone = self._rate(sets, way_m)
        spots = scene.view.frame.centres_m(scene.eyes(places))
        best, chosen = -1.0, 0
        for n in np.argsort(-alone, kind="stable")[:FIRSTS]:
            rate = float(alone[n])
            if places[n] >= 0:
                onward_m = scene.ground.field(int(places[n]))[0] * scene.view.frame.cell_m
                on_m = np.where(places < 0, np.inf, onward_m[places])
                # What both may see counts once: the nearer they are, the more that is.
                apart = np.linalg.norm(spots - spots[n], axis=1) / self._means.sensor.range_m
                more = sets.cells * np.minimum(apart, 1.0)[:, None]
                so_many = int(np.argmax(sets.cells[n] / self._seconds(way_m[n], LOOKS)))
                spent_s = self._seconds(way_m[n] + on_m[:, None], LOOKS + LOOKS[so_many])
                rate = max(rate, float(((sets.cells[n, so_many] + more) / spent_s).max()))
            if rate > best:
                best, chosen = rate, int(n)
        return chosen

    def _around(self, scene: Scene, place: int) -> Ints:
        """Return the places (N,) about one, itself first."""
        if place < 0:
            return np.array([place])
        cells = scene.ground.cells
        near = np.abs(cells - cells[place]).max(axis=1) * scene.view.frame.cell_m <= REFINED_M
        found = np.flatnonzero(near & np.isfinite(scene.way_m))
        return np.concatenate((np.array([place]), found[found != place]))


def alike(scene: Scene) -> Kinds:
    """Tell no cells apart."""
    of = np.zeros(scene.log_odds.shape, dtype=np.uint8)
    return Kinds(of, 0, np.zeros((DISTANCES, 1), dtype=np.int64), 1)


def not_theirs(scene: Scene, places: Ints) -> Floats:
    """Return by how much looks towards each bearing (E, B) count, given what team-mates do.

    A look is taken for the disc that it would claim.
    """
    view, range_m = scene.view, scene.means.sensor.range_m
    spots = view.frame.centres_m(scene.eyes(places))[:, :2]
    bearing = 2.0 * math.pi * (np.arange(BEARINGS) + 0.5) / BEARINGS
    ahead = CLAIM_AHEAD * range_m * np.column_stack((np.cos(bearing), np.sin(bearing)))
    discs = spots[:, None] + ahead[None]
    share = np.ones(discs.shape[:2])
    own_m = np.hypot(*(discs - np.array((view.pose.x_m, view.pose.y_m))).transpose(2, 0, 1))
    for other in view.others:
        their_m = np.hypot(*(discs - np.array((other.x_m, other.y_m))).transpose(2, 0, 1))
        share[their_m < own_m] = THEIRS
    for x, y, radius_m in view.claims:
        apart_m = np.hypot(*(discs - np.array((x, y))).transpose(2, 0, 1))
        overlap = np.maximum(0.0, 1.0 - apart_m / (radius_m + CLAIM_RADIUS * range_m))
        share = np.minimum(share, 1.0 - (1.0 - CLAIMED) * overlap)
    return share
