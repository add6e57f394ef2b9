"""A payload sent over the emulated link for real, and what came of it.

Nothing is computed from the settings that can be measured: two radios as robots have them seal,
send, judge and open every frame, on one virtual loop (`linktest.virtual`) or in two processes
on the wall clock (`linktest.real`). What should have come out is computed apart from them.
"""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from comms.air import Air, Packet
from comms.channel import Seat, airtime_ns
from comms.errors import CommsError
from comms.frames import ENVELOPE_BYTES, Frame, Kind, Opener, Sealer
from comms.link import Receiver, Transmitter
from comms.profiles import LinkProfile
from comms.radio import CARRIER, Outgoing, Radio
from comms.timebase import NS, now_ns
from scenarios.errors import StudyError

ROSTER = ("here", "there")
HERE, THERE = ROSTER
MAX_BYTES = 10_000_000
MAX_DAYS = 30
"""A loop's time is exact to the nanosecond for 50 days."""


class LinkTestError(StudyError):
    """A link test that can't be made, or that broke down."""


@dataclass(frozen=True)
class LinkTest:
    """What is to be sent over which link."""

    profile: LinkProfile
    payload_bytes: int
    seed: int = 1

    def check(self) -> None:
        """Raise LinkTestError where the link or the payload allows no test."""
        if not 1 <= self.payload_bytes <= MAX_BYTES:
            raise LinkTestError(f"--bytes is {self.payload_bytes}; 1 to {MAX_BYTES} are allowed")
        if not 0 <= self.seed < 2**63:
            raise LinkTestError(f"--seed is {self.seed}; 0 to {2**63 - 1} are allowed")
        if not self.profile.carries:
            raise LinkTestError(
                f"the link carries nothing (rate {self.profile.rate_bps:g} bps, "
                f"up = {str(self.profile.up).lower()}); a rate of at least 1 bps is needed, and up"
            )
        try:
            self.receiver(HERE)
        except CommsError as error:  # a recorded trace can't be read
            raise LinkTestError(str(error)) from error
        days = self.about_s() / 86_400
        if days > MAX_DAYS:
            raise LinkTestError(
                f"--bytes {self.payload_bytes} would take {days:.0f} days at "
                f"{self.profile.rate_bps:g} bps; at most {MAX_DAYS} are allowed"
            )

    def about_s(self) -> float:
        """Return about how long sending takes, in the link's own time."""
        room_bytes = self.profile.frame_bytes - ENVELOPE_BYTES
        charged = self.profile.frame_bytes + self.profile.overhead_bytes
        frames = -(-self.payload_bytes // room_bytes)
        return airtime_ns(frames * charged, self.profile.rate_bps) / NS

    def payload(self) -> bytes:
        """Return the bytes to send; noise, so that nothing could be guessed."""
        return np.random.default_rng((self.seed, 0)).bytes(self.payload_bytes)

    def receiver(self, sender: str) -> Receiver:
        """Return what decides about a sender's frames."""
        return Receiver({sender: self.profile}, {sender: self.rng(2)})

    def rng(self, purpose: int) -> np.random.Generator:
        """Return a source of luck; purpose 1: the transmitter, 2: the receiver."""
        return np.random.default_rng((self.seed, purpose))


@dataclass(frozen=True)
class SentFrame:
    """A frame as its sender knows it."""

    number: int
    payload_at: int
    """Where in the payload its piece begins."""
    piece_bytes: int
    frame_bytes: int
    """Envelope and piece."""
    charged_bytes: int
    start_ns: int
    put_ns: int
    """The clock's time when it was put on the air: the end of its transmission, if all is well."""


@dataclass(frozen=True)
class HeardFrame:
    """A frame that was delivered and opened."""

    number: int
    payload: bytes
    arrive_ns: int
    """As the link has it."""
    heard_ns: int
    """The clock's time when it was handed over."""


@dataclass(frozen=True)
class Trial:
    """One test, all over."""

    test: LinkTest
    sent: Sequence[SentFrame]
    """All that were put on the air; more than none."""
    cut_frames: int
    """Frames that were cut short because the sender hung over their end."""
    heard: Sequence[HeardFrame]
    """Each frame once, by number."""
    dropped: dict[str, int] = field(default_factory=dict[str, int])
    """What the receiver did not take in, by reason."""


class Talker:
    """Gives its radio a payload, piece by piece, and notes what became of the frames."""

    def __init__(self, payload: bytes) -> None:
        """Take what is to be said."""
        self._payload = payload
        self._at = 0
        self._piece = (0, 0)
        self._begun: dict[int, tuple[tuple[int, int], int, int]] = {}
        self.sent: list[SentFrame] = []
        self.cut_frames = 0
        self.finished = asyncio.Event()
        """All has been put on the air."""

    def choose(self, t_ns: int, room_bytes: int) -> Outgoing | None:
        """Return the next piece; the radio asks when the one before has left."""
        del t_ns
        piece = self._payload[self._at : self._at + room_bytes]
        if not piece:
            self.finished.set()
            return None
        self._piece = (self._at, len(piece))
        self._at += len(piece)
        return Outgoing(Kind.MAP, piece)

    def note_put(self, packet: Packet) -> None:
        """Note that a frame (or the mere sign of one) is put on the air now."""
        if packet.number <= CARRIER:
            return
        piece, start_ns, charged_bytes = self._begun.pop(packet.number)
        in_frame = len(packet.data)
        self.sent.append(
            SentFrame(packet.number, *piece, in_frame, charged_bytes, start_ns, now_ns())
        )

    def on_tx(self, *, number: int, charged_bytes: int, start_ns: int, **_: object) -> None:
        """Note that a transmission begins."""
        self._begun[number] = (self._piece, start_ns, charged_bytes)

    def on_cut(self, number: int) -> None:
        """Count a frame that was cut short."""
        self._begun.pop(number)
        self.cut_frames += 1

    def on_rx(self, sender: str, number: int, arrive_ns: int, verdict: str) -> None:
        """Nothing comes here."""


class Listener:
    """Keeps what its radio hears."""

    def __init__(self) -> None:
        """Start without any."""
        self.heard: list[HeardFrame] = []

    def choose(self, t_ns: int, room_bytes: int) -> None:
        """Say nothing."""
        del t_ns, room_bytes

    def on_frame(self, frame: Frame, arrive_ns: int) -> None:
        """Keep a frame; each comes once, its number is the sender's count."""
        self.heard.append(HeardFrame(frame.seq, frame.payload, arrive_ns, now_ns()))

    def on_tx(self, **_: object) -> None:
        """Nothing is sent from here."""

    def on_cut(self, number: int) -> None:
        """Nothing is sent from here."""

    def on_rx(self, sender: str, number: int, arrive_ns: int, verdict: str) -> None:
        """Leave the counts to the radio."""


def make_radio(test: LinkTest, air: Air, who: Talker | Listener, late_tolerance_ns: int) -> Radio:
    """Return one end's radio, made as a robot's is."""
    here = isinstance(who, Talker)
    name, other = ROSTER if here else ROSTER[::-1]
    key = np.random.default_rng((test.seed, 3)).bytes(32)
    seat = Seat(ROSTER.index(name), len(ROSTER), test.profile.latency_ns)
    return Radio(
        name,
        air,
        sealer=Sealer(key, ROSTER.index(name), 0),
        opener=Opener(key, len(ROSTER), ROSTER.index(name)),
        transmitter=Transmitter({other: test.profile}, test.rng(1), seat=seat),
        receiver=test.receiver(other),
        choose=who.choose,
        on_frame=_ignore if here else who.on_frame,
        log=who,
        late_tolerance_ns=late_tolerance_ns,
    )


def _ignore(frame: Frame, arrive_ns: int) -> None:
    """Stand where nothing is heard."""
    del frame, arrive_ns
