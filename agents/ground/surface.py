"""What wheels care about in a map: local slope, and what stands out of its surroundings.

Windows are squares of an odd number of cells. Slopes come from a least-squares plane, so that
the noise of single cells (which at 10 m is as large as a cell) doesn't look like steep ground.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from agents.geometry import Bools, Floats
from comms import kernels
from comms.kernels import kernel

SURE = 4.0
"""Sigmas that a rock or a ledge must stand out to be believed: it bars half a footprint around."""
COMPARED = 1.46
"""Sigmas of one cell in a ledge's comparison of four cells: sqrt(2 + 2 / 16)."""
CALM = 0.45
"""Share of white noise that a 1-2-1 mean leaves in such a comparison (0.375 and correlation)."""
LIKELY = 0.4
"""What stands out by this share of a wheel, and by half as many sigmas, is gone round if there is a
way: a step one cell wide shows half its height in the means of its cells."""
CLEARANCE_M = 0.1
"""Room that a robot leaves to hazards besides its own circle: it knows its place no better."""


RAW_APART, CALM_APART = 0.7, 0.4
"""Which share of a cell's sigma its neighbours do not have too, in a comparison of single cells and
after a 1-2-1 mean. Measured in missions: the levelling of a look, which errs for all its cells
together, is most of their sigma. Single cells have long tails, so more of it is left to them."""


def odd_cells(length_m: float, cell_m: float) -> int:
    """Return the odd number of cells nearest to a length, at least 3."""
    return max(3, 2 * round((length_m / cell_m - 1) / 2) + 1)


def disc(radius_cells: float) -> np.ndarray:
    """Return a round structuring element (uint8) of cells whose centres lie within a radius."""
    reach = int(radius_cells)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return (x * x + y * y <= radius_cells * radius_cells).astype(np.uint8)


def plane_slope(surface_m: Floats, window_m: float, cell_m: float) -> Floats:
    """Return the slope (H, W), rise over run, of the plane fitted to the window at each cell.

    `surface_m` (H, W) is complete (no NaN). Beyond the grid the surface is mirrored.
    """
    side = odd_cells(window_m, cell_m)
    ramp = np.arange(side, dtype=np.float64) - side // 2
    ramp /= (ramp * ramp).sum() * cell_m
    flat = np.full(side, 1.0 / side)
    level = surface_m - float(surface_m.mean())
    east = cv2.sepFilter2D(level, cv2.CV_64F, ramp, flat, borderType=cv2.BORDER_REFLECT_101)
    north = cv2.sepFilter2D(level, cv2.CV_64F, flat, ramp, borderType=cv2.BORDER_REFLECT_101)
    return np.hypot(east, north)


def gradient(surface_m: Floats, cell_m: float) -> tuple[Floats, Floats]:
    """Return dz/dy and dz/dx (H, W) by central differences."""
    return (
        np.asarray(np.gradient(surface_m, cell_m, axis=0), dtype=np.float64),
        np.asarray(np.gradient(surface_m, cell_m, axis=1), dtype=np.float64),
    )


def mean_over(values: Floats, side: int) -> Floats:
    """Return the mean (H, W) over a square of `side` cells about each cell, mirrored outside."""
    return np.asarray(
        cv2.blur(values, (side, side), borderType=cv2.BORDER_REFLECT), dtype=np.float64
    )


def smoothed(surface_m: Floats) -> Floats:
    """Return the surface after a 1-2-1 mean in both directions."""
    weights = np.array([0.25, 0.5, 0.25])
    return np.asarray(
        cv2.sepFilter2D(surface_m, cv2.CV_64F, weights, weights, borderType=cv2.BORDER_REFLECT),
        dtype=np.float64,
    )


class Roughness(NamedTuple):
    """What wheels should not meet; all (H, W)."""

    hazard: Bools
    likely: Bools
    """Of what stands out like this, a part is higher than the mean of its cells tells."""


def roughness(
    surface_m: Floats,
    wheel_m: float,
    footprint_m: float,
    cell_m: float,
    sigma_m: Floats,
) -> Roughness:
    """Find the cells that hold a rock or a ledge higher than half a wheel.

    A rock stands out of the straight line between the ground on both its sides in *every* one of
    four directions, at the distance of a wheel or of half a footprint. A ledge rises by more over
    one wheel than the slope over the footprint explains. A steep smooth face is neither, and a
    lip or a crest stands out in some directions only.

    What the noise of single cells (`sigma_m`, (H, W)) explains is no hazard, or a whole noisy map
    would be one: heights are compared twice, as they are and after a 1-2-1 mean, which leaves
    `CALM` of the noise, and each time something must stand out `SURE` sigmas of the comparison, of
    which `RAW_APART` and `CALM_APART` count.
    """
    calm = standing_out(smoothed(surface_m), wheel_m, footprint_m, cell_m)
    raw = standing_out(surface_m, wheel_m, footprint_m, cell_m)
    noise_m = SURE * COMPARED * sigma_m
    limit_m = 0.5 * wheel_m
    hazard = (raw > np.maximum(limit_m, RAW_APART * noise_m)) | (
        calm > np.maximum(limit_m, CALM_APART * CALM * noise_m)
    )
    likely = raw > np.maximum(LIKELY * wheel_m, 0.5 * RAW_APART * noise_m)
    return Roughness(hazard, likely)


def standing_out(surface_m: Floats, wheel_m: float, footprint_m: float, cell_m: float) -> Floats:
    """Return the height (H, W), metres, of the rock or ledge at each cell; noise included.

    A ledge rises over one wheel by more than the slope over the footprint explains, in one of four
    directions at least. A rock stands out of the mean of the two cells that lie so far off on both
    sides, a wheel or half a footprint, in all of four directions. Borders go on beyond the grid.
    """
    surface_m = np.ascontiguousarray(surface_m, dtype=np.float64)
    near, far = _directions(0.5 * wheel_m / cell_m), _directions(0.5 * footprint_m / cell_m)
    reach = np.array([_directions(wheel_m / cell_m), far], dtype=np.int64)
    out = np.empty_like(surface_m)
    _stand_out(surface_m, np.array(near, dtype=np.int64), np.array(far, dtype=np.int64), reach, out)
    return out


@kernel
def _stand_out(
    surface: np.ndarray, near: np.ndarray, far: np.ndarray, reach: np.ndarray, out: np.ndarray
) -> None:
    """Fill `out` (H, W); `near`, `far` (4, 2) and `reach` (2, 4, 2) are steps in cells."""
    height, width = surface.shape
    share = np.empty(4)
    for k in range(4):
        share[k] = math.hypot(near[k, 0], near[k, 1]) / math.hypot(far[k, 0], far[k, 1])
    for i in range(height):
        for j in range(width):
            most = 0.0
            for k in range(4):
                rise = _across(surface, i, j, near[k, 0], near[k, 1], -1.0)
                slope = _across(surface, i, j, far[k, 0], far[k, 1], -1.0)
                most = max(most, abs(rise - share[k] * slope))
            for r in range(2):
                least = np.inf
                for k in range(4):
                    sides = _across(surface, i, j, reach[r, k, 0], reach[r, k, 1], 1.0)
                    least = min(least, surface[i, j] - 0.5 * sides)
                most = max(most, least)
            out[i, j] = most


@kernel
def _across(surface: np.ndarray, i: int, j: int, dy: int, dx: int, sign: float) -> float:
    """Return the cell on one side of (i, j), plus `sign` times that on the other."""
    height, width = surface.shape
    ahead = surface[min(max(i + dy, 0), height - 1), min(max(j + dx, 0), width - 1)]
    behind = surface[min(max(i - dy, 0), height - 1), min(max(j - dx, 0), width - 1)]
    return ahead + sign * behind


def _directions(length_cells: float) -> list[tuple[int, int]]:
    """Return whole-cell steps (rows, columns) of a length in four directions."""
    straight = max(1, round(length_cells))
    slanted = max(1, round(length_cells * math.sqrt(0.5)))
    return [(0, straight), (straight, 0), (slanted, slanted), (slanted, -slanted)]


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    standing_out(np.zeros((4, 4)), 0.2, 0.8, 0.1)
