"""`team-information`: routes of several looks, from what rays are likely to meet in the unknown.

It differs from the paper's fifth method in five ways:

- rays into the unknown end where the robot has learned that they do (`hazard`), so that the walls
  that go on and the shadows behind them are told from open floor;
- a far cell that a look leaves half sure counts in part, and the rest when it is made sure;
- looks are chosen together: all that are worth taking at a place, and the next place with it, by
  what they yield per effort (`sites`); what shows little waits while much is to be had elsewhere;
- the best places are refined, down to single cells and degrees;
- cells that team-mates said they will look at, or stand nearer to, count less. Nobody leads: a
  team-mate that falls silent drops out of the view, and with it what it claimed.
"""

import numpy as np

from agents.geometry import Floats, Ints
from agents.planar.casting import yaw_of
from agents.planar.hazard import Hazard
from agents.planar.methods import Memory, look_at
from agents.planar.scene import Means, Scene
from agents.planar.sites import Sites, ahead, rates, survey
from agents.planar.view import PlanarLook, PlanarView

RELATED = 0.6
"""Cells along a ray stand or fall together: this power of their chances fits what was measured."""
SMALL = 0.3
"""While a look is to be had somewhere, those that show less than this share of it wait."""
HEADS = 3
"""Routes that are compared."""
APART_CELLS = 8.0
"""Their first places lie at least so far apart."""
REFINED = ((6, 2), (2, 1))
"""Half widths and steps, in cells, of the squares in which a place is refined."""
CLAIMED = 0.1
"""What a cell counts that a team-mate said it will look at."""
THEIRS = 0.5
"""What a cell counts that a team-mate stands nearer to."""


class TeamInformation:
    """Ours; see above."""

    def __init__(self, means: Means) -> None:
        """Begin with nothing seen and nothing learned."""
        self._means = means
        self._memory = Memory(means.planner.beta)
        self._hazard = Hazard()

    def choose(self, view: PlanarView, rng: np.random.Generator) -> PlanarLook | None:
        """Return the next look, or None when no look is expected to map `min_gain_cells` cells."""
        interest = self._memory.interest(view) * _not_theirs(view)
        solid_p = self._hazard.take(view)
        scene = Scene(view, self._means, interest, pass_p=(1.0 - solid_p) ** RELATED)
        least = max(self._means.planner.min_gain_cells, 1e-9)
        sites = survey(scene, scene.worth, scene.candidates(rng), least)
        if not sites.gain.any():
            return None
        least = max(least, SMALL * float(sites.gain.max()))
        cell, first, gain = _refined(scene, _best(scene, sites.of(least), least), least)
        self._memory.expect(scene, cell, first)
        yaw_rad = float(yaw_of(np.array(first), scene.rays.width))
        return look_at(scene, cell, yaw_rad, gain)


def _not_theirs(view: PlanarView) -> Floats:
    """Return by how much cells (rows, cols) count, given what team-mates do."""
    frame, share = view.frame, np.ones(view.frame.shape)
    rows, cols = np.indices(frame.shape)
    x_m = frame.x_m + (cols + 0.5) * frame.cell_m
    y_m = frame.y_m + (rows + 0.5) * frame.cell_m
    own_m = np.hypot(x_m - view.pose.x_m, y_m - view.pose.y_m)
    for other in view.others:
        share[np.hypot(x_m - other.x_m, y_m - other.y_m) < own_m] = THEIRS
    for x, y, radius_m in view.claims:
        share[np.hypot(x_m - x, y_m - y) < radius_m] = CLAIMED
    return share


def _ways_m(scene: Scene, cells: Ints) -> Floats:
    return scene.way_m[cells[:, 0], cells[:, 1]]


def _best(scene: Scene, sites: Sites, least: float) -> Ints:
    """Return the first place (2,) of the best of some routes."""
    rate, sets = rates(sites, _ways_m(scene, sites.cells))
    heads: list[int] = []
    for at in np.argsort(-rate, kind="stable"):
        away = [float(np.hypot(*(sites.cells[at] - sites.cells[head]))) for head in heads]
        if rate[at] > 0 and all(apart >= APART_CELLS for apart in away):
            heads.append(int(at))
        if len(heads) == HEADS:
            break
    worth = [ahead(scene, sites, head, int(sets[head]), least) for head in heads]
    return sites.cells[heads[int(np.argmax(worth))]]


def _refined(scene: Scene, place: Ints, least: float) -> tuple[tuple[int, int], int, float]:
    """Return the best cell about a place, with its best look's first ray and gain."""
    first, gain = 0, 0.0
    for half, step in REFINED:
        side = np.arange(-half, half + 1, step)
        around = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2) + place
        around = np.concatenate((place[None], around))
        inside = ((around >= 0) & (around < np.array(scene.view.frame.shape))).all(axis=1)
        around = around[inside]
        around = around[np.isfinite(_ways_m(scene, around))]
        sites = survey(scene, scene.worth, around, least)
        rate, sets = rates(sites, _ways_m(scene, around))
        best = int(rate.argmax())
        place, first = around[best], int(sites.first[best, sets[best], 0])
        gain = float(sites.gain[best, sets[best], 0])
    return (int(place[0]), int(place[1])), first, gain
