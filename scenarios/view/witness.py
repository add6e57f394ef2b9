"""What a robot's host tells of it to those who watch: how its map grows, what it is about to do.

It reads and is never read: a run with it and one without it are the same.
"""

from typing import Any

import numpy as np

from agents.geometry import Bools
from agents.mapper import NextLook
from agents.robot import Robot
from scenarios.view.growth import Growth, from_above
from scenarios.wire import Plan


class Witness:
    """Watches one robot in one of its lives."""

    def __init__(self, plan: Plan) -> None:
        """Begin with what the robot's host was told."""
        self._observable, self._frame = plan.observable, plan.terrain.frame
        self._map = Growth(plan.terrain)
        self._growth: list[Any] = []
        self._plan: NextLook | None = None
        self._claim: tuple[float, float, float] | None = None

    def weigh(self, t_ns: int, done: Bools, estimate: Any, robot: Robot) -> None:
        """Take the team map as it is weighed; `done` are its mapped cells."""
        own = np.zeros(self._frame.shape, dtype=bool)
        for submap in robot.own.submaps:
            own |= from_above(submap.known, self._frame)
        step = self._map.step(estimate, own)
        if step is not None:
            cells = int(np.count_nonzero(done & self._observable))
            self._growth.append((t_ns, cells, *step))

    def take(self, now_ns: int, robot: Robot) -> tuple[list[Any], list[Any]]:
        """Return what grew since the last time, and the robot's plan where it has changed.

        A plan has the `way` [[x, y] ...] to the next look and its `heading`, and the `claim`
        (x, y, radius) that the team was told: ground that it will look at, or waits to know.
        """
        growth, self._growth = self._growth, []
        if robot.plan is self._plan and robot.claim == self._claim:
            return growth, []
        self._plan, self._claim = robot.plan, robot.claim
        return growth, [(now_ns, self._told())]

    def _told(self) -> dict[str, Any]:
        told: dict[str, Any] = {}
        if self._plan is not None:
            told["way"] = [[round(float(v), 2) for v in point] for point in self._plan.path_m]
            told["heading"] = round(float(self._plan.heading_rad), 3)
        if self._claim is not None:
            told["claim"] = [round(float(v), 2) for v in self._claim]
        return told
