"""Places to look from, each with the several looks that are worth taking there together.

A drive costs more than a look, so a place is worth what all its good looks show, not just its
best one. The looks at a place are chosen greedily from the same rays, none counted twice, and as
many are taken as make the most of the whole stop: the rate

    (g_1 + ... + g_m) / (m + way / LOOK_WORTH_M)

is what the stop yields per unit of effort, one look being an effort like driving `LOOK_WORTH_M`.
"""

from dataclasses import dataclass

import numpy as np

from agents import paths
from agents.geometry import Floats, Ints
from agents.planar.casting import gains, visibility
from agents.planar.scene import Scene
from agents.planar.sensing import MAPPED
from comms import kernels
from comms.kernels import kernel

LOOK_WORTH_M = 2.0
"""Metres of driving that cost as much as one look (its gains saved elsewhere)."""
MOST_LOOKS = 6
"""Looks at one place, at most."""


@dataclass(frozen=True)
class Sites:
    """Places and what may be seen from each; arrays by place."""

    cells: Ints
    """(E, 2)."""
    by_bearing: Floats
    """(E, B) cells expected to be mapped, by the bearing that shows them."""
    gain: Floats
    """(E, MOST_LOOKS) cells that each look adds, the best first; 0 where it is not worth it."""
    first: Ints
    """(E, MOST_LOOKS) the first ray of each."""


def survey(scene: Scene, lacking: Floats, cells: Ints, least: float) -> Sites:
    """Return what looks from cells (E, 2) promise; looks below `least` cells count as nothing."""
    by_bearing = gains(scene.through, lacking, scene.rays, cells) / MAPPED
    gain, first = _look_sets(by_bearing, scene.rays.width)
    return Sites(cells, by_bearing, np.where(gain >= least, gain, 0.0), first)


@kernel
def _choose_looks(left: np.ndarray, width: int, gain: np.ndarray, first: np.ndarray) -> None:
    """Take window after window of each ring (E, B); what one shows, the next no longer does."""
    bearings = left.shape[1]
    for e in range(len(left)):
        ring = left[e]
        for m in range(gain.shape[1]):
            total = 0.0
            for k in range(width):
                total += ring[k]
            best, at = total, 0
            for b in range(1, bearings):
                total += ring[(b + width - 1) % bearings] - ring[b - 1]
                if total > best + 1e-9:
                    best, at = total, b
            gain[e, m] = max(best, 0.0)
            first[e, m] = at
            for k in range(width):
                ring[(at + k) % bearings] = 0.0


def _look_sets(by_bearing: Floats, width: int) -> tuple[Floats, Ints]:
    """Return gains and first rays (E, MOST_LOOKS) of looks chosen greedily at each place."""
    gain = np.zeros((len(by_bearing), MOST_LOOKS))
    first = np.zeros(gain.shape, dtype=np.int64)
    _choose_looks(by_bearing.copy(), width, gain, first)
    return gain, first


def rates(sites: Sites, way_m: Floats) -> tuple[Floats, Ints]:
    """Return each place's best rate (E,) and with how many looks; `way_m` (E,) leads there."""
    looks = np.arange(1, MOST_LOOKS + 1)
    effort = looks + way_m[:, None] / LOOK_WORTH_M
    each = np.cumsum(sites.gain, axis=1) / effort
    most = each.argmax(axis=1)
    return each[np.arange(len(each)), most], most + 1


def ahead(scene: Scene, sites: Sites, at: int, looks: int, least: float) -> float:
    """Return the rate of a route: the looks at one place, then those at the next best place."""
    way_m = scene.way_m[sites.cells[:, 0], sites.cells[:, 1]]
    cells, eye = sites.cells, sites.cells[at]
    lacking = scene.lacking.copy()
    for first in sites.first[at, :looks]:
        lacking *= 1.0 - visibility(scene.through, scene.rays, eye, int(first))
    reach = 2.0 * scene.means.sensor.range_m / scene.view.frame.cell_m
    near = np.hypot(*(cells - eye).T) < reach
    anew = survey(scene, lacking, cells[near], least)
    gain = sites.gain.copy()
    gain[near] = anew.gain
    onward_m, _ = paths.travel_field(scene.cost, eye[None], scene.view.frame.cell_m)
    after = Sites(cells, sites.by_bearing, gain, sites.first)
    next_m = onward_m[cells[:, 0], cells[:, 1]]
    rate, count = rates(after, next_m)
    then = int(rate.argmax())
    more = int(count[then])
    total = float(sites.gain[at, :looks].sum() + gain[then, :more].sum())
    driven_m = float(way_m[at] + next_m[then])
    return total / (looks + more + driven_m / LOOK_WORTH_M)


@kernels.warmer
def warm() -> None:
    """Compile the kernel of this module."""
    _look_sets(np.ones((1, 8)), 2)
