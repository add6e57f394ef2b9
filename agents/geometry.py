"""Frames, poses and grids.

World and team frames: x east, y north, z up, metres; yaw counter-clockwise from +x, radians.
Grids keep row 0 at the *south* edge (row grows with y, column with x); files that keep row 0 at
the north are flipped where they are read and written, and nowhere else.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


def wrap_angle(angle_rad: float) -> float:
    """Return the angle in (-pi, pi]."""
    return math.pi - (math.pi - angle_rad) % (2 * math.pi)


@dataclass(frozen=True)
class Pose:
    """Where a robot stands: the ground contact below its mast, in metres, and its yaw."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float

    def moved(self, forward_m: float, left_m: float, up_m: float, turn_rad: float) -> "Pose":
        """Return the pose after a displacement given in this pose's own frame."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return Pose(
            self.x_m + c * forward_m - s * left_m,
            self.y_m + s * forward_m + c * left_m,
            self.z_m + up_m,
            wrap_angle(self.yaw_rad + turn_rad),
        )

    def team_from_robot(self, points_m: Floats) -> Floats:
        """Turn points (N, 3) of the levelled robot frame into the frame of this pose."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        x, y, z = points_m[:, 0], points_m[:, 1], points_m[:, 2]
        return np.column_stack((self.x_m + c * x - s * y, self.y_m + s * x + c * y, self.z_m + z))

    def distance_m(self, other: "Pose") -> float:
        """Return the horizontal distance to another pose."""
        return math.hypot(self.x_m - other.x_m, self.y_m - other.y_m)


@dataclass(frozen=True)
class GridFrame:
    """A grid of square cells: its south-west corner, its cell size and its shape."""

    x_m: float
    y_m: float
    cell_m: float
    rows: int
    cols: int

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return (self.rows, self.cols)

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """(west, east, south, north): what matplotlib's `imshow` calls extent."""
        return (
            self.x_m,
            self.x_m + self.cols * self.cell_m,
            self.y_m,
            self.y_m + self.rows * self.cell_m,
        )

    def cell_of(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Return the (row, col) that holds a point; it may lie outside the grid."""
        return (
            math.floor((y_m - self.y_m) / self.cell_m),
            math.floor((x_m - self.x_m) / self.cell_m),
        )

    def cells_of(self, xy_m: Floats) -> Ints:
        """Return rows and columns (N, 2) of points (N, 2 or 3); they may lie outside the grid."""
        cols = np.floor((xy_m[:, 0] - self.x_m) / self.cell_m)
        rows = np.floor((xy_m[:, 1] - self.y_m) / self.cell_m)
        return np.column_stack((rows, cols)).astype(np.int64)

    def mask_of(self, xy_m: Floats) -> Bools:
        """Return the cells (rows, cols) in which any of points (N, 2 or 3) lies."""
        cells = self.cells_of(xy_m)
        inside = ((cells >= 0) & (cells < self.shape)).all(axis=1)
        mask = np.zeros(self.shape, dtype=np.bool_)
        mask[cells[inside, 0], cells[inside, 1]] = True
        return mask

    def centre_of(self, row: int, col: int) -> tuple[float, float]:
        """Return the (x, y) of a cell's centre."""
        return (self.x_m + (col + 0.5) * self.cell_m, self.y_m + (row + 0.5) * self.cell_m)

    def holds(self, row: int, col: int) -> bool:
        """Say whether a cell lies inside the grid."""
        return 0 <= row < self.rows and 0 <= col < self.cols
