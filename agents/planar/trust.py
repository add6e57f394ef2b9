"""How far a ray's chance of coming so far can be trusted: mended look by look.

`casting.onward` adds odds along a ray, which is a model; in open squares rays come farther than it
says, in buildings with many rooms they either come all the way or not at all. So the robot keeps a
record of the chances that cells had to be seen by its looks, and of which were seen, and bends the
chances to fit.
"""

import numpy as np

from agents.geometry import Floats, Ints
from agents.planar.record import Record, chance, logit

STEPS = 256
"""Chances are told apart by so much of 1."""
EDGES = np.array([-2.5, -1.7, -1.0, -0.4, 0.2, 0.8, 1.4, 2.2, 3.2])
PRIOR_CELLS = 1500.0
"""Cells of one look stand and fall together, so it takes some looks to outweigh the model."""
PRIOR_SHARE = 0.5
LEAST = 1e-3


class Trust:
    """What one robot has learned of its chances to see unmeasured cells."""

    def __init__(self) -> None:
        """Begin with the model."""
        self._record = Record(EDGES, PRIOR_CELLS, PRIOR_SHARE)
        self._guess = logit(np.clip(np.arange(STEPS + 1) / STEPS, LEAST, 1.0 - LEAST))
        self._before: tuple[Ints, Floats] | None = None

    def table(self) -> Floats:
        """Return what chances of 0, 1 / `STEPS`, ..., 1 are to be taken for; never falling."""
        shifts = self._record.shifts()
        middles = np.concatenate(([EDGES[0]], 0.5 * (EDGES[1:] + EDGES[:-1]), [EDGES[-1]]))
        bent = chance(self._guess + np.interp(self._guess, middles, shifts))
        bent[0], bent[-1] = 0.0, 1.0
        return np.maximum.accumulate(bent)

    def expect(self, seen_p: Floats, log_odds: Floats) -> None:
        """Note the model's chances (rows, cols) that the look to come sees each cell."""
        cells = np.flatnonzero((log_odds == 0) & (seen_p > LEAST))
        chances = np.rint(seen_p.ravel()[cells] * STEPS).astype(np.int64)
        self._before = (cells, self._guess[chances])

    def take(self, log_odds: Floats) -> None:
        """Learn from what was measured since."""
        if self._before is None:
            return
        cells, guess = self._before
        self._record.count(guess, log_odds.ravel()[cells] != 0)
        self._before = None
