"""The emulated link: when a frame ends and arrives, and what becomes of it. No clock, no I/O.

A robot has one transmitter, and all its team-mates hear the same frame. Frames leave one after
another, each taking exactly 8 * bytes / rate; nothing is saved up, nothing waits. When copies of it
arrive is settled by the transmitter; whether a team-mate hears it is decided at that team-mate, for
each directed link by itself.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from comms.channel import Medium, Seat, airtime_ns, turn_ns
from comms.ears import Ear, OpenSpace, Passing, Propagation
from comms.faults import NO_FAULTS, Fate, Luck, Verdict, copies_ns, flipped_bits
from comms.linksettings import MIN_FRAME_BYTES
from comms.profiles import LinkProfile
from comms.timebase import NS


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
    """(receiver, arrival in ns) of every team-mate, heard or not; a copy is one more."""
    sensed: tuple[tuple[str, int], ...] = ()
    """On a channel where robots listen first: when each can sense that somebody is on air."""


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
        seat: Seat | None = None,
    ) -> None:
        """Take the link to each team-mate, in roster order, and the source of luck.

        `first_number` is not 0 where the robot's radio goes on after a restart; `seat` is its place
        on a shared channel.
        """
        self._profiles = dict(profiles)
        self._seat = seat or Seat(team=len(profiles) + 1)
        *lots, patience = (Luck(own) for own in rng.spawn(len(self._profiles) + 1))
        self._luck = dict(zip(self._profiles, lots, strict=True))
        self._patience = patience
        self._number = first_number
        self._free_at_ns = 0
        self._last_arrival_ns = dict.fromkeys(self._profiles, 0)
        self._settle()

    def _settle(self) -> None:
        """Work out what all who can hear allow."""
        carrying = [p for p in self._profiles.values() if p.carries]
        self._carries = bool(carrying)
        self._rate_bps = min((p.rate_bps for p in carrying), default=math.inf)
        self._overhead_bytes = max((p.overhead_bytes for p in carrying), default=0)
        self._frame_bytes = min((p.frame_bytes for p in carrying), default=0)
        self._shared = next((p.shared for p in carrying), None)
        least_bytes = MIN_FRAME_BYTES + self._overhead_bytes
        self._least_ns = airtime_ns(least_bytes, self._rate_bps)
        if self._shared is not None and self._shared.kind == "tdma":
            self._frame_bytes = min(self._frame_bytes, self._fitting_bytes(self._shared.slot_ns))

    def _fitting_bytes(self, left_ns: int) -> int:
        """Return how long a frame may be that ends within `left_ns`; 0 where none does."""
        if math.isinf(self._rate_bps):
            return self._frame_bytes
        rate, per_rate = self._rate_bps.as_integer_ratio()
        return max(0, left_ns * rate // (8 * NS * per_rate) - self._overhead_bytes)

    @property
    def free_at_ns(self) -> int:
        """When the last frame's transmission ends."""
        return self._free_at_ns

    @property
    def frame_bytes(self) -> int:
        """Longest frame, envelope included, that all who can hear take; 0 if nobody can."""
        return self._frame_bytes

    @property
    def rate_bps(self) -> float:
        """Bits a second that this robot can send in the long run; its share of a shared channel."""
        shared = self._shared is not None and self._shared.kind != "own"
        return self._rate_bps / self._seat.team if shared else self._rate_bps

    def can_send(self) -> bool:
        """Say whether any link carries anything."""
        return self._carries

    def set_profile(self, receiver: str, profile: LinkProfile) -> None:
        """Change a link; a frame that is on air keeps the times that it began with."""
        assert receiver in self._profiles, receiver
        self._profiles[receiver] = profile
        self._settle()

    def opening_ns(self, since_ns: int, medium: Medium) -> int:
        """Return when this robot may begin a frame that it has waited to begin since `since_ns`.

        On a channel where robots listen first, ask again at that instant: somebody else (who is in
        `medium` then) may have begun.
        """
        shared = self._shared
        if shared is None or shared.kind == "own":
            return since_ns
        if shared.kind == "tdma":
            return turn_ns(self._seat, shared.slot_ns, since_ns, self._least_ns)[0]
        free_ns = medium.free_ns(since_ns, self._seat.sense_ns)
        return free_ns + math.floor(self._patience.chance(0, free_ns) * shared.backoff_ns)

    def room_bytes(self, t_ns: int) -> int:
        """Return how long a frame may be that begins at an opening: at most `frame_bytes`."""
        if self._shared is None or self._shared.kind != "tdma":
            return self._frame_bytes
        end_ns = turn_ns(self._seat, self._shared.slot_ns, t_ns, self._least_ns)[1]
        return min(self._frame_bytes, self._fitting_bytes(end_ns - t_ns))

    def next_turn_ns(self, t_ns: int) -> int | None:
        """Return when there will be room for a longer frame; None: there never is more."""
        if self._shared is None or self.room_bytes(t_ns) == self._frame_bytes:
            return None
        slot_ns = self._shared.slot_ns
        return turn_ns(self._seat, slot_ns, t_ns, slot_ns)[0]

    def begin(self, now_ns: int, frame_bytes: int) -> Transmission:
        """Send a frame now, or as soon as the one before has ended.

        Args:
            now_ns: the present; or the end of the frame before, where this one was waited for.
            frame_bytes: length of the frame, envelope included; at most `self.frame_bytes`.
        """
        assert 0 < frame_bytes <= self.frame_bytes, (frame_bytes, self.frame_bytes)
        charged_bytes = frame_bytes + self._overhead_bytes
        start_ns = max(now_ns, self._free_at_ns)
        end_ns = start_ns + airtime_ns(charged_bytes, self._rate_bps)
        self._free_at_ns = end_ns
        arrivals = tuple(
            (name, arrive_ns)
            for name in self._profiles
            for arrive_ns in self._arrivals_ns(name, start_ns, end_ns)
        )
        number = self._number
        self._number += 1
        sensed = self._sensed(start_ns, end_ns)
        return Transmission(number, start_ns, end_ns, charged_bytes, arrivals, sensed)

    def _sensed(self, start_ns: int, end_ns: int) -> tuple[tuple[str, int], ...]:
        if self._shared is None or self._shared.kind != "csma" or end_ns == start_ns:
            return ()
        sense_ns = self._seat.sense_ns
        assert sense_ns > 0, "a shared channel needs a sensing delay"
        return tuple((name, start_ns + sense_ns) for name in self._profiles)

    def _arrivals_ns(self, receiver: str, start_ns: int, end_ns: int) -> tuple[int, ...]:
        """Return when a frame arrives; but for those held back, none overtakes another."""
        profile, luck = self._profiles[receiver], self._luck[receiver]
        arrive_ns = end_ns + profile.latency_ns
        if profile.jitter_ns:
            chance = luck.chance(self._number, start_ns)
            arrive_ns += min(math.floor(chance * (profile.jitter_ns + 1)), profile.jitter_ns)
        arrive_ns = max(arrive_ns, self._last_arrival_ns[receiver])
        if profile.faults is NO_FAULTS:
            self._last_arrival_ns[receiver] = arrive_ns
            return (arrive_ns,)
        late = copies_ns(profile.faults, luck, self._number, start_ns, profile.latency_ns)
        if late[0] == 0:
            self._last_arrival_ns[receiver] = arrive_ns
        return tuple(arrive_ns + late_ns for late_ns in late)


class Receiver:
    """What a robot hears of each team-mate's frames."""

    def __init__(
        self,
        profiles: Mapping[str, LinkProfile],
        rngs: Mapping[str, np.random.Generator],
        propagation: Propagation | None = None,
        medium: Medium | None = None,
    ) -> None:
        """Take the link from each team-mate and its source of luck, and what is between them.

        Raises:
            TraceError: a link follows a recorded trace, and that can't be read.

        """
        self._ears = {name: Ear(profile, rngs[name]) for name, profile in profiles.items()}
        self._propagation = propagation or OpenSpace()
        self.medium = medium or Medium()
        """Whom this robot knows to be on air."""

    def knows(self, sender: str) -> bool:
        """Say whether there is a link from `sender`."""
        return sender in self._ears

    def set_profile(self, sender: str, profile: LinkProfile, now_ns: int) -> None:
        """Change the link from `sender`, now."""
        self._ears[sender].turn(profile, now_ns)

    def sense(self, sender: str, start_ns: int, end_ns: int, now_ns: int) -> None:
        """Take note that `sender` is on air in a span, if it is a team-mate within reach."""
        ear = self._ears.get(sender)
        if ear is None:
            return
        if ear.profile.carries and self._out_of_reach(ear.profile, sender, now_ns) is None:
            self.medium.senses(sender, start_ns, end_ns)

    def fate(self, passing: Passing) -> Fate:
        """Decide about a frame at its first arrival; its copies share that fate.

        A link has to be up from the frame's first bit to its arrival. Changes of links and
        fates have to be asked for in the order of their instants.
        """
        return self._ears[passing.sender].once(passing, self._decide)

    def _decide(self, ear: Ear, passing: Passing) -> Fate:
        why_not = self._dropped_because(ear, passing)
        if why_not is not None:
            return Fate(why_not)
        number, start_ns = passing.number, passing.start_ns
        flips = flipped_bits(
            ear.profile.faults.bit_errors, ear.luck, number, start_ns, passing.frame_bytes
        )
        return Fate(Verdict.DELIVERED, passing.at_ns, flips)

    def _dropped_because(self, ear: Ear, passing: Passing) -> Verdict | None:
        """Return why a frame is not heard, None if it is; what is plainest first."""
        profile, span = ear.profile, (passing.start_ns, passing.end_ns)
        if not profile.carries or passing.start_ns < ear.up_since_ns:
            return Verdict.DOWN
        loss = ear.loss(*span)
        if loss is None:
            return Verdict.OUTAGE
        away = self._out_of_reach(profile, passing.sender, passing.at_ns[0])
        if away is not None:
            return away
        disturbed = self._disturbed(profile, passing)
        if disturbed is not None:
            return disturbed
        if loss > 0.0 and ear.luck.chance(passing.number, passing.start_ns) < loss:
            return Verdict.LOST
        return None

    def _out_of_reach(self, profile: LinkProfile, sender: str, t_ns: int) -> Verdict | None:
        if profile.range_m is not None:
            distance_m = self._propagation.distance_m(sender, t_ns)
            if distance_m is not None and distance_m > profile.range_m:
                return Verdict.FAR
        if profile.faults.line_of_sight and self._propagation.hides(
            sender, t_ns, profile.antenna_m, profile.mate_antenna_m
        ):
            return Verdict.HIDDEN
        return None

    def _disturbed(self, profile: LinkProfile, passing: Passing) -> Verdict | None:
        """Say whether the receiver was sending itself, or somebody spoke in between."""
        on_one_channel = profile.shared.kind == "csma"
        span = (passing.start_ns, passing.end_ns)
        if (profile.faults.half_duplex or on_one_channel) and self.medium.was_sending(*span):
            return Verdict.SENDING
        if on_one_channel and self.medium.clashes(passing.sender, *span):
            return Verdict.CLASH
        return None
