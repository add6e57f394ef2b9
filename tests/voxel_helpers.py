"""Small worlds of cubes, and maps of them as a robot would have them."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from agents.geometry import Pose, wrap_angle
from agents.layers import Anchor
from agents.maps.voxel import Cube, VoxelOccupancy, VoxelSubmap
from agents.maps.voxellook import look_odds
from agents.occupancy.view import Means, Situation
from agents.settings import DriveSettings, PlannerSettings, SensorSettings
from agents.voxel.frame import VoxelFrame, by_block
from agents.voxel.ground import Build
from agents.voxel.sense import VoxelSense
from sim.voxel.world import VoxelWorld, look

CELL_M = 0.25
SENSOR = SensorSettings(
    fov_deg=90.0, fov_vertical_deg=75.0, near_m=0.0, range_m=5.0, height_m=0.7,
    columns=64, rows=56, look_s=2.0,
)  # fmt: skip
EXACT = DriveSettings(
    footprint_m=0.4, climb_m=0.3, slip_sigma=0, slip_bias_sigma=0, odometry_sigma=0,
    yaw_sigma_deg_per_m=0, yaw_sigma_deg_per_turn=0, speed_mps=1.0, turn_rate_radps=1.0,
)  # fmt: skip
PLANNER = PlannerSettings(
    candidate_step_m=1.0, headings=8, tilts_deg=(-25.0, 20.0), max_candidates=20,
    min_gain_cells=20.0,
)  # fmt: skip
MEANS = Means(SENSOR, EXACT, PLANNER)
BUILD = Build.of(EXACT, SENSOR, CELL_M)


def hall() -> VoxelWorld:
    """Return two rooms of 5 x 3 m with a door between them, a step, a table and a pillar.

    Wheels stand in layer 4, and east of the door in layer 5. The table stands in the west, its top
    an overhang.
    """
    solid = np.ones((20, 16, 44), dtype=bool)
    solid[4:16, 2:14, 2:22] = False
    solid[5:16, 2:14, 24:42] = False
    solid[5:10, 6:10, 22:24] = False
    solid[8:9, 9:12, 12:16] = True
    solid[4:16, 11, 34] = True
    frame = VoxelFrame(-2.0, 1.0, CELL_M, 16, 44, -1.0, 20)
    return VoxelWorld(frame, solid, (4, 7, 6))


def map_of(world: VoxelWorld, seen: np.ndarray, size: float = 4.0) -> VoxelOccupancy:
    """Return a map of the cells (layers, rows, cols) that were seen, all as they are."""
    cells = np.argwhere(seen)
    odds = np.where(world.solid[tuple(cells.T)], size, -size)
    cubes = {}
    for block, which, places in by_block(cells):
        cube = Cube(np.zeros((16, 16, 16)), np.zeros((16, 16, 16), dtype=np.uint16))
        cube.log_odds.ravel()[places] = odds[which]
        cube.looks.ravel()[places] = 1
        cubes[block] = cube
    return VoxelOccupancy(cubes)


def explored(
    world: VoxelWorld, means: Means, method: str, most_looks: int
) -> tuple[int, VoxelOccupancy, bool]:
    """Let one robot map a world alone, from exact poses, without a radio.

    Returns the looks that it took, its map, and whether it ended by itself.
    """
    told = {"frame": world.frame, "sensor": means.sensor, "drive": means.drive}
    sense = VoxelSense(cast("Any", SimpleNamespace(**told, planner=means.planner, method=method)))
    rng, looks = np.random.default_rng(5), 0
    pose, tilt_rad = standing(world, world.start), sense.first_looks[0][1]
    submap = VoxelSubmap(world.frame, Anchor.at(pose, (0.0, 0.0, 0.0, 0.0)))
    ahead = [wrap_angle(pan) for pan, _ in sense.first_looks]
    ground = world.ground(Build.of(means.drive, means.sensor, world.frame.cell_m))
    while looks < most_looks:
        camera = replace(pose, yaw_rad=ahead.pop()) if ahead else pose
        sense.arrived()
        sense.expect(
            sense.view(VoxelOccupancy(submap.cubes), Situation(pose=pose)), camera, tilt_rad
        )
        ranges_m = look(world, camera, tilt_rad, means.sensor, rng)
        exact = (0.0, 0.0, 0.0, 0.0)
        submap.observe(
            look_odds(ranges_m, camera, tilt_rad, world.frame, means.sensor, extra_variance=exact)
        )
        looks += 1
        fused = VoxelOccupancy(submap.cubes)
        sense.fused(fused)
        if ahead:
            continue
        chosen = sense.choose(sense.view(fused, Situation(pose=pose)), rng)
        if chosen is None:
            return looks, fused, True
        x_m, y_m = (float(v) for v in chosen.path_m[-1])
        cell = world.frame.voxel_of(x_m, y_m, pose.z_m + 0.5 * world.frame.cell_m)
        place = ground.place_at(*cell, 20)
        pose = standing(world, tuple(int(n) for n in ground.cells[place]), chosen.heading_rad)
        tilt_rad = chosen.tilt_rad
    return looks, VoxelOccupancy(submap.cubes), False


def standing(world: VoxelWorld, cell: tuple[int, int, int], yaw_rad: float = 0.0) -> Pose:
    return world.standing(np.array(cell), yaw_rad)
