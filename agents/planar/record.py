"""How far guesses held, look by look: what was guessed, what came of it, and the shift between."""

import numpy as np

from agents.geometry import Bools, Floats, Ints


class Record:
    """Guesses (log-odds) and their outcomes, all together and by what was guessed."""

    def __init__(self, edges: Floats, prior_cells: float, prior_share: float) -> None:
        """Begin with nothing.

        Args:
            edges: (K,) log-odds, ascending, at which guesses are told apart.
            prior_cells: the guesses count like so many cells, all together and in each bin ...
            prior_share: ... of which this share came true.
        """
        self._edges = edges
        self._prior_cells, self._prior_share = prior_cells, prior_share
        bins = len(edges) + 1
        self._cells: Floats = np.zeros(bins)
        self._true: Floats = np.zeros(bins)
        self._guessed: Floats = np.zeros(bins)
        """How many of them the guesses alone held for true."""

    def count(self, guess: Floats, true: Bools) -> None:
        """Take in what became of some guesses (N,)."""
        bins: Ints = np.searchsorted(self._edges, guess).astype(np.int64)
        count = len(self._cells)
        self._cells += np.bincount(bins, minlength=count)
        self._true += np.bincount(bins[true], minlength=count)
        self._guessed += np.bincount(bins, weights=chance(guess), minlength=count)

    def shifts(self) -> Floats:
        """Return by how much guesses are off (K + 1,): as a whole, and the bin besides."""
        prior = self._prior_cells
        cells = float(self._cells.sum()) + prior
        whole = logit((float(self._true.sum()) + prior * self._prior_share) / cells) - logit(
            (float(self._guessed.sum()) + prior * self._prior_share) / cells
        )
        middle = self._guessed / np.maximum(self._cells, 1.0)
        expected = chance(logit(np.clip(middle, 1e-3, 1.0 - 1e-3)) + whole)
        found = (self._true + prior * expected) / (self._cells + prior)
        return whole + np.where(self._cells > 0, logit(found) - logit(expected), 0.0)


def chance(log_odds: Floats) -> Floats:
    """Return probabilities of log-odds."""
    return 1.0 / (1.0 + np.exp(-log_odds))


def logit(p: Floats | float) -> Floats:
    """Return log-odds of probabilities in (0, 1)."""
    return np.log(p / (1.0 - np.asarray(p, dtype=np.float64)))
