"""What a link can do to a frame: one small verdict, and the luck that it is drawn with.

Luck depends on the link and the frame alone, never on what was drawn before: a robot that slept
through a hundred frames has the same luck with the next as one that did not, and a change of one
link's settings leaves the luck of all others as it was.
"""

import hashlib
import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np

from comms.bursts import Bursts
from comms.timebase import NS
from comms.traces import Trace, read_trace

TraceEnd = Literal["hold", "loop"]


class Verdict(StrEnum):
    """What became of a frame at one receiver, in a fixed word."""

    DELIVERED = "delivered"
    LOST = "lost"
    DOWN = "link down"
    OUTAGE = "outage"
    FAR = "out of range"
    HIDDEN = "out of sight"
    SENDING = "receiver sending"
    CLASH = "clash"


@dataclass(frozen=True, slots=True)
class Fate:
    """What a link did to a frame: delivered it at these times, or dropped it because."""

    verdict: Verdict
    at_ns: tuple[int, ...] = ()
    """When it is handed over: once, or more often where it was doubled; never if dropped."""
    flipped_bits: tuple[int, ...] = ()
    """Bits of it that arrive wrong, counted from the lowest of its first byte."""


@dataclass(frozen=True)
class Faults:
    """What may go wrong on a directed link beside plain loss and range; at first nothing does."""

    line_of_sight: bool = False
    """Nothing is heard where ground stands between the antennas."""
    burst_ns: int = 0
    """Mean length of a bad spell; 0: there are none."""
    burst_gap_ns: int = 60 * NS
    """Mean length of the good time between two of them."""
    burst_loss: float = 1.0
    """Probability that a frame which meets a bad spell is not heard."""
    outages_ns: tuple[tuple[int, int], ...] = ()
    """Spans of the run in which nothing passes, in order."""
    trace_file: str = ""
    """Path of a recorded trace."""
    trace_end: TraceEnd = "hold"
    half_duplex: bool = False
    """A robot that sends hears nothing meanwhile."""
    bit_errors: float = 0.0
    """Probability of each bit to arrive flipped."""
    duplication: float = 0.0
    """Probability that a frame arrives twice."""
    reordering: float = 0.0
    """Probability that a frame is held back, and overtaken."""
    reordering_ns: int = NS
    """A frame is held back up to this long."""


NO_FAULTS = Faults()


class Luck:
    """Numbers that belong to one directed link and its frames."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Take a key of one's own from `rng`."""
        self._key = rng.bytes(16)

    def _bits(self, what: bytes) -> int:
        draw = hashlib.blake2s(what, key=self._key, digest_size=8).digest()
        return int.from_bytes(draw, "little")

    def chance(self, number: int, start_ns: int, purpose: bytes = b"") -> float:
        """Return a frame's number in [0, 1) for one purpose (b"": its loss)."""
        return (self._bits(b"%s%d %d" % (purpose, number, start_ns)) >> 11) / 2.0**53

    def generator(self, number: int, start_ns: int, purpose: bytes) -> np.random.Generator:
        """Return a source of numbers for one frame, or for all that happens from a time on."""
        return np.random.default_rng(self._bits(b"%s%d %d" % (purpose, number, start_ns)))


def copies_ns(
    faults: Faults, luck: Luck, number: int, start_ns: int, latency_ns: int
) -> tuple[int, ...]:
    """Return how much later than expected a frame arrives: (0,), held back, or twice."""
    held_ns = 0
    if faults.reordering and luck.chance(number, start_ns, b"held") < faults.reordering:
        held_ns = 1 + math.floor(luck.chance(number, start_ns, b"hold") * faults.reordering_ns)
    if faults.duplication and luck.chance(number, start_ns, b"twice") < faults.duplication:
        # Never at the same instant: arrivals of one instant go by sender and number.
        copy_ns = 1 + math.floor(luck.chance(number, start_ns, b"copy") * latency_ns)
        return (held_ns, held_ns + copy_ns)
    return (held_ns,)


def flipped_bits(
    bit_errors: float, luck: Luck, number: int, start_ns: int, frame_bytes: int
) -> tuple[int, ...]:
    """Draw which bits of a frame arrive wrong, each with probability `bit_errors`."""
    if bit_errors == 0.0:
        return ()
    rng = luck.generator(number, start_ns, b"bits")
    wrong = np.flatnonzero(rng.random(8 * frame_bytes) < bit_errors)
    return tuple(wrong.tolist())


def with_flips(data: bytes, bits: tuple[int, ...]) -> bytes:
    """Return a frame with some of its bits flipped."""
    if not bits:
        return data
    harmed = bytearray(data)
    for bit in bits:
        harmed[bit >> 3] ^= 1 << (bit & 7)
    return bytes(harmed)


class Weather:
    """What a link's surroundings do in time: bad spells, outages, a recorded trace."""

    def __init__(
        self, faults: Faults, luck: Luck, since_ns: int = 0, before: "Weather | None" = None
    ) -> None:
        """Begin at `since_ns`, with the state that the long run gives; or go on as `before`.

        Raises:
            TraceError: the trace's file can't be read.

        """
        self._faults = faults
        self._bursts: Bursts | None = None
        if before is not None and before.spells == self.spells:
            self._bursts = before._bursts
        elif faults.burst_ns:
            rng = luck.generator(0, since_ns, b"bursts")
            self._bursts = Bursts(rng, faults.burst_gap_ns, faults.burst_ns, since_ns)
        self._traces: list[Trace] = []
        if faults.outages_ns:
            self._traces.append(Trace.of_outages(faults.outages_ns))
        if faults.trace_file:
            self._traces.append(read_trace(faults.trace_file, loop=faults.trace_end == "loop"))

    @property
    def spells(self) -> tuple[int, int]:
        """Mean lengths of bad and good spells."""
        return (self._faults.burst_ns, self._faults.burst_gap_ns)

    def loss(self, loss: float, start_ns: int, end_ns: int) -> float | None:
        """Return the probability that a frame on air in this span is lost; None: it can't pass.

        A frame that meets a bad spell or an outage at any moment of the span has met it.
        """
        if self._bursts is not None and self._bursts.meets(start_ns, end_ns):
            loss = self._faults.burst_loss
        for trace in self._traces:
            ratio = trace.least(start_ns, end_ns)
            if ratio == 0.0:
                return None
            loss = 1.0 - (1.0 - loss) * ratio
        return loss
