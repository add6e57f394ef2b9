"""A floor as robots live on it: what they see, what they run into, and where they start.

Walls reach above everybody; robots are low and neither hide a thing nor stand in each other's way.
"""

import asyncio
import math
from collections.abc import Callable

import numpy as np

from agents.floorways import gap_m
from agents.geometry import Bools, Floats, Pose, wrap_angle
from agents.planar.rays import crossings, most_crossed
from agents.ports import Exposure
from agents.settings import DriveSettings, SensorSettings
from comms import kernels
from comms.kernels import kernel
from comms.timebase import now_ns, to_s
from sim.drift import Leg
from sim.errors import WorldError
from sim.planar_world import PlanarWorld, look, reachable
from sim.rover import Drive, Publish, WheeledBody

SPACING_M = 1.5
"""Robots of a team start at least so far from one another."""
SCRAPE_M, SCRAPES = 0.005, 0.8
"""A robot that touches a wall may come nearer to it by so much in a step, down to this share of its
radius: wheels slip aside."""
BUMP = "bump"
"""Why a drive ended that ran into something solid."""


class PlanarCamera:
    """`agents.ports.Camera` of a planar range camera: a fan of ranges, no points.

    Each ray goes to the face of the first solid cell, and errs by S L^n (Sujan & Meggiolaro,
    Eq. 4); beyond the depth of field nothing comes back.
    """

    def __init__(
        self,
        world: PlanarWorld,
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
        panned = Pose(pose.x_m, pose.y_m, pose.z_m, wrap_angle(pose.yaw_rad + pan_rad))
        ranges_m, _ = look(self._world, panned, self._sensor, self._rng)
        nothing = np.zeros((0, 3)), np.zeros(0)
        return Exposure(to_s(now_ns()), pan_rad, tilt_rad, *nothing, ranges_m=ranges_m)


class PlanarBody(WheeledBody):
    """A rover on a level floor: stopped by what is solid, which counts as a hazard hit."""

    def __init__(
        self,
        name: str,
        world: PlanarWorld,
        drive: DriveSettings,
        start: Pose,
        publish: Publish,
        rng: np.random.Generator,
        *,
        start_ns: int = 0,
    ) -> None:
        """Stand at a start pose, and publish that; see `WheeledBody`."""
        self._world = world
        self._radius_m = drive.footprint_m / 2
        super().__init__(name, drive, start, publish, rng, start_ns=start_ns)

    async def _advance(self, before: Pose, leg: Leg) -> Drive:
        """Drive the straight part; being stopped counts once."""
        done = await super()._advance(before, leg)
        self.hazards_hit += done.halted == BUMP
        return done

    def _refusal(self, here: Pose, there: Pose) -> str:
        """Say whether the robot's circle would run into something.

        Away from it, it always may; along it, it may scrape.
        """
        gap = self._gap_m(there)
        if gap >= self._radius_m or gap >= self._gap_m(here):
            return ""
        scrapes = gap >= SCRAPES * self._radius_m and gap >= self._gap_m(here) - SCRAPE_M
        return "" if scrapes else BUMP

    def _gap_m(self, pose: Pose) -> float:
        return gap_m(self._world.solid, self._world.frame, pose.x_m, pose.y_m, self._radius_m)

    def _grounded(self, pose: Pose) -> Pose:
        """Return the pose: the floor is level."""
        return pose

    def _touches(self, pose: Pose) -> bool:
        """Say nothing touches: what is solid stops the robot before."""
        del pose
        return False


@kernel
def _is_clear(
    solid: np.ndarray, x: float, y: float, angle: float, reach: float, cells: np.ndarray
) -> bool:
    rows, cols = solid.shape
    entry = np.empty(len(cells))
    for n in range(crossings(x, y, angle, reach, cells, entry)):
        i, j = cells[n, 0], cells[n, 1]
        if 0 <= i < rows and 0 <= j < cols and solid[i, j]:
            return False
    return True


class PlanarScene:
    """Walls in the way of radio waves (as `sim.scene.Scene`)."""

    def __init__(self, world: PlanarWorld) -> None:
        """Take the floor."""
        self._world = world

    def clear(self, eye_m: Floats, target_m: Floats) -> bool:
        """Say whether no wall lies between two points of the world."""
        frame = self._world.frame
        way = (target_m - eye_m)[:2] / frame.cell_m
        reach = math.hypot(way[0], way[1])
        x, y = (eye_m[0] - frame.x_m) / frame.cell_m, (eye_m[1] - frame.y_m) / frame.cell_m
        cells = np.empty((most_crossed(reach), 2), dtype=np.int64)
        angle = math.atan2(way[1], way[0])
        return _is_clear(self._world.solid, float(x), float(y), angle, reach, cells)


def place_explorers(
    world: PlanarWorld, count: int, footprint_m: float, rng: np.random.Generator
) -> list[Pose]:
    """Return start poses: the world's start, then the nearest places that leave some room.

    They face all around, the first by lot.

    Raises:
        WorldError: there is no room for so many.

    """
    cells = np.argwhere(reachable(world, footprint_m))
    order = np.argsort(((cells - np.array(world.start)) ** 2).sum(axis=1), kind="stable")
    spots: list[tuple[float, float]] = []
    for row, col in cells[order]:
        x_m, y_m = world.frame.centre_of(int(row), int(col))
        if all(math.hypot(x_m - x, y_m - y) >= SPACING_M for x, y in spots):
            spots.append((x_m, y_m))
        if len(spots) == count:
            break
    if len(spots) < count:
        raise WorldError(
            f"{count} robots {SPACING_M:g} m apart: the floor has room for {len(spots)}"
        )
    turn = float(rng.uniform(-math.pi, math.pi))
    return [
        Pose(x_m, y_m, 0.0, wrap_angle(turn + 2 * math.pi * n / count))
        for n, (x_m, y_m) in enumerate(spots)
    ]


def stands_free(world: PlanarWorld, x_m: float, y_m: float, footprint_m: float) -> bool:
    """Say whether a robot's circle at a point touches nothing solid."""
    return gap_m(world.solid, world.frame, x_m, y_m, footprint_m) >= footprint_m / 2


@kernels.warmer
def _warm() -> None:
    solid: Bools = np.zeros((4, 4), dtype=np.bool_)
    _is_clear(solid, 0.5, 0.5, 0.5, 2.0, np.empty((8, 2), dtype=np.int64))
