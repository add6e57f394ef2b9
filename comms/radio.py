"""One robot's radio: the links' rules on the running loop's clock.

The link pulls: when it falls free it asks for the next frame, so what goes out is chosen by what
is known at that moment. Only urgent payloads wait here, one per kind and key, the newest.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from comms.air import Air, Packet
from comms.errors import CommsError
from comms.frames import ENVELOPE_BYTES, URGENT, Frame, FrameError, Kind, Opener, Sealer
from comms.link import Receiver, Transmission, Transmitter, Verdict
from comms.profiles import LinkProfile
from comms.timebase import now_ns, sleep_until_ns
from comms.urgent import UrgentQueue

BURST_FRAMES = 4096
"""Frames that an unlimited link sends at one instant before it waits for `BURST_PAUSE_NS`."""
BURST_PAUSE_NS = 1_000_000


class RadioError(CommsError):
    """The robot chose a payload that doesn't fit the link."""


@dataclass(frozen=True)
class Outgoing:
    """What a robot wants to say next."""

    kind: Kind
    payload: bytes


Choose = Callable[[int, int], Outgoing | None]
"""Asked with (now in ns, payload bytes at most) when the link falls free; None: nothing to say."""


class RadioLog(Protocol):
    """Keeps the record of one robot's frames."""

    def on_tx(
        self,
        *,
        number: int,
        kind: Kind,
        charged_bytes: int,
        chosen_ns: int,
        start_ns: int,
        end_ns: int,
    ) -> None:
        """Note that a frame's transmission begins, and when it will end."""
        ...

    def on_cut(self, number: int) -> None:
        """Note that a frame was cut short: nobody gets it."""
        ...

    def on_rx(self, sender: str, number: int, arrive_ns: int, verdict: str) -> None:
        """Note what became of a frame: a `Verdict`, or a `FrameError`'s reason."""
        ...


@dataclass
class Traffic:
    """What a radio has sent and heard so far."""

    sent_frames: int = 0
    sent_bytes: int = 0
    """Charged: the modem's overhead included, frames that were cut short too."""
    airtime_ns: int = 0
    received_frames: int = 0
    received_bytes: int = 0
    """Frames that were delivered and opened, envelope included."""


def _anywhere(sender: str, t_ns: int) -> None:
    """Stand in for a propagation port: distances are not known."""
    del sender, t_ns


class Radio:
    """The transmitter and the receiver of one robot.

    `dropped` counts what was not taken in, by reason: a `Verdict` or a `FrameError`'s word.
    """

    def __init__(
        self,
        name: str,
        air: Air,
        *,
        sealer: Sealer,
        opener: Opener,
        transmitter: Transmitter,
        receiver: Receiver,
        choose: Choose,
        on_frame: Callable[[Frame, int], None],
        log: RadioLog,
        distance_m: Callable[[str, int], float | None] = _anywhere,
        late_tolerance_ns: int = 0,
    ) -> None:
        """Put a radio together and listen.

        Args:
            name: the robot's.
            air: carries packets to the team-mates.
            sealer: makes this robot's frames.
            opener: checks the team-mates'.
            transmitter: when frames end and arrive.
            receiver: what is heard.
            choose: asked for the next frame; its answer has to fit the bytes that it was told.
            on_frame: gets each good frame with its arrival (ns).
            log: keeps the record.
            distance_m: propagation: how far a sender was at a time (ns); None: not known.
            late_tolerance_ns: how much later than its end a frame may be put on the air; where a
                robot hung for longer, its frame was cut. Above 0 only on a real clock.
        """
        self.name = name
        self.dropped: dict[str, int] = {}
        self.traffic = Traffic()
        self._air = air
        self._sealer = sealer
        self._opener = opener
        self._transmitter = transmitter
        self._receiver = receiver
        self._choose = choose
        self._on_frame = on_frame
        self._log = log
        self._distance_m = distance_m
        self._late_tolerance_ns = late_tolerance_ns
        self._urgent = UrgentQueue()
        self._kicked = asyncio.Event()
        air.listen(self._hear)

    @property
    def payload_bytes(self) -> int:
        """Longest payload that the next frame can hold; 0 while no link carries anything."""
        return max(0, self._transmitter.frame_bytes - ENVELOPE_BYTES)

    @property
    def next_seq(self) -> int:
        """The number that the next frame will bear."""
        return self._sealer.next_seq

    def kick(self) -> None:
        """Say that there may be something to send."""
        self._kicked.set()

    def set_link(
        self, sender: str, receiver: str, profile: LinkProfile, at_ns: int | None = None
    ) -> None:
        """Change a directed link from `at_ns` (or now) on, if it is one of this robot's."""
        if sender == self.name:
            self._transmitter.set_profile(receiver, profile)
            self.kick()
        elif receiver == self.name:
            self._receiver.set_profile(sender, profile, now_ns() if at_ns is None else at_ns)

    def send_urgent(
        self, kind: Kind, payload: bytes, key: str, until_ns: int | None = None
    ) -> None:
        """Send a payload before all others, as soon as the frame that is on air has ended.

        See `UrgentQueue.put` for what it takes, replaces and refuses.
        """
        self._urgent.put(kind, payload, key, until_ns)
        self.kick()

    async def run(self) -> None:
        """Send for ever: whenever the link is free, whatever is worth most at that moment."""
        burst_ns, burst_frames = -1, 0
        while True:
            self._kicked.clear()
            t_ns = now_ns()
            outgoing = self._next(t_ns)
            if outgoing is None:
                await self._kicked.wait()
                continue
            burst_ns, burst_frames = t_ns, burst_frames + 1 if t_ns == burst_ns else 1
            await self._send(outgoing, t_ns)
            if burst_frames >= BURST_FRAMES:
                await sleep_until_ns(t_ns + BURST_PAUSE_NS)

    def _next(self, t_ns: int) -> Outgoing | None:
        """Return what goes out next, if anything may and wants to."""
        room_bytes = self.payload_bytes
        if room_bytes == 0:
            return None
        outgoing = self._next_urgent(t_ns) or self._choose(t_ns, room_bytes)
        if outgoing is not None and len(outgoing.payload) > room_bytes:
            raise RadioError(
                f"{outgoing.kind.name} payload has {len(outgoing.payload)} bytes; "
                f"the link takes {room_bytes}"
            )
        return outgoing

    def _next_urgent(self, t_ns: int) -> Outgoing | None:
        taken = self._urgent.take(t_ns)
        return None if taken is None else Outgoing(*taken)

    async def _send(self, outgoing: Outgoing, chosen_ns: int) -> None:
        """Occupy the link for a frame's time, and put it on the air at its end."""
        data = self._sealer.seal(outgoing.kind, outgoing.payload)
        sent = self._transmitter.begin(chosen_ns, len(data))
        self._note_tx(outgoing.kind, chosen_ns, sent)
        await sleep_until_ns(sent.end_ns)
        if now_ns() > sent.end_ns + self._late_tolerance_ns:
            self._log.on_cut(sent.number)
            return
        urgent = outgoing.kind in URGENT
        packet = Packet(
            self.name, sent.number, sent.start_ns, sent.end_ns, sent.arrivals, urgent, data
        )
        self._air.put(packet)

    def _note_tx(self, kind: Kind, chosen_ns: int, sent: Transmission) -> None:
        self.traffic.sent_frames += 1
        self.traffic.sent_bytes += sent.charged_bytes
        self.traffic.airtime_ns += sent.end_ns - sent.start_ns
        self._log.on_tx(
            number=sent.number,
            kind=kind,
            charged_bytes=sent.charged_bytes,
            chosen_ns=chosen_ns,
            start_ns=sent.start_ns,
            end_ns=sent.end_ns,
        )

    def _hear(self, packet: Packet, arrive_ns: int) -> None:
        """Take what the link delivers, if it is a team-mate's frame."""
        frame, word = self._judged(packet, arrive_ns)
        self._log.on_rx(packet.sender, packet.number, arrive_ns, word)
        if frame is None:
            self.dropped[word] = self.dropped.get(word, 0) + 1
            return
        self.traffic.received_frames += 1
        self.traffic.received_bytes += len(packet.data)
        self._on_frame(frame, arrive_ns)

    def _judged(self, packet: Packet, arrive_ns: int) -> tuple[Frame | None, str]:
        if not self._receiver.knows(packet.sender):
            return None, "stranger"
        distance_m = self._distance_m(packet.sender, arrive_ns)
        verdict = self._receiver.verdict(packet.sender, packet.number, packet.start_ns, distance_m)
        if verdict is not Verdict.DELIVERED:
            return None, verdict.value
        try:
            return self._opener.open(packet.data), verdict.value
        except FrameError as error:
            return None, error.reason
