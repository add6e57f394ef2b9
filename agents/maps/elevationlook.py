"""One look at the ground, binned: what an elevation map takes in."""

from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, GridFrame, Ints, Pose
from agents.ports import Exposure

INDEPENDENT = 4
"""Points of one look on one cell tell its mean height as well as so many that fell anywhere on it:
they are on the side that faces the camera, however many they are."""


@dataclass(frozen=True)
class LookCells:
    """One look, binned: the cells that it hit, with one mean and one variance each."""

    rows: Ints
    cols: Ints
    mean_m: Floats
    variance_m2: Floats


def bin_look(
    exposure: Exposure,
    pose: Pose,
    frame: GridFrame,
    *,
    attitude_sigma_rad: float,
    extra_variance: tuple[float, float, float, float],
) -> LookCells:
    """Turn the points of one look into one measurement per cell.

    Points of one look share the error of its levelling and of the robot's pose, so however many
    fall in a cell, its variance never falls below that common part. `extra_variance` is the
    pose's variance (x, y, z, yaw) beyond that of the submap's anchor.
    """
    points = pose.team_from_robot(exposure.points_m)
    cells = frame.cells_of(points)
    inside = (
        (cells[:, 0] >= 0)
        & (cells[:, 0] < frame.rows)
        & (cells[:, 1] >= 0)
        & (cells[:, 1] < frame.cols)
    )
    local, points, cells = exposure.points_m[inside], points[inside], cells[inside]
    along_sigma = exposure.sigma_m[inside]
    flat = cells[:, 0] * frame.cols + cells[:, 1]
    counts = np.bincount(flat, minlength=frame.rows * frame.cols)
    used = np.flatnonzero(counts)
    count, place = counts[used], np.zeros(counts.size, dtype=np.int64)
    place[used] = np.arange(used.size)
    where = place[flat]
    if used.size == 0:
        nothing = np.zeros(0, dtype=np.int64)
        return LookCells(nothing, nothing, np.zeros(0), np.zeros(0))
    range_m = np.linalg.norm(local, axis=1) + 1e-9
    ground_m = np.hypot(local[:, 0], local[:, 1])
    sine = np.minimum(1.0, np.abs(local[:, 2]) / range_m + 0.1)
    weight = 1.0 / np.maximum(along_sigma * sine, 1e-3) ** 2
    total = np.bincount(where, weight)
    z_m = points[:, 2]
    mean = np.bincount(where, weight * z_m) / total
    spread = np.bincount(where, (z_m - mean[where]) ** 2) / count
    spread = np.maximum(spread, (0.3 * frame.cell_m) ** 2)
    reach = np.bincount(where, ground_m) / count
    slope2 = np.minimum(spread * 12.0 / frame.cell_m**2, 9.0)
    var_x, var_y, var_z, var_yaw = extra_variance
    common = (
        (attitude_sigma_rad * reach) ** 2
        + var_z
        + slope2 * (0.5 * (var_x + var_y) + reach**2 * var_yaw)
    )
    variance = 1.0 / total + spread / np.minimum(count, INDEPENDENT) + common
    return LookCells(used // frame.cols, used % frame.cols, mean, variance)
