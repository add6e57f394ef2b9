"""A small air inside one process, to test radios with; runs have `scenarios.crews.crew`."""

import asyncio
import heapq
from collections.abc import Callable, Sequence
from functools import partial
from itertools import count
from typing import Protocol

from comms.air import Handler, Packet
from comms.timebase import to_s


class Post(Protocol):
    """A receiving loop's way to have something done at a time.

    Of calls at one instant, the lower source index goes first, then the lower number. `wake` says
    whether the loop has to act at that instant, or may take it when it next does.
    """

    def __call__(
        self,
        arrive_ns: int,
        source_index: int,
        number: int,
        callback: Callable[[], None],
        wake: bool,
    ) -> None:
        """Have `callback` called at `arrive_ns`."""
        ...


def post_on(loop: asyncio.AbstractEventLoop) -> Post:
    """Return the posting function of an ordinary loop.

    Asyncio orders timers by their time alone, so the order of ties is kept here.
    """
    waiting: list[tuple[int, int, int, int, Callable[[], None]]] = []
    arrival_order = count()

    def call_due(due_ns: int) -> None:
        while waiting and waiting[0][0] <= due_ns:
            heapq.heappop(waiting)[-1]()

    def post(
        arrive_ns: int, source_index: int, number: int, callback: Callable[[], None], wake: bool
    ) -> None:
        del wake  # an ordinary loop acts on every timer
        entry = (arrive_ns, source_index, number, next(arrival_order), callback)
        heapq.heappush(waiting, entry)
        loop.call_at(to_s(arrive_ns), call_due, arrive_ns)

    return post


class Endpoint:
    """One robot's end of a `MemoryAir`."""

    def __init__(self, hub: "MemoryAir", post: Post) -> None:
        """Made by `MemoryAir.endpoint`."""
        self._hub = hub
        self._post = post
        self._handler: Handler | None = None
        self._open = True

    def put(self, packet: Packet) -> None:
        """Send a packet to its receivers."""
        self._hub.carry(packet)

    def listen(self, handler: Handler) -> None:
        """Have every packet that comes from now on handed to `handler`."""
        self._handler = handler

    def close(self) -> None:
        """Hear nothing more; what is under way is dropped."""
        self._open = False

    def expect(self, packet: Packet, source_index: int, arrive_ns: int) -> None:
        """Have a packet handed over at its arrival."""
        self._post(
            arrive_ns,
            source_index,
            packet.number,
            partial(self._hand_over, packet, arrive_ns),
            packet.urgent,
        )

    def _hand_over(self, packet: Packet, arrive_ns: int) -> None:
        if self._open and self._handler is not None:
            self._handler(packet, arrive_ns)


class MemoryAir:
    """Joins the robots of one process."""

    def __init__(self, roster: Sequence[str]) -> None:
        """Take the names of the team, in roster order."""
        self._index = {name: index for index, name in enumerate(roster)}
        self._endpoints: dict[str, Endpoint] = {}

    def endpoint(self, name: str, post: Post) -> Endpoint:
        """Return a robot's end of the air; one that it had before is closed."""
        assert name in self._index, name
        self.remove(name)
        self._endpoints[name] = Endpoint(self, post)
        return self._endpoints[name]

    def remove(self, name: str) -> None:
        """Take a robot off the air: it hears nothing more, not even what is under way."""
        endpoint = self._endpoints.pop(name, None)
        if endpoint is not None:
            endpoint.close()

    def carry(self, packet: Packet) -> None:
        """Bring a packet to all its receivers that are on the air now."""
        source_index = self._index[packet.sender]
        for receiver, arrive_ns in packet.arrivals:
            endpoint = self._endpoints.get(receiver)
            if endpoint is not None:
                endpoint.expect(packet, source_index, arrive_ns)
