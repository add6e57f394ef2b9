"""Which frames were heard, which were lost, and what was in them: by number, in a few bytes.

Every robot numbers its frames; who hears 17 and then 19 knows that it lost 18, and says so. Whoever
sent or heard 18 knows what was in it.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from agents.sharing.beliefs import GUARD_S, Stretch
from agents.sharing.reports import MAX_MISSED_RANGES, Acks
from agents.store import AnchorKey

LOGGED_FRAMES = 1024
"""Frames of each sender whose content is remembered: hours, at a rover's pace."""
TELLINGS = 2
"""A lost frame is named in so many reports: the first may be lost itself."""
SETTLING_S = 2.0
"""A frame that is missed may still come for so long, having been overtaken."""


@dataclass
class _Gap:
    first: int
    last: int
    noticed_s: float
    tellings: int = 0


@dataclass
class _Ear:
    """What was heard of one sender's present life."""

    incarnation: int
    upto: int
    gaps: list[_Gap] = field(default_factory=list[_Gap])


class Ears:
    """Which frames of each team-mate were heard, and which were lost."""

    def __init__(self) -> None:
        """Start having heard nobody."""
        self._ears: dict[int, _Ear] = {}

    def hear(self, sender: int, incarnation: int, seq: int, now_s: float) -> bool:
        """Note a frame; return whether it is the first of its sender's life that was heard."""
        ear = self._ears.get(sender)
        if ear is None or ear.incarnation < incarnation:
            self._ears[sender] = _Ear(incarnation, seq + 1)
            return True
        if ear.incarnation > incarnation:
            return False
        if seq >= ear.upto:
            if seq > ear.upto:
                ear.gaps.append(_Gap(ear.upto, seq - 1, now_s))
                del ear.gaps[:-MAX_MISSED_RANGES]
            ear.upto = seq + 1
        else:
            ear.gaps = [part for gap in ear.gaps for part in _without(gap, seq)]
        return False

    def forgive(self, sender: int) -> None:
        """Forget what was lost of a sender: it is known not to matter."""
        if sender in self._ears:
            self._ears[sender].gaps.clear()

    def forget(self, sender: int) -> None:
        """Forget a sender altogether."""
        self._ears.pop(sender, None)

    def lost_since_s(self) -> float | None:
        """Return when the first loss was noticed that is still to be told, if any."""
        times = [g.noticed_s for e in self._ears.values() for g in e.gaps if g.tellings == 0]
        return min(times, default=None)

    def acks(self, now_s: float, everybody: Iterable[int] = ()) -> tuple[Acks, ...]:
        """Return what is to be told of those of whom frames were lost, and of `everybody`."""
        out: list[Acks] = []
        listed = set(everybody)
        for robot in sorted({*self._ears, *listed}):
            ear = self._ears.get(robot)
            if ear is None:
                out.append(Acks(robot, 0, 0))
                continue
            told = [g for g in ear.gaps if now_s - g.noticed_s >= SETTLING_S]
            if told or robot in listed:
                missed = tuple((g.first, g.last) for g in told)
                out.append(Acks(robot, ear.incarnation, ear.upto, missed))
        return tuple(out)

    def told(self, acks: Iterable[Acks]) -> None:
        """Note what was told; what was told often enough is not told again."""
        for one in acks:
            ear = self._ears.get(one.robot)
            if ear is None:
                continue
            named = set(one.missed)
            for gap in ear.gaps:
                gap.tellings += (gap.first, gap.last) in named
            ear.gaps = [gap for gap in ear.gaps if gap.tellings < TELLINGS]


def _without(gap: _Gap, seq: int) -> list[_Gap]:
    if not gap.first <= seq <= gap.last:
        return [gap]
    below = _Gap(gap.first, seq - 1, gap.noticed_s, gap.tellings)
    above = _Gap(seq + 1, gap.last, gap.noticed_s, gap.tellings)
    return [part for part in (below, above) if part.first <= part.last]


@dataclass(slots=True)
class Logged:
    """What one frame carried."""

    seq: int
    t_s: float
    stretches: tuple[Stretch, ...]
    anchor: tuple[AnchorKey, int] | None = None
    denied: int = 0
    """Team-mates that said that they did not hear it: a bit each."""


class FrameLog:
    """What the last frames carried that were sent or heard here, by sender's life."""

    def __init__(self) -> None:
        """Start empty."""
        self._lives: dict[int, dict[int, deque[Logged]]] = {}
        """By sender and incarnation."""
        self._last: dict[tuple[int, int], int] = {}
        """The highest number of each life."""

    def note(self, robot: int, incarnation: int, logged: Logged) -> None:
        """Remember what a frame carried."""
        lives = self._lives.setdefault(robot, {})
        lives.setdefault(incarnation, deque(maxlen=LOGGED_FRAMES)).append(logged)
        last = self._last.get((robot, incarnation), -1)
        self._last[robot, incarnation] = max(last, logged.seq)

    def forget(self, robot: int) -> None:
        """Forget the frames of a robot, in all its lives."""
        for incarnation in self._lives.pop(robot, {}):
            del self._last[robot, incarnation]

    def missed(self, acks: Acks, now_s: float) -> list[Logged]:
        """Return the frames that, by its own word, a team-mate did not hear."""
        lives = [
            life
            for incarnation, life in sorted(self._lives.get(acks.robot, {}).items())
            if (incarnation == acks.incarnation or acks.upto == 0)
            and (acks.missed or acks.upto <= self._last[acks.robot, incarnation])
        ]
        return [
            frame
            for life in lives
            for frame in life
            if any(a <= frame.seq <= b for a, b in acks.missed)
            or (frame.seq >= acks.upto and now_s - frame.t_s > GUARD_S)
        ]
