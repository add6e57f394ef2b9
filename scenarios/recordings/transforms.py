"""Who stands where in whose frame, over time: what /tf, /tf_static and topics of poses tell."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from agents.geometry import Floats, Ints

SLACK_NS = 1_000_000_000
"""A frame is taken to stand where it stood, so long before its first pose and after its last."""
DEEPEST = 64
"""Frames above one another, at most: more are a circle."""


@dataclass(frozen=True)
class Place:
    """A frame in another one."""

    rotation: Floats
    """(3, 3)."""
    shift_m: Floats
    """(3,)."""

    def of(self, inner: "Place") -> "Place":
        """Return where a frame is that is known in this one."""
        return Place(self.rotation @ inner.rotation, self.rotation @ inner.shift_m + self.shift_m)

    def inverse(self) -> "Place":
        """Return the other frame in this one."""
        back = self.rotation.T
        return Place(back, -back @ self.shift_m)

    def points(self, points_m: Floats) -> Floats:
        """Turn points (N, 3) of this frame into those of the frame that it stands in."""
        return points_m @ self.rotation.T + self.shift_m


HERE = Place(np.eye(3), np.zeros(3))


@dataclass
class Track:
    """A frame's way in its parent."""

    parent: str
    is_static: bool = False
    _told: dict[int, tuple[list[float], list[float]]] = field(
        default_factory=dict[int, tuple[list[float], list[float]]]
    )
    _laid: tuple[Ints, Floats, Rotation] | None = None

    def add(self, t_ns: int, position: Any, orientation: Any) -> None:
        """Take a pose: geometry_msgs Vector3 or Point, and Quaternion; of one time, the last."""
        shift = [float(position[axis]) for axis in "xyz"]
        turn = [float(orientation[axis]) for axis in "xyzw"]
        if np.isfinite([*shift, *turn]).all() and any(turn):
            self._told[t_ns] = (shift, turn)
            self._laid = None

    @property
    def times_ns(self) -> Ints:
        """(K,) when its pose was told, rising."""
        return self._lay()[0]

    def at(self, t_ns: int) -> Place | None:
        """Return its place at a time; None where nothing near enough was told."""
        if not self._told:
            return None
        times, shifts, turns = self._lay()
        if self.is_static:
            return Place(turns[-1].as_matrix(), shifts[-1])
        if not times[0] - SLACK_NS <= t_ns <= times[-1] + SLACK_NS:
            return None
        t_ns = min(max(t_ns, int(times[0])), int(times[-1]))
        after = min(max(int(np.searchsorted(times, t_ns)), 1), len(times) - 1)
        if len(times) == 1:
            return Place(turns[0].as_matrix(), shifts[0])
        before = after - 1
        share = (t_ns - int(times[before])) / (int(times[after]) - int(times[before]))
        turn = Slerp([0.0, 1.0], turns[before : after + 1])(share)
        return Place(turn.as_matrix(), shifts[before] + share * (shifts[after] - shifts[before]))

    def _lay(self) -> tuple[Ints, Floats, Rotation]:
        if self._laid is None:
            times = np.array(sorted(self._told), dtype=np.int64)
            told = [self._told[int(t_ns)] for t_ns in times]
            shifts = np.array([shift for shift, _ in told])
            self._laid = times, shifts, Rotation.from_quat([turn for _, turn in told])
        return self._laid


class Transforms:
    """All frames of a recording."""

    def __init__(self) -> None:
        """Know of no frame."""
        self.tracks: dict[str, Track] = {}
        """By frame."""

    def add(self, parent: str, child: str, t_ns: int, pose: tuple[Any, Any], static: bool) -> None:
        """Take where a frame is; one that is told another parent belongs to that from then on."""
        track = self.tracks.get(child)
        if track is None or track.parent != parent:
            track = self.tracks[child] = Track(parent, static)
        track.add(t_ns, *pose)

    def line(self, frame: str) -> list[str]:
        """Return a frame and those above it, up to the one that stands in none."""
        found = [frame]
        while found[-1] in self.tracks and len(found) < DEEPEST:
            found.append(self.tracks[found[-1]].parent)
        return found

    def between(self, outer: str, inner: str, t_ns: int) -> Place | None:
        """Return a frame's place in another one at a time; None where that is not known."""
        above = self.line(outer)
        shared = next((frame for frame in self.line(inner) if frame in above), None)
        if shared is None:
            return None
        up, down = self._climb(inner, shared, t_ns), self._climb(outer, shared, t_ns)
        return None if up is None or down is None else down.inverse().of(up)

    def _climb(self, frame: str, top: str, t_ns: int) -> Place | None:
        place = HERE
        while frame != top:
            step = self.tracks[frame].at(t_ns)
            if step is None:
                return None
            place, frame = step.of(place), self.tracks[frame].parent
        return place
