"""A cliff edge that is taken for a straight line: method 3 of Sujan & Meggiolaro, section 3.2.

The paper says no more than that. Here the line is fitted by least squares to the cells of the rim
beside which measured ground falls away, and moved back until none of them lies on the robot's
side: a line that may be driven along wherever the edge strays.
"""

import cv2
import numpy as np

from agents.geometry import Bools, Floats
from agents.ground import surface

FALL_WHEELS = 2.0
"""The rim is where the ground falls by more than so many wheels ..."""
WITHIN_WHEELS = 5.0
"""... within so many."""
LEAST_CELLS = 10
"""Of fewer cells no line is made: no edge is known yet."""


def behind_line(
    plateau: Bools,
    measured_m: Floats,
    cell: tuple[int, int],
    *,
    wheel_m: float,
    cell_m: float,
) -> Bools:
    """Return the cells (H, W) on the robot's side of the straight line for the plateau's edge.

    Args:
        plateau: (H, W) the plateau that the robot stands on.
        measured_m: (H, W) measured elevation, NaN unknown.
        cell: the robot's (row, column).
        wheel_m: wheel diameter.
        cell_m: cell size.
    """
    rim = _rim(plateau, measured_m, wheel_m, cell_m)
    if len(rim) < LEAST_CELLS:
        return np.ones(plateau.shape, dtype=np.bool_)
    middle = rim.mean(axis=0)
    _, _, axes = np.linalg.svd(rim - middle, full_matrices=False)
    inward = axes[1]
    here = np.array(cell, dtype=np.float64)
    if (here - middle) @ inward < 0:
        inward = -inward
    bound = min(float((rim @ inward).max()), float(here @ inward))
    rows, cols = np.indices(plateau.shape)
    return rows * inward[0] + cols * inward[1] >= bound


def _rim(plateau: Bools, measured_m: Floats, wheel_m: float, cell_m: float) -> Floats:
    """Return the plateau's cells (N, 2) beside which measured ground falls away."""
    heights = np.where(np.isnan(measured_m), np.inf, measured_m)
    reach = surface.disc(WITHIN_WHEELS * wheel_m / cell_m)
    lowest = np.asarray(cv2.erode(heights, reach), dtype=np.float64)
    inner = cv2.erode(plateau.astype(np.uint8), surface.disc(1.5)) > 0
    with np.errstate(invalid="ignore"):
        falls = measured_m - lowest > FALL_WHEELS * wheel_m
    return np.argwhere(plateau & ~inner & falls).astype(np.float64)
