"""Robots in a world of cubes: what stops them, what hides them, where they start."""

from dataclasses import replace

import numpy as np

from agents.geometry import Floats, Pose
from agents.voxel.ground import Build, Ground
from agents.voxelcast import cast
from sim.errors import WorldError
from sim.occupancy import BUMP, apart, facing
from sim.voxel.world import VoxelWorld

DROP = "drop"
"""Why a drive ended before a step that is too high to go down."""


class VoxelTread:
    """`sim.occupancy.Tread` on a cave's floor: up and down single steps, no higher and no lower."""

    def __init__(self, world: VoxelWorld, ground: Ground) -> None:
        """Take the world, and where a robot of this build can stand in it."""
        self._world = world
        self._ground = ground

    def _place(self, pose: Pose) -> int:
        """Return the place under a pose: the one nearest in height, for floors lie far apart."""
        frame = self._world.frame
        cell = frame.voxel_of(pose.x_m, pose.y_m, pose.z_m + 0.5 * frame.cell_m)
        return self._ground.place_at(*cell, self._ground.build.tall - 1)

    def refusal(self, here: Pose, there: Pose) -> str:
        """Say why a step can't be made, or nothing. From where nobody can stand, any step may."""
        if self._place(here) < 0:
            return ""
        if self._place(there) < 0:
            return BUMP
        most_m = (self._ground.build.climb + 0.5) * self._world.frame.cell_m
        rise_m = there.z_m - here.z_m
        return BUMP if rise_m > most_m else DROP if rise_m < -most_m else ""

    def grounded(self, pose: Pose) -> Pose:
        """Put a pose on the floor."""
        place = self._place(pose)
        if place < 0:
            return pose
        layer = int(self._ground.cells[place, 0])
        return replace(pose, z_m=self._world.frame.z_m + layer * self._world.frame.cell_m)


class VoxelScene:
    """Rock in the way of radio waves (as `sim.scene.Scene`)."""

    def __init__(self, world: VoxelWorld) -> None:
        """Take the world."""
        self._world = world

    def clear(self, eye_m: Floats, target_m: Floats) -> bool:
        """Say whether no rock lies between two points of the world."""
        way = target_m - eye_m
        length_m = float(np.linalg.norm(way))
        if length_m == 0.0:
            return True
        eye = (float(eye_m[0]), float(eye_m[1]), float(eye_m[2]))
        hits = cast(self._world.rock, eye, (way / length_m)[None], length_m)
        return bool(np.isnan(hits.distance_m[0]))


def place_explorers(
    world: VoxelWorld, build: Build, count: int, rng: np.random.Generator
) -> list[Pose]:
    """Return start poses: the world's start, then the nearest places that leave some room.

    They face all around, the first by lot.

    Raises:
        WorldError: there is no room for so many.
    """
    ground = world.ground(build)
    place = ground.place_at(*world.start, 0)
    if place < 0:
        raise WorldError(f"no robot can stand at the start {world.start} (layer, row, column)")
    way, _ = ground.field(place)
    order = np.argsort(way, kind="stable")
    cells = ground.cells[order[np.isfinite(way[order])]]
    spots = apart(cells, count, world.frame.cell_m)
    yaws_rad = facing(count, rng)
    return [world.standing(cell, yaw) for cell, yaw in zip(spots, yaws_rad, strict=True)]
