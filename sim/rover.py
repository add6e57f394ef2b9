"""Rovers that move over true ground, and tell the world plane where they are."""

import asyncio
import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from agents.geometry import Pose, wrap_angle
from agents.ports import Odometry
from agents.settings import DriveSettings
from comms.timebase import from_s, now_ns, sleep_until_ns
from sim.drift import Leg, draw_leg, measure
from sim.ground import Terrain, footing_on
from sim.motion import Motions, Segment

STEP_M = 0.1
"""The ground under a rover is looked at this often."""
PIECE_STEPS = 4
"""Steps in one published segment."""

Publish = Callable[[Segment], None]


@dataclass(frozen=True)
class Drive:
    """How far one order got."""

    way_m: float
    halted: str = ""
    slide: tuple[float, float] = (0.0, 0.0)
    """World displacement (east, north) in metres that was not driven."""


def ways_m(total_m: float, step_m: float) -> list[float]:
    """Return the ways at the ends of equal steps of at most `step_m` that make up a total."""
    steps = math.ceil(total_m / step_m - 1e-9)
    return [total_m * k / steps for k in range(1, steps + 1)]


def _no_tether(_t_ns: int) -> float:
    return 0.0


class WheeledBody(ABC):
    """`agents.ports.Body` of anything on four wheels; what it stands on says how far it gets.

    `hazards_hit` counts how often it met what it should not have met.
    """

    def __init__(
        self,
        name: str,
        drive: DriveSettings,
        start: Pose,
        publish: Publish,
        rng: np.random.Generator,
        *,
        start_ns: int = 0,
        tether_now: Callable[[int], float] = _no_tether,
    ) -> None:
        """Stand at a start pose, and publish that.

        `tether_now(t_ns)` is the length out of the robot's own drum, which its wheels don't move.
        """
        self.name = name
        self.hazards_hit = 0
        self._drive = drive
        self._publish = publish
        self._rng = rng
        self._tether_now = tether_now
        self._motions = Motions()
        self._slip_bias = float(rng.normal(0.0, drive.slip_bias_sigma))
        pose = self._grounded(start)
        self._touching = self._touches(pose)
        self._emit(start_ns, start_ns, pose, pose, "start")

    def pose_at(self, t_ns: int) -> Pose:
        """Return the true pose at a time at which the robot was there."""
        pose = self._motions.pose_at(self.name, t_ns)
        assert pose is not None, f"{self.name} was not there yet at {t_ns} ns"
        return pose

    def pose_now(self) -> Pose:
        """Return the true pose by the running loop's time."""
        return self.pose_at(now_ns())

    async def drive(self, turn_rad: float, forward_m: float) -> Odometry:
        """Turn on the spot, then drive straight (backwards where negative), as far as it goes.

        Cancelled, the robot stops where it is.
        """
        before = self.pose_now()
        leg = draw_leg(self._drive, self._slip_bias, turn_rad, forward_m, self._rng)
        try:
            await self._turn(before, leg)
            done = await self._advance(before, leg)
        except asyncio.CancelledError:
            self._halt()
            raise
        after = self.pose_now()
        c, s = math.cos(before.yaw_rad), math.sin(before.yaw_rad)
        east, north = done.slide
        return measure(
            self._drive,
            leg,
            done.way_m,
            after.z_m - before.z_m,
            self._rng,
            halted=done.halted,
            slide=(c * east + s * north, c * north - s * east),
        )

    async def _turn(self, before: Pose, leg: Leg) -> None:
        """Turn, in parts of less than half a turn."""
        after = self._grounded(leg.pose_after(before, 0.0))
        total = leg.turn_rad + leg.turn_error_rad
        parts = max(1, math.ceil(abs(total) / 3.0))
        start_ns = now_ns()
        span_ns = from_s(abs(leg.turn_rad) / self._drive.turn_rate_radps)
        poses = [
            replace(after, yaw_rad=wrap_angle(before.yaw_rad + total * k / parts))
            for k in range(1, parts + 1)
        ]
        times = [start_ns + span_ns * k // parts for k in range(parts + 1)]
        for k, (start, end) in enumerate(itertools.pairwise([before, *poses])):
            self._emit(times[k], times[k + 1], start, end, "turn")
        await sleep_until_ns(times[-1])

    async def _advance(self, before: Pose, leg: Leg) -> Drive:
        """Drive the straight part; publish all of it at once, and wait until it is driven."""
        track, way_m, halted = self._track(before, leg)
        times = [now_ns()]
        for a, b in itertools.pairwise(track):
            times.append(times[-1] + self._span_ns(a, b))
        for k in range(0, len(track) - 1, PIECE_STEPS):
            last = min(k + PIECE_STEPS, len(track) - 1)
            self._emit(times[k], times[last], track[k], track[last], "drive")
        try:
            await sleep_until_ns(times[-1])
        finally:
            passed = now_ns()
            for pose in (p for p, t in zip(track, times, strict=True) if t <= passed):
                self._touch(pose)
        return Drive(way_m, halted)

    def _track(self, before: Pose, leg: Leg) -> tuple[list[Pose], float, str]:
        """Return the true poses of a leg up to where the ground ends it, the way, and why."""
        track, driven_m = [self._grounded(leg.pose_after(before, 0.0))], 0.0
        for way_m in ways_m(abs(leg.forward_m), STEP_M):
            pose = self._grounded(leg.pose_after(before, way_m))
            refusal = self._refusal(track[-1], pose)
            if refusal:
                return track, driven_m, refusal
            track.append(pose)
            driven_m = way_m
        return track, driven_m, ""

    @abstractmethod
    def _refusal(self, here: Pose, there: Pose) -> str:
        """Say why a step can't be made, or nothing."""

    @abstractmethod
    def _grounded(self, pose: Pose) -> Pose:
        """Put a pose on the ground."""

    @abstractmethod
    def _touches(self, pose: Pose) -> bool:
        """Say whether the robot stands on something that it should not meet."""

    def _span_ns(self, a: Pose, b: Pose) -> int:
        """Return the time from one pose to the next, by the way over the ground."""
        way_m = math.hypot(b.x_m - a.x_m, b.y_m - a.y_m, b.z_m - a.z_m)
        return from_s(way_m / self._drive.speed_mps)

    def _touch(self, pose: Pose) -> None:
        """Count a hazard when the robot comes onto it, not while it stays on it."""
        touching = self._touches(pose)
        self.hazards_hit += touching and not self._touching
        self._touching = touching

    def _emit(self, start_ns: int, end_ns: int, start: Pose, end: Pose, note: str) -> None:
        tether_m = self._tether_now(start_ns)
        segment = Segment(self.name, start_ns, end_ns, start, end, tether_m, tether_m, note)
        self._motions.add(segment)
        self._publish(segment)

    def _halt(self) -> None:
        """Stop now, whatever was published of a motion that was still to come."""
        t_ns = now_ns()
        pose = self.pose_at(t_ns)
        self._emit(t_ns, t_ns, pose, pose, "halt")


class RoverBody(WheeledBody):
    """An untethered rover on rough ground: halts where that gets too steep for it.

    `hazards_hit` counts how often its circle came onto a rock or a step (`sim.ground.hazard_mask`).
    """

    def __init__(
        self,
        name: str,
        terrain: Terrain,
        drive: DriveSettings,
        start: Pose,
        publish: Publish,
        rng: np.random.Generator,
        *,
        start_ns: int = 0,
        tether_now: Callable[[int], float] = _no_tether,
    ) -> None:
        """Stand at a start pose, and publish that; see `WheeledBody`."""
        self.footing = footing_on(terrain, drive.footprint_m, drive.wheel_m, drive.climb_m)
        super().__init__(name, drive, start, publish, rng, start_ns=start_ns, tether_now=tether_now)

    def _refusal(self, here: Pose, there: Pose) -> str:
        """Say why a step can't be made, or nothing. A step to easier ground always can."""
        cell = self.footing.cell(there.x_m, there.y_m)
        if cell is None:
            return "window's border"
        slope = float(self.footing.slope_deg[cell])
        if slope > self._drive.max_slope_deg and slope > self._slope_deg(here):
            return "too steep"
        return ""

    def _slope_deg(self, pose: Pose) -> float:
        cell = self.footing.cell(pose.x_m, pose.y_m)
        return 0.0 if cell is None else float(self.footing.slope_deg[cell])

    def _grounded(self, pose: Pose) -> Pose:
        """Put a pose on the ground, as the footprint's circle meets it."""
        z_m = self.footing.ground_m(pose.x_m, pose.y_m)
        return pose if math.isnan(z_m) else replace(pose, z_m=z_m)

    def _touches(self, pose: Pose) -> bool:
        cell = self.footing.cell(pose.x_m, pose.y_m)
        return cell is not None and bool(self.footing.contact[cell])
