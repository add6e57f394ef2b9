"""How a robot with a planar occupancy map sees and plans (`agents.occupancy.mapper.Sense`)."""

import math

import numpy as np

from agents.briefing import AgentSettings
from agents.floorways import way_to
from agents.geometry import Bools, Floats, Pose
from agents.mapper import Expected, NextLook
from agents.maps.planar import Occupancy
from agents.maps.planarlook import LookOdds, look_odds, visible_cells
from agents.occupancy.matching import Match
from agents.occupancy.view import Situation
from agents.planar import Means, PlanarView, method
from agents.planar.matching import match
from agents.ports import Exposure


class PlanarSense:
    """One robot's, on a floor."""

    def __init__(self, settings: AgentSettings) -> None:
        """Take what it has to see and drive with, and its method."""
        self.settings = s = settings
        self.method = method(s.method, Means(s.sensor, s.drive, s.planner))
        self._barred: Bools = np.zeros(s.frame.shape, dtype=bool)
        """Where it was stopped, though the map said that all is free."""

    @property
    def first_looks(self) -> tuple[tuple[float, float], ...]:
        """One look ahead: from there on every look is chosen."""
        return ((0.0, 0.0),)

    @property
    def all_round(self) -> tuple[tuple[float, float], ...]:
        """As many looks as it takes fields of view to close the circle."""
        count = math.ceil(360.0 / self.settings.sensor.fov_deg)
        return tuple((2.0 * math.pi * n / count, 0.0) for n in range(count))

    def view(self, fused: Occupancy, situation: Situation) -> PlanarView:
        """Return the whole floor."""
        return PlanarView(self.settings.frame, fused.log_odds, fused.mapped, **vars(situation))

    def arrived(self) -> None:
        """Do nothing: where it stood is as well seen as any other place."""

    def expect(self, view: PlanarView, camera: Pose, tilt_rad: float) -> Expected:
        """Return the cells that the look's rays reach, unknown ones passed."""
        del tilt_rad
        reached = visible_cells(view.log_odds > 0, view.frame, camera, self.settings.sensor)
        return Expected(float(np.count_nonzero(reached)), reached.astype(np.float64))

    def match(
        self, view: PlanarView, camera: Pose, covariance: Floats, exposure: Exposure
    ) -> Match | None:
        """See `agents.planar.matching`."""
        ranges_m, sensor = exposure.ranges_m, self.settings.sensor
        return match(view.log_odds, view.frame, camera, covariance, ranges_m, sensor)

    def measured(
        self, exposure: Exposure, camera: Pose, extra_variance: tuple[float, float, float, float]
    ) -> tuple[LookOdds, Bools]:
        """Return the log-odds of a look, and its mask (rows, cols)."""
        frame, sensor = self.settings.frame, self.settings.sensor
        look = look_odds(exposure.ranges_m, camera, frame, sensor, extra_variance=extra_variance)
        measured = np.zeros(frame.shape, dtype=bool)
        measured[look.rows, look.cols] = True
        return look, measured

    def fused(self, fused: Occupancy) -> None:
        """Do nothing: its methods remember what they expected."""

    def choose(self, view: PlanarView, rng: np.random.Generator) -> NextLook | None:
        """Choose a look, and go there on a way that leaves the robot room."""
        look = self.method.choose(view, rng)
        if look is None:
            return None
        way_m = way_to(
            view.mapped & (view.log_odds < 0),
            view.frame,
            view.pose,
            (look.pose.x_m, look.pose.y_m),
            self.settings.drive.footprint_m,
            self._barred,
        )
        path_m = look.path_m if way_m is None or len(look.path_m) < 2 else way_m
        return NextLook(path_m, look.pose.yaw_rad, 0.0, look.claim)

    def halted(self, pose: Pose) -> None:
        """Bar the cell ahead: ways round it come first."""
        frame = self.settings.frame
        ahead_m = 0.5 * (self.settings.drive.footprint_m + frame.cell_m)
        cell = frame.cell_of(
            pose.x_m + ahead_m * math.cos(pose.yaw_rad), pose.y_m + ahead_m * math.sin(pose.yaw_rad)
        )
        if frame.holds(*cell):
            self._barred[cell] = True
