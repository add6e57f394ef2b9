"""One robot's process on the wall clock: packets come as they come, and grants carry no time."""

import asyncio
import sys
from collections.abc import Callable
from typing import Protocol

from comms.air import Packet
from comms.zenoh_air import Wire
from scenarios.host import Host
from scenarios.hostradio import Outbox
from scenarios.wire import Grant, Plan, Report
from sim.clock import ScaledLoop

REPORT_S = 0.1
"""Wall seconds between two reports of a robot."""
SWITCH_S = 0.0005
"""A robot that thinks in a thread must not keep its radio waiting: Python's usual 5 ms are much."""


class LivingOutbox(Outbox, Protocol):
    """An outbox that says under which incarnation it sends."""

    life: int


def serve_real(
    plan: Plan,
    wire: Wire,
    outbox: LivingOutbox,
    carried: Callable[[str, bytes], tuple[str, Packet | None]],
) -> Report:
    """Be one robot on the wall clock; return its last report."""
    speed = plan.scenario.clock.speed
    sys.setswitchinterval(SWITCH_S)
    loop = ScaledLoop(speed)
    if plan.epoch_s is not None:
        loop.begin(plan.epoch_s)
    asyncio.set_event_loop(loop)
    host = Host(plan, loop, outbox)
    outbox.life = host.robot.me.incarnation
    own = f"{plan.name}#{outbox.life}"
    begun: asyncio.Future[float] = loop.create_future()
    done: asyncio.Future[None] = loop.create_future()

    def heard(key: str, data: bytes) -> None:
        sender, packet = carried(key, data)
        if sender != own and packet is not None:
            host.air.deliver(loop, packet, plan.start_ns)

    def told(key: str, data: bytes) -> None:
        del key
        grant = Grant.from_wire(data)
        host.take(grant, [])
        for command in grant.commands:
            if command[0] == "begin" and not begun.done():
                begun.set_result(command[1])
            if command[0] == "finish" and not done.done():
                done.set_result(None)

    wire.listen("team/**", heard, loop.call_soon_threadsafe)
    wire.listen(f"world/grant/{plan.name}", told, loop.call_soon_threadsafe)

    def report() -> None:
        wire.put(f"world/report/{plan.name}", host.report().to_wire())

    async def live() -> None:
        report()
        if plan.epoch_s is None:
            await asyncio.wait([begun, done], return_when=asyncio.FIRST_COMPLETED)
            if begun.done():
                loop.begin(begun.result())
        if not done.done():
            host.start()
        while not done.done():
            await asyncio.wait([done], timeout=REPORT_S * speed)
            report()

    loop.run_until_complete(live())
    return host.finish(host.now_ns())
