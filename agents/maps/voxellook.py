"""One look into space, cell by cell: what a voxel map takes in.

A ray ends half a cell behind the face that it met, and frees the cells that it has left before.
How sure it can be of a cell is as on a floor (`agents.planar.sensing`): by the error of its range.
Of the rays of one look the majority decides, and the look is as sure as their majority is large,

    l = +-l(range) |passed - ended| / (passed + ended),

for a cell at whose corner half of the rays end is a surface's edge, not half of a wall.
"""

import math
from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, Ints, Pose
from agents.planar.sensing import evidence
from agents.settings import SensorSettings
from agents.voxel.frame import VoxelFrame
from agents.voxel.rays import crossings, ray_directions
from comms import kernels
from comms.kernels import kernel

BEHIND = 0.5
"""A ray ends in the cell that lies so many cells behind the face that it met."""


@dataclass(frozen=True)
class VoxelLook:
    """What one look adds to the log-odds of the cells that its rays crossed."""

    cells: Ints
    """(N, 3) layer, row and column, each cell once."""
    log_odds: Floats
    """(N,)."""


def eye_of(pose: Pose, sensor: SensorSettings) -> tuple[float, float, float]:
    """Return (x, y, z) of the camera of a robot that stands at a pose."""
    return (pose.x_m, pose.y_m, pose.z_m + sensor.height_m)


def world_rays(sensor: SensorSettings, yaw_rad: float, tilt_rad: float) -> Floats:
    """Return the camera's rays (N, 3) as (layer, row, col), its middle pointing at a yaw."""
    return np.ascontiguousarray(ray_directions(sensor, yaw_rad, tilt_rad)[:, ::-1])


@kernel
def _sweep(
    votes: np.ndarray,
    low: np.ndarray,
    start: np.ndarray,
    rays: np.ndarray,
    reach: np.ndarray,
    face: np.ndarray,
) -> None:
    """Count, per cell of a cube about the eye, rays that passed and rays that ended there.

    A ray that came back passed the cells that it left before the face, and tells nothing of what it
    crosses between there and its end.
    """
    side = votes.shape[1]
    most = 3 * side + 8
    cells, entry = np.empty((most, 3), dtype=np.int64), np.empty(most)
    for k in range(len(rays)):
        count = crossings(start, rays[k], reach[k], cells, entry)
        for n in range(count):
            z, y, x = cells[n, 0] - low[0], cells[n, 1] - low[1], cells[n, 2] - low[2]
            if min(z, y, x) < 0 or max(z, y, x) >= side:
                break
            if n == count - 1 and face[k] < np.inf:
                votes[1, z, y, x] += 1
            elif n == count - 1 or entry[n + 1] <= face[k]:
                votes[0, z, y, x] += 1


def look_odds(
    ranges_m: Floats,
    pose: Pose,
    tilt_rad: float,
    frame: VoxelFrame,
    sensor: SensorSettings,
    *,
    extra_variance: tuple[float, float, float, float],
) -> VoxelLook:
    """Turn the ranges (N,) of one look into one measurement per cell.

    `pose` is the robot's, its yaw where the camera points. `extra_variance` is the pose's variance
    (x, y, z, yaw) beyond that of the submap's anchor: log-odds are divided by 1 + (variance of the
    cell's place) / cell^2, as in `VoxelKind.blurred`.
    """
    cell_m = frame.cell_m
    hit = np.isfinite(ranges_m)
    reach = np.where(hit, ranges_m / cell_m + BEHIND, sensor.range_m / cell_m)
    start = frame.at(*eye_of(pose, sensor))
    half = math.ceil(sensor.range_m / cell_m) + 2
    low = np.floor(start).astype(np.int64) - half
    votes = np.zeros((2, *(2 * half + 1,) * 3), dtype=np.int32)
    _sweep(votes, low, start, world_rays(sensor, pose.yaw_rad, tilt_rad), reach, ranges_m / cell_m)
    cells = np.argwhere(votes[0] != votes[1])
    free, full = (votes[n][tuple(cells.T)] for n in (0, 1))
    cells += low
    inside = ((cells >= 0) & (cells < np.array(frame.voxels))).all(axis=1)
    cells, free, full = cells[inside], free[inside], full[inside]
    away_m = (cells + 0.5 - start) * cell_m
    range_m = np.sqrt((away_m**2).sum(axis=1))
    sure = evidence(np.minimum(range_m, sensor.range_m), cell_m, sensor)
    sure = sure * np.abs(full - free) / (full + free)
    var_x, var_y, var_z, var_yaw = extra_variance
    level = 0.5 * (var_x + var_y) + (away_m[:, 1:] ** 2).sum(axis=1) * var_yaw
    sure = sure / (1.0 + np.maximum(level, var_z) / cell_m**2)
    return VoxelLook(cells, np.where(full > free, sure, -sure))


@kernel
def _chances(
    out: np.ndarray,
    low: np.ndarray,
    index: np.ndarray,
    through: np.ndarray,
    absent: float,
    start: np.ndarray,
    rays: np.ndarray,
    reach: float,
) -> None:
    """Write, per cell of a cube about the eye, the largest chance that a ray comes there (Eq. 5).

    `through` (blocks, 16, 16, 16): the chance to pass a cell; `absent` that of one in no block.
    """
    side = out.shape[0]
    most = 3 * side + 8
    cells, entry = np.empty((most, 3), dtype=np.int64), np.empty(most)
    for k in range(len(rays)):
        p = 1.0
        for n in range(crossings(start, rays[k], reach, cells, entry)):
            i, j, m = cells[n, 0], cells[n, 1], cells[n, 2]
            if min(i, j, m) < 0:
                break
            a, b, c = i >> 4, j >> 4, m >> 4
            if a >= index.shape[0] or b >= index.shape[1] or c >= index.shape[2]:
                break
            z, y, x = i - low[0], j - low[1], m - low[2]
            out[z, y, x] = max(out[z, y, x], p)
            block = index[a, b, c]
            p *= absent if block < 0 else through[block, i & 15, j & 15, m & 15]
            if p < 0.02:
                break


def chances(
    index: np.ndarray,
    through: np.ndarray,
    absent: float,
    pose: Pose,
    tilt_rad: float,
    frame: VoxelFrame,
    sensor: SensorSettings,
) -> tuple[Ints, Floats]:
    """Return the cells (N, 3) that a look may show, and the probability (N,) of each.

    Args:
        index: (layers, rows, cols) of blocks, -1 where there is none.
        through: (blocks, 16, 16, 16) float32, the probability that a ray passes a cell.
        absent: the same of a cell in no block.
        pose: the robot's, its yaw where the camera points.
        tilt_rad: of the camera.
        frame: of the map.
        sensor: its rays and range.
    """
    start = frame.at(*eye_of(pose, sensor))
    half = math.ceil(sensor.range_m / frame.cell_m) + 2
    low = np.floor(start).astype(np.int64) - half
    out = np.zeros((2 * half + 1,) * 3)
    rays = world_rays(sensor, pose.yaw_rad, tilt_rad)
    _chances(out, low, index, through, absent, start, rays, sensor.range_m / frame.cell_m)
    cells = np.argwhere(out)
    p = out[tuple(cells.T)]
    cells += low
    inside = (cells < np.array(frame.voxels)).all(axis=1)
    return cells[inside], p[inside]


@kernels.warmer
def _warm() -> None:
    sensor = SensorSettings(columns=4, rows=4, range_m=2.0)
    frame = VoxelFrame(0.0, 0.0, 1.0, 16, 16)
    pose = Pose(8.0, 8.0, 4.0, 0.0)
    look_odds(np.full(16, np.inf), pose, 0.0, frame, sensor, extra_variance=(0.0, 0.0, 0.0, 0.0))
    through = np.ones((1, 16, 16, 16), dtype=np.float32)
    chances(np.zeros((1, 1, 1), dtype=np.int32), through, 0.9, pose, 0.0, frame, sensor)
