"""Places to look from, each with the several looks that are worth taking there together.

A drive costs more than a look, so a place is worth what all its good looks show, not just its
best one. The looks at a place are chosen together from the same rays (`looksets`), and as many are
taken as make the most of the whole stop: the rate

    (g_1 + ... + g_m) / (m + way / LOOK_WORTH_M)

is what the stop yields per unit of effort, one look being an effort like driving `LOOK_WORTH_M`.
"""

from dataclasses import dataclass

import numpy as np

from agents import paths
from agents.geometry import Floats, Ints
from agents.planar.casting import gains, visibility
from agents.planar.looksets import look_sets
from agents.planar.scene import Scene

LOOK_WORTH_M = 2.0
"""Metres of driving that cost as much as one look (its gains saved elsewhere)."""
MOST_LOOKS = 6
"""Looks at one place, at most."""


@dataclass(frozen=True)
class Sites:
    """Places and what may be seen from each; arrays by place."""

    cells: Ints
    """(E, 2)."""
    gain: Floats
    """(E, M, M) cells that the best set of 1, ..., M looks adds, look by look, the most first."""
    first: Ints
    """(E, M, M) the first ray of each."""

    @property
    def looks(self) -> Ints:
        """(E, M) looks of each set that are worth their while."""
        return np.count_nonzero(self.gain, axis=2)

    @property
    def total(self) -> Floats:
        """(E, M) cells that each set adds."""
        return self.gain.sum(axis=2)

    def of(self, least: float) -> "Sites":
        """Return the same places where looks below `least` cells count as nothing."""
        return Sites(self.cells, np.where(self.gain >= least, self.gain, 0.0), self.first)


def survey(scene: Scene, worth: Floats, cells: Ints, least: float) -> Sites:
    """Return what looks from cells (E, 2) promise; looks below `least` cells count as nothing."""
    by_bearing = gains(scene.through, scene.lacking, worth, scene.rays, cells)
    gain, first = look_sets(by_bearing, scene.rays.width, MOST_LOOKS)
    return Sites(cells, gain, first).of(least)


def rates(sites: Sites, way_m: Floats) -> tuple[Floats, Ints]:
    """Return each place's best rate (E,) and which set (E,) has it; `way_m` (E,) leads there."""
    effort = sites.looks + way_m[:, None] / LOOK_WORTH_M
    each = sites.total / np.maximum(effort, 1e-9)
    most = each.argmax(axis=1)
    return each[np.arange(len(each)), most], most


def ahead(scene: Scene, sites: Sites, at: int, chosen: int, least: float) -> float:
    """Return the rate of a route: a set of looks at one place, then one at the next best place."""
    way_m = scene.way_m[sites.cells[:, 0], sites.cells[:, 1]]
    cells, eye = sites.cells, sites.cells[at]
    worth = scene.worth.copy()
    for first in sites.first[at, chosen][sites.gain[at, chosen] > 0]:
        worth *= 1.0 - visibility(scene.through, scene.rays, eye, int(first))
    reach = 2.0 * scene.means.sensor.range_m / scene.view.frame.cell_m
    near = np.hypot(*(cells - eye).T) < reach
    gain = sites.gain.copy()
    gain[near] = survey(scene, worth, cells[near], least).gain
    onward_m, _ = paths.travel_field(scene.cost, eye[None], scene.view.frame.cell_m)
    after = Sites(cells, gain, sites.first)
    next_m = onward_m[cells[:, 0], cells[:, 1]]
    rate, sets = rates(after, next_m)
    then = int(rate.argmax())
    total = float(sites.total[at, chosen] + after.total[then, sets[then]])
    looks = int(sites.looks[at, chosen] + after.looks[then, sets[then]])
    return total / (looks + float(way_m[at] + next_m[then]) / LOOK_WORTH_M)
