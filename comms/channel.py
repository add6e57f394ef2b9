"""Who may speak when: each on a channel of its own, in turns, or whoever finds the channel free.

Turns (tdma) are slots of equal length in the order of the team, counted from the run's start; a
frame ends inside the slot in which it began. On a free-for-all (csma) a robot that would speak
listens first: it waits until the channel has fallen free, one sensing delay more, and a random
while, and begins if nobody else has. A carrier is sensed one least latency after it began, so two
may still begin at once; where both are heard, neither is understood. Robots out of each other's
reach do not sense each other at all.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Literal

from comms.timebase import NS

ChannelKind = Literal["own", "tdma", "csma"]
KEPT_SPANS = 4096
"""Spans on air that are remembered of oneself, and of all others."""


def airtime_ns(charged_bytes: int, rate_bps: float) -> int:
    """Return 8 * bytes / rate, rounded up to a whole nanosecond; in integers, so exactly that."""
    if math.isinf(rate_bps):
        return 0
    # A float is a fraction of integers; the ceiling of a quotient of integers is exact.
    bits, per_bit = rate_bps.as_integer_ratio()
    return -(-8 * NS * charged_bytes * per_bit // bits)


@dataclass(frozen=True)
class Shared:
    """How the team's transmitters share the air."""

    kind: ChannelKind = "own"
    slot_ns: int = 2 * NS
    """Length of a turn."""
    backoff_ns: int = NS // 2
    """Longest wait, above the sensing delay, once the channel is free."""


ONE_EACH = Shared()


@dataclass(frozen=True)
class Seat:
    """A robot's place among those who share a channel."""

    index: int = 0
    """In the roster."""
    team: int = 1
    """Length of the roster."""
    sense_ns: int = 0
    """How long after its beginning a carrier is sensed: the least latency of any link."""


def turn_ns(seat: Seat, slot_ns: int, now_ns: int, need_ns: int) -> tuple[int, int]:
    """Return (start, end) of the next time in which a robot may speak for at least `need_ns`.

    The start is `now_ns` where its turn is on and long enough. `need_ns` is at most a slot.
    """
    assert 0 <= need_ns <= slot_ns, (need_ns, slot_ns)
    cycle_ns = seat.team * slot_ns
    begin_ns = now_ns - (now_ns - seat.index * slot_ns) % cycle_ns
    if now_ns + max(need_ns, 1) > begin_ns + slot_ns:
        begin_ns += cycle_ns
    return max(now_ns, begin_ns), begin_ns + slot_ns


class Medium:
    """What a robot knows of who is or was on air: itself, and the carriers that it senses."""

    def __init__(self) -> None:
        """Start in silence."""
        self._own: deque[tuple[int, int]] = deque(maxlen=KEPT_SPANS)
        self._others: deque[tuple[str, int, int]] = deque(maxlen=KEPT_SPANS)
        self._longest_ns = 0
        self._busy_until_ns: int | None = None

    def sends(self, start_ns: int, end_ns: int) -> None:
        """Note a transmission of one's own, in their order; what takes no time disturbs nobody."""
        if end_ns > start_ns:
            self._own.append((start_ns, end_ns))
            self._busy(end_ns)

    def senses(self, sender: str, start_ns: int, end_ns: int) -> None:
        """Note somebody's carrier, in the order of their beginnings."""
        self._others.append((sender, start_ns, end_ns))
        self._longest_ns = max(self._longest_ns, end_ns - start_ns)
        self._busy(end_ns)

    def _busy(self, end_ns: int) -> None:
        known_ns = self._busy_until_ns
        self._busy_until_ns = end_ns if known_ns is None else max(end_ns, known_ns)

    def free_ns(self, now_ns: int, sense_ns: int) -> int:
        """Return when all that is on air now will have been over for one sensing delay."""
        known_ns = self._busy_until_ns
        return now_ns if known_ns is None else max(now_ns, known_ns + sense_ns)

    def was_sending(self, start_ns: int, end_ns: int) -> bool:
        """Say whether one's own transmitter was on at any moment of a span."""
        for start, end in reversed(self._own):
            if end <= start_ns:
                return False
            if start < end_ns:
                return True
        return False

    def clashes(self, sender: str, start_ns: int, end_ns: int) -> bool:
        """Say whether somebody but `sender` was on air at any moment of its frame."""
        for name, start, end in reversed(self._others):
            if start <= start_ns - self._longest_ns:
                return False
            if name != sender and start < end_ns and start_ns < end:
                return True
        return False
