"""The ground itself, and what it lets a robot do: stand, drive, or hit something."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import cv2
import numpy as np
from scipy import ndimage

from agents.geometry import Bools, Floats, GridFrame, Ints, Singles


@dataclass(frozen=True, eq=False)
class Terrain:
    """True ground in the world frame: a height and a texture per cell centre, row 0 south.

    No two are equal but the same one, so that what is worked out of one can be kept.
    """

    frame: GridFrame
    elevation_m: Singles
    """(rows, cols) heights of the cell centres; NaN where nobody knows them. Between the centres
    the ground is bilinear."""
    texture: Singles
    """(rows, cols) in [0, 1]: how well a stereo camera can match this ground."""
    edge_m: Floats | None = None
    """(M, 2) points along the lip of a made cliff, west to east; None for other ground."""

    def height_m(self, x_m: float, y_m: float) -> float:
        """Return the ground's height at a point; NaN outside and where it is unknown."""
        return bilinear(self.frame, self.elevation_m, x_m, y_m)


def bilinear(frame: GridFrame, grid: Singles | Floats, x_m: float, y_m: float) -> float:
    """Return a grid's value between its cell centres; held constant over the outer half cell."""
    row, col = frame.cell_of(x_m, y_m)
    if not frame.holds(row, col):
        return math.nan
    v = min(max((y_m - frame.y_m) / frame.cell_m - 0.5, 0.0), frame.rows - 1.0)
    u = min(max((x_m - frame.x_m) / frame.cell_m - 0.5, 0.0), frame.cols - 1.0)
    r, c = min(int(v), max(frame.rows - 2, 0)), min(int(u), max(frame.cols - 2, 0))
    r1, c1 = min(r + 1, frame.rows - 1), min(c + 1, frame.cols - 1)
    b, a = v - r, u - c
    south = (1 - a) * float(grid[r, c]) + a * float(grid[r, c1])
    north = (1 - a) * float(grid[r1, c]) + a * float(grid[r1, c1])
    return (1 - b) * south + b * north


def disc(radius_cells: float) -> Bools:
    """Return a round structuring element, (2n+1, 2n+1)."""
    n = max(0, math.floor(radius_cells + 1e-9))
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    return x * x + y * y <= (radius_cells + 1e-9) ** 2


def dilated(mask: Bools, radius_cells: float) -> Bools:
    """Return the cells within a radius of the mask's cells."""
    element = disc(radius_cells).astype(np.uint8)
    return cv2.dilate(mask.astype(np.uint8), element).astype(np.bool_)


def filled(elevation_m: Singles | Floats) -> Floats:
    """Return heights with every unknown cell given the value of its nearest known one."""
    known = np.isfinite(elevation_m)
    full = elevation_m.astype(np.float64)
    if not known.all():
        nearest = ndimage.distance_transform_edt(
            ~known, return_distances=False, return_indices=True
        )
        rows, cols = cast("tuple[Ints, Ints]", nearest)
        full = full[rows, cols]
    return full


def plane_fit(full_m: Floats, cell_m: float, width_m: float) -> tuple[Floats, Floats, Floats]:
    """Fit a plane to a square around each cell by least squares.

    Returns (height in m at the cell, slope to the east, slope to the north), each (rows, cols).
    """
    n = max(1, round(width_m / cell_m / 2))
    ramp = np.arange(-n, n + 1, dtype=np.float64)
    ramp /= (ramp**2).sum() * cell_m
    mean = np.full(2 * n + 1, 1 / (2 * n + 1))
    low = float(full_m.mean())
    centred = full_m - low  # heights above the areoid are thousands of metres: keep the digits

    def fit(along_x: Floats, along_y: Floats) -> Floats:
        got = cv2.sepFilter2D(centred, cv2.CV_64F, along_x, along_y, borderType=cv2.BORDER_REFLECT)
        return np.asarray(got, dtype=np.float64)

    return fit(mean, mean) + low, fit(ramp, mean), fit(mean, ramp)


def _shifted(full_m: Floats, rows: int, cols: int) -> Floats:
    """Return the grid as seen `rows` north and `cols` east of each cell, borders repeated."""
    h, w = full_m.shape
    r = np.clip(np.arange(h) + rows, 0, h - 1)
    c = np.clip(np.arange(w) + cols, 0, w - 1)
    return full_m[np.ix_(r, c)]


def _offsets(length_cells: float) -> list[tuple[int, int]]:
    """Return whole-cell offsets of a length in the four directions, each at least one cell."""
    straight = max(1, round(length_cells))
    slanted = max(1, round(length_cells * math.sqrt(0.5)))
    return [(0, straight), (straight, 0), (slanted, slanted), (slanted, -slanted)]


def hazard_mask(
    terrain: Terrain, wheel_m: float, footprint_m: float, climb_m: float | None = None
) -> Bools:
    """Say which cells hold what a wheel must not meet: rocks and steps, not a smooth steep face.

    Too high is what is higher than `climb_m`, half a wheel if that is left out.
    A cell is a rock where it stands too high above the straight line between the
    ground on both its sides in *every* one of four directions, at the distance of a wheel or of
    half a footprint (a lip or a crest stands out in some directions only). It is a
    step where the ground, over one wheel, rises too high beyond what its mean
    slope over the footprint explains. Unknown cells are none. Shape (rows, cols), row 0 south.
    """
    full = filled(terrain.elevation_m)
    cell = terrain.frame.cell_m
    limit = wheel_m / 2 if climb_m is None else climb_m
    hazard = np.zeros(full.shape, dtype=np.bool_)
    for length in (wheel_m, footprint_m / 2):
        stands_out = np.full(full.shape, np.inf)
        for dr, dc in _offsets(length / cell):
            line = (_shifted(full, dr, dc) + _shifted(full, -dr, -dc)) / 2
            np.minimum(stands_out, full - line, out=stands_out)
        hazard |= stands_out > limit
    hazard |= _steps(full, cell, wheel_m, footprint_m) > limit
    return hazard & np.isfinite(terrain.elevation_m)


def _steps(full_m: Floats, cell_m: float, wheel_m: float, footprint_m: float) -> Floats:
    """Return the rise over one wheel that the slope over the footprint does not explain, in m."""
    worst = np.zeros(full_m.shape)
    near, far = _offsets(wheel_m / 2 / cell_m), _offsets(footprint_m / 2 / cell_m)
    for (r1, c1), (r2, c2) in zip(near, far, strict=True):
        rise = _shifted(full_m, r1, c1) - _shifted(full_m, -r1, -c1)
        slope = _shifted(full_m, r2, c2) - _shifted(full_m, -r2, -c2)
        share = math.hypot(r1, c1) / math.hypot(r2, c2)
        # Wheels that cover less than two cells can't tell a step from a slope.
        np.maximum(worst, np.abs(rise - share * slope), out=worst)
    return worst


class Footing:
    """What the ground offers to a robot of one size, at every cell."""

    def __init__(
        self,
        terrain: Terrain,
        footprint_m: float,
        wheel_m: float,
        climb_m: float | None = None,
    ) -> None:
        """Fit the footprint's plane everywhere and find what its circle would touch."""
        self.frame = terrain.frame
        self.footprint_m = footprint_m
        cell = terrain.frame.cell_m
        known = np.isfinite(terrain.elevation_m)
        self.height_m, self.east_slope, self.north_slope = plane_fit(
            filled(terrain.elevation_m), cell, footprint_m
        )
        self.slope_deg: Floats = np.degrees(np.arctan(np.hypot(self.east_slope, self.north_slope)))
        """(rows, cols) slope of the plane under the footprint."""
        self.hazard = hazard_mask(terrain, wheel_m, footprint_m, climb_m)
        """(rows, cols) rocks and steps (see `hazard_mask`)."""
        radius = footprint_m / 2 / cell
        self.contact = dilated(self.hazard, radius)
        """(rows, cols) standing here, the robot's circle touches a rock or a step."""
        self.open = ~dilated(np.pad(~known, 1, constant_values=True), radius)[1:-1, 1:-1]
        """(rows, cols) the robot's circle is inside the window, on known ground."""

    def standable(self, max_slope_deg: float) -> Bools:
        """Return the cells on which a robot can stand and drive without a tether."""
        return self.open & ~self.contact & (self.slope_deg <= max_slope_deg)

    def cell(self, x_m: float, y_m: float) -> tuple[int, int] | None:
        """Return the cell of a point where the robot's circle is inside the window, else None."""
        row, col = self.frame.cell_of(x_m, y_m)
        return (row, col) if self.frame.holds(row, col) and self.open[row, col] else None

    def ground_m(self, x_m: float, y_m: float) -> float:
        """Return the height on which the footprint rests at a point; NaN outside the window."""
        return bilinear(self.frame, self.height_m, x_m, y_m)


@lru_cache(maxsize=2)
def footing_on(terrain: Terrain, footprint_m: float, wheel_m: float, climb_m: float) -> Footing:
    """Return the footing of robots of one kind, worked out once for all that are in a process."""
    return Footing(terrain, footprint_m, wheel_m, climb_m)


def largest_regions(mask: Bools, least_cells: float) -> Bools:
    """Return the connected parts of a mask of at least a size; the largest where none is."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        mask.astype(np.uint8), connectivity=4
    )
    if count < 2:
        return np.zeros(mask.shape, dtype=np.bool_)
    areas = stats[:, cv2.CC_STAT_AREA].copy()
    areas[0] = 0
    kept = (areas >= min(least_cells, areas.max())) & (areas > 0)
    return np.asarray(kept[np.asarray(labels, dtype=np.int64)], dtype=np.bool_)


def region_of(mask: Bools, row: int, col: int) -> Bools:
    """Return the connected part of a mask that holds a cell, or is nearest to it."""
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), None, 4)
    if count < 2:
        return np.zeros(mask.shape, dtype=np.bool_)
    rows, cols = np.nonzero(mask)
    nearest = int(np.argmin((rows - row) ** 2 + (cols - col) ** 2))
    return np.asarray(labels == labels[rows[nearest], cols[nearest]], dtype=np.bool_)
