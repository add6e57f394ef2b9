"""Reading a grid between its cells: the one place where ground is interpolated."""

import numpy as np

from agents.geometry import Floats, Singles
from comms import kernels


@kernels.kernel
def cubic_weight(t: float) -> float:
    """Return the Catmull-Rom weight of a sample at distance t, in cells."""
    t = abs(t)
    if t < 1.0:
        return (1.5 * t - 2.5) * t * t + 1.0
    if t < 2.0:
        return ((-0.5 * t + 2.5) * t - 4.0) * t + 2.0
    return 0.0


@kernels.kernel
def resample(
    source: Floats, row0: float, col0: float, step: float, rows: int, cols: int
) -> Singles:
    """Sample a grid at row0 + i*step, col0 + j*step (in source cells, centres at integers).

    Catmull-Rom cubic (local, so that an unknown cell spoils only its neighbours; C1-smooth);
    bilinear where one of the outer twelve of the sixteen cells is NaN, and NaN where one of the
    inner four is. Beyond the outermost centres the border value is held. Returns (rows, cols).
    """
    height, width = source.shape
    out = np.empty((rows, cols), dtype=np.float32)
    for i in range(rows):
        v = min(max(row0 + i * step, 0.0), height - 1.0)
        r = min(int(v), max(height - 2, 0))
        b = v - r
        for j in range(cols):
            u = min(max(col0 + j * step, 0.0), width - 1.0)
            c = min(int(u), max(width - 2, 0))
            a = u - c
            total = 0.0
            for dr in range(-1, 3):
                wr = cubic_weight(b - dr)
                rr = min(max(r + dr, 0), height - 1)
                for dc in range(-1, 3):
                    cc = min(max(c + dc, 0), width - 1)
                    total += wr * cubic_weight(a - dc) * source[rr, cc]
            if np.isnan(total):
                r1 = min(r + 1, height - 1)
                c1 = min(c + 1, width - 1)
                south = (1.0 - a) * source[r, c] + a * source[r, c1]
                north = (1.0 - a) * source[r1, c] + a * source[r1, c1]
                total = (1.0 - b) * south + b * north
            out[i, j] = total
    return out


@kernels.warmer
def _warm() -> None:
    resample(np.zeros((3, 3)), 0.0, 0.0, 0.5, 2, 2)
