"""The Cliff-bot's body: it goes where no wheel would hold, as far as its tethers let it."""

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from agents.geometry import Pose
from agents.settings import DriveSettings
from comms.timebase import NS, from_s, now_ns, sleep_until_ns
from sim.drift import Leg
from sim.ground import Terrain
from sim.rover import Drive, Publish, RoverBody, ways_m

STEP_M = 0.15
STRETCH_M = 0.05
"""A tether gives so much before it holds the robot back."""
TAUT_POLLS = 20
"""Seconds that the robot pulls at a taut tether before it gives up."""
FRICTION_DEG = 35.0
"""Ground steeper than this holds nothing that does not hang on a tether."""
SLACK_M = 0.3
"""With more slack than this on every tether the robot slides on such ground."""
SLIDE_MPS = 0.5
SLIDE_STEP_M = 0.1
MAX_SLIDE_M = 30.0

Tethers = Callable[[int], Sequence[tuple[Pose, float]]]


class TetheredBody(RoverBody):
    """`agents.ports.Body` on tethers that run straight from the anchors' poses to its own.

    A step that would need more tether than is out waits for it, and is given up after 20 s ("tether
    taut"). Where the ground is steeper than friction holds and all tethers are slack, the robot
    slides down until one holds it, or the ground does ("slid"). It is checked at every step.
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
        tethers: Tethers,
        start_ns: int = 0,
    ) -> None:
        """Stand at a start pose, and publish that.

        `tethers(t_ns)` gives each anchor's true pose and its tether's length, as the world plane
        knows them at that time, its delay already taken off.
        """
        super().__init__(name, terrain, drive, start, publish, rng, start_ns=start_ns)
        self._tethers = tethers

    async def _advance(self, before: Pose, leg: Leg) -> Drive:
        """Drive step by step, each when the tethers let it."""
        here, driven_m = self._grounded(leg.pose_after(before, 0.0)), 0.0
        for way_m in ways_m(abs(leg.forward_m), STEP_M):
            there = self._grounded(leg.pose_after(before, way_m))
            refusal = self._refusal(here, there) or await self._held_back(here, there)
            if refusal == "slid":
                return await self._slide(here, driven_m)
            if refusal:
                return Drive(driven_m, refusal)
            await self._move(here, there, self._span_ns(here, there), "step")
            here, driven_m = there, way_m
        return await self._slide(here, driven_m) if self._slips(here) else Drive(driven_m)

    def _refusal(self, here: Pose, there: Pose) -> str:
        """Say why the ground forbids a step; with a tether, steepness does not."""
        if not self._tethers(now_ns()):
            return super()._refusal(here, there)
        return "" if self.footing.cell(there.x_m, there.y_m) is not None else "window's border"

    async def _held_back(self, here: Pose, there: Pose) -> str:
        """Wait until the tethers allow a step; say what became of it, or nothing."""
        for _ in range(TAUT_POLLS):
            if self._slips(here):
                return "slid"
            if self._long_enough(here, there):
                return ""
            await sleep_until_ns(now_ns() + NS)
        return "" if self._long_enough(here, there) else "tether taut"

    def _long_enough(self, here: Pose, there: Pose) -> bool:
        """Say whether every tether reaches; a step towards an anchor is always allowed."""
        return all(
            reach_m(anchor, there) <= max(length_m + STRETCH_M, reach_m(anchor, here))
            for anchor, length_m in self._tethers(now_ns())
        )

    def _slips(self, here: Pose) -> bool:
        """Say whether neither the ground nor a tether holds the robot."""
        slack = all(
            length_m - reach_m(anchor, here) > SLACK_M
            for anchor, length_m in self._tethers(now_ns())
        )
        return slack and self._slope_deg(here) > FRICTION_DEG

    async def _slide(self, here: Pose, driven_m: float) -> Drive:
        """Slide down the steepest way until a tether or the ground holds."""
        track = self._slide_track(here)
        for a, b in itertools.pairwise(track):
            span_ns = from_s(reach_m(a, b) / SLIDE_MPS)
            await self._move(a, b, span_ns, "slide")
        end = track[-1]
        return Drive(driven_m, "slid", (end.x_m - here.x_m, end.y_m - here.y_m))

    def _slide_track(self, here: Pose) -> list[Pose]:
        tethers = self._tethers(now_ns())
        track = [here]
        while len(track) <= MAX_SLIDE_M / SLIDE_STEP_M:
            pose = track[-1]
            cell = self.footing.cell(pose.x_m, pose.y_m)
            if cell is None or self.footing.slope_deg[cell] <= FRICTION_DEG:
                break
            east, north = self.footing.east_slope[cell], self.footing.north_slope[cell]
            share = SLIDE_STEP_M / math.hypot(east, north)
            lower = self._grounded(
                Pose(
                    pose.x_m - share * float(east),
                    pose.y_m - share * float(north),
                    pose.z_m,
                    pose.yaw_rad,
                )
            )
            held = any(reach_m(anchor, lower) > length_m for anchor, length_m in tethers)
            if held or self.footing.cell(lower.x_m, lower.y_m) is None:
                break
            track.append(lower)
        return track

    async def _move(self, here: Pose, there: Pose, span_ns: int, note: str) -> None:
        """Publish one step, and take its time; what it meets counts when it is made."""
        start_ns = now_ns()
        self._emit(start_ns, start_ns + span_ns, here, there, note)
        await sleep_until_ns(start_ns + span_ns)
        self._touch(there)


def reach_m(anchor: Pose, robot: Pose) -> float:
    """Return the length of tether that a straight run between two poses needs."""
    return math.hypot(anchor.x_m - robot.x_m, anchor.y_m - robot.y_m, anchor.z_m - robot.z_m)
