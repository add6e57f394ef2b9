"""Robots in a world of cubes: what they see, what stops them, where they start."""

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from agents.geometry import Floats, Pose, wrap_angle
from agents.ports import Exposure
from agents.settings import DriveSettings, SensorSettings
from agents.voxel.ground import Build, Ground
from agents.voxelcast import cast
from comms.timebase import now_ns, to_s
from sim.drift import Leg
from sim.errors import WorldError
from sim.planar import BUMP, SPACING_M
from sim.rover import Drive, Publish, WheeledBody
from sim.voxel.world import VoxelWorld, look

DROP = "drop"
"""Why a drive ended before a step that is too high to go down."""


class VoxelCamera:
    """`agents.ports.Camera` of a ranging camera in space: a range per ray, no points."""

    def __init__(
        self,
        world: VoxelWorld,
        sensor: SensorSettings,
        pose_now: Callable[[], Pose],
        rng: np.random.Generator,
    ) -> None:
        """Look from `pose_now()`, the robot's own true pose."""
        self._world = world
        self._sensor = sensor
        self._pose_now = pose_now
        self._rng = rng

    async def look(self, pan_rad: float, tilt_rad: float) -> Exposure:
        """Take `sensor.look_s` to point and range; the exposure is of the moment when it ends."""
        await asyncio.sleep(self._sensor.look_s)
        pose = self._pose_now()
        panned = replace(pose, yaw_rad=wrap_angle(pose.yaw_rad + pan_rad))
        ranges_m = look(self._world, panned, tilt_rad, self._sensor, self._rng)
        nothing = np.zeros((0, 3)), np.zeros(0)
        return Exposure(to_s(now_ns()), pan_rad, tilt_rad, *nothing, ranges_m=ranges_m)


class VoxelBody(WheeledBody):
    """A rover on a cave's floor: climbs single steps, and stops at what is higher or lower."""

    def __init__(
        self,
        name: str,
        world: VoxelWorld,
        ground: Ground,
        drive: DriveSettings,
        start: Pose,
        publish: Publish,
        rng: np.random.Generator,
        *,
        start_ns: int = 0,
    ) -> None:
        """Stand at a start pose, and publish that; see `WheeledBody`."""
        self._world = world
        self._ground = ground
        super().__init__(name, drive, start, publish, rng, start_ns=start_ns)

    async def _advance(self, before: Pose, leg: Leg) -> Drive:
        """Drive the straight part; being stopped by something solid counts once."""
        done = await super()._advance(before, leg)
        self.hazards_hit += done.halted == BUMP
        return done

    def _place(self, pose: Pose) -> int:
        """Return the place under a pose: the one nearest in height, for floors lie far apart."""
        frame = self._world.frame
        cell = frame.voxel_of(pose.x_m, pose.y_m, pose.z_m + 0.5 * frame.cell_m)
        return self._ground.place_at(*cell, self._ground.build.tall - 1)

    def _refusal(self, here: Pose, there: Pose) -> str:
        """Say why a step can't be made, or nothing. From where nobody can stand, any step may."""
        if self._place(here) < 0:
            return ""
        if self._place(there) < 0:
            return BUMP
        most_m = (self._ground.build.climb + 0.5) * self._world.frame.cell_m
        rise_m = there.z_m - here.z_m
        return BUMP if rise_m > most_m else DROP if rise_m < -most_m else ""

    def _grounded(self, pose: Pose) -> Pose:
        """Put a pose on the floor."""
        place = self._place(pose)
        if place < 0:
            return pose
        layer = int(self._ground.cells[place, 0])
        return replace(pose, z_m=self._world.frame.z_m + layer * self._world.frame.cell_m)

    def _touches(self, pose: Pose) -> bool:
        """Say nothing touches: what is solid stops the robot before."""
        del pose
        return False


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
    apart = SPACING_M / world.frame.cell_m
    spots: list[np.ndarray] = []
    for cell in cells:
        if all(np.hypot(*(cell - other)[1:]) >= apart for other in spots):
            spots.append(cell)
        if len(spots) == count:
            break
    if len(spots) < count:
        raise WorldError(
            f"{count} robots {SPACING_M:g} m apart: the world has room for {len(spots)}"
        )
    turn = float(rng.uniform(-math.pi, math.pi))
    return [
        world.standing(cell, wrap_angle(turn + 2 * math.pi * n / count))
        for n, cell in enumerate(spots)
    ]
