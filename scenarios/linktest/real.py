"""A link test on the wall clock: two processes, a radio in each, Zenoh's loopback between them."""

import asyncio
import contextlib
import signal
import time
from collections.abc import Coroutine, Generator
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from comms.air import Handler, Packet
from comms.timebase import NS, sleep_until_ns
from comms.zenoh_air import Wire, open_client, open_hub
from scenarios.linktest.transfer import (
    HeardFrame,
    LinkTest,
    LinkTestError,
    Listener,
    Talker,
    Trial,
    make_radio,
)
from scenarios.linktest.virtual import faults_of
from sim.clock import ScaledLoop

TEAM_KEY = "team/here/0"
PROBE_KEY = "team/probe/0"
PROBE_S = 0.02
"""Wall seconds between two probes: a put that comes before news of a subscription is lost."""
UP_S = 60.0
"""Wall seconds that the other process has to come up, and to report at the end."""
BEFORE_S = 0.2
"""Wall seconds between the agreement on the clock's zero and zero: both are at rest by then."""
START_NS = 50_000_000
"""When the first frame's transmission begins."""
STRAGGLER_S = 5.0
"""Wall seconds that a frame may be overdue at the end before it counts as not come."""

Report = tuple[list[HeardFrame], dict[str, int]]


def on_real_clock(test: LinkTest) -> Trial:
    """Send the payload in real time; instants are what the computer makes of them.

    Raises:
        LinkTestError: see `LinkTest.check`; or the other process does not come up, or dies.
        comms.zenoh_air.TransportError: Zenoh could not be opened.

    """
    test.check()
    with _hub() as wire, _other_process(test, wire) as (process, pipe):
        _await(process, pipe, wire)
        epoch_s = time.monotonic() + BEFORE_S
        pipe.send(epoch_s)
        talker = _talk(test, wire, epoch_s)
        pipe.send(len(talker.sent))
        heard, dropped = _answer(process, pipe)
    return Trial(test, talker.sent, talker.cut_frames, heard, dropped)


@contextlib.contextmanager
def _hub() -> Generator[Wire]:
    wire = open_hub()
    try:
        yield wire
    finally:
        wire.close()


@contextlib.contextmanager
def _other_process(test: LinkTest, wire: Wire) -> Generator[tuple[BaseProcess, Connection]]:
    """Start the receiving process; it ends when its pipe is closed."""
    # Not forked: a session of Zenoh's does not survive that.
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=listen_main, args=(wire.endpoint, test, theirs), daemon=True)
    process.start()
    theirs.close()
    try:
        yield process, ours
    finally:
        ours.close()
        process.join(2.0)
        if process.is_alive():
            process.kill()
            process.join()


def _await(process: BaseProcess, pipe: Connection, wire: Wire) -> None:
    """Wait until the other process hears what is put here."""
    deadline_s = time.monotonic() + UP_S
    while not pipe.poll(PROBE_S):
        if not process.is_alive() or time.monotonic() > deadline_s:
            raise LinkTestError("the receiving process did not come up")
        wire.put(PROBE_KEY, b"")
    _receive(pipe)


def _answer(process: BaseProcess, pipe: Connection) -> Report:
    if not pipe.poll(UP_S):
        state = "hangs" if process.is_alive() else "died"
        raise LinkTestError(f"the receiving process {state}")
    return _receive(pipe)


def _receive(pipe: Connection) -> Report:
    try:
        return pipe.recv()
    except EOFError:
        raise LinkTestError("the receiving process died") from None


# --- the sending end -------------------------------------------------------------------


class _Putting:
    """The sender's end of the air."""

    def __init__(self, wire: Wire, talker: Talker) -> None:
        self._wire, self._talker = wire, talker
        self.last_arrival_ns = 0

    def put(self, packet: Packet) -> None:
        self._talker.note_put(packet)
        self._wire.put(TEAM_KEY, packet.to_wire())
        self.last_arrival_ns = max(self.last_arrival_ns, *(at for _, at in packet.arrivals))

    def listen(self, handler: Handler) -> None:
        """Hear nothing: the other end does not speak."""


def _talk(test: LinkTest, wire: Wire, epoch_s: float) -> Talker:
    """Say all, and wait until the last of it should be there."""
    talker = Talker(test.payload())
    air = _Putting(wire, talker)

    async def talk() -> None:
        await sleep_until_ns(START_NS)
        running = asyncio.create_task(make_radio(test, air, talker, NS).run())
        finished = asyncio.create_task(talker.finished.wait())
        await asyncio.wait([running, finished], return_when=asyncio.FIRST_COMPLETED)
        if running.done():
            running.result()  # a radio sends for ever, or it broke
        running.cancel()
        await sleep_until_ns(air.last_arrival_ns)

    _run(talk(), epoch_s)
    return talker


def _run(life: Coroutine[None, None, None], epoch_s: float) -> None:
    """Live on the wall clock, whose zero is at monotonic time `epoch_s`."""
    loop = ScaledLoop(1.0)
    loop.begin(epoch_s)
    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(life)


# --- the receiving end -----------------------------------------------------------------


def listen_main(endpoint: str, test: LinkTest, pipe: Connection) -> None:
    """Be the receiving process: hear all, report, and end with the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the sender's to handle
    wire = open_client(endpoint)
    try:
        _listen(wire, test, pipe)
    except (EOFError, OSError):
        return  # the sender is gone: nobody is left to report to
    finally:
        wire.close()


class _Hearing:
    """The receiver's end of the air: hands packets over at their arrival."""

    def __init__(self) -> None:
        self._handler: Handler | None = None
        self.taken = 0
        """Packets that have come, and whose arrival is over."""

    def put(self, packet: Packet) -> None:
        raise AssertionError(f"the receiver sent {packet.number}")

    def listen(self, handler: Handler) -> None:
        self._handler = handler

    def deliver(self, loop: ScaledLoop, packet: Packet) -> None:
        """Post a packet for its arrivals."""
        hear = self._handler
        assert hear is not None
        for _, arrive_ns in packet.arrivals:
            loop.call_at(arrive_ns / NS, hear, packet, arrive_ns)
        last_ns = max(at_ns for _, at_ns in packet.arrivals)
        loop.call_at(last_ns / NS, self._count)

    def _count(self) -> None:
        self.taken += 1


def _listen(wire: Wire, test: LinkTest, pipe: Connection) -> None:
    loop = ScaledLoop(1.0)
    faults = faults_of(loop)
    listener, air = Listener(), _Hearing()
    radio = make_radio(test, air, listener, NS)
    probed: asyncio.Future[None] = loop.create_future()

    def heard(key: str, data: bytes) -> None:
        if key == TEAM_KEY:
            air.deliver(loop, Packet.from_wire(data))
        elif not probed.done():
            probed.set_result(None)

    async def live() -> None:
        begin = asyncio.create_task(_from(pipe))
        await asyncio.wait([probed, begin], return_when=asyncio.FIRST_COMPLETED)
        pipe.send(None)
        loop.begin(await begin)
        put_frames = await _from(pipe)
        deadline_s = loop.time() + STRAGGLER_S
        while air.taken < put_frames and loop.time() < deadline_s and not faults:
            await asyncio.sleep(0.01)

    wire.listen("team/**", heard, loop.call_soon_threadsafe)
    loop.run_until_complete(live())
    loop.close()
    if faults:
        raise faults[0]
    pipe.send((listener.heard, radio.dropped))


async def _from(pipe: Connection) -> Any:
    """Return what the pipe has, when it has something; raise EOFError where it was closed."""
    loop = asyncio.get_running_loop()
    readable: asyncio.Future[None] = loop.create_future()
    loop.add_reader(pipe.fileno(), lambda: readable.done() or readable.set_result(None))
    await readable
    loop.remove_reader(pipe.fileno())
    return pipe.recv()
