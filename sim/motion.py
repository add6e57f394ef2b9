"""Who was where and when: what bodies publish on the world plane, and everybody reads."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

from agents.geometry import Pose, wrap_angle

MAX_SEGMENTS = 512
"""Segments kept per robot: more than the longest drive publishes at once, hours of single moves."""

Wire = tuple[str, int, int, tuple[float, ...], tuple[float, ...], float, float, str]


@dataclass(frozen=True)
class Segment:
    """One robot's motion over a span of time: linear inside it, at rest at its end after it.

    Times are the simulation's integer nanoseconds; poses are true poses in the world frame; the
    yaw turns the shorter way. Tether lengths are those of the robot's own drum, in metres.
    """

    robot: str
    start_ns: int
    end_ns: int
    start: Pose
    end: Pose
    tether_start_m: float = 0.0
    tether_end_m: float = 0.0
    note: str = ""

    def __post_init__(self) -> None:
        """Hold that time runs forwards."""
        assert self.end_ns >= self.start_ns, f"segment ends before it starts: {self}"

    def share_at(self, t_ns: int) -> float:
        """Return how much of the span has passed, in [0, 1]."""
        if t_ns >= self.end_ns:
            return 1.0
        if t_ns <= self.start_ns:
            return 0.0
        return (t_ns - self.start_ns) / (self.end_ns - self.start_ns)

    def pose_at(self, t_ns: int) -> Pose:
        """Return the pose at a time; the ends themselves exactly."""
        share = self.share_at(t_ns)
        if share <= 0.0:
            return self.start
        return self.end if share >= 1.0 else blend(self.start, self.end, share)

    def tether_at(self, t_ns: int) -> float:
        """Return the tether's length at a time, in metres."""
        share = self.share_at(t_ns)
        if share >= 1.0:
            return self.tether_end_m
        return self.tether_start_m + share * (self.tether_end_m - self.tether_start_m)

    def to_wire(self) -> Wire:
        """Return plain numbers and strings, exact in any format with 64-bit floats."""
        return (
            self.robot,
            self.start_ns,
            self.end_ns,
            _numbers(self.start),
            _numbers(self.end),
            self.tether_start_m,
            self.tether_end_m,
            self.note,
        )

    @classmethod
    def from_wire(cls, wire: Sequence[object]) -> "Segment":
        """Rebuild what `to_wire` gave, from tuples or lists."""
        robot, start_ns, end_ns, start, end, tether_start_m, tether_end_m, note = cast("Wire", wire)
        return cls(
            robot, start_ns, end_ns, Pose(*start), Pose(*end), tether_start_m, tether_end_m, note
        )


def _numbers(pose: Pose) -> tuple[float, ...]:
    return (float(pose.x_m), float(pose.y_m), float(pose.z_m), float(pose.yaw_rad))


def blend(start: Pose, end: Pose, share: float) -> Pose:
    """Return the pose a share of the way from one to another, turning the shorter way."""
    return Pose(
        start.x_m + share * (end.x_m - start.x_m),
        start.y_m + share * (end.y_m - start.y_m),
        start.z_m + share * (end.z_m - start.z_m),
        wrap_angle(start.yaw_rad + share * wrap_angle(end.yaw_rad - start.yaw_rad)),
    )


class Motions:
    """All motion heard of; at any time the newest-published segment that has begun holds.

    A later segment thus overrules the rest of an earlier one from its own start on (a stop in the
    middle of a drive), and the past stays as it was.
    """

    def __init__(self) -> None:
        """Know of nobody yet."""
        self._segments: dict[str, deque[Segment]] = {}

    @property
    def robots(self) -> tuple[str, ...]:
        """Names, in the order in which they were first heard of."""
        return tuple(self._segments)

    def add(self, segment: Segment) -> None:
        """Take a segment; per robot, in the order of publishing. The oldest are forgotten."""
        kept = self._segments.setdefault(segment.robot, deque(maxlen=MAX_SEGMENTS))
        kept.append(segment)

    def current(self, robot: str, t_ns: int) -> Segment | None:
        """Return the segment that holds at a time; None before the first that is known."""
        kept = self._segments.get(robot, ())
        return next((s for s in reversed(kept) if s.start_ns <= t_ns), None)

    def pose_at(self, robot: str, t_ns: int) -> Pose | None:
        """Return a robot's true pose at a time; None where nothing is known of it."""
        segment = self.current(robot, t_ns)
        return None if segment is None else segment.pose_at(t_ns)

    def tether_at(self, robot: str, t_ns: int) -> float:
        """Return the length out of a robot's drum, in metres; 0 where nothing is known of it."""
        segment = self.current(robot, t_ns)
        return 0.0 if segment is None else segment.tether_at(t_ns)

    def freeze(self, robot: str, t_ns: int) -> None:
        """Stop a robot where it is at a time: what is dead neither drives on nor pays out."""
        segment = self.current(robot, t_ns)
        if segment is not None:
            pose, tether_m = segment.pose_at(t_ns), segment.tether_at(t_ns)
            self.add(Segment(robot, t_ns, t_ns, pose, pose, tether_m, tether_m, "frozen"))
