"""Two maps of the ground: placed by their slopes first, by their heights in the end."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from agents.geometry import Bools, Floats, GridFrame
from agents.joining.fitting import Field, Fit, Moving
from agents.joining.placing import Pair
from agents.joining.searching import Strewn, alike, around, middles_m, reach_m
from agents.joining.verdict import Judged, Needs

STEEPEST = 1.0
"""Slopes are clipped to this: what is steeper is an edge that hides its own foot."""
SPREAD = 0.35
"""Share of the slopes' own variance by which two looks at the same ground differ, half a cell and
half a turn's step off."""
OVERLAP = 0.15
"""Share of the own map that must lie on the team's."""
MOST_CELLS = 220
"""Sides of both maps together, in cells of the search."""
COMMON_M = (3.0, 0.03)
"""Cells within so many metres share an error of so many: that of the looks' levelling."""
INFLATION = 1.5
"""Blocks err alike too, and a late-comer's odometry between its places: measured, see
docs/localisation.md."""
FINENESS = 15.0
"""So many cells of the search from the middle of the own map to its edge."""
SAME_MISFIT = 1.0
"""Residuals squared, in units of their variances, of ground that is the same."""


def strewn(frame: GridFrame, elevation_m: Floats, variance_m2: Floats) -> Strewn:
    """Return the known cells; planes are sum of 1/sigma^2, of z/sigma^2, and the number."""
    known = np.isfinite(variance_m2)
    weight = 1.0 / np.maximum(variance_m2[known], 1e-8)
    planes = np.stack((weight, weight * elevation_m[known], np.ones(len(weight))))
    return Strewn(middles_m(frame, known), planes)


def heights(planes: Floats, least: float) -> tuple[Floats, Floats]:
    """Return mean height and its variance (inf unknown) of binned cells (3, rows, cols).

    Cells that fall into one err alike: they tell its height no better than one of them.
    """
    known = planes[2] >= least
    weight = np.where(known, planes[0], 1.0)
    return (
        np.where(known, planes[1] / weight, 0.0),
        np.where(known, planes[2] / weight, np.inf),
    )


def slopes(planes: Floats, cell_m: float, least: float) -> tuple[Floats, Floats, Floats]:
    """Return slopes east and north (rows, cols), 0 where unknown, and 1 where known, else 0."""
    height_m, variance = heights(planes, least)
    height_m = np.where(np.isfinite(variance), height_m, np.nan)
    east, north = np.full(height_m.shape, np.nan), np.full(height_m.shape, np.nan)
    east[:, 1:-1] = (height_m[:, 2:] - height_m[:, :-2]) / (2.0 * cell_m)
    north[1:-1] = (height_m[2:] - height_m[:-2]) / (2.0 * cell_m)
    known = np.isfinite(east) & np.isfinite(north)
    east = np.where(known, np.clip(east, -STEEPEST, STEEPEST), 0.0)
    north = np.where(known, np.clip(north, -STEEPEST, STEEPEST), 0.0)
    return east, north, known.astype(np.float64)


def _correlation(east: Floats, own_east: Floats, north: Floats, own_north: Floats) -> float:
    """Return by how much slopes (N,) of two maps are the same, but for that of the whole.

    1 are equal ones; that the ground falls off alike on both says little.
    """
    alike, size = 0.0, 1e-12
    for one, other in ((east, own_east), (north, own_north)):
        middle = 0.5 * (one.mean() + other.mean()) if len(one) else 0.0
        alike += 2.0 * float(((one - middle) * (other - middle)).sum())
        size += float(((one - middle) ** 2 + (other - middle) ** 2).sum())
    return alike / size


@dataclass(frozen=True)
class Slopes:
    """`agents.joining.searching.Comparing` of elevation maps, by the slopes of both.

    Slopes do not know how high a map lies; and their errors are short, where heights err alike
    over whole hills. A pair of slopes speaks for "the same" by the likelihood ratio of their
    difference: variance s^2 if they are the same, s^2 + 2 tau^2 if not, with tau^2 that of slopes
    on this ground.
    """

    tau2: float
    noise2: float
    least: float

    @property
    def mix(self) -> Floats:
        """See `Comparing.mix`; channels are known, slopes east and north, and their square."""
        same = self.noise2 + SPREAD * self.tau2
        other = same + 2.0 * self.tau2
        surprise, price = math.log(other / same), 0.5 * (1.0 / same - 1.0 / other)
        mix = np.diag((surprise, 2.0 * price, 2.0 * price, 0.0))
        mix[0, 3] = mix[3, 0] = -price
        return mix

    def channels(self, planes: Floats, cell_m: float) -> Floats:
        """See `Comparing.channels`."""
        east, north, known = slopes(planes, cell_m, self.least)
        return np.stack((known, east, north, east**2 + north**2))


class Ground(Pair):
    """Two maps of the ground."""

    @cached_property
    def times(self) -> int:
        """See `Pair.times`; two or more."""
        reach, grid = reach_m(self.own), around(self.team, self.cell_m)
        side_m = max(grid.shape) * self.cell_m + 2.0 * reach
        return max(2, math.ceil(max(reach / FINENESS, side_m / MOST_CELLS) / self.cell_m))

    @property
    def coarse_m(self) -> float:
        """Side of the cells of the search."""
        return self.grid.cell_m

    @property
    def least(self) -> float:
        """So many cells of the map make one of the search known."""
        return max(1.0, 0.3 * self.times**2)

    @cached_property
    def team_planes(self) -> Floats:
        """The team's map, binned."""
        return self.team.binned(self.grid)

    @cached_property
    def team_slopes(self) -> tuple[Floats, Floats, Floats]:
        """See `slopes`."""
        return slopes(self.team_planes, self.coarse_m, self.least)

    @cached_property
    def alike(self) -> float:
        """How many cells tell no more than one: half of the slopes of any four are shared."""
        east, north, known = self.team_slopes
        count = max(float(known.sum()), 1.0)
        fields = [np.where(known > 0, one - one.sum() / count, 0.0) for one in (east, north)]
        return max(4.0, alike(np.stack(fields), known))

    @cached_property
    def comparing(self) -> Slopes:
        """By what slopes of this team's map are like."""
        east, north, known = self.team_slopes
        tau2 = float((east**2 + north**2).sum() / max(known.sum(), 1.0) / 2.0)
        _, variance = heights(self.team_planes, self.least)
        is_known = np.isfinite(variance)
        noise2 = (
            float(np.median(variance[is_known])) / (2.0 * self.coarse_m**2)
            if is_known.any()
            else 1.0
        )
        return Slopes(max(tau2, 1e-6), noise2 / 4.0, self.least)

    @cached_property
    def field(self) -> Field:
        """The team's heights, twice as fine as the search, or a little finer."""
        fine = around(self.team, self.cell_m, self.times // 2)
        return Field(fine, *heights(self.team.binned(fine), 1.0))

    @cached_property
    def broad(self) -> Field:
        """See `Pair.broad`."""
        return Field(self.grid, *heights(self.team_planes, self.least))

    @cached_property
    def moving(self) -> Moving:
        """The own heights, as fine."""
        fine = around(self.own, self.cell_m, self.times // 2)
        value, variance = heights(self.own.binned(fine), 1.0)
        known = np.isfinite(variance)
        return Moving(middles_m(fine, known), value[known], variance[known], COMMON_M, lifts=True)

    def judge(self, found: Fit) -> Judged:
        """Return what speaks for a place: how slopes agree, less what heights contradict."""
        east, north, known = self.team_slopes
        moved = self.own.turned(found.turn_rad, found.x_m, found.y_m).binned(self.grid)
        own_east, own_north, own_known = slopes(moved, self.coarse_m, self.least)
        both = (known > 0) & (own_known > 0)
        cells = int(both.sum())
        share = max(0.0, _correlation(east[both], own_east[both], north[both], own_north[both]))
        for_it = -cells * math.log1p(-(min(share, 0.9999) ** 2))
        against = 0.5 * cells * max(0.0, found.misfit - SAME_MISFIT)
        contradiction = ""
        if found.misfit > SAME_MISFIT:
            contradiction = (
                f"heights differ by {math.sqrt(found.misfit):.1f} sigmas where it fits best"
            )
        overlap_m2 = cells * self.coarse_m**2
        return Judged(found, overlap_m2, (for_it - against) / self.alike, share, contradiction)

    @cached_property
    def needs(self) -> Needs:
        """See `Needs`."""
        return Needs(
            overlap_m2=OVERLAP * self.own.size * self.cell_m**2, evidence=14.0, agreement=0.75,
            rival=0.6, sigma_m=0.25 * self.coarse_m, sigma_rad=0.03, apart_m=2.0 * self.coarse_m,
            inflation=INFLATION, alike=0.8,
        )  # fmt: skip

    def poor(self) -> str:
        """See `Pair.poor`."""
        return "one of the maps is too small" if min(self.own.size, self.team.size) < 50 else ""

    def shared(self, found: Fit) -> Bools:
        """See `Pair.shared`."""
        cells = self.grid.cells_of(found.carried(self.own.xy_m))
        inside = ((cells >= 0) & (cells < self.grid.shape)).all(axis=1)
        row, col = np.where(inside, cells[:, 0], 0), np.where(inside, cells[:, 1], 0)
        shared: Bools = inside & (self.team_planes[2] > 0)[row, col]
        return shared
