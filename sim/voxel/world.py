"""Voxel worlds: which cubes of space are solid, where one can stand, and what can be seen.

Observable are the cells, the first obstacle along a ray included, that a noise-free look sees from
any place on a 2 m lattice that can be reached from the start, all round and at the planner's tilts.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from agents.geometry import Bools, Floats, Ints, Pose
from agents.maps.voxellook import eye_of
from agents.settings import DriveSettings, SensorSettings
from agents.voxel.frame import Block, VoxelFrame
from agents.voxel.ground import FREE, SOLID, Build, Ground
from agents.voxel.rays import crossings, ray_directions
from agents.voxelcast import SIDE, VoxelBlocks, cast
from comms import kernels
from comms.kernels import kernel
from sim.errors import WorldError
from sim.occupancy import measured_m

LATTICE_M = 2.0


@dataclass(frozen=True)
class VoxelWorld:
    """What is solid, and where robots start."""

    frame: VoxelFrame
    solid: Bools
    """(layers, rows, cols)."""
    start: Block
    """The cell in which the first robot's wheels stand."""

    @cached_property
    def rock(self) -> VoxelBlocks:
        """The solid cells as rays meet them."""
        some = np.ones(self.solid.shape, dtype=np.bool_)
        frame = self.frame
        return VoxelBlocks.from_dense(
            frame.corner_m, frame.cell_m, self.solid.astype(np.float32), some
        )

    def ground(self, build: Build) -> Ground:
        """Return where a robot can stand."""
        count = len(self.rock.cells)
        corners = np.zeros((count, 3), dtype=np.int64)
        where = np.argwhere(self.rock.index >= 0)
        corners[self.rock.index[tuple(where.T)]] = where * SIDE
        states = np.where(self.rock.cells > 0.5, SOLID, FREE).astype(np.int8)
        room = np.array(self.frame.voxels)
        for number in np.flatnonzero((corners + SIDE > room).any(axis=1)):
            inside = tuple(slice(0, int(n)) for n in np.maximum(room - corners[number], 0))
            beyond = np.ones((SIDE,) * 3, dtype=np.bool_)
            beyond[inside] = False
            states[number][beyond] = SOLID
        return Ground(self.rock.index, states, corners, build)

    def standing(self, cell: Ints, yaw_rad: float) -> Pose:
        """Return the pose of a robot whose wheels stand in the middle of a cell's lower face."""
        x_m, y_m, z_m = (float(v) for v in self.frame.centres_m(cell[None])[0])
        return Pose(x_m, y_m, z_m - 0.5 * self.frame.cell_m, yaw_rad)


def best_start(world: VoxelWorld, build: Build) -> VoxelWorld:
    """Return the world with its start in the middle of the largest floor that hangs together.

    Raises:
        WorldError: there is no room for the robot.
    """
    ground = world.ground(build)
    left = np.ones(len(ground.cells), dtype=np.bool_)
    largest = np.zeros(len(ground.cells), dtype=np.bool_)
    while left.sum() > largest.sum():
        part = ground.reachable(int(np.argmax(left))) & left
        left &= ~part
        if part.sum() > largest.sum():
            largest = part
    if not largest.any():
        raise WorldError("the world has no room for the robot: nowhere is a free and level place")
    cells = ground.cells[largest]
    apart = ((cells - cells.mean(axis=0)) ** 2).sum(axis=1)
    layer, row, col = (int(v) for v in cells[int(np.argmin(apart))])
    return VoxelWorld(world.frame, world.solid, (layer, row, col))


def look(
    world: VoxelWorld,
    pose: Pose,
    tilt_rad: float,
    sensor: SensorSettings,
    rng: np.random.Generator | None,
) -> Floats:
    """Return the ranges (rows * columns,) that a camera measures; inf where nothing came back.

    `pose` is the robot's, its yaw where the camera points. A ray goes to the face of the first
    solid cell and errs by S L^n (Sujan & Meggiolaro, Eq. 4); `rng` None: no noise.
    """
    rays = ray_directions(sensor, pose.yaw_rad, tilt_rad)
    ranges_m = cast(world.rock, eye_of(pose, sensor), rays, sensor.range_m).distance_m
    ranges_m = np.where(ranges_m >= sensor.near_m, ranges_m, np.inf)
    return measured_m(ranges_m, sensor, rng)


@kernel
def _mark(
    solid: np.ndarray, start: np.ndarray, rays: np.ndarray, reach: float, seen: np.ndarray
) -> None:
    """Mark the cells that rays cross up to the first solid one, that one included."""
    most = 3 * int(reach) + 10
    cells, entry = np.empty((most, 3), dtype=np.int64), np.empty(most)
    for r in range(len(rays)):
        for n in range(crossings(start, rays[r], reach, cells, entry)):
            i, j, k = cells[n, 0], cells[n, 1], cells[n, 2]
            if min(i, j, k) < 0:
                break
            if i >= solid.shape[0] or j >= solid.shape[1] or k >= solid.shape[2]:
                break
            seen[i, j, k] = True
            if solid[i, j, k]:
                break


def observable(
    world: VoxelWorld, sensor: SensorSettings, drive: DriveSettings, tilts_deg: tuple[float, ...]
) -> Bools:
    """Return the cells (layers, rows, cols) that count when coverage is told; see above."""
    frame = world.frame
    ground = world.ground(Build.of(drive, sensor, frame.cell_m))
    place = ground.place_at(*world.start, 0)
    seen = np.zeros(frame.voxels, dtype=np.bool_)
    if place < 0:
        return seen
    cells = ground.cells[ground.reachable(place)]
    step = max(1, round(LATTICE_M / frame.cell_m))
    cells = cells[((cells - np.array(world.start))[:, 1:] % step == 0).all(axis=1)]
    turns = max(4, math.ceil(360.0 / sensor.fov_deg * sensor.columns))
    round_view = sensor.model_copy(update={"fov_deg": 360.0, "columns": turns})
    fans = [ray_directions(round_view, 0.0, math.radians(tilt)) for tilt in tilts_deg]
    rays = np.ascontiguousarray(np.concatenate(fans)[:, ::-1])
    for cell in cells:
        x_m, y_m, z_m = eye_of(world.standing(cell, 0.0), sensor)
        start = frame.at(x_m, y_m, z_m)
        _mark(world.solid, start, rays, sensor.range_m / frame.cell_m, seen)
    return seen


@kernels.warmer
def _warm() -> None:
    solid = np.zeros((16, 16, 16), dtype=np.bool_)
    seen = np.zeros_like(solid)
    _mark(solid, np.full(3, 8.5), np.array(((0.0, 0.6, 0.8),)), 4.0, seen)
