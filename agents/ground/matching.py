"""Where a robot stands on the ground that it has mapped, by the shape of the ground in a look.

Points of the look are held against the elevation map: the pose at which they lie on it best, by
Gauss-Newton from the believed one. What is known beforehand counts as what it is: the pose's own
covariance, and the arm's levelling, which turns all points of a look about the camera. Level ground
fixes height and nothing else; then the covariance says so.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from agents.fusion import rotate_covariance, symmetric, yaw_matrix
from agents.geometry import Bools, Floats, GridFrame, Pose, wrap_angle
from agents.maps.elevationlook import INDEPENDENT
from agents.ports import Exposure
from agents.settings import SensorSettings

LEAST_CELLS = 80
"""With fewer cells in common a look is not held against the map."""
ALIKE = 6.0
"""So many cells tell as much as one: neighbours share errors of the matcher, and of the map."""
MODEL = 0.2
"""By this share of a cell the mapped surface is another than the ground that a point lies on."""
MISFIT = 4.0
"""Residuals' variance, in units of what is expected, beyond which nothing is told."""
TAIL = 4.0
"""Residuals of so many sigmas count for nothing (Tukey's biweight)."""
ROUNDS = 8
ENOUGH_M = 2e-4
"""Corrections smaller than this end the search."""
FLOOR_M, FLOOR_RAD = 0.003, 0.0005
"""No look tells more than this."""
VAGUE_M, VAGUE_RAD = 0.5, 0.2
"""What says less than this says nothing."""


@dataclass(frozen=True)
class Match:
    """A measured pose and its covariance (4, 4) of (x, y, z, yaw), in the map's frame."""

    pose: Pose
    covariance: Floats
    cells: int
    """How many cells of the map spoke."""


@dataclass(frozen=True)
class Points:
    """A look, joined to one point per cell of the map."""

    local_m: Floats
    """(N, 3) levelled robot frame."""
    along_m: Floats
    """(N,) standard deviation along the ray."""


@dataclass(frozen=True)
class Relief:
    """The map's surface, and where it can be held against a look."""

    frame: GridFrame
    height_m: Floats
    """(H, W); only where `usable` it means anything."""
    east: Floats
    north: Floats
    """(H, W) slopes."""
    usable: Bools


def relief_of(frame: GridFrame, elevation_m: Floats, cells: Bools) -> Relief:
    """Return the surface of some cells (H, W) of a map (H, W; NaN unknown).

    A cell can be used if the eight about it are known too.
    """
    known = ~np.isnan(elevation_m)
    whole = np.where(known, elevation_m, 0.0)
    weights = np.array([0.25, 0.5, 0.25])
    smooth = np.asarray(cv2.sepFilter2D(whole, cv2.CV_64F, weights, weights), dtype=np.float64)
    inner = cv2.erode(known.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
    north, east = (np.gradient(smooth, frame.cell_m, axis=axis) for axis in (0, 1))
    deep = cv2.erode(inner.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
    return Relief(frame, smooth, east, north, deep & cells)


def points_of(exposure: Exposure, frame: GridFrame, pose: Pose) -> Points:
    """Join the points of a look cell by cell, as a pose puts them on the grid."""
    cells = frame.cells_of(pose.team_from_robot(exposure.points_m))
    inside = (cells >= 0).all(axis=1) & (cells[:, 0] < frame.rows) & (cells[:, 1] < frame.cols)
    local, sigma = exposure.points_m[inside], exposure.sigma_m[inside]
    flat = cells[inside, 0] * frame.cols + cells[inside, 1]
    _, where, count = np.unique(flat, return_inverse=True, return_counts=True)
    weight = 1.0 / sigma**2
    total = np.bincount(where, weight)
    mean = np.column_stack([np.bincount(where, weight * local[:, k]) / total for k in range(3)])
    along = np.sqrt(count / total / np.minimum(count, INDEPENDENT))
    return Points(mean, along)


def match(
    relief: Relief, points: Points, pose: Pose, covariance: Floats, sensor: SensorSettings
) -> Match | None:
    """Return where the robot stood by a look, or None where the look doesn't tell.

    Args:
        relief: what was mapped before.
        points: of the look.
        pose: as it is believed, in the frame in which the map is drawn.
        covariance: (4, 4) of that, (x, y, z, yaw), metres and radians, in the same frame.
        sensor: its height and levelling.
    """
    tilt = np.radians(sensor.attitude_sigma_deg) ** 2
    prior = np.zeros((6, 6))
    prior[:4, :4] = np.linalg.inv(covariance + np.diag([FLOOR_M**2] * 3 + [FLOOR_RAD**2]))
    prior[4:, 4:] = np.eye(2) / max(tilt, 1e-10)
    offset, spread = np.zeros(6), 1.0
    for _ in range(ROUNDS):
        told = _normal(relief, points, pose, offset, sensor.height_m, spread)
        if told is None:
            return None
        step = np.linalg.solve(told.information + prior, told.gradient - prior @ offset)
        offset, spread = offset + step, told.spread
        if float(np.abs(step[:3]).max()) < ENOUGH_M:
            break
    told = _normal(relief, points, pose, offset, sensor.height_m, spread)
    if told is None or told.spread > MISFIT:
        return None
    noise = _noise(told, prior[4:, 4:])
    # The fit holds what was believed in it already: the measurement is what it adds to that.
    measured = offset[:4] + noise @ prior[:4, :4] @ offset[:4]
    stood = Pose(
        pose.x_m + measured[0],
        pose.y_m + measured[1],
        pose.z_m + measured[2],
        wrap_angle(pose.yaw_rad + measured[3]),
    )
    floor = np.diag([FLOOR_M**2] * 3 + [FLOOR_RAD**2])
    return Match(stood, symmetric(noise) + floor, told.cells)


def blur(relief: Relief, points: Points, pose: Pose, sensor: SensorSettings) -> Floats:
    """Return how surely a drawing (4, 4) stands for the pose from which a look was drawn.

    It errs by the look's own noise, as a match of another look with it does.
    """
    level = np.eye(2) / max(np.radians(sensor.attitude_sigma_deg) ** 2, 1e-10)
    told = _normal(relief, points, pose, np.zeros(6), sensor.height_m, 1.0)
    if told is None:
        return np.diag([VAGUE_M**2] * 3 + [VAGUE_RAD**2])
    return _noise(told, level)


def _noise(told: "_Told", level: Floats) -> Floats:
    """Return the covariance (4, 4) of a pose, levelling (2, 2) and all else taken out."""
    across = told.information[:4, 4:]
    shared = np.linalg.solve(level + told.information[4:, 4:], across.T)
    information = told.information[:4, :4] - across @ shared
    information += np.diag([VAGUE_M**-2] * 3 + [VAGUE_RAD**-2])
    return symmetric(np.linalg.inv(symmetric(information)))


@dataclass(frozen=True)
class _Told:
    """Normal equations of (x, y, z, yaw, roll, pitch), and how well points fit."""

    information: Floats
    gradient: Floats
    spread: float
    cells: int


def _normal(
    relief: Relief, points: Points, pose: Pose, offset: Floats, height_m: float, spread: float
) -> _Told | None:
    """Linearise about a pose and an offset (6,) of it; None where too few cells are common."""
    frame, yaw = relief.frame, pose.yaw_rad + offset[3]
    arm = np.array([0.0, 0.0, height_m])
    from_eye = (points.local_m - arm) @ yaw_matrix(yaw)[:3, :3].T
    tilt = np.array([offset[4], offset[5], 0.0])
    from_eye = from_eye + np.cross(tilt, from_eye)
    at = from_eye + arm + np.array([pose.x_m, pose.y_m, pose.z_m]) + offset[:3]
    col = (at[:, 0] - frame.x_m) / frame.cell_m - 0.5
    row = (at[:, 1] - frame.y_m) / frame.cell_m - 0.5
    j, i = np.floor(col).astype(np.int64), np.floor(row).astype(np.int64)
    inside = (i >= 0) & (j >= 0) & (i < frame.rows - 1) & (j < frame.cols - 1)
    near_i, near_j = (np.clip(np.rint(v), 0, n - 1).astype(np.int64)
                      for v, n in ((row, frame.rows), (col, frame.cols)))  # fmt: skip
    chosen = np.flatnonzero(inside & relief.usable[near_i, near_j])
    if len(chosen) < LEAST_CELLS:
        return None
    i, j, at, from_eye = i[chosen], j[chosen], at[chosen], from_eye[chosen]
    b, a = row[chosen] - i, col[chosen] - j

    def surface(grid: Floats) -> Floats:
        low = grid[i, j] * (1 - a) + grid[i, j + 1] * a
        high = grid[i + 1, j] * (1 - a) + grid[i + 1, j + 1] * a
        return low * (1 - b) + high * b

    east, north = surface(relief.east), surface(relief.north)
    error = at[:, 2] - surface(relief.height_m)
    normal = np.column_stack((-east, -north, np.ones(len(chosen))))
    ray = from_eye / np.linalg.norm(from_eye, axis=1, keepdims=True)
    along = points.along_m[chosen] * np.einsum("nk,nk->n", ray, normal)
    variance = along**2 + (MODEL * frame.cell_m) ** 2 * np.einsum("nk,nk->n", normal, normal)
    ratio = error**2 / variance
    centre = float(np.median(ratio)) / 0.455  # the median of chi-squared with one degree
    weight = np.maximum(0.0, 1.0 - ratio / (TAIL**2 * max(centre, spread, 1.0))) ** 2
    about = from_eye + arm  # of the robot's own axis
    slopes = np.column_stack(
        (
            normal,
            normal[:, 1] * about[:, 0] - normal[:, 0] * about[:, 1],
            from_eye[:, 1] - normal[:, 1] * from_eye[:, 2],
            normal[:, 0] * from_eye[:, 2] - from_eye[:, 0],
        )
    )
    share = weight / variance / (ALIKE * max(centre, 1.0))
    weighted = slopes * share[:, None]
    return _Told(weighted.T @ slopes, -(weighted.T @ error), centre, len(chosen))


def in_frame_of(base: Pose, stood: Pose, covariance: Floats) -> tuple[Floats, Floats]:
    """Return a measured pose (4,) and its covariance (4, 4) in the frame of a base pose."""
    turn = yaw_matrix(-base.yaw_rad)
    apart = np.array(
        (stood.x_m - base.x_m, stood.y_m - base.y_m, stood.z_m - base.z_m, 0.0), dtype=np.float64
    )
    offset = turn @ apart
    offset[3] = wrap_angle(stood.yaw_rad - base.yaw_rad)
    return offset, rotate_covariance(covariance, turn)
