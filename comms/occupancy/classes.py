"""Log odds of occupancy as few classes: rounded towards nothing known, never away from it.

Sixteen symbols: unknown, and eight sizes of log odds of either sign (0 has none). A receiver is
told at most what the sender knew: the largest size that is not above |log odds|. Up to a size of
5.29 that takes less than 1.41, and less than 0.1 off the probability; larger ones are cut there.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

from comms.errors import CodecError

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]
Symbols = NDArray[np.uint8]

SIZES = (0.0, 0.4, 0.84, 1.38, 2.2, 2.94, 3.89, 5.29)
"""Sizes of log odds: about probabilities of 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98 and 0.995. That of
2.2 lies just beyond 0.9, from where a cell counts as mapped."""
TOP = len(SIZES) - 1
UNKNOWN, ZERO = 0, 8
"""Symbols: a cell that nobody measured, and log odds of 0. Below it is free, above it occupied."""
FREE, NOT_KNOWN, OCCUPIED, OPEN = 0, 1, 2, 3
"""States of a cell; an open one is not decided yet."""
STATE_OF = np.array([NOT_KNOWN] + [FREE] * ZERO + [OCCUPIED] * TOP, np.uint8)
"""The state that each symbol stands for."""

_SIZES = np.nextafter(np.array(SIZES, np.float32), np.float32(0))
_LOG_ODDS = np.concatenate([[0], -_SIZES[:0:-1], _SIZES]).astype(np.float32)
LARGEST_ERROR = float(max(b - a for a, b in itertools.pairwise(SIZES)))
"""Largest loss of log odds by rounding, as long as they are within +-5.29."""


def symbols_of(log_odds: NDArray[np.floating], known: Bools) -> Symbols:
    """Return the symbol of every cell, any shape; log odds are read only where `known`.

    Raises `CodecError` where a known cell has none (NaN); infinite ones are certain.
    """
    inside = log_odds[known].astype(np.float64)
    if np.isnan(inside).any():
        raise CodecError("every known cell needs log odds, not NaN")
    sizes = np.searchsorted(_SIZES.astype(np.float64), np.abs(inside), "right") - 1
    symbols = np.full(log_odds.shape, UNKNOWN, np.uint8)
    symbols[known] = ZERO + np.where(inside < 0, -sizes, sizes)
    return symbols


def log_odds_of(symbols: Symbols) -> Singles:
    """Return the log odds that symbols stand for; 0 where unknown, which adds nothing to a sum."""
    return _LOG_ODDS[symbols]
