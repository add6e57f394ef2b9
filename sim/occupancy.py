"""Robots in worlds of free and solid cells, flat or not: what they see, and what stops them.

What differs between a floor and a cave is handed in: how ranges are cast, and the `Tread` that says
where wheels can go (`sim.planar`, `sim.voxel.robot`).
"""

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from agents.geometry import Floats, Ints, Pose, wrap_angle
from agents.planar.sensing import sigma_m
from agents.ports import Exposure
from agents.settings import DriveSettings, SensorSettings
from comms.timebase import now_ns, to_s
from sim.drift import Leg
from sim.errors import WorldError
from sim.rover import Drive, Publish, WheeledBody

SPACING_M = 1.5
"""Robots of a team start at least so far from one another."""
BUMP = "bump"
"""Why a drive ended that ran into something solid."""


def measured_m(true_m: Floats, sensor: SensorSettings, rng: np.random.Generator | None) -> Floats:
    """Return ranges (N,) with errors S L^n (Sujan & Meggiolaro, Eq. 4); inf beyond the range.

    `rng` draws them; None: there are none.
    """
    if rng is None:
        return true_m
    noise = rng.standard_normal(true_m.shape)
    hit = np.isfinite(true_m)
    ranges_m = true_m.copy()
    ranges_m[hit] += sigma_m(true_m[hit], sensor) * noise[hit]
    return np.where(ranges_m <= sensor.range_m, np.maximum(ranges_m, 0.0), np.inf)


class RangeCamera:
    """`agents.ports.Camera` of a ranging camera: a range per ray, no points.

    Each ray goes to the face of the first solid cell, and errs as `measured_m` says; beyond the
    depth of field nothing comes back.
    """

    def __init__(
        self,
        ranges_m: Callable[[Pose, float], Floats],
        sensor: SensorSettings,
        pose_now: Callable[[], Pose],
    ) -> None:
        """Look from `pose_now()`, the robot's own true pose.

        `ranges_m(pose, tilt_rad)` measures; the pose's yaw is where the camera points.
        """
        self._ranges_m = ranges_m
        self._sensor = sensor
        self._pose_now = pose_now

    async def look(self, pan_rad: float, tilt_rad: float) -> Exposure:
        """Take `sensor.look_s` to point and range; the exposure is of the moment when it ends."""
        await asyncio.sleep(self._sensor.look_s)
        pose = self._pose_now()
        panned = replace(pose, yaw_rad=wrap_angle(pose.yaw_rad + pan_rad))
        ranges_m = self._ranges_m(panned, tilt_rad)
        nothing = np.zeros((0, 3)), np.zeros(0)
        return Exposure(to_s(now_ns()), pan_rad, tilt_rad, *nothing, ranges_m=ranges_m)


class Tread(Protocol):
    """Where the wheels of one robot can go."""

    def refusal(self, here: Pose, there: Pose) -> str:
        """Say why a step can't be made, or nothing."""
        ...

    def grounded(self, pose: Pose) -> Pose:
        """Put a pose on the floor."""
        ...


class OccupancyBody(WheeledBody):
    """A rover among solid cells: stopped by them, which counts as a hazard hit."""

    def __init__(
        self,
        name: str,
        tread: Tread,
        drive: DriveSettings,
        start: Pose,
        publish: Publish,
        rng: np.random.Generator,
        *,
        start_ns: int = 0,
    ) -> None:
        """Stand at a start pose, and publish that; see `WheeledBody`."""
        self._tread = tread
        super().__init__(name, drive, start, publish, rng, start_ns=start_ns)

    async def _advance(self, before: Pose, leg: Leg) -> Drive:
        """Drive the straight part; being stopped by something solid counts once."""
        done = await super()._advance(before, leg)
        self.hazards_hit += done.halted == BUMP
        return done

    def _refusal(self, here: Pose, there: Pose) -> str:
        return self._tread.refusal(here, there)

    def _grounded(self, pose: Pose) -> Pose:
        return self._tread.grounded(pose)

    def _touches(self, pose: Pose) -> bool:
        """Say nothing touches: what is solid stops the robot before."""
        del pose
        return False


def apart(cells: Ints, count: int, cell_m: float) -> Ints:
    """Return the first `count` of cells (N, rows and columns last) that leave robots room.

    Raises:
        WorldError: there is no room for so many.
    """
    least = SPACING_M / cell_m
    spots: list[Ints] = []
    for cell in cells:
        if all(np.hypot(*(cell - other)[-2:]) >= least for other in spots):
            spots.append(cell)
        if len(spots) == count:
            return np.array(spots)
    raise WorldError(f"{count} robots {SPACING_M:g} m apart: the world has room for {len(spots)}")


def facing(count: int, rng: np.random.Generator) -> list[float]:
    """Return the yaws of a team that faces all around, the first by lot."""
    turn = float(rng.uniform(-math.pi, math.pi))
    return [wrap_angle(turn + 2 * math.pi * n / count) for n in range(count)]
