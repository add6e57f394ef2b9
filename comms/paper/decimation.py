"""Adaptive decimation: what is smaller than the robot cares about is taken off the map.

Sujan & Meggiolaro, section 2.4, name it ("removes highly insignificant objects, such as small
pebbles") and don't say how. Here: a cell that stands out from the median of its known 3 x 3
neighbourhood by no more than a limit takes that median. Slopes and edges are their own medians,
and what is taller than the limit stays.
"""

import numpy as np
from numpy.typing import NDArray

from comms.kernels import kernel, warmer
from comms.parts import whole

Floats = NDArray[np.float64]
Flags = NDArray[np.uint8]


@kernel
def decimated(elevation_m: Floats, known: Flags, pebble_m: float) -> Floats:
    """Return elevations (H, W) without bumps and dents of up to `pebble_m`, one cell wide.

    Known cells are read and changed only; no cell moves by more than `pebble_m`.
    """
    rows, cols = elevation_m.shape
    out = elevation_m.copy()
    near = np.empty(9, np.float64)
    for i in range(rows):
        for j in range(cols):
            if not known[i, j]:
                continue
            n = whole(0)
            for a in range(max(i - 1, 0), min(i + 2, rows)):
                for b in range(max(j - 1, 0), min(j + 2, cols)):
                    if known[a, b]:
                        value = elevation_m[a, b]
                        k = n
                        while k > 0 and near[k - 1] > value:
                            near[k] = near[k - 1]
                            k -= 1
                        near[k] = value
                        n += 1
            # Of an even number the one nearer to the cell: no height that nobody measured.
            low, high = near[(n - 1) // 2], near[n // 2]
            median = min(max(elevation_m[i, j], low), high)
            if abs(median - elevation_m[i, j]) <= pebble_m:
                out[i, j] = median
    return out


@warmer
def _warm() -> None:
    decimated(np.zeros((2, 2)), np.ones((2, 2), np.uint8), 0.1)
