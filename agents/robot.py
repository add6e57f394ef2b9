"""One robot: its map, its pose, its radio, and the few verbs of which its roles are made.

A role (`agents.roles`) is a coroutine over these verbs and reads like the paper's Figure 2: look,
localise, fuse, share, plan, move. The robot reaches its body through `agents.ports`, its
team-mates through its radio, and time through asyncio; there is nothing else.
"""

import asyncio
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from agents.briefing import AgentSettings, RobotLog
from agents.disk import Disk
from agents.elevationmapper import ElevationMapper
from agents.fusion import compose, stand_of_seer
from agents.geometry import Floats, Pose, wrap_angle
from agents.joining import Joined, Joiner, own_estimate, placed
from agents.layers import Mask
from agents.mapper import Expected, Mapper, NextLook
from agents.member import LEG_M, Member
from agents.messages import Fix
from agents.occupancy.mapper import OccupancyMapper
from agents.planar.sense import PlanarSense
from agents.ports import Exposure, Hardware, Sighting
from agents.pose.anchoring import needs_submap, placing
from agents.pose.localising import is_located, reference, take_in
from agents.pose.waywatch import WayWatch
from agents.voxel.sense import VoxelSense

TRAIL_POINTS, TRAIL_STEP_M = 1000, 0.1
"""So many points of the way that it came a robot remembers, so far apart: where the map shows no
way out it can go back, however often it has turned on the spot since."""


MAPPERS: dict[str, Callable[["Robot"], Mapper]] = {
    "elevation": ElevationMapper,
    "planar": lambda robot: OccupancyMapper(robot, PlanarSense),
    "voxel": lambda robot: OccupancyMapper(robot, VoxelSense),
}
"""By kind of map."""


class Robot(Member):
    """One robot in one incarnation: a member of the team with a body."""

    def __init__(
        self,
        settings: AgentSettings,
        hardware: Hardware,
        disk: Disk,
        log: RobotLog,
        rng: np.random.Generator,
    ) -> None:
        """Put a robot together; on a disk that holds a former life (`Disk.begin`), take it up."""
        super().__init__(settings, hardware, disk, log)
        self.rng = rng
        self.mapper: Mapper = MAPPERS[settings.map.kind](self)
        self.joiner = Joiner()
        self.looks = 0
        self.plan: NextLook | None = None
        """The look that it is about to take."""
        self.trail = [(self.pose.x_m, self.pose.y_m)]
        self.watch: WayWatch | None = None
        """Sees how it moves, if it has the eyes for that."""
        if hardware.eyes is not None and settings.sensor.stereo.odometry:
            self.watch = WayWatch(hardware.eyes, settings.sensor, rng.spawn(1)[0], log.event)

    # --- look, localise, fuse -------------------------------------------------------------

    async def look(self, pan_rad: float, tilt_rad: float) -> None:
        """Look once at a heading (pan from ahead), and take in all that it shows."""
        camera = self.hardware.camera
        assert camera is not None
        if self.watch is not None:
            self.watch.tell_way()
        exposure = await camera.look(pan_rad, tilt_rad)
        await self._use(exposure, await self.mapper.expect(pan_rad, tilt_rad))

    async def be_led(self) -> bool:
        """Go a step along with the guide, and take in what it shows; return False at the end.

        A look that was not chosen was not expected to show anything.
        """
        guide = self.hardware.guide
        assert guide is not None
        step = await guide.step()
        if step is None:
            return False
        if step.odometry is not None:
            self.filter.predict(step.odometry)
            self._trace()
        if step.exposure is not None:
            nothing = np.zeros(self.settings.frame.shape, dtype=np.float32)
            await self._use(step.exposure, Expected(0.0, nothing))
        return True

    async def _use(self, exposure: Exposure, expected: Expected) -> None:
        """Localise and fuse by a look."""
        if exposure.ill:
            self.log.event("ill look", "; ".join(exposure.ill))
        self.localise(exposure)
        await self.mapper.localise(exposure)
        await self.mapper.fuse(exposure, expected)
        self.looks += 1
        await self.join()
        await self.save()

    def charted(self, *, relative: bool = False) -> Any:
        """Return the map that it plans on: the team's, or its own while it is lost.

        `relative`: each place against its neighbours (`TeamMap.relative`).
        """
        if not self.located and self.own.submaps:
            return own_estimate(self.team.kind, self.own, self.filter)
        return self.team.relative() if relative else self.team.fused()

    async def join(self) -> None:
        """Find the own map on the team's, if this robot does not know where it is, and it is due.

        What the team's anchors are unsure of, all of the team's map may be wrong by.
        """
        if self.located:
            return
        team = self.team.relative()
        cells = int(team.known.sum())
        if not self.joiner.is_due(self.looks, self.own.known_cells(), cells):
            return
        own = own_estimate(self.team.kind, self.own, self.filter)
        found = await asyncio.to_thread(placed, own, team, self.settings.frame)
        if self.located:
            return  # somebody told it meanwhile
        if isinstance(found, Joined):
            x_m, y_m = (float(v) for v in found.middle_m)
            unsure = self.team.placing((x_m, y_m), self.settings.sensor.range_m)
            pose, covariance = found.unsure_by(unsure).stand(self.pose)
            self.settle(pose, covariance, f"matched its map: {found.told}")
        elif found.why != self.joiner.said:
            self.joiner.said = found.why
            self.log.event("not joined", found.why)

    def settle(self, pose: Pose, covariance: Floats, by: str) -> None:
        """See `Teller.settle`; what was planned and remembered in its own frame is let go."""
        super().settle(pose, covariance, by)
        self.mapper.relocated()
        self.plan, self.claim = None, None
        self.trail = [(self.pose.x_m, self.pose.y_m)]

    def localise(self, exposure: Exposure) -> None:
        """Take bearings on what stands still, and tell those where they are who don't know."""
        for sighting in exposure.sightings:
            known = reference(self.settings, self.mates, sighting.name, self.origin)
            if known is not None and self.located:
                take_in(self.filter, known, sighting)
            elif known is not None:
                stand = stand_of_seer(known.pose, known.covariance, sighting)
                self.settle(*stand, f"saw {sighting.name}")
        if self.located:
            self.correct_anchors()
            for sighting in exposure.sightings:
                self._help(sighting, exposure.t_s)

    def _help(self, sighting: Sighting, t_s: float) -> None:
        """Tell a team-mate in sight where it is, if it can't see that itself."""
        if sighting.name in self.settings.roster:
            index = self.settings.roster.index(sighting.name)
            mate = self.mates.get(index)
            is_lost = mate is not None and not is_located(mate)
            if is_lost or self.settings.roles[index] == "cliffbot":
                self._tell_fix(index, sighting, t_s)

    @property
    def is_lost(self) -> bool:
        """Whether it is less sure of its pose than its map is fine."""
        variance = np.diag(self.filter.covariance)
        far_m = self.settings.sensor.range_m
        cell_m = self.settings.frame.cell_m
        return bool(max(variance[:2]) > cell_m**2 or far_m**2 * variance[3] > cell_m**2)

    def bearings(self) -> list[tuple[float, float]]:
        """Return pan and tilt to what one can take a bearing on in range, the nearest first."""
        found: list[tuple[float, float, float]] = []
        names = (*(mark.name for mark in self.settings.landmarks), *self.settings.roster)
        for name in names:
            known = reference(self.settings, self.mates, name, self.origin)
            if known is None:
                continue
            distance_m, pan_rad, tilt_rad = self.bearing_to(known.pose)
            if distance_m < 0.9 * self.settings.sensor.range_m:
                found.append((distance_m, pan_rad, tilt_rad))
        return [(pan_rad, tilt_rad) for _, pan_rad, tilt_rad in sorted(found)]

    def bearing_to(self, pose: Pose) -> tuple[float, float, float]:
        """Return how far a pose is, and the pan and tilt that point the camera at it."""
        dx, dy = pose.x_m - self.pose.x_m, pose.y_m - self.pose.y_m
        distance_m = math.hypot(dx, dy)
        up_m = pose.z_m - self.pose.z_m - self.settings.sensor.height_m
        pan_rad = wrap_angle(math.atan2(dy, dx) - self.pose.yaw_rad)
        return distance_m, pan_rad, math.atan2(up_m, max(distance_m, 0.1))

    def current_submap(self) -> tuple[int, Any]:
        """Return the submap that a look goes into, and its index: a new one if that is due."""
        if needs_submap(self.own, self.filter, self.settings.frame.cell_m):
            self.begin_submap()
        return len(self.own.submaps) - 1, self.own.submaps[-1]

    def placing(self) -> tuple[Pose, tuple[float, float, float, float]]:
        """Return where a look is drawn in the current submap, and its variance against the anchor.

        The variance is of (x, y, z, yaw).
        """
        return placing(self.own, len(self.own.submaps) - 1, self.filter)

    def looked(
        self,
        submap: int,
        exposure: Exposure,
        expected_cells: float,
        *,
        drawn: Mask,
        measured: Mask,
        new: Mask,
    ) -> None:
        """Note that a look has measured cells, some of them new.

        `drawn` are those of the submap's own drawing.
        """
        self.tiles_changed(submap, drawn)
        self.log.look(
            exposure,
            expected_cells=expected_cells,
            obtained_cells=int(measured.sum()),
            new_cells=int(new.sum()),
        )

    def _tell_fix(self, index: int, sighting: Sighting, t_s: float) -> None:
        offset = (*sighting.offset_m, sighting.bearing_rad)
        pose, covariance = compose(self.pose, self.filter.covariance, offset, sighting.covariance)
        x, y, z, yaw = (float(v) for v in np.diag(covariance))
        self.tell_fix(Fix(index, t_s, pose, (x, y, z, yaw)))

    # --- plan and move --------------------------------------------------------------------

    async def choose_look(self) -> NextLook | None:
        """Choose the next look, and say to the others where it will be.

        On a real clock the radio goes on while the robot thinks; on the virtual one thinking takes
        no time.
        """
        plan = await self.mapper.choose()
        self.plan = plan
        if plan is None:
            self.claim = None
            return None
        if self.located:
            self.claim = plan.claim
            self.tell_status()
        return plan

    def wish_to_know(self, goal_m: tuple[float, float]) -> None:
        """Tell the team that this robot waits to know the ground between itself and a point."""
        x_m, y_m = (self.pose.x_m + goal_m[0]) / 2, (self.pose.y_m + goal_m[1]) / 2
        half_m = math.dist((self.pose.x_m, self.pose.y_m), goal_m) / 2
        self.claim = (x_m, y_m, half_m + self.settings.drive.footprint_m)
        self.tell_status()

    async def travel(self, path_m: Floats) -> bool:
        """Drive along a path (N, 2) in the team frame; return whether its end was reached."""
        for x_m, y_m in path_m[1:]:
            if await self.drive_to(float(x_m), float(y_m)):
                return False
        return True

    async def drive_to(self, x_m: float, y_m: float, leg_m: float = LEG_M) -> str:
        """Drive straight to a point, leg by leg; return why the body halted, or nothing."""
        while True:
            dx, dy = x_m - self.pose.x_m, y_m - self.pose.y_m
            distance_m = math.hypot(dx, dy)
            if distance_m < 0.5 * self.settings.frame.cell_m:
                return ""
            turn_rad = wrap_angle(math.atan2(dy, dx) - self.pose.yaw_rad)
            halted = await self.drive(turn_rad, min(distance_m, leg_m))
            if halted:
                return halted

    async def drive(self, turn_rad: float, forward_m: float) -> str:
        """Turn and drive; the pose follows. Return why the body halted, or nothing."""
        body = self.hardware.body
        assert body is not None
        if self.watch is not None:
            await self.watch.begin(turn_rad, self.filter)
        if self.hardware.camera is None:  # others tell it where it is, and later
            self.stops.leave(self.filter, self.stands_since_s, self.now_s)
        self.stands_since_s = math.inf
        odometry = await body.drive(turn_rad, forward_m)
        self.stands_since_s = self.now_s
        self.filter.predict(odometry)
        if self.watch is not None:
            await self.watch.end(odometry, self.filter)
        self._trace()
        if odometry.halted:
            self.log.event("halted", odometry.halted)
        return odometry.halted

    def _trace(self) -> None:
        here = (self.pose.x_m, self.pose.y_m)
        if math.dist(self.trail[-1], here) > TRAIL_STEP_M:
            self.trail.append(here)
            del self.trail[:-TRAIL_POINTS]
