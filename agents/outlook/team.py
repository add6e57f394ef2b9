"""`team-information` on the ground: looks chosen together, refined, and apart from team-mates'.

It differs from the paper's fifth method in these:

- a look is worth the cells that it is expected to add, `P` for each, not `h(P / 2)` (Eq. 3), which
  makes ten cells of which one will be seen worth as much as three that are seen for sure;
- a cell that was measured is worth `AGAIN` of a fresh one;
- where cells failed to be measured, their neighbours are trusted less too (`outlook.trust`), so
  that ground without texture is not tried piece by piece;
- looks are chosen together: the first of the best route of `DEPTH` looks, each taking from those
  after it what it shows;
- heading, tilt and place are refined, down to degrees and single cells.

What team-mates said that they will look at counts less already (`planning.scene`): nobody leads,
and one that falls silent drops out of the view with its claim.
"""

import math

import numpy as np

from agents.geometry import Floats, Ints, Pose, Singles
from agents.ground.markov import Border
from agents.outlook.survey import Look, Site, Survey, after
from agents.outlook.trust import trust
from agents.planning.looks import Gains, LookPlan, expected_visibility, plan
from agents.planning.rating import rate
from agents.planning.scene import Scene, View

SIGHT: Border = "mirror"
"""Unknown ground is taken to go on as the known does at its rim, not to fall away."""
AGAIN = 0.15
"""What a cell counts that was measured, but not yet `n_max` times."""
DEPTH = 3
"""Looks of a route."""
HEADS = 4
"""Routes that are compared."""
APART_CELLS = 8.0
"""Their first places lie so far apart, or their first looks point elsewhere."""
TURNED_RAD = math.radians(40.0)
REFINED = ((4, 2), (1, 1))
"""Half widths and steps, in cells, of the squares in which a place is refined."""


class TeamInformation:
    """Ours; see above."""

    def expect(self, view: View, pose: Pose, pan_rad: float, tilt_rad: float) -> Singles:
        """Return each cell's probability (H, W) of being measured in a look from a pose."""
        return expected_visibility(view, pose, pan_rad, tilt_rad, sight=SIGHT)

    def choose(self, view: View, rng: np.random.Generator) -> LookPlan | None:
        """Return the first look of the best route found, None where no look is worth it."""
        return _Choice(view).plan()


class _Choice:
    """One choice in the making."""

    def __init__(self, view: View) -> None:
        self.scene = Scene(view, again=AGAIN, trust=trust(view), sight=SIGHT)
        self.survey = Survey(self.scene)
        self.cells = self.scene.candidates
        self.sites = [self._site(cell) for cell in self.cells]
        if len(self.cells) == 1:
            # It can drive nowhere yet: it has to see the ground before its wheels.
            self.survey.tilts_rad = self.survey.tilts_rad.min(keepdims=True)
        self.way_m = self.scene.travel[0][self.cells[:, 0], self.cells[:, 1]]

    def _site(self, cell: Ints) -> Site:
        return self.survey.site((int(cell[0]), int(cell[1])))

    def plan(self) -> LookPlan | None:
        """Return the chosen look."""
        worth = self.survey.worth
        looks = [self.survey.best(site, worth) for site in self.sites]
        gains = np.array([look.gain for look in looks])
        least = max(self.scene.view.planner.min_gain_cells, 1e-9)
        if gains.max() < least:
            return None
        ratings = np.where(gains >= least, self._rated(gains, self.cells, self.way_m), -np.inf)
        heads = self._heads(ratings, looks)
        routes = [self._route(n, looks[n], worth) for n in heads]
        n = heads[int(np.argmax(routes))]
        cell, look = self._refined(n, looks[n], worth)
        return self._planned(cell, look, float(ratings[n]))

    def _rated(self, gains: Floats, cells: Ints, way_m: Floats) -> Floats:
        """Return Eq. 23 of looks with these gains (N,), from cells (N, 2) so far off (N,)."""
        scene, view = self.scene, self.scene.view
        unsafe = scene.unsafe_p[cells[:, 0], cells[:, 1]]
        unsafe[(cells == np.array(scene.cell)).all(axis=1)] = 0.0
        return rate(
            gains,
            way_m,
            scene.arrival_sigma_m(way_m),
            unsafe,
            best_bits=max(float(gains.max()), 1e-9),
            range_m=view.sensor.range_m,
            cell_m=view.frame.cell_m,
            planner=view.planner,
        )

    def _heads(self, ratings: Floats, looks: list[Look]) -> list[int]:
        """Return the best first looks that are not nearly the same."""
        heads: list[int] = []
        for n in np.argsort(-ratings, kind="stable"):
            if not np.isfinite(ratings[n]):
                break
            if all(self._differ(int(n), other, looks) for other in heads):
                heads.append(int(n))
            if len(heads) == HEADS:
                break
        return heads

    def _differ(self, one: int, other: int, looks: list[Look]) -> bool:
        apart = float(np.hypot(*(self.cells[one] - self.cells[other])))
        turn = looks[one].heading_rad - looks[other].heading_rad
        turn = abs((turn + math.pi) % (2.0 * math.pi) - math.pi)
        return apart >= APART_CELLS or turn >= TURNED_RAD

    def _route(self, first: int, look: Look, worth: Floats) -> float:
        """Return the worth of a route that begins with a look: gains less its way, in cells."""
        view = self.scene.view
        metre = view.planner.w_distance / view.sensor.range_m * look.gain
        at, total = first, look.gain - metre * float(self.way_m[first])
        for _ in range(DEPTH - 1):
            worth = after(worth, self.survey.shown(self.sites[at], look))
            nexts = [self.survey.best(site, worth) for site in self.sites]
            ways_m = np.hypot(*(self.cells - self.cells[at]).T) * view.frame.cell_m
            value = np.array([n.gain for n in nexts]) - metre * ways_m
            at = int(value.argmax())
            look = nexts[at]
            total += float(value[at])
        return total

    def _refined(self, n: int, look: Look, worth: Floats) -> tuple[tuple[int, int], Look]:
        """Return a better place and look near a good one."""
        place = self.cells[n]
        look = self.survey.refined(self.sites[n], worth, look)
        if n == 0:
            return self.scene.cell, look
        shape = np.array(self.scene.view.frame.shape)
        for half, step in REFINED:
            side = np.arange(-half, half + 1, step)
            around = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
            around = np.concatenate((place[None], around + place))
            around = around[((around >= 0) & (around < shape)).all(axis=1)]
            way_m = self.scene.travel[0][around[:, 0], around[:, 1]]
            may = np.isfinite(way_m) & (self.scene.cost[around[:, 0], around[:, 1]] <= 1.0)
            around, way_m = around[may], way_m[may]
            looks = [self.survey.refined(self._site(c), worth, look) for c in around]
            ratings = self._rated(np.array([each.gain for each in looks]), around, way_m)
            best = int(ratings.argmax())
            place, look = around[best], looks[best]
        return (int(place[0]), int(place[1])), look

    def _planned(self, cell: tuple[int, int], look: Look, rating: float) -> LookPlan:
        here = cell == self.scene.cell
        cells = np.array((self.scene.cell, cell))
        gains = Gains(
            cells,
            np.array((look.heading_rad,)),
            np.array((look.tilt_rad,)),
            np.full((2, 1, 1), look.gain),
            self.scene.travel[0][cells[:, 0], cells[:, 1]],
        )
        return plan(self.scene, gains, (0 if here else 1, 0, 0), rating)
