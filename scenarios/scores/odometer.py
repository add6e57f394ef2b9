"""How far robots truly went, and how wrong they are on the way."""

import math

from agents.geometry import Pose
from sim.motion import Segment


class Odometer:
    """Length of the way that a robot truly went, over the ground; no motion is counted ahead."""

    def __init__(self) -> None:
        """Begin with none."""
        self._driven_m = 0.0
        self._way: Segment | None = None

    def drive(self, segment: Segment) -> None:
        """Take the next motion; what it cuts short of the one before was not driven."""
        self._driven_m += self._part_of_way_m(segment.start_ns)
        self._way = segment

    def distance_m(self, t_ns: int) -> float:
        """Return the length of the way up to now."""
        return self._driven_m + self._part_of_way_m(t_ns)

    def _part_of_way_m(self, t_ns: int) -> float:
        if self._way is None:
            return 0.0
        share = self._way.share_at(t_ns) if t_ns > self._way.start_ns else 0.0
        return share * _length_m(self._way.start, self._way.end)


def _length_m(start: Pose, end: Pose) -> float:
    return math.hypot(end.x_m - start.x_m, end.y_m - start.y_m, end.z_m - start.z_m)


class Rms:
    """A root mean square that keeps no values."""

    def __init__(self) -> None:
        """Begin with none."""
        self._sum, self._count = 0.0, 0

    def append(self, value: float) -> None:
        """Take one more."""
        self._sum += value * value
        self._count += 1

    @property
    def value(self) -> float | None:
        """The root mean square so far; None of nothing."""
        return math.sqrt(self._sum / self._count) if self._count else None
