"""One robot's radio: the links' rules on the running loop's clock.

The link pulls: when it falls free it asks for the next frame, so what goes out is chosen by what
is known at that moment. Only urgent payloads wait here, one per kind and key, the newest.
"""

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import dataclass

from comms.air import Air, Packet
from comms.ears import Passing
from comms.errors import CommsError
from comms.faults import Verdict, with_flips
from comms.frames import URGENT, Frame, FrameError, Kind, Opener, Sealer
from comms.link import Receiver, Transmission, Transmitter
from comms.profiles import LinkProfile
from comms.timebase import now_ns, sleep_until_ns, to_s
from comms.traffic import RadioLog, Traffic
from comms.urgent import UrgentQueue

BURST_FRAMES = 4096
"""Frames that an unlimited link sends at one instant before it waits for `BURST_PAUSE_NS`."""
BURST_PAUSE_NS = 1_000_000


CARRIER = -1
"""A packet numbered this less n is no frame: it is what others sense of frame n while it lasts."""


class RadioError(CommsError):
    """The robot chose a payload that doesn't fit the link."""


@dataclass(frozen=True)
class Outgoing:
    """What a robot wants to say next."""

    kind: Kind
    payload: bytes


Choose = Callable[[int, int], Outgoing | None]
"""Asked with (now in ns, payload bytes at most) when the link falls free; None: nothing to say."""


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
            late_tolerance_ns: how late a robot may wake for the end of its frame: the frame is put
                on the air then, and the next begins where it ended. Where it hung for longer, its
                frame was cut. Above 0 only on a real clock, where every timer is a little late.
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
        self._late_tolerance_ns = late_tolerance_ns
        self._urgent = UrgentQueue()
        self._kicked = asyncio.Event()
        air.listen(self._hear)

    @property
    def payload_bytes(self) -> int:
        """Longest payload that the next frame can hold; 0 while no link carries anything."""
        return max(0, self._transmitter.frame_bytes - self._sealer.envelope_bytes)

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
        freed_ns = None
        while True:
            self._kicked.clear()
            t_ns = await self._turn_ns(freed_ns)
            outgoing = self._next(t_ns)
            if outgoing is None:
                await self._something_new(t_ns)
                freed_ns = None
                continue
            burst_ns, burst_frames = t_ns, burst_frames + 1 if t_ns == burst_ns else 1
            freed_ns = await self._send(outgoing, t_ns)
            if burst_frames >= BURST_FRAMES:
                await sleep_until_ns(t_ns + BURST_PAUSE_NS)

    async def _turn_ns(self, freed_ns: int | None) -> int:
        """Wait until the channel is this robot's, and return since when it is.

        On a channel of its own it is at once. That may be a moment ago, where a wall clock let the
        robot wake late for the end of its last frame (`freed_ns`): else those moments would add up.
        """
        since_ns = now_ns() if freed_ns is None else freed_ns
        while True:
            opening_ns = self._transmitter.opening_ns(since_ns, self._receiver.medium)
            late_ns = now_ns() - opening_ns
            if 0 <= late_ns <= self._late_tolerance_ns:
                return opening_ns
            if late_ns < 0:
                await sleep_until_ns(opening_ns)
            else:
                since_ns = now_ns()

    async def _something_new(self, t_ns: int) -> None:
        """Wait for a kick; or, where what is left of a turn was too short, for the next turn."""
        next_ns = self._transmitter.next_turn_ns(t_ns)
        if next_ns is None:
            await self._kicked.wait()
            return
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout_at(to_s(next_ns)):
                await self._kicked.wait()

    def _next(self, t_ns: int) -> Outgoing | None:
        """Return what goes out next, if anything may and wants to."""
        room_bytes = max(0, self._transmitter.room_bytes(t_ns) - self._sealer.envelope_bytes)
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

    async def _send(self, outgoing: Outgoing, chosen_ns: int) -> int | None:
        """Occupy the link for a frame's time, and put it on the air at its end.

        Returns that end; None where the frame was cut, or took no time.
        """
        data = self._sealer.seal(outgoing.kind, outgoing.payload)
        sent = self._transmitter.begin(chosen_ns, len(data))
        self._note_tx(outgoing.kind, chosen_ns, sent)
        if sent.sensed:
            self._air.put(self._packet(sent, CARRIER - sent.number, sent.sensed))
        await sleep_until_ns(sent.end_ns)
        if now_ns() > sent.end_ns + self._late_tolerance_ns:
            self._log.on_cut(sent.number)
            return None
        urgent = outgoing.kind in URGENT
        self._air.put(self._packet(sent, sent.number, sent.arrivals, urgent, data))
        return sent.end_ns if sent.end_ns > sent.start_ns else None

    def _packet(
        self,
        sent: Transmission,
        number: int,
        arrivals: tuple[tuple[str, int], ...],
        urgent: bool = False,
        data: bytes = b"",
    ) -> Packet:
        return Packet(self.name, number, sent.start_ns, sent.end_ns, arrivals, urgent, data)

    def _note_tx(self, kind: Kind, chosen_ns: int, sent: Transmission) -> None:
        self.traffic.sent_frames += 1
        self.traffic.sent_bytes += sent.charged_bytes
        self.traffic.airtime_ns += sent.end_ns - sent.start_ns
        self._receiver.medium.sends(sent.start_ns, sent.end_ns)
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
        if packet.number <= CARRIER:
            self._receiver.sense(packet.sender, packet.start_ns, packet.end_ns, arrive_ns)
            return
        judged = self._judged(packet, arrive_ns)
        if judged is None:
            return
        frame, word = judged
        self._log.on_rx(packet.sender, packet.number, arrive_ns, word)
        if frame is None:
            self.dropped[word] = self.dropped.get(word, 0) + 1
            return
        self.traffic.received_frames += 1
        self.traffic.received_bytes += len(packet.data)
        self._on_frame(frame, arrive_ns)

    def _judged(self, packet: Packet, arrive_ns: int) -> tuple[Frame | None, str] | None:
        """Return the frame, if it is one, and a word; None for a copy that tells nothing new."""
        if not self._receiver.knows(packet.sender):
            return None, "stranger"
        here_ns = tuple(t_ns for name, t_ns in packet.arrivals if name == self.name)
        at_ns = here_ns or (arrive_ns,)
        span, size = (packet.start_ns, packet.end_ns), len(packet.data)
        fate = self._receiver.fate(Passing(packet.sender, packet.number, *span, at_ns, size))
        whole = fate.verdict is Verdict.DELIVERED and not fate.flipped_bits
        if arrive_ns > at_ns[0] and not whole:
            return None  # it was told of when the first came
        if fate.verdict is not Verdict.DELIVERED:
            return None, fate.verdict.value
        try:
            return self._opener.open(with_flips(packet.data, fate.flipped_bits)), fate.verdict.value
        except FrameError as error:
            return None, error.reason
