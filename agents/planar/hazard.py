"""Where rays end in what nobody measured yet: learned look by look, from a prior.

A cell that a look reaches for the first time is solid with a probability that depends most on
two lengths: how far it is from the nearest cell known to be solid, and from the nearest known to
be free. Beside a wall the wall goes on; in the open nothing is likely to begin. Each look tells of
some hundreds of such cells which they were, so the robot keeps count, bin by bin, and begins with
what was counted in made-up worlds, moved by how built-up its own world is on the whole.
"""

import numpy as np

from agents.geometry import Bools, Floats, Ints
from agents.markov import distance_to_known_m
from agents.planar.view import PlanarView

SOLID_EDGES_M = np.array([0.5, 0.9, 1.3, 2.1, 4.0, 8.0])
FREE_EDGES_M = np.array([0.5, 0.9, 1.7, 3.3, 6.5])
PRIOR_PERCENT = np.array(
    [
        [70.0, 77.0, 40.0, 10.0, 6.0, 5.0],
        [22.0, 48.0, 52.0, 15.0, 6.0, 5.0],
        [4.8, 21.0, 24.0, 12.0, 6.0, 5.0],
        [2.7, 7.8, 19.0, 14.0, 6.0, 5.0],
        [1.3, 3.2, 6.0, 11.0, 8.7, 4.2],
        [0.5, 1.0, 1.9, 4.4, 6.2, 4.3],
        [0.9, 0.8, 0.8, 1.7, 2.9, 3.0],
    ]
)
"""Cells in a hundred that were solid, by distance to solid (rows) and to free (columns)."""
PRIOR_RATE = 0.043
"""Of all cells that looks reached there for the first time, the share that was solid."""
PRIOR_LOOKS = 300.0
"""The prior on that share counts like so many cells ..."""
PRIOR_CELLS = 40.0
"""... and in each bin like so many."""


class Hazard:
    """What one robot has learned of the world that it explores."""

    def __init__(self) -> None:
        """Begin with the prior alone."""
        shape = PRIOR_PERCENT.shape
        self._reached: Floats = np.zeros(shape)
        self._solid: Floats = np.zeros(shape)
        self._before: tuple[Bools, Ints] | None = None

    def take(self, view: PlanarView) -> Floats:
        """Learn from what was measured since the last call; return each cell's p of being solid.

        Only of unmeasured cells (rows, cols) is anything said; others hold their bin's too.
        """
        log_odds = view.log_odds
        if self._before is not None:
            unknown, bins = self._before
            fresh = unknown & (log_odds != 0)
            size = self._reached.size
            self._reached += np.bincount(bins[fresh], minlength=size).reshape(self._reached.shape)
            solid = bins[fresh & (log_odds > 0)]
            self._solid += np.bincount(solid, minlength=size).reshape(self._solid.shape)
        bins = _bins(log_odds, view.frame.cell_m)
        self._before = (log_odds == 0, bins)
        return self._probabilities()[bins]

    def _probabilities(self) -> Floats:
        """Return each bin's probability, flat."""
        reached, solid = float(self._reached.sum()), float(self._solid.sum())
        rate = (solid + PRIOR_RATE * PRIOR_LOOKS) / (reached + PRIOR_LOOKS)
        shift = _logit(np.array(rate)) - _logit(np.array(PRIOR_RATE))
        prior = 1.0 / (1.0 + np.exp(-_logit(PRIOR_PERCENT / 100.0) - shift))
        found = (self._solid + PRIOR_CELLS * prior) / (self._reached + PRIOR_CELLS)
        return found.ravel()


def _bins(log_odds: Floats, cell_m: float) -> Ints:
    solid_m = distance_to_known_m(log_odds > 0, cell_m)
    free_m = distance_to_known_m(log_odds < 0, cell_m)
    row = np.searchsorted(SOLID_EDGES_M, solid_m)
    col = np.searchsorted(FREE_EDGES_M, free_m)
    return (row * PRIOR_PERCENT.shape[1] + col).astype(np.int64)


def _logit(p: Floats) -> Floats:
    return np.log(p / (1.0 - p))
