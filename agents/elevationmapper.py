"""Mapping the ground: what a robot with an elevation map expects, fuses and chooses."""

import asyncio
import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from agents.briefing import ACTIVITIES
from agents.geometry import Bools, Floats, Pose, Singles
from agents.ground.stands import Stands
from agents.mapper import Expected, NextLook
from agents.maps.elevation import UNIFORM
from agents.maps.elevationlook import bin_look
from agents.planning.following import way_to_see
from agents.planning.information import Interest
from agents.planning.strategies import View, strategy
from agents.planning.waydown import TIRED, Descent, Point, open_questions
from agents.ports import Exposure
from agents.pose.localising import is_located
from agents.stereo.eyes import off_mates
from comms.codec import sigma_as_sent

if TYPE_CHECKING:
    from agents.robot import Robot


MOVING = ("exploring", "descending")
"""What a team-mate that may have moved since it was heard says that it does."""
TOLD_LATE_S, MOST_MOVED_M, MOST_UNSURE_M = 10.0, 1.0, 0.55
"""So old may its word have been when it was heard; it has gone no farther, and is no less sure."""
HOPES = 6
"""So many ways down are asked about before it is taken that no look helps; those that no look could
answer count the less the more there were."""
LEAST_INTEREST = 0.05
SAME_STAND_M = 0.2
"""A team-mate that has moved by less asks in vain to be seen from where it was looked at before."""
BARRED = 50
"""So many places where it came to a halt a robot remembers."""


class ElevationMapper:
    """`agents.mapper.Mapper` of elevation maps."""

    def __init__(self, robot: "Robot") -> None:
        """Serve a robot."""
        self.robot = robot
        self.settings = robot.settings
        self.relocated()
        self.stands = Stands(self.settings.frame, self.settings.sensor)

    def relocated(self) -> None:
        """Begin with nothing planned, expected in vain or asked."""
        self.strategy = strategy(self.settings.method)
        self.interest = Interest(self.settings.frame.shape, self.settings.planner.beta)
        self.barred: tuple[tuple[float, float, float], ...] = ()
        self.asked = np.zeros(self.settings.frame.shape)
        """In how many looks a cell was expected that keeps a team-mate's way from being safe."""
        self.taken = np.zeros(self.settings.frame.shape, dtype=np.int64)
        """In how many of its looks a cell was measured, in whichever submap that is kept: what one
        submap tells in vain, as another is surer, is not worth looking at again."""
        self.sought: list[tuple[Point, Point]] = []
        """Where the team-mate stood that was looked at last, and from where."""
        self.hidden: tuple[Point, float] | None = None
        """Where it stood that could be seen from nowhere, and the map's age by which that was."""
        self.open: Bools = np.zeros(self.settings.frame.shape, dtype=np.bool_)
        """Those cells, as of when the last look was chosen."""

    @property
    def first_looks(self) -> tuple[tuple[float, float], ...]:
        """Looks all around."""
        planner = self.settings.planner
        pans = np.linspace(0.0, 2 * math.pi, planner.first_looks, endpoint=False)
        return tuple((float(pan), math.radians(planner.first_tilt_deg)) for pan in pans)

    @property
    def all_round(self) -> tuple[tuple[float, float], ...]:
        """The same."""
        return self.first_looks

    async def expect(self, pan_rad: float, tilt_rad: float) -> Expected:
        """Return Eq. 5 in the field of view, times the chance that a ray falls on a cell."""
        chances: Singles = await asyncio.to_thread(
            self.strategy.expect, self.view(), self.robot.pose, pan_rad, tilt_rad
        )
        # In single precision the order in which numpy adds up would show in the record.
        return Expected(round(float(np.sum(chances, dtype=np.float64)), 3), chances)

    async def localise(self, exposure: Exposure) -> None:
        """Hold the look against the own map, and correct the pose by it.

        The map lies no better than its anchor: what is told is where the robot is on it.
        """
        robot = self.robot
        if robot.own.submaps and self.settings.map.matching:
            index = len(robot.own.submaps) - 1
            told = await asyncio.to_thread(
                self.stands.locate, robot.own.submaps[index], index, exposure, robot.filter
            )
            if told:
                robot.log.event("look and map disagree", "; ".join(told))
            robot.correct_anchors()

    async def fuse(self, exposure: Exposure, expected: Expected) -> None:
        """Fuse one look into the own layer (Eqs. 19-21), and lose interest in what failed."""
        robot = self.robot
        exposure = self._without_mates(exposure)
        index, submap = robot.current_submap()
        known_before = robot.charted().known
        drawn_at, beyond = robot.placing()
        cells = await asyncio.to_thread(
            bin_look,
            exposure,
            drawn_at,
            self.settings.frame,
            attitude_sigma_rad=math.radians(self.settings.sensor.attitude_sigma_deg),
            extra_variance=beyond,
        )
        submap.observe(cells)
        self.asked += self.open * expected.chances
        if self.settings.map.matching:
            self.stands.drew(submap, index, drawn_at, exposure, cells, robot.filter)
        drawn = np.zeros(self.settings.frame.shape, dtype=bool)
        drawn[cells.rows, cells.cols] = True
        measured = self.settings.frame.mask_of(robot.pose.team_from_robot(exposure.points_m))
        self.taken += measured
        self.interest.update(expected.chances, measured)
        robot.looked(
            index,
            exposure,
            expected.cells,
            drawn=drawn,
            measured=measured,
            new=measured & ~known_before,
        )

    def _without_mates(self, exposure: Exposure) -> Exposure:
        """Leave out the points that may be a team-mate's own, where it says that it is.

        Eyes that really see, see robots too, and not always the tag that tells so.
        """
        robot = self.robot
        if robot.hardware.eyes is None:
            return exposure
        stands: list[tuple[Pose, float]] = []
        for _, mate in sorted(robot.mates.items()):
            if is_located(mate):
                sigma_m = math.sqrt(max(mate.status.variance[:2]) + robot.filter.sigma_m**2)
                off_m = min(2.0 * sigma_m, MOST_UNSURE_M)
                if ACTIVITIES[mate.status.activity] in MOVING:
                    age_s = max(exposure.t_s - mate.heard_s, 0.0) + TOLD_LATE_S
                    off_m += min(self.settings.drive.speed_mps * age_s, MOST_MOVED_M)
                stands.append((mate.status.pose, off_m))
        return off_mates(exposure, robot.pose, stands)

    def view(self) -> View:
        """Return what the planner sees: the team map and where everybody is."""
        robot = self.robot
        fused = robot.charted()
        others = [
            *(mate.status.pose for _, mate in sorted(robot.mates.items()) if is_located(mate)),
            *(landmark.pose for landmark in self.settings.landmarks),
        ]
        return View(
            frame=self.settings.frame,
            elevation_m=fused.elevation_m,
            sigma_m=np.sqrt(robot.charted(relative=True).variance_m2),
            looks=np.maximum(fused.looks, self.taken),
            interest=self.interest.share,
            pose=robot.pose,
            pose_sigma_m=robot.filter.sigma_m,
            others=others if robot.located else [],
            sensor=self.settings.sensor,
            drive=self.settings.drive,
            planner=self.settings.planner,
            claims=robot.interest.regions(wished=False) if robot.located else [],
            wishes=tuple(robot.interest.regions(wished=True)) if robot.located else (),
            barred=self.barred,
            trail_m=np.array([*robot.trail, (robot.pose.x_m, robot.pose.y_m)]),
        )

    async def _questions(self, view: View) -> Bools | None:
        """Return what keeps a team-mate's most hopeful way down from being safe, if one waits.

        What was expected to be seen and was not is asked about as little as what was asked often.
        """
        robot, goal_m = self.robot, self.settings.goal_m
        for index, mate in sorted(robot.mates.items()):
            waits = self.settings.roles[index] == "cliffbot" and mate.status.claim is not None
            if waits and goal_m is not None and is_located(mate):
                in_vain = TIRED * (1.0 / np.maximum(view.interest, LEAST_INTEREST) - 1.0)
                down = Descent(mate.status.pose, goal_m, self.asked + in_vain)
                ground = (view.frame, view.drive, view.elevation_m, self._sigma_as_heard(view))
                self.open = await asyncio.to_thread(open_questions, *ground, down)
                return self.open
        self.open[:] = False
        return None

    def _pressing(self, questions: Bools) -> Floats:
        """Return how much questions (H, W) count still, by how many looks they were asked for."""
        return np.where(questions, 1.0 / (1.0 + self.asked / TIRED) ** 2, 0.0)

    def _sigma_as_heard(self, view: View) -> Floats:
        """Return sigma (H, W) as team-mates are told it: more roughly, and so never less.

        What is sharp enough for who measured it may not be for those who hear of it.
        """
        known = ~np.isnan(view.elevation_m)
        sent = sigma_as_sent(np.where(known, view.sigma_m, 0.0), known)
        heard = np.sqrt(sent**2 + UNIFORM * self.settings.map.max_error_m**2)
        return np.where(known, heard, np.inf)

    async def choose(self) -> NextLook | None:
        """Choose the next look (Eq. 23)."""
        view, plan = self.view(), None
        for hope in range(HOPES):
            questions = await self._questions(view)
            asking = (
                view if questions is None else replace(view, questions=self._pressing(questions))
            )
            plan = await asyncio.to_thread(self.strategy.choose, asking, self.robot.rng)
            if plan is not None or questions is None or not questions.any():
                break
            # No look can answer these: another way down may do.
            self.asked += TIRED * 2.0**hope * questions
        if plan is None:
            return None
        heading_rad = plan.heading_rad
        reach_m = 0.5 * self.settings.sensor.range_m
        x_m, y_m = plan.path_m[-1]
        claim = (
            float(x_m) + reach_m * math.cos(heading_rad),
            float(y_m) + reach_m * math.sin(heading_rad),
            reach_m,
        )
        return NextLook(plan.path_m, heading_rad, plan.tilt_rad, claim)

    async def way_to_see(self, mate: Pose) -> Floats | None:
        """Return the way to where a team-mate shows; not from where it was looked for in vain."""
        stands = (mate.x_m, mate.y_m)
        self.sought = [one for one in self.sought if math.dist(one[0], stands) < SAME_STAND_M]
        asked = (stands, self.robot.map_changed_s)
        if asked == self.hidden:
            return None
        vain = [place for _, place in self.sought]
        way_m = await asyncio.to_thread(way_to_see, self.view(), mate, vain)
        if way_m is None:
            self.hidden = asked
        else:
            self.sought.append((stands, (float(way_m[-1, 0]), float(way_m[-1, 1]))))
        return way_m

    def halted(self) -> float | None:
        """Bar the ground before the wheels, which the map took for better; look as planned."""
        pose, radius_m = self.robot.pose, 0.5 * self.settings.drive.footprint_m
        ahead_m = radius_m + self.settings.frame.cell_m
        x_m = pose.x_m + ahead_m * math.cos(pose.yaw_rad)
        y_m = pose.y_m + ahead_m * math.sin(pose.yaw_rad)
        self.barred = (*self.barred, (x_m, y_m, radius_m))[-BARRED:]
        return None
