"""What one robot's process does: joins the router, takes grants, runs windows, gives reports."""

import contextlib
import ctypes
import os
import resource
import signal
from multiprocessing import forkserver
from pathlib import Path
from typing import Any, cast

from agents.recall import RECALL
from comms.air import Packet, PacketError
from comms.zenoh_air import Channel, Wire, open_client
from comms.zenoh_security import Credentials
from scenarios.crews.crew import Inbox, cpu_s
from scenarios.crews.realserve import serve_real
from scenarios.host import Host
from scenarios.wire import Grant, Plan, Report
from sim.clock import VirtualLoop

PR_SET_PDEATHSIG = 1
M_ARENA_MAX = -8
"""One heap for all threads: those of Zenoh keep little, and each its own heap of its own."""


def robot_main(plan: Plan, credentials: Credentials | None = None) -> None:
    """Be one robot's process: take grants, run windows, give reports."""
    prepare_process()
    RECALL.share(plan.pictures)
    wire = open_client(plan.endpoint, credentials=credentials)
    try:
        _serve(plan, wire)
    finally:
        wire.close()


def prepare_process() -> None:
    """Leave Ctrl-C to the runner, and die when it does: no orphan is left behind."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(AttributeError):  # another C library than GNU's
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
    with contextlib.suppress(OSError):  # where the kernel has no such thing
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    # The fork server, whose death that signal tells, lives on while anybody holds this end of its
    # pipe; every process that it forks gets one, and so would keep itself alive.
    server = cast("Any", forkserver)._forkserver  # there is no public name for it
    if server._forkserver_alive_fd is not None:
        os.close(server._forkserver_alive_fd)
        server._forkserver_alive_fd = None


class OnZenoh:
    """Carries a host's packets over Zenoh."""

    def __init__(self, wire: Wire, name: str) -> None:
        """Send as the robot of this name; its incarnation is known once it lives."""
        self._wire, self._name = wire, name
        self.life = 0

    def put(self, packet: Packet) -> None:
        """Put a packet on the team plane."""
        self._wire.put(f"team/{self._name}/{self.life}", packet.to_wire())


def sender_of(key: str) -> str:
    """Return who sent a packet (name#incarnation), by its key."""
    _, name, life = key.split("/")
    return f"{name}#{life}"


def carried(key: str, data: bytes) -> tuple[str, Packet | None]:
    """Return who put a packet on the air, by its key, and the packet, if it is one of that robot's.

    The hub lets each robot put under its own name only: a packet that names another is a lie.
    """
    sender = sender_of(key)
    try:
        packet = Packet.from_wire(data)
    except PacketError:
        return sender, None
    return sender, packet if packet.sender == sender.partition("#")[0] else None


def _serve(plan: Plan, wire: Wire) -> None:
    if plan.scenario.clock.mode == "real":
        _last_words(wire, serve_real(plan, wire, OnZenoh(wire, plan.name), carried))
        return
    grants = wire.channel(f"world/grant/{plan.name}")
    air = wire.channel("team/**")
    loop = VirtualLoop(list(plan.scenario.robots).index(plan.name), plan.start_ns)
    inbox = Inbox(plan.baseline)
    outbox = OnZenoh(wire, plan.name)
    host = Host(plan, loop, outbox)
    outbox.life = host.robot.me.incarnation
    own = f"{plan.name}#{outbox.life}"
    host.start()
    _tell(wire, host.report())
    while True:
        grant = Grant.from_wire(grants.wait()[1])
        _listen(air, inbox, own, grant.counts)
        looks = host.robot.looks
        report = host.run_window(grant, inbox.take(grant.counts))
        if host.robot.looks != looks or report.final is not None:
            give_back()
        if report.final is not None:
            report.final["cost"] = (cpu_s(), peak_bytes(), unique_bytes())
        _tell(wire, report)
        if report.final is not None:
            host.bury()
            return


def _last_words(wire: Wire, report: Report) -> None:
    assert report.final is not None
    report.final["cost"] = (cpu_s(), peak_bytes(), unique_bytes())
    _tell(wire, report)


def _tell(wire: Wire, report: Report) -> None:
    wire.put(f"world/report/{report.name}", report.to_wire())


def _listen(air: Channel, inbox: Inbox, own: str, counts: dict[str, int]) -> None:
    """Take what is on the air, and wait for what a grant says must be there."""
    while True:
        message = air.poll()
        if message is None:
            if inbox.has(counts):
                return
            message = air.wait()
        sender, packet = carried(*message)
        if sender != own and packet is not None:
            inbox.add(sender, packet)


def give_back() -> None:
    """Give memory that is free back to the computer: other robots think next.

    A look takes some tens of megabytes for a moment, which the C library would keep.
    """
    with contextlib.suppress(AttributeError):  # another C library than GNU's
        ctypes.CDLL(None).malloc_trim(0)


def unique_bytes(pid: int | None = None) -> int | None:
    """Return the memory that a process (this one) shares with no other; None: nobody says so."""
    try:
        lines = Path(f"/proc/{pid or 'self'}/smaps_rollup").read_text().splitlines()[1:]
    except OSError:
        return None
    sizes_kib = {key: int(rest.split()[0]) for key, _, rest in (x.partition(":") for x in lines)}
    return 1024 * (sizes_kib["Private_Clean"] + sizes_kib["Private_Dirty"])


def peak_bytes() -> int:
    """Return the most memory that this process held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
