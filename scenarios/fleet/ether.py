"""The air of a fleet: a packet goes to whoever is within radio range when its last bit is sent."""

import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

from agents.geometry import Pose
from comms.air import Handler, Packet
from comms.ears import Passing
from comms.faults import Fate, Verdict
from comms.link import Receiver
from sim.clock import VirtualLoop


class NearReceiver(Receiver):
    """Hears all that the air brings: who is in range was decided there."""

    def __init__(self) -> None:
        """Know of no link: all are alike."""
        super().__init__({}, {})

    def knows(self, sender: str) -> bool:
        """Know everybody."""
        del sender
        return True

    def fate(self, passing: Passing) -> Fate:
        """Take every frame."""
        del passing
        return Fate(Verdict.DELIVERED)


class Ether:
    """All airs of a fleet: brings a packet to whoever is in range."""

    def __init__(self, loop: VirtualLoop, radio_m: float, pose_now: Callable[[str], Pose]) -> None:
        """Carry packets on a loop so far; `pose_now(name)` is where a robot truly is."""
        self._loop = loop
        self._radio_m = radio_m
        self._pose_now = pose_now
        self._handlers: dict[str, Handler] = {}
        self._squares: dict[tuple[int, int], list[str]] = defaultdict(list)
        self._square_of: dict[str, tuple[int, int]] = {}

    def listen(self, name: str, handler: Handler) -> None:
        """Have a handler called with what reaches a robot."""
        self._handlers[name] = handler

    def stands(self, name: str, pose: Pose) -> None:
        """Note where a robot is."""
        side_m = self._radio_m
        square = (math.floor(pose.x_m / side_m), math.floor(pose.y_m / side_m))
        before = self._square_of.get(name)
        if before != square:
            if before is not None:
                self._squares[before].remove(name)
            self._squares[square].append(name)
            self._square_of[name] = square

    def put(self, sender: str, number: int, packet: Packet) -> None:
        """Bring a packet of a robot, by name and number in the fleet, to who is in range."""
        here = self._pose_now(sender)
        row, col = self._square_of[sender]
        near = [
            name
            for r in (row - 1, row, row + 1)
            for c in (col - 1, col, col + 1)
            for name in self._squares[r, c]
        ]
        arrive_ns = packet.arrivals[0][1]
        reach_m = self._radio_m
        hearing = [
            self._handlers[name]
            for name in sorted(near)
            if name != sender and self._pose_now(name).distance_m(here) <= reach_m
        ]

        def arrive() -> None:
            for handler in hearing:
                handler(packet, arrive_ns)

        self._loop.post(arrive_ns, number, packet.number, arrive, True)


@dataclass
class End:
    """One robot's end of the ether."""

    ether: Ether
    name: str
    number: int

    def put(self, packet: Packet) -> None:
        """Send."""
        self.ether.put(self.name, self.number, packet)

    def listen(self, handler: Handler) -> None:
        """Hear."""
        self.ether.listen(self.name, handler)
