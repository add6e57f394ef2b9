"""Mapping a floor: what a robot with a planar occupancy map expects, fuses and chooses."""

import asyncio
import math
from typing import TYPE_CHECKING

import numpy as np

from agents.anchoring import submap_name
from agents.floormatch import match
from agents.floorways import way_to
from agents.fusion import offset_between, rotate_covariance
from agents.geometry import Bools, Pose, wrap_angle
from agents.localising import GATE
from agents.mapper import Expected, NextLook
from agents.maps.planar import Occupancy
from agents.maps.planarlook import look_odds, visible_cells
from agents.planar import PlanarView, method
from agents.ports import Exposure

if TYPE_CHECKING:
    from agents.robot import Robot


class PlanarMapper:
    """`agents.mapper.Mapper` of planar maps."""

    def __init__(self, robot: "Robot") -> None:
        """Serve a robot."""
        self.robot = robot
        self.settings = s = robot.settings
        self.method = method(s.method, s.sensor, s.drive, s.planner)
        self._barred: Bools = np.zeros(s.frame.shape, dtype=bool)
        """Where it was stopped, though the map said that all is free."""

    @property
    def first_looks(self) -> tuple[tuple[float, float], ...]:
        """One look ahead: from there on every look is chosen."""
        return ((0.0, 0.0),)

    async def expect(self, pan_rad: float, tilt_rad: float) -> Expected:
        """Return the cells that the look's rays reach on the map as it is, unknown ones passed."""
        del tilt_rad
        solid = self._fused().log_odds > 0
        chances = visible_cells(
            solid, self.settings.frame, _panned(self.robot.pose, pan_rad), self.settings.sensor
        )
        return Expected(float(np.count_nonzero(chances)), chances.astype(np.float64))

    async def localise(self, exposure: Exposure) -> None:
        """Hold the look against the map, and correct the pose by it.

        What fits the map says where the robot is on it, not where the map is: it is a measurement
        against the current submap's anchor.
        """
        robot = self.robot
        if not robot.own.submaps:
            return
        camera = _panned(robot.pose, exposure.pan_rad)
        found = await asyncio.to_thread(
            match,
            self._fused().log_odds,
            self.settings.frame,
            camera,
            robot.filter.covariance,
            exposure.ranges_m,
            self.settings.sensor,
        )
        if found is None:
            return
        yaw_rad = wrap_angle(found.pose.yaw_rad - exposure.pan_rad)
        stood = Pose(found.pose.x_m, found.pose.y_m, found.pose.z_m, yaw_rad)
        name = submap_name(len(robot.own.submaps) - 1)
        if robot.filter.holds(name):
            offset, _, turn = offset_between(robot.filter.pose_of(name), stood)
            covariance = rotate_covariance(found.covariance, turn)
            robot.filter.fix_against(name, offset, covariance, gate=GATE)
            robot.correct_anchors()

    async def fuse(self, exposure: Exposure, expected: Expected) -> None:
        """Add one look's log-odds to the own layer."""
        robot, frame = self.robot, self.settings.frame
        index, submap = robot.current_submap()
        known_before = self._fused().known
        drawn_at, beyond = robot.placing()
        cells = look_odds(
            exposure.ranges_m,
            _panned(drawn_at, exposure.pan_rad),
            frame,
            self.settings.sensor,
            extra_variance=beyond,
        )
        submap.observe(cells)
        measured = np.zeros(frame.shape, dtype=bool)
        measured[cells.rows, cells.cols] = True
        robot.looked(
            index,
            exposure,
            expected.cells,
            drawn=measured,
            measured=measured,
            new=measured & ~known_before,
        )

    def view(self) -> PlanarView:
        """Return what the planner sees: the team map and where everybody is."""
        robot, fused = self.robot, self._fused()
        x, y, z, yaw = (float(v) for v in np.diag(robot.filter.covariance))
        return PlanarView(
            frame=self.settings.frame,
            log_odds=fused.log_odds,
            mapped=fused.mapped,
            pose=robot.pose,
            others=tuple(mate.status.pose for _, mate in sorted(robot.mates.items())),
            claims=tuple(robot.regions(wished=False)),
            variance=(x, y, z, yaw),
        )

    async def choose(self) -> NextLook | None:
        """Choose the next look, by the method that is set."""
        look = await asyncio.to_thread(self.method.choose, self.view(), self.robot.rng)
        if look is None:
            return None
        fused, goal_m = self._fused(), (look.pose.x_m, look.pose.y_m)
        way_m = way_to(
            fused.mapped & (fused.log_odds < 0),
            self.settings.frame,
            self.robot.pose,
            goal_m,
            self.settings.drive.footprint_m,
            self._barred,
        )
        path_m = look.path_m if way_m is None or len(look.path_m) < 2 else way_m
        return NextLook(path_m, look.pose.yaw_rad, 0.0, look.claim)

    def halted(self) -> float | None:
        """Look at what stands ahead; ways round the place where it was stopped come first."""
        frame, pose = self.settings.frame, self.robot.pose
        ahead_m = 0.5 * (self.settings.drive.footprint_m + frame.cell_m)
        cell = frame.cell_of(
            pose.x_m + ahead_m * math.cos(pose.yaw_rad), pose.y_m + ahead_m * math.sin(pose.yaw_rad)
        )
        if frame.holds(*cell):
            self._barred[cell] = True
        return 0.0

    def _fused(self) -> Occupancy:
        return self.robot.team.fused()


def _panned(pose: Pose, pan_rad: float) -> Pose:
    """Return the camera's pose: its yaw is where it points."""
    return Pose(pose.x_m, pose.y_m, pose.z_m, wrap_angle(pose.yaw_rad + pan_rad))
