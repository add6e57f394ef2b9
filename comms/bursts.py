"""Losses in bursts (Gilbert and Elliott): a link that is good for a while, then bad for a while.

The two states are a process in time, not a count of frames: a fade goes on while nobody speaks, a
long frame is hit more easily than a short one, and a setting means the same at every rate. The
process runs by itself from its own source of luck, so what it is at an instant depends on that
instant alone, however often or seldom somebody asks.
"""

from bisect import bisect_right

import numpy as np

KEPT_EDGES = 1 << 16
"""Changes of state that are remembered; no frame is under way for longer."""
DRAWN_EDGES = 64


class Bursts:
    """Good and bad spells, exponentially long."""

    def __init__(self, rng: np.random.Generator, good_ns: float, bad_ns: float, since_ns: int = 0):
        """Take the mean lengths; the first state has the probability of the long run."""
        self._rng = rng
        self._mean_ns = (good_ns, bad_ns)
        self._first_bad = bool(rng.random() * (good_ns + bad_ns) < bad_ns)
        self._edges: list[int] = []
        self._next_bad = self._first_bad
        self._until_ns = since_ns

    def meets(self, start_ns: int, end_ns: int) -> bool:
        """Say whether a bad spell touches a span of time.

        Before `since_ns` the state is as it is there; so it is before all that is remembered.
        """
        self._draw_to(end_ns)
        at = bisect_right(self._edges, start_ns)
        bad = self._first_bad ^ bool(at & 1)
        return bad or self._edges[at] < end_ns

    def _draw_to(self, t_ns: int) -> None:
        while self._until_ns <= t_ns or not self._edges:
            for length in self._rng.standard_exponential(DRAWN_EDGES):
                spell_ns = max(1, round(float(length) * self._mean_ns[self._next_bad]))
                self._until_ns += spell_ns
                self._edges.append(self._until_ns)
                self._next_bad = not self._next_bad
            if len(self._edges) > 2 * KEPT_EDGES:
                del self._edges[:-KEPT_EDGES]  # an even number: the state before stays as it was
