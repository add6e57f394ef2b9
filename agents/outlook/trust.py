"""How far ground is trusted to be measured, from what became of the ground about it.

Eq. 9 learns of each cell by itself: ground without texture is tried patch by patch until all of it
has failed. But what can't be measured lies together. Interest keeps count of the failures since a
cell was last measured, `-ln(interest) / beta` expected cells, and the map of the successes; a cell
that was not tried yet is taken to succeed as often as those within `NEAR_M` did.
"""

import cv2
import numpy as np

from agents.geometry import Floats
from agents.planning.scene import View

NEAR_M = 1.5
"""Standard deviation of the bell by which neighbours count."""
BEFORE = 0.2
"""Tries that are taken to have succeeded before any was made, per cell of the bell."""


def trust(view: View) -> Floats:
    """Return the chance (H, W), in [0, 1], that a cell in plain view is measured at all."""
    if view.planner.beta <= 0:
        return np.ones(view.frame.shape)
    failed = -np.log(np.maximum(view.interest, 1e-12)) / view.planner.beta
    sigma = NEAR_M / view.frame.cell_m

    def about(values: Floats) -> Floats:
        blurred = cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(blurred, dtype=np.float64)

    won = about((view.looks > 0).astype(np.float64))
    lost = about(np.minimum(failed, 3.0))
    return (won + BEFORE) / (won + lost + BEFORE)
