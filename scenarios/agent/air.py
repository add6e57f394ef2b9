"""A robot's own end of the air: packets over a router that may come late, be cut off, and be back.

Nothing here waits for the network: what can't be sent now is lost, as it would be on a radio, and
the team's repair sends it again.
"""

import asyncio
from collections.abc import Callable
from dataclasses import replace

from comms.air import Handler, Packet
from comms.timebase import now_ns, to_s
from comms.zenoh_air import TransportError, Wire
from scenarios.crews.robotprocess import carried

LATEST_NS = 2_000_000_000
"""Clocks of a team agree to this: a packet that says to be from further off is from now."""
TRY_AGAIN_S = 2.0
"""Pause between two tries to reach the router."""


class AgentAir:
    """Joins the team plane as soon as, and as long as, the router can be reached."""

    def __init__(self, name: str, life: int, tell: Callable[[str, str], None]) -> None:
        """Send as a robot's incarnation; `tell` is told (what, detail) of the network."""
        self._name, self._life, self._tell = name, life, tell
        self._handler: Handler | None = None
        self._wire: Wire | None = None
        self.heard_s: dict[str, float] = {}
        """When each team-mate was last heard."""

    def put(self, packet: Packet) -> None:
        """Send a packet, if there is a way."""
        if self._wire is not None:
            self._wire.put(f"team/{self._name}/{self._life}", packet.to_wire(), may_drop=True)

    def listen(self, handler: Handler) -> None:
        """Have packets handed to the radio."""
        self._handler = handler

    async def join(self, connect: Callable[[], Wire]) -> None:
        """Reach the router, however often it takes; afterwards the session finds back by itself."""
        loop = asyncio.get_running_loop()
        told = False
        while self._wire is None:
            try:
                wire = await asyncio.to_thread(connect)
            except TransportError as error:
                if not told:
                    self._tell("network", f"{error}; it goes on alone, and tries again")
                    told = True
                await asyncio.sleep(TRY_AGAIN_S)
                continue
            wire.listen("team/**", self._heard, loop.call_soon_threadsafe)
            self._wire = wire
            self._tell("network", f"joined at {wire.endpoint}")

    def close(self) -> None:
        """Leave the network."""
        if self._wire is not None:
            self._wire.close()
            self._wire = None

    def _heard(self, key: str, data: bytes) -> None:
        parts = key.split("/")
        if len(parts) != 3 or parts[1] == self._name:
            return
        _, packet = carried(key, data)
        if packet is None or self._handler is None:
            return
        packet, due_ns = on_time(packet, self._name, now_ns())
        self.heard_s[packet.sender] = to_s(due_ns)
        asyncio.get_running_loop().call_at(to_s(due_ns), self._handler, packet, due_ns)


def on_time(packet: Packet, me: str, here_ns: int) -> tuple[Packet, int]:
    """Return a packet by this robot's clock, and when it arrives: as it says, or now.

    What it says counts only as far as the clocks may differ: it is not played later, nor taken for
    older, than that.
    """
    said = [t_ns for name, t_ns in packet.arrivals if name == me]
    if said and 0 <= said[0] - here_ns <= LATEST_NS:
        return packet, said[0]
    shift_ns = here_ns - (said[0] if said else packet.end_ns)
    moved = replace(
        packet,
        start_ns=packet.start_ns + shift_ns,
        end_ns=packet.end_ns + shift_ns,
        arrivals=((me, here_ns),),
    )
    return moved, here_ns
