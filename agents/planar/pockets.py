"""What is worth more now than later: pockets of unknown floor that would have to be come back for.

Unknown cells in the midst of many will be seen when the robot goes there, whatever it does now. A
few in a corner, once left behind, cost a way of their own, or are never seen. So while there is
more to explore than scraps, cells count the more the fewer open unknown ones lie about them. What
a robot saves in metres by picking pockets up in passing it pays for in a few looks.
"""

import numpy as np
from scipy import ndimage

from agents.geometry import Floats

ALONE = 3.0
"""What a cell counts that is alone; one where the most others are counts 1."""
ABOUT = 0.27
"""Others count within this share of the sensor's range, to each side."""


def pocket_weights(open_p: Floats, cell_m: float, range_m: float) -> Floats:
    """Return what cells (rows, cols) count, from 1 to `ALONE`.

    `open_p` is each cell's chance of being unknown and open: 0 where it is known.
    """
    side = 2 * round(ABOUT * range_m / cell_m) + 1
    about = ndimage.uniform_filter(open_p, side, mode="constant")
    most = float(about.max())
    if most <= 0.0:
        return np.ones_like(open_p)
    return ALONE - (ALONE - 1.0) * np.clip(about / most, 0.0, 1.0)
