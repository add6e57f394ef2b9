"""The emulated link: when a frame ends and arrives, and what becomes of it. No clock, no I/O.

A robot has one transmitter, and all its team-mates hear the same frame. Frames leave one after
another, each taking exactly 8 * bytes / rate; nothing is saved up, nothing waits. Whether a
team-mate hears a frame is decided at that team-mate, for each directed link by itself.
"""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction

import numpy as np

from comms.profiles import LinkProfile
from comms.timebase import NS


class Verdict(StrEnum):
    """What a link did to a frame."""

    DELIVERED = "delivered"
    LOST = "lost"
    DOWN = "link down"
    FAR = "out of range"


@dataclass(frozen=True)
class Transmission:
    """One frame's time on air."""

    number: int
    """Count of this transmitter's frames, from 0."""
    start_ns: int
    end_ns: int
    charged_bytes: int
    """The frame's own bytes and the modem's overhead."""
    arrivals: tuple[tuple[str, int], ...]
    """(receiver, arrival in ns) of every team-mate, heard or not."""


def airtime_ns(charged_bytes: int, rate_bps: float) -> int:
    """Return 8 * bytes / rate, rounded up to a whole nanosecond; in integers, so exactly that."""
    if math.isinf(rate_bps):
        return 0
    return math.ceil(Fraction(8 * NS * charged_bytes) / Fraction(rate_bps))


class Transmitter:
    """One robot's broadcast transmitter.

    Everybody must be able to follow one and the same frame, so of the links that carry anything
    the slowest sets the rate, the smallest frame the frame's length, and the largest overhead is
    charged. A link that is down holds nobody up.
    """

    def __init__(
        self,
        profiles: Mapping[str, LinkProfile],
        rng: np.random.Generator,
        first_number: int = 0,
    ) -> None:
        """Take the link to each team-mate, in roster order, and the source of jitter.

        `first_number` is not 0 where the robot's radio goes on after a restart.
        """
        self._profiles = dict(profiles)
        self._rng = rng
        self._number = first_number
        self._free_at_ns = 0
        self._last_arrival_ns = dict.fromkeys(self._profiles, 0)

    @property
    def free_at_ns(self) -> int:
        """When the last frame's transmission ends."""
        return self._free_at_ns

    @property
    def frame_bytes(self) -> int:
        """Longest frame, envelope included, that all who can hear take; 0 if nobody can."""
        return min((p.frame_bytes for p in self._carrying()), default=0)

    def can_send(self) -> bool:
        """Say whether any link carries anything."""
        return any(p.carries for p in self._profiles.values())

    def set_profile(self, receiver: str, profile: LinkProfile) -> None:
        """Change a link; a frame that is on air keeps the times that it began with."""
        assert receiver in self._profiles, receiver
        self._profiles[receiver] = profile

    def begin(self, now_ns: int, frame_bytes: int) -> Transmission:
        """Send a frame now, or as soon as the one before has ended.

        Args:
            now_ns: the present.
            frame_bytes: length of the frame, envelope included; at most `self.frame_bytes`.
        """
        assert 0 < frame_bytes <= self.frame_bytes, (frame_bytes, self.frame_bytes)
        carrying = self._carrying()
        charged_bytes = frame_bytes + max(p.overhead_bytes for p in carrying)
        start_ns = max(now_ns, self._free_at_ns)
        end_ns = start_ns + airtime_ns(charged_bytes, min(p.rate_bps for p in carrying))
        self._free_at_ns = end_ns
        arrivals = tuple((name, self._arrival_ns(name, end_ns)) for name in self._profiles)
        number = self._number
        self._number += 1
        return Transmission(number, start_ns, end_ns, charged_bytes, arrivals)

    def _carrying(self) -> list[LinkProfile]:
        return [p for p in self._profiles.values() if p.carries]

    def _arrival_ns(self, receiver: str, end_ns: int) -> int:
        """Draw one arrival; frames of one link never overtake each other.

        One number is drawn per frame and link, needed or not, so that a change of one link's
        settings doesn't shift the luck of the others.
        """
        profile = self._profiles[receiver]
        jitter_ns = math.floor(self._rng.random() * (profile.jitter_ns + 1))
        arrive_ns = end_ns + profile.latency_ns + min(jitter_ns, profile.jitter_ns)
        arrive_ns = max(arrive_ns, self._last_arrival_ns[receiver])
        self._last_arrival_ns[receiver] = arrive_ns
        return arrive_ns


def _beyond(distance_m: float | None, range_m: float | None) -> bool:
    return distance_m is not None and range_m is not None and distance_m > range_m


class _Ear:
    """One directed link as its receiver knows it."""

    def __init__(self, profile: LinkProfile, rng: np.random.Generator) -> None:
        self.profile = profile
        self.up_since_ns = 0
        self._luck = rng.bytes(16)

    def chance(self, number: int, start_ns: int) -> float:
        """Return the number in [0, 1) that decides a frame's loss.

        It depends on the frame alone, and not on what was decided before: a robot that slept
        through a hundred frames has the same luck with the next as one that did not.
        """
        what = b"%d %d" % (number, start_ns)
        draw = hashlib.blake2s(what, key=self._luck, digest_size=8).digest()
        return (int.from_bytes(draw, "little") >> 11) / 2.0**53


class Receiver:
    """What a robot hears of each team-mate's frames."""

    def __init__(
        self,
        profiles: Mapping[str, LinkProfile],
        rngs: Mapping[str, np.random.Generator],
    ) -> None:
        """Take the link from each team-mate, and its source of luck."""
        self._ears = {name: _Ear(profile, rngs[name]) for name, profile in profiles.items()}

    def knows(self, sender: str) -> bool:
        """Say whether there is a link from `sender`."""
        return sender in self._ears

    def set_profile(self, sender: str, profile: LinkProfile, now_ns: int) -> None:
        """Change the link from `sender`, now."""
        ear = self._ears[sender]
        if profile.carries and not ear.profile.carries:
            ear.up_since_ns = now_ns
        ear.profile = profile

    def verdict(
        self, sender: str, number: int, start_ns: int, distance_m: float | None = None
    ) -> Verdict:
        """Decide about a frame at its arrival.

        A link has to be up from the frame's first bit to its arrival. Changes of links and
        verdicts have to be asked for in the order of their instants.

        Args:
            sender: a team-mate that `knows` says yes to.
            number: the sender's count of its frames.
            start_ns: when its transmission began.
            distance_m: how far off the sender is; None: unknown, taken as near.
        """
        ear = self._ears[sender]
        profile = ear.profile
        if not profile.carries or start_ns < ear.up_since_ns:
            return Verdict.DOWN
        if _beyond(distance_m, profile.range_m):
            return Verdict.FAR
        if ear.chance(number, start_ns) < profile.loss:
            return Verdict.LOST
        return Verdict.DELIVERED
