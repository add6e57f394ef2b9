"""One robot: its map, its pose, its radio, and the few verbs of which its roles are made.

A role (`agents.roles`) is a coroutine over these verbs and reads like the paper's Figure 2: look,
localise, fuse, share, plan, move. The robot reaches its body through `agents.ports`, its
team-mates through its radio, and time through asyncio; there is nothing else.
"""

import asyncio
import math

import numpy as np

from agents.briefing import AgentSettings, RobotLog
from agents.disk import Disk
from agents.fusion import compose
from agents.geometry import Floats, Pose, Singles, wrap_angle
from agents.information import Interest
from agents.layers import bin_look
from agents.member import GATE, LEG_M, Member
from agents.messages import Fix, Status
from agents.ports import Exposure, Hardware, Sighting
from agents.strategies import LookPlan, View, expected_visibility, strategy

TRAIL_POINTS = 64
"""So many corners of the way that it came a robot remembers."""


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
        self.strategy = strategy(settings.method)
        self.interest = Interest(settings.frame.shape, settings.planner.beta)
        self.looks = 0
        self.trail = [(self.pose.x_m, self.pose.y_m)]

    # --- look, localise, fuse -------------------------------------------------------------

    async def look(self, pan_rad: float, tilt_rad: float) -> None:
        """Look once at a heading (pan from ahead), and take in all that it shows."""
        camera = self.hardware.camera
        assert camera is not None
        exposure = await camera.look(pan_rad, tilt_rad)
        expected = await asyncio.to_thread(
            expected_visibility, self.view(), self.pose, pan_rad, tilt_rad
        )
        if exposure.ill:
            self.log.event("ill look", "; ".join(exposure.ill))
        self.localise(exposure)
        await self.fuse(exposure, expected)
        self.looks += 1
        await self.save()

    def localise(self, exposure: Exposure) -> None:
        """Take bearings on team-mates that stand still, and tell moving ones where they are."""
        for sighting in exposure.sightings:
            index = self.settings.roster.index(sighting.name)
            mate = self.mates.get(index)
            role = self.settings.roles[index]
            if role == "anchor" and mate is not None and self._is_surer(mate.status, sighting):
                self.filter.saw(
                    mate.status.pose, np.diag(mate.status.variance), sighting, gate=GATE
                )
            elif role == "cliffbot":
                self._tell_fix(index, sighting, exposure.t_s)

    def _is_surer(self, status: Status, sighting: Sighting) -> bool:
        """Say whether a bearing on a team-mate would tell more than is known already.

        What the team-mate is wrong by, it is wrong by each time: a robot that is as sure as one
        such look makes it learns nothing from a second one, and must not grow surer by it.
        """
        own = np.diag(self.filter.covariance)
        look = np.diag(sighting.covariance) + np.array(status.variance)
        return bool(np.any(own > look))

    @property
    def is_lost(self) -> bool:
        """Whether it is less sure of its pose than its map is fine."""
        variance = np.diag(self.filter.covariance)
        far_m = self.settings.sensor.range_m
        cell_m = self.settings.map.cell_m
        return bool(max(variance[:2]) > cell_m**2 or far_m**2 * variance[3] > cell_m**2)

    def bearings(self) -> list[tuple[float, float]]:
        """Return pan and tilt to the team-mates in range that stand still, the nearest first."""
        found: list[tuple[float, float, float]] = []
        for index, mate in sorted(self.mates.items()):
            if self.settings.roles[index] != "anchor":
                continue
            distance_m, pan_rad, tilt_rad = self.bearing_to(mate.status.pose)
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

    async def fuse(self, exposure: Exposure, expected: Singles) -> None:
        """Fuse one look into the own layer (Eqs. 19-21), and lose interest in what failed."""
        covariance = self.filter.covariance
        cell_m = self.settings.map.cell_m
        if self.own.needs_submap(covariance, shift_m=cell_m, turn_rad=0.02):
            self.own.begin_submap(self.pose, covariance)
        index = len(self.own.submaps) - 1
        submap = self.own.submaps[index]
        known_before = self.team.fused().known
        cells = await asyncio.to_thread(
            bin_look,
            exposure,
            self.pose,
            self.settings.frame,
            attitude_sigma_rad=math.radians(self.settings.sensor.attitude_sigma_deg),
            extra_variance=self.own.beyond_anchor(covariance),
        )
        submap.observe(cells)
        measured = np.zeros(self.settings.frame.shape, dtype=bool)
        measured[cells.rows, cells.cols] = True
        self.interest.update(expected, measured)
        self.tiles_changed(index, measured)
        new = measured & ~known_before
        self.log.look(
            exposure,
            expected_cells=float(np.sum(expected)),
            obtained_cells=int(np.count_nonzero(measured)),
            new_cells=int(np.count_nonzero(new)),
        )

    def _tell_fix(self, index: int, sighting: Sighting, t_s: float) -> None:
        offset = (*sighting.offset_m, sighting.bearing_rad)
        pose, covariance = compose(self.pose, self.filter.covariance, offset, sighting.covariance)
        x, y, z, yaw = (float(v) for v in np.diag(covariance))
        self.tell_fix(Fix(index, t_s, pose, (x, y, z, yaw)))

    # --- plan and move --------------------------------------------------------------------

    def view(self) -> View:
        """Return what the planner sees: the team map and where everybody is."""
        fused = self.team.fused()
        return View(
            frame=self.settings.frame,
            elevation_m=fused.elevation_m,
            sigma_m=self.team.relief_sigma_m(),
            looks=fused.looks.astype(np.int64),
            interest=self.interest.share,
            pose=self.pose,
            pose_sigma_m=self.filter.sigma_m,
            others=[mate.status.pose for _, mate in sorted(self.mates.items())],
            sensor=self.settings.sensor,
            drive=self.settings.drive,
            planner=self.settings.planner,
            claims=self.regions(wished=False),
            wishes=tuple(self.regions(wished=True)),
            trail_m=np.array(self.trail),
        )

    async def choose_look(self) -> LookPlan | None:
        """Choose the next look (Eq. 23), and say to the others where it will be.

        On a real clock the radio goes on while the robot thinks; on the virtual one thinking takes
        no time.
        """
        plan = await asyncio.to_thread(self.strategy.choose, self.view(), self.rng)
        if plan is None:
            self.claim = None
            return None
        heading_rad = plan.heading_rad
        reach_m = 0.5 * self.settings.sensor.range_m
        x_m, y_m = plan.path_m[-1]
        self.claim = (
            float(x_m) + reach_m * math.cos(heading_rad),
            float(y_m) + reach_m * math.sin(heading_rad),
            reach_m,
        )
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
            if not await self.drive_to(float(x_m), float(y_m)):
                return False
        return True

    async def drive_to(self, x_m: float, y_m: float, leg_m: float = LEG_M) -> bool:
        """Drive straight to a point, leg by leg; return False where the body halted."""
        while True:
            dx, dy = x_m - self.pose.x_m, y_m - self.pose.y_m
            distance_m = math.hypot(dx, dy)
            if distance_m < 0.5 * self.settings.map.cell_m:
                return True
            turn_rad = wrap_angle(math.atan2(dy, dx) - self.pose.yaw_rad)
            if not await self.drive(turn_rad, min(distance_m, leg_m)):
                return False

    async def drive(self, turn_rad: float, forward_m: float) -> bool:
        """Turn and drive; the pose follows the odometry. Return False where the body halted."""
        body = self.hardware.body
        assert body is not None
        odometry = await body.drive(turn_rad, forward_m)
        self.filter.predict(odometry)
        self.trail.append((self.pose.x_m, self.pose.y_m))
        del self.trail[:-TRAIL_POINTS]
        if odometry.halted:
            self.log.event("halted", odometry.halted)
        return not odometry.halted
