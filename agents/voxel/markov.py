"""What an unmeasured cell may be, by those around it (the Markov estimate, in space)."""

import numpy as np

from agents.geometry import Bools, Ints, Singles
from comms import kernels
from comms.kernels import kernel

SWEEPS = 6
"""The estimate reaches so many cells from what was measured; beyond that nobody can guess."""


@kernel
def _sweep(
    index: np.ndarray, p: np.ndarray, known: np.ndarray, corners: np.ndarray, out: np.ndarray
) -> None:
    """Write the mean of each unknown cell's six neighbours; 0.5 where no block is kept."""
    for block in range(len(p)):
        for z in range(16):
            for y in range(16):
                for x in range(16):
                    if known[block, z, y, x]:
                        out[block, z, y, x] = p[block, z, y, x]
                        continue
                    total = 0.0
                    for n in range(6):
                        side = 1 if n % 2 else -1
                        i = z + (side if n < 2 else 0)
                        j = y + (side if 2 <= n < 4 else 0)
                        k = x + (side if n >= 4 else 0)
                        if min(i, j, k) >= 0 and max(i, j, k) < 16:
                            total += p[block, i, j, k]
                            continue
                        a = (corners[block, 0] + i) >> 4
                        b = (corners[block, 1] + j) >> 4
                        c = (corners[block, 2] + k) >> 4
                        beside = -1
                        if (
                            min(a, b, c) >= 0
                            and a < index.shape[0]
                            and b < index.shape[1]
                            and c < index.shape[2]
                        ):
                            beside = index[a, b, c]
                        total += 0.5 if beside < 0 else p[beside, i & 15, j & 15, k & 15]
                    out[block, z, y, x] = total / 6.0


def relaxed(index: np.ndarray, p: Singles, known: Bools, corners: Ints) -> Singles:
    """Return p (blocks, 16, 16, 16) with its unknown cells estimated; the known ones stay.

    They begin at 0.5 and take the mean of their neighbours `SWEEPS` times (Jacobi). The paper goes
    on until nothing moves, which in space makes all that is hidden the mean of all that is known:
    a cell behind a metre of rock is no likelier to be free for that.
    """
    now = np.where(known, p, np.float32(0.5)).astype(np.float32)
    then = np.empty_like(now)
    for _ in range(SWEEPS):
        _sweep(index, now, known, corners, then)
        now, then = then, now
    return now


@kernels.warmer
def _warm() -> None:
    cells = np.zeros((1, 16, 16, 16), dtype=np.float32)
    corners = np.zeros((1, 3), dtype=np.int64)
    relaxed(np.zeros((1, 1, 1), dtype=np.int32), cells, cells > 0, corners)
