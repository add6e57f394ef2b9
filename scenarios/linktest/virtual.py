"""A link test on the virtual clock: both radios on one loop, every instant exact."""

import asyncio
from typing import Any

from comms.air import Handler, Packet
from comms.timebase import NS
from scenarios.linktest.transfer import (
    MAX_DAYS,
    ROSTER,
    THERE,
    LinkTest,
    Listener,
    Talker,
    Trial,
    make_radio,
)
from sim.clock import VirtualLoop

FOREVER_NS = 2 * MAX_DAYS * 86_400 * NS


class _OneLoop:
    """Both ends of an air on one virtual loop: what is put comes at its arrival."""

    def __init__(self, loop: VirtualLoop, talker: Talker) -> None:
        self._loop = loop
        self._talker = talker
        self._handlers: list[Handler] = []

    def listen(self, handler: Handler) -> None:
        self._handlers.append(handler)

    def put(self, packet: Packet) -> None:
        self._talker.note_put(packet)
        hear = self._handlers[ROSTER.index(THERE)]
        for _, arrive_ns in packet.arrivals:

            def arrive(at_ns: int = arrive_ns) -> None:
                hear(packet, at_ns)

            self._loop.post(arrive_ns, 0, packet.number, arrive, wake=True)


def on_virtual_clock(test: LinkTest) -> Trial:
    """Send the payload on simulated time; every instant is exact.

    Raises:
        LinkTestError: see `LinkTest.check`.

    """
    test.check()
    loop = VirtualLoop(0)
    faults = faults_of(loop)
    talker, listener = Talker(test.payload()), Listener()
    air = _OneLoop(loop, talker)
    radios = [make_radio(test, air, who, 0) for who in (talker, listener)]
    sending = loop.create_task(radios[0].run())
    loop.run_window(FOREVER_NS)
    if sending.done():
        sending.result()  # a radio sends for ever, or it broke
    sending.cancel()
    loop.run_window(FOREVER_NS)
    loop.close()
    if faults:
        raise faults[0]
    return Trial(test, talker.sent, talker.cut_frames, listener.heard, radios[1].dropped)


def faults_of(loop: asyncio.AbstractEventLoop) -> list[BaseException]:
    """Return a list that gets what is raised in a loop's callbacks.

    Asyncio would log it and go on: a fault of ours would look like a lost frame.
    """
    faults: list[BaseException] = []

    def keep(_: object, context: dict[str, Any]) -> None:
        faults.append(context.get("exception") or RuntimeError(context["message"]))

    loop.set_exception_handler(keep)
    return faults
