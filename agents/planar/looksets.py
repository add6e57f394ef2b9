"""Looks from one place, chosen together: the best 1, 2, ... windows on a ring of bearings.

Taken one by one, the best window often lies in the middle of what is to be seen, and what is left
on either side costs a look each. So the sets are found by dynamic programming: on a ring that is
cut open, the best m windows up to bearing j are the best m up to j - 1, or the window that ends at
j with the best m - 1 before it. Every cut of one window's width is tried; one of them touches an
edge of the best set's windows.
"""

import numpy as np

from agents.geometry import Floats, Ints
from comms import kernels
from comms.kernels import kernel

COARSE = 5
"""Bearings that are taken as one: a sector."""


@kernel
def _best_sets(
    ring: np.ndarray, width: int, total: np.ndarray, first: np.ndarray, gain: np.ndarray
) -> None:
    """Fill, for every place (E, B) and number of looks, the best windows.

    A window that begins before the cut counts with what lies after it alone.
    """
    places, bearings = ring.shape
    most = total.shape[1]
    best = np.zeros((most + 1, bearings + 1))
    taken = np.zeros((most + 1, bearings + 1), dtype=np.bool_)
    summed = np.zeros(bearings + 1)
    for e in range(places):
        if not ring[e].any():
            continue
        for cut in range(min(width, bearings)):
            for j in range(bearings):
                summed[j + 1] = summed[j] + ring[e, (cut + j) % bearings]
            for m in range(1, most + 1):
                for j in range(1, bearings + 1):
                    from_ = max(j - width, 0)
                    new = best[m - 1, from_] + summed[j] - summed[from_]
                    taken[m, j] = new > best[m, j - 1] + 1e-9
                    best[m, j] = new if taken[m, j] else best[m, j - 1]
            for m in range(1, most + 1):
                if best[m, bearings] <= total[e, m - 1] + 1e-9:
                    continue
                total[e, m - 1] = best[m, bearings]
                gain[e, m - 1] = 0.0
                j, left = bearings, m
                while j > 0 and left > 0:
                    if taken[left, j]:
                        from_ = max(j - width, 0)
                        left -= 1
                        gain[e, m - 1, left] = summed[j] - summed[from_]
                        first[e, m - 1, left] = (cut + j - width) % bearings
                        j = from_
                    else:
                        j -= 1


def sectors(by_bearing: Floats) -> Floats:
    """Return what each sector shows (E, B / COARSE), of what each bearing shows (E, B)."""
    return by_bearing.reshape(len(by_bearing), -1, COARSE).sum(axis=2)


def look_sets(ring: Floats, width: int, most: int) -> tuple[Floats, Ints]:
    """Return the best sets of 1, ..., `most` looks at each place.

    Args:
        ring: (E, K) >= 0, what each sector of bearings shows.
        width: sectors in a look.
        most: looks at most.

    Returns:
        gain (E, most, most): what each look of the set of m + 1 adds, the most first, 0 where a
        set needs fewer; first (E, most, most): the first sector of each.
    """
    gain = np.zeros((len(ring), most, most))
    first = np.zeros((len(ring), most, most), dtype=np.int64)
    _best_sets(ring, width, np.zeros((len(ring), most)), first, gain)
    order = np.argsort(-gain, axis=2, kind="stable")
    return np.take_along_axis(gain, order, 2), np.take_along_axis(first, order, 2)


@kernels.warmer
def warm() -> None:
    """Compile the kernel of this module."""
    look_sets(np.ones((1, 4)), 2, 2)
