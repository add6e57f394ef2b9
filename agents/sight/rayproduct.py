"""Eq. 5 as the paper prints it: the product of Phi over the cells under each ray.

Kept to compare with, and for who wants the paper's own planner. Its error against the product of
every factor by `erfc` is below 1e-3: factors beyond `CERTAIN` sigmas are 1, Phi comes from a table,
and a product below `NOTHING` is 0. A block of points that none of them may hide is passed over.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.sight.crests import LEAST_SIGMA_M, NEVER, TABLE_SIGMAS, table_phi
from comms.kernels import kernel

BLOCK = 8
"""Points of a ray that are passed over together."""
CERTAIN = TABLE_SIGMAS
"""Sigmas from which a factor is 1; 300 of them are off by 1e-4 together."""
NOTHING = 5e-4


class Fan(NamedTuple):
    """Rays laid from an eye; arrays (bearings, points) but the last."""

    slope: np.ndarray
    """Rise over run at which a point is seen; very low off the map."""
    sharpness: np.ndarray
    """One over the standard deviation of the slope."""
    top: np.ndarray
    """(bearings, blocks) steepest slope that a point of the block may still hide."""


def empty_fan(bearings: int, points: int) -> Fan:
    """Return a fan to be laid."""
    blocks = (points + BLOCK - 1) // BLOCK
    return Fan(*(np.empty((bearings, n)) for n in (points, points, blocks)))


@kernel
def lay(
    surface: np.ndarray, sigma: np.ndarray, eye: tuple[float, float, float], cell: float, fan: Fan
) -> None:
    """Fill a fan about an eye (row, column, height); points off the map obstruct nothing."""
    bearings, points = fan.slope.shape
    h, w = surface.shape
    fan.top[:] = NEVER
    fan.slope[:] = NEVER
    fan.sharpness[:] = 1.0
    for b in range(bearings):
        angle = 2.0 * math.pi * b / bearings
        dy, dx = math.sin(angle), math.cos(angle)
        for k in range(points):
            i = math.floor(eye[0] + (k + 1.0) * dy + 0.5)
            j = math.floor(eye[1] + (k + 1.0) * dx + 0.5)
            if i < 0 or j < 0 or i >= h or j >= w:
                break
            run = (k + 1.0) * cell
            spread = max(sigma[i, j], LEAST_SIGMA_M) / run
            slope = (surface[i, j] - eye[2]) / run
            fan.sharpness[b, k], fan.slope[b, k] = 1.0 / spread, slope
            fan.top[b, k // BLOCK] = max(fan.top[b, k // BLOCK], slope + CERTAIN * spread)


@kernel
def chance_along(fan: Fan, b: int, slope: float, count: int) -> float:
    """Return the product over the `count` points before a target, from the target inwards."""
    p = 1.0
    for block in range((count - 1) // BLOCK, -1, -1):
        if fan.top[b, block] <= slope:
            continue
        for k in range(min(count, (block + 1) * BLOCK) - 1, block * BLOCK - 1, -1):
            z = (slope - fan.slope[b, k]) * fan.sharpness[b, k]
            if z <= -CERTAIN:
                return 0.0
            if z < CERTAIN:
                p *= table_phi(z)
        if p < NOTHING:
            return 0.0
    return p
