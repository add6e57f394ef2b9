"""Two maps of a floor: walls meet walls, and none stands where the other map has open floor."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage

from agents.geometry import Bools, Floats, GridFrame
from agents.joining.fitting import Fit, Moving
from agents.joining.placing import Pair
from agents.joining.searching import Strewn, alike, around, middles_m, reach_m, turning
from agents.joining.verdict import Judged, Needs
from agents.joining.walls import Lines
from agents.maps.occupancy import MAPPED

MISSED = 0.35
"""A wall of one map meets none of the other's so often, half a cell and half a turn's step off."""
MOST_CELLS = 400
"""Sides of both maps together, in cells of the search."""
COMMON_M = (3.0, 0.08)
"""Cells of walls within so many metres share an error of so many: that of what they fell into."""
CLEAR_CELLS = 1
"""A wall contradicts open floor that is at least so far from the other map's walls."""
WRONG = 0.03
"""Share of walls that meet open floor where both maps are of the same floor."""
LEAST_M2, OVERLAP = 45.0, 0.15
"""So much floor must overlap, and such a share of the own map."""
ALIKE = 4.0
"""So many cells of a wall tell no more than one."""
INFLATION = 1.0


def strewn(frame: GridFrame, log_odds: Floats) -> Strewn:
    """Return the mapped cells; planes are the number of solid and of free ones."""
    mapped = np.abs(log_odds) > MAPPED
    solid = log_odds[mapped] > 0
    return Strewn(middles_m(frame, mapped), np.stack((solid, ~solid)).astype(np.float64))


@dataclass(frozen=True)
class Walls:
    """`agents.joining.searching.Comparing` of floors.

    What a pair of cells says is the likelihood ratio of their states, by the share that is solid.
    """

    solid_share: float

    @property
    def mix(self) -> Floats:
        """See `Comparing.mix`; channels are known, and solid."""
        share = min(max(self.solid_share, 0.01), 0.6)
        both = math.log((1.0 - MISSED) / share)
        one = math.log(MISSED / (1.0 - share))
        none = math.log(max(1.0 - share * (1.0 + MISSED), 0.05) / (1.0 - share) ** 2)
        return np.array(((none, one - none), (one - none, both + none - 2.0 * one)))

    def channels(self, planes: Floats, cell_m: float) -> Floats:
        """See `Comparing.channels`."""
        del cell_m
        solid = planes[0] > 0
        return np.stack((solid | (planes[1] > 0), solid)).astype(np.float64)


@dataclass(frozen=True)
class _States:
    """What is mapped of a floor, to be asked at points."""

    frame: GridFrame
    solid: Bools
    free: Bools
    """Mapped as free, and no wall is near."""
    near: Bools
    """Solid, or next to it."""

    @staticmethod
    def of(strewn: Strewn, cell_m: float) -> "_States":
        """Return the states of a map on the least grid that holds it."""
        frame = around(strewn, cell_m)
        planes = strewn.binned(frame)
        solid = planes[0] > 0
        near = _grown(solid, 1)
        return _States(frame, solid, (planes[1] > 0) & ~_grown(solid, CLEAR_CELLS), near)

    def at(self, xy_m: Floats) -> tuple[Bools, Bools]:
        """Return which points (N, 2) lie at a wall, and which well within open floor."""
        cells = self.frame.cells_of(xy_m)
        inside = ((cells >= 0) & (cells < self.frame.shape)).all(axis=1)
        row, col = np.where(inside, cells[:, 0], 0), np.where(inside, cells[:, 1], 0)
        near: Bools = inside & self.near[row, col]
        return near, inside & self.free[row, col] & ~near

    @property
    def chance(self) -> float:
        """Share of the mapped cells that lie at a wall."""
        known = self.solid | self.free
        return float((self.near & known).sum() / max(known.sum(), 1))


def _grown(solid: Bools, cells: int) -> Bools:
    wide = np.ones((2 * cells + 1, 2 * cells + 1))
    return np.asarray(ndimage.binary_dilation(solid, wide), dtype=np.bool_)


class Floor(Pair):
    """Two maps of a floor."""

    @cached_property
    def times(self) -> int:
        """See `Pair.times`."""
        grid = around(self.team, self.cell_m)
        side_m = max(grid.shape) * self.cell_m + 2.0 * reach_m(self.own)
        return max(1, math.ceil(side_m / self.cell_m / MOST_CELLS))

    @cached_property
    def states(self) -> tuple[_States, _States]:
        """The own map's and the team's."""
        return _States.of(self.own, self.cell_m), _States.of(self.team, self.cell_m)

    @cached_property
    def walls(self) -> tuple[Floats, Floats]:
        """The places (N, 2) of solid cells, own and the team's."""
        own, team = (s.xy_m[s.planes[0] > 0] for s in (self.own, self.team))
        return own, team

    @cached_property
    def field(self) -> Lines:
        """The team's walls."""
        return Lines(self.walls[1], self.cell_m)

    @cached_property
    def broad(self) -> Lines:
        """See `Pair.broad`: the directions of walls are those of many cells as it is."""
        return self.field

    @cached_property
    def moving(self) -> Moving:
        """The own walls, which are to lie on the team's."""
        places = self.walls[0]
        nothing = np.zeros(len(places))
        return Moving(places, nothing, nothing, COMMON_M, lifts=False)

    def judge(self, found: Fit) -> Judged:
        """Return what speaks for a place: walls at walls, less those in open floor."""
        own, team = self.states
        home = (self.walls[1] - (found.x_m, found.y_m)) @ turning(found.turn_rad)
        hits, misses = 0, 0
        for states, places in ((team, found.carried(self.walls[0])), (own, home)):
            near, open_floor = states.at(places)
            hits += int(near.sum())
            misses += int(open_floor.sum())
        cells = int(np.count_nonzero(np.logical_or(*team.at(found.carried(self.own.xy_m)))))
        chance = min(max(0.5 * (own.chance + team.chance), 0.02), 0.9)
        gain = hits * math.log((1.0 - WRONG) / chance) + misses * math.log(WRONG / (1.0 - chance))
        agreement = hits / max(hits + misses, 1)
        return Judged(found, cells * self.cell_m**2, gain / self.alike, agreement)

    @cached_property
    def needs(self) -> Needs:
        """See `Needs`."""
        return Needs(
            overlap_m2=max(LEAST_M2, OVERLAP * self.own.size * self.cell_m**2), evidence=22.0,
            agreement=0.93, rival=0.55, sigma_m=self.cell_m, sigma_rad=0.04,
            apart_m=2.0 * self.cell_m, inflation=INFLATION, alike=0.9,
        )  # fmt: skip

    @cached_property
    def alike(self) -> float:
        """How many cells of walls tell no more than one: walls are long."""
        planes = self.team.binned(around(self.team, self.cell_m))
        solid, known = planes[0] > 0, (planes[0] > 0) | (planes[1] > 0)
        apart = np.where(known, solid - solid.sum() / known.sum(), 0.0)
        return max(ALIKE, alike(apart[None], known.astype(np.float64)))

    @cached_property
    def comparing(self) -> Walls:
        """By how much of the team's map is solid."""
        coarse = self.team.binned(self.grid)
        known = ((coarse[0] > 0) | (coarse[1] > 0)).sum()
        return Walls(float((coarse[0] > 0).sum() / known))

    def poor(self) -> str:
        """See `Pair.poor`."""
        few = min(len(places) for places in self.walls) < 12
        return "one of the maps shows too few walls" if few else ""

    def shared(self, found: Fit) -> Bools:
        """See `Pair.shared`."""
        near, open_floor = self.states[1].at(found.carried(self.own.xy_m))
        return near | open_floor
