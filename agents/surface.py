"""What wheels care about in a map: local slope, and what stands out of its surroundings.

Windows are squares of an odd number of cells. Slopes come from a least-squares plane, so that
the noise of single cells (which at 10 m is as large as a cell) doesn't look like steep ground.
"""

import cv2
import numpy as np

from agents.geometry import Bools, Floats

STEP_GAIN = 0.75
"""What the 1-2-1 smoothing leaves of a sharp step's height."""


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


def mean_over(values: Floats, side: int) -> Floats:
    """Return the mean (H, W) over a square of `side` cells about each cell, mirrored outside."""
    return np.asarray(cv2.blur(values, (side, side), borderType=cv2.BORDER_REFLECT))


def smoothed(surface_m: Floats) -> Floats:
    """Return the surface after a 1-2-1 mean in both directions."""
    weights = np.array([0.25, 0.5, 0.25])
    return np.asarray(
        cv2.sepFilter2D(surface_m, cv2.CV_64F, weights, weights, borderType=cv2.BORDER_REFLECT)
    )


def bumps(surface_m: Floats, width_m: float, cell_m: float) -> Floats:
    """Return by how many metres (H, W) a cell stands above or below ground wider than `width_m`.

    White and black top-hat with a disc: 0 on any plane however steep, on cliff lips and feet;
    the full height on rocks and in holes narrower than the disc.
    """
    element = disc(0.5 * width_m / cell_m)
    opened = cv2.morphologyEx(surface_m, cv2.MORPH_OPEN, element, borderType=cv2.BORDER_REFLECT)
    closed = cv2.morphologyEx(surface_m, cv2.MORPH_CLOSE, element, borderType=cv2.BORDER_REFLECT)
    return np.maximum(surface_m - opened, closed - surface_m)


def steps(surface_m: Floats, width_m: float, cell_m: float) -> Floats:
    """Return the height (H, W) of the sharpest step at each cell, metres, in four directions.

    A step rises more over one width than the ground does over the width before it *and* the
    width after it: rock flanks and ledges count, however steep their surroundings; a steep
    smooth face and its lip and foot do not.
    """
    reach = max(1, round(width_m / cell_m))
    out = np.zeros_like(surface_m)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        length = reach if dy == 0 or dx == 0 else max(1, round(reach / np.sqrt(2.0)))
        np.maximum(out, _steps_along(surface_m, dy * length, dx * length), out=out)
    return out


def _steps_along(surface_m: Floats, dy: int, dx: int) -> Floats:
    height, width = surface_m.shape
    pad_y, pad_x = 2 * abs(dy), 2 * abs(dx)
    padded = np.pad(surface_m, ((pad_y, pad_y), (pad_x, pad_x)), mode="edge")

    def moved(k: int) -> Floats:
        top, left = pad_y + k * dy, pad_x + k * dx
        return padded[top : top + height, left : left + width]

    before = np.abs(moved(0) - moved(-1))
    here = np.abs(moved(1) - moved(0))
    after = np.abs(moved(2) - moved(1))
    rise = np.maximum(0.0, here - np.maximum(before, after))
    return np.maximum(rise, _shifted(rise, dy, dx))


def _shifted(values: Floats, dy: int, dx: int) -> Floats:
    """Return values moved by (dy, dx) cells, 0 where nothing moved in."""
    out = np.zeros_like(values)
    height, width = values.shape
    to_y, from_y = slice(max(0, dy), height + min(0, dy)), slice(max(0, -dy), height + min(0, -dy))
    to_x, from_x = slice(max(0, dx), width + min(0, dx)), slice(max(0, -dx), width + min(0, -dx))
    out[to_y, to_x] = values[from_y, from_x]
    return out


def hazards(surface_m: Floats, wheel_m: float, footprint_m: float, cell_m: float) -> Bools:
    """Return cells (H, W) that hold a rock, a hole or a ledge higher than half a wheel."""
    calm = smoothed(surface_m)
    limit = 0.5 * wheel_m
    ledge = steps(calm, wheel_m, cell_m) > STEP_GAIN * limit
    return ledge | (bumps(calm, 2.0 * footprint_m, cell_m) > STEP_GAIN * limit)
