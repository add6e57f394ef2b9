"""The inner loops of laying elevation maps over one another, compiled."""

import math

import numpy as np

from comms import kernels
from comms.kernels import kernel

STEEPEST = 3.0
"""Slopes are clipped at this: beyond, a cell is a wall, and its height is anybody's guess."""


@kernel
def fill_slope(elevation: np.ndarray, cell_m: float, out: np.ndarray) -> None:
    """Fill `out` (H, W) with the gradient's magnitude; 0 where a neighbour is unknown (NaN)."""
    height, width = elevation.shape
    for i in range(height):
        south, north = max(i - 1, 0), min(i + 1, height - 1)
        for j in range(width):
            west, east = max(j - 1, 0), min(j + 1, width - 1)
            dx = (elevation[i, east] - elevation[i, west]) / (2 * cell_m)
            dy = (elevation[north, j] - elevation[south, j]) / (2 * cell_m)
            slope = math.hypot(dx, dy)
            out[i, j] = 0.0 if math.isnan(slope) else min(slope, STEEPEST)


@kernel
def fill_blurred(
    elevation: np.ndarray,
    variance: np.ndarray,
    beside: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    cell_m: float,
    corner_m: tuple[float, float],
    first: tuple[int, int],
    anchor_m: tuple[float, float],
    anchor_variance: tuple[float, float, float, float],
    out: np.ndarray,
) -> None:
    """Fill `out` (H, W) with a window's variance and what the anchor's covariance adds to it.

    `beside` are the elevations next to it in the south, north (W), west and east (H). `corner_m`
    is the (x, y) of the map's corner, `first` the (row, col) of the window's, `anchor_m` (x, y) of
    the anchor; its variance is of (x, y, z, yaw). Numbers come out as by `fill_slope` and
    `agents.maps.elevation.cell_variance`, to the last bit.
    """
    height, width = elevation.shape
    south, north, west, east = beside
    var_x, var_y, var_z, var_yaw = anchor_variance
    for i in range(height):
        dy_m = corner_m[1] + (first[0] + i + 0.5) * cell_m - anchor_m[1]
        for j in range(width):
            left = elevation[i, j - 1] if j > 0 else west[i]
            right = elevation[i, j + 1] if j + 1 < width else east[i]
            below = elevation[i - 1, j] if i > 0 else south[j]
            above = elevation[i + 1, j] if i + 1 < height else north[j]
            slope = math.hypot((right - left) / (2 * cell_m), (above - below) / (2 * cell_m))
            slope = 0.0 if math.isnan(slope) else min(slope, STEEPEST)
            dx_m = corner_m[0] + (first[1] + j + 0.5) * cell_m - anchor_m[0]
            shift = 0.5 * (var_x + var_y) + (dx_m * dx_m + dy_m * dy_m) * var_yaw
            out[i, j] = variance[i, j] + (var_z + slope * slope * shift)


@kernel
def take_surer(
    elevation: np.ndarray,
    variance: np.ndarray,
    looks: np.ndarray,
    other_elevation: np.ndarray,
    other_variance: np.ndarray,
    other_looks: np.ndarray,
) -> None:
    """Replace cells (H, W) by those of another estimate that is surer of them."""
    for i in range(variance.shape[0]):
        for j in range(variance.shape[1]):
            if other_variance[i, j] < variance[i, j]:
                elevation[i, j] = other_elevation[i, j]
                variance[i, j] = other_variance[i, j]
            looks[i, j] = max(looks[i, j], other_looks[i, j])


@kernel
def add_layer(
    information: np.ndarray,
    weighted: np.ndarray,
    looks: np.ndarray,
    elevation: np.ndarray,
    variance: np.ndarray,
    more_looks: np.ndarray,
) -> None:
    """Add what one origin knows (H, W) to the sums of 1/sigma^2, of z/sigma^2, and of looks."""
    for i in range(variance.shape[0]):
        for j in range(variance.shape[1]):
            weight = 1.0 / variance[i, j]
            if weight > 0.0:
                information[i, j] += weight
                weighted[i, j] += weight * elevation[i, j]
            looks[i, j] += more_looks[i, j]


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    one, count = np.ones((3, 3)), np.ones((3, 3), dtype=np.uint16)
    fill_slope(one, 0.1, np.empty((3, 3)))
    row, place, four = np.ones(3), (0.0, 0.0), (1.0, 1.0, 1.0, 1.0)
    fill_blurred(one, one, (row, row, row, row), 0.1, place, (0, 0), place, four, np.empty((3, 3)))
    take_surer(one, one.copy(), count, one, one, count)
    add_layer(one, one.copy(), count, one, one, count)
