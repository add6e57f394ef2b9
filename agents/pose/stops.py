"""Where a robot stood lately: what it is told of a moment ago is about the place of then.

Who is seen hears of it seconds later, over a thin link, when it may have driven on. A fix belongs
to the stop at which it was taken; by what the two share it corrects the pose of now as well. What
was seen while it drove belongs to no stop: between two the odometry says nothing.
"""

from typing import NamedTuple

from agents.pose.posefilter import PoseFilter, Remembered

MOST = 8
"""So many stops are remembered."""
TICK_S = 0.01
"""To so much the time of a fix is rounded."""


class Stop(NamedTuple):
    """A place and the time for which the robot stood there."""

    name: Remembered
    since_s: float
    until_s: float


class Stops:
    """The latest stops of a robot."""

    def __init__(self) -> None:
        """Have stood nowhere."""
        self._stops: list[Stop] = []
        self._count = 0

    def leave(self, way: PoseFilter, since_s: float, now_s: float) -> None:
        """Remember where the robot stands since a time, and drives off now."""
        name = Remembered("stop", self._count)
        self._count += 1
        way.remember(name)
        self._stops.append(Stop(name, since_s, now_s))
        if len(self._stops) > MOST:
            way.forget(self._stops.pop(0).name)

    def at(self, t_s: float) -> Remembered | None:
        """Return the stop of a time; None: it drove then, or has forgotten."""
        for stop in reversed(self._stops):
            if stop.since_s + TICK_S <= t_s <= stop.until_s - TICK_S:
                return stop.name
        return None
