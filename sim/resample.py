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
def _resample(padded: Floats, row0: float, col0: float, step: float, out: Singles) -> None:
    height, width = padded.shape[0] - 2, padded.shape[1] - 2
    rows, cols = out.shape
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
                for dc in range(-1, 3):
                    total += wr * cubic_weight(a - dc) * padded[r + dr + 1, c + dc + 1]
            if np.isnan(total):
                south = (1.0 - a) * padded[r + 1, c + 1] + a * padded[r + 1, c + 2]
                north = (1.0 - a) * padded[r + 2, c + 1] + a * padded[r + 2, c + 2]
                total = (1.0 - b) * south + b * north
            out[i, j] = total


def resample(
    source: Floats, first: tuple[float, float], step: float, shape: tuple[int, int]
) -> Singles:
    """Sample a grid (at least 2 x 2) at `first` + (i, j) * `step`, in source cells; `shape` of it.

    Source centres lie at integers. Catmull-Rom cubic (local, so that an unknown cell spoils only
    its neighbours; C1-smooth; exact on planes), bilinear where one of the outer twelve of the
    sixteen cells is NaN, and NaN where one of the inner four is. Beyond the outermost centres the
    border value is held.
    """
    out = np.empty(shape, dtype=np.float32)
    padded = np.pad(source, 1, mode="reflect", reflect_type="odd")
    _resample(padded, first[0], first[1], step, out)
    return out


@kernels.warmer
def _warm() -> None:
    resample(np.zeros((3, 3)), (0.0, 0.0), 0.5, (2, 2))
