"""Exploring a planar world without a radio: robots choose, drive and look on one shared map.

Robots act in the order of their clocks. Each drives the way that it planned at its own speed,
turns, looks, and adds what it measured to the map; poses are exact and what one measured is known
to all at once. So this compares ways of choosing, and nothing else.
"""

import heapq
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from agents import planar
from agents.geometry import Bools, Floats, Pose, wrap_angle
from agents.ground import paths
from agents.planar.sensing import LIMIT, MAPPED, look_log_odds
from agents.planar.view import PlanarLook, PlanarView
from agents.settings import DriveSettings, PlannerSettings, SensorSettings
from sim.planar_world import PlanarWorld, look, standable


@dataclass(frozen=True)
class Setup:
    """Who explores, with what."""

    method: str
    sensor: SensorSettings
    drive: DriveSettings
    planner: PlannerSettings
    robots: int = 1
    goal: float = 1.0
    """Explore until this share of the observable cells is mapped."""


@dataclass(frozen=True)
class Taken:
    """The state of affairs after one look."""

    robot: int
    t_s: float
    """Simulated time at its end."""
    driven_m: float
    """By all robots together."""
    coverage: float
    """Mapped share of the observable cells."""
    wrong: float
    """Share of the mapped observable cells that are mapped wrongly."""
    gain: float
    """Cells that the method expected to map."""
    got: float
    """Cells that it mapped, in the same unit."""
    choice_s: float
    """CPU time of choosing."""


@dataclass
class Exploration:
    """A map in the making, and the record of how it was made."""

    world: PlanarWorld
    observable: Bools
    setup: Setup
    taken: list[Taken] = field(default_factory=list[Taken])
    bumps: int = 0
    """Ways that led through cells where the robot does not fit."""
    ended: str = ""
    """Why it ended: "goal", "done" (the methods had nothing more to gain) or "looks"."""

    def __post_init__(self) -> None:
        """Begin with an empty map."""
        self.log_odds: Floats = np.zeros(self.world.frame.shape)
        # A robot squeezes through what is as wide as itself, measured to a cell.
        self._fits = standable(self.world.solid, self.world.frame.cell_m, 0.0)

    @property
    def mapped(self) -> Bools:
        """Cells whose occupancy is off by more than 0.4 from 0.5."""
        return np.abs(self.log_odds) > MAPPED

    def run(self, rng: np.random.Generator) -> None:
        """Explore until the goal is reached, nothing more is to gain, or looks have run out."""
        setup = self.setup
        choosing, seeing = rng.spawn(2)
        x, y = self.world.frame.centre_of(*self.world.start)
        count = setup.robots
        poses = [Pose(x, y, 0.0, wrap_angle(2.0 * math.pi * k / count)) for k in range(count)]
        means = planar.Means(setup.sensor, setup.drive, setup.planner)
        methods = [planar.method(setup.method, means) for _ in range(count)]
        plans: list[PlanarLook | None] = [None] * count
        driven_m = 0.0
        queue = [(0.0, k) for k in range(count)]
        idle = 0
        while queue and len(self.taken) < setup.planner.max_looks * count:
            now_s, k = heapq.heappop(queue)
            plan = plans[k]
            got, gain = 0.0, 0.0
            if plan is not None:
                got, gain = self._look(plan.pose, seeing), plan.gain
                poses[k] = plan.pose
                plans[k] = None
            elif not self.taken or now_s == 0.0:
                got = self._look(poses[k], seeing)
                now_s += setup.sensor.look_s
            begun = time.process_time()
            chosen = methods[k].choose(self._view(k, poses, plans), choosing)
            choice_s = time.process_time() - begun
            coverage, wrong = self._coverage()
            self.taken.append(Taken(k, now_s, driven_m, coverage, wrong, gain, got, choice_s))
            if coverage >= setup.goal:
                self.ended = "goal"
                return
            if chosen is None:
                idle += 1
                if idle == count:
                    break
                continue
            plans[k] = chosen
            driven_m += paths.length_m(chosen.path_m)
            self.bumps += self._bumps(chosen.path_m)
            heapq.heappush(queue, (now_s + self._takes_s(poses[k], chosen), k))
        self.ended = "done" if idle == count else "looks"

    def _view(
        self, k: int, poses: Sequence[Pose], plans: Sequence[PlanarLook | None]
    ) -> PlanarView:
        others = [j for j in range(len(poses)) if j != k]
        claims = tuple(plan.claim for j in others if (plan := plans[j]) is not None)
        return PlanarView(
            self.world.frame,
            self.log_odds.copy(),
            self.mapped,
            pose=poses[k],
            others=tuple(poses[j] for j in others),
            claims=claims,
        )

    def _look(self, pose: Pose, rng: np.random.Generator) -> float:
        """Look and add what was measured; return how many cells' worth of log-odds that was."""
        ranges_m, _ = look(self.world, pose, self.setup.sensor, rng)
        before = np.minimum(np.abs(self.log_odds), MAPPED).sum()
        added = look_log_odds(self.world.frame, pose, ranges_m, self.setup.sensor)
        self.log_odds = np.clip(self.log_odds + added, -LIMIT, LIMIT)
        return float(np.minimum(np.abs(self.log_odds), MAPPED).sum() - before) / MAPPED

    def _coverage(self) -> tuple[float, float]:
        told = self.mapped & self.observable
        wrong = told & ((self.log_odds > 0) != self.world.solid)
        count = float(told.sum())
        return count / float(self.observable.sum()), float(wrong.sum()) / max(count, 1.0)

    def _takes_s(self, pose: Pose, plan: PlanarLook) -> float:
        """Return how long driving, turning on the spot and looking take."""
        legs = np.diff(plan.path_m, axis=0)
        yaws = [pose.yaw_rad, *np.arctan2(legs[:, 1], legs[:, 0]), plan.pose.yaw_rad]
        turned = sum(abs(wrap_angle(float(b) - float(a))) for a, b in pairwise(yaws))
        drive = self.setup.drive
        driving_s = paths.length_m(plan.path_m) / drive.speed_mps + turned / drive.turn_rate_radps
        return driving_s + self.setup.sensor.look_s

    def _bumps(self, path_m: Floats) -> int:
        """Return 1 if the way leads through a cell where no robot fits."""
        frame = self.world.frame
        for a, b in pairwise(path_m):
            steps = max(1, math.ceil(float(np.hypot(*(b - a))) / (0.25 * frame.cell_m)))
            points = a + np.linspace(0.0, 1.0, steps + 1)[:, None] * (b - a)
            cells = frame.cells_of(points)
            if not self._fits[cells[:, 0], cells[:, 1]].all():
                return 1
        return 0
