"""Robots as processes: forked from a warm server, joined by a Zenoh router in the runner.

Grants, reports and packets go through the same router, in order: a report arrives behind the
packets that it counts, so a robot that is granted a window finds them waiting.
"""

import contextlib
import ctypes
import os
import resource
import signal
import threading
import time
from dataclasses import dataclass, replace
from multiprocessing import connection, forkserver, get_context
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any, cast

from comms.air import Packet, PacketError
from comms.zenoh_air import Channel, Wire, open_client, open_hub
from scenarios.crew import Cost, Inbox, Obituary, cpu_s
from scenarios.host import Host
from scenarios.realtime import serve_real
from scenarios.wire import Grant, Plan, Report
from sim.clock import VirtualLoop

HANG_S = 120.0
"""A process that owes a report for so long (wall) hangs, and is killed."""
LAST_WORDS_S = 0.2
"""So long (wall) a dead process's last report may still be on its way."""
CLOSE_S = 3.0
"""So long (wall) a process may take to end after its last report."""
POLL_S = 0.002
"""Pause (wall) when nothing has come."""
PRELOAD = ["scenarios.preload"]
"""What the fork server imports before the first robot is forked: everything, kernels included."""
PR_SET_PDEATHSIG = 1


def start_fork_server() -> None:
    """Set the fork server going in the background, so that it is warm when robots are forked."""
    get_context("forkserver").set_forkserver_preload(PRELOAD)
    forkserver.ensure_running()


# --- in the robot's process -------------------------------------------------------------


def robot_main(plan: Plan) -> None:
    """Be one robot's process, on the virtual clock: take grants, run windows, give reports."""
    prepare_process()
    wire = open_client(plan.endpoint)
    try:
        _serve(plan, wire)
    finally:
        wire.close()


def prepare_process() -> None:
    """Leave Ctrl-C to the runner, and die when it does: no orphan is left behind."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
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
        report = host.run_window(grant, inbox.take(grant.counts))
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


def unique_bytes() -> int | None:
    """Return the memory that this process shares with no other; None where nobody says so."""
    try:
        lines = Path("/proc/self/smaps_rollup").read_text().splitlines()[1:]
    except OSError:
        return None
    sizes_kib = {key: int(rest.split()[0]) for key, _, rest in (x.partition(":") for x in lines)}
    return 1024 * (sizes_kib["Private_Clean"] + sizes_kib["Private_Dirty"])


def peak_bytes() -> int:
    """Return the most memory that this process held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


# --- in the runner ----------------------------------------------------------------------


@dataclass
class _Robot:
    process: ForkServerProcess
    owes_since_s: float | None
    stopped: bool = False


class ZenohCrew:
    """A process per robot."""

    def __init__(self) -> None:
        """Open the router, and watch over the processes to come."""
        self.costs: dict[str, Cost] = {}
        self._context = get_context("forkserver")
        self._hub = open_hub()
        self._reports = self._hub.channel("world/report/*")
        self._robots: dict[str, _Robot] = {}
        self._ended = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="watcher", daemon=True)
        self._watcher.start()

    def launch(self, plans: list[Plan]) -> None:
        """Fork robots, all at once."""
        for plan in plans:
            whole = replace(plan, endpoint=self._hub.endpoint)
            process = self._context.Process(target=robot_main, args=(whole,), name=plan.name)
            process.start()
            self._robots[plan.name] = _Robot(process, time.monotonic())
            self.costs.setdefault(plan.name, Cost())

    def grant(self, name: str, grant: Grant) -> None:
        """Send a grant."""
        self._robots[name].owes_since_s = time.monotonic()
        self._hub.put(f"world/grant/{name}", grant.to_wire())

    def next_report(self, waiting: list[str]) -> Report | Obituary:
        """Return the next report, or the obituary of a robot whose process has ended."""
        del waiting
        while True:
            told = self._understood(*self._reports.wait())
            if told is not None:
                return told

    def poll(self) -> Report | Obituary | None:
        """Return a report that has come, or None after a short wait."""
        message = self._reports.poll()
        if message is None:
            time.sleep(POLL_S)
            return None
        return self._understood(*message)

    def _understood(self, key: str, data: bytes) -> Report | Obituary | None:
        name = key.rsplit("/", 1)[1]
        robot = self._robots.get(name)
        if robot is None:
            return None  # of a robot that was killed meanwhile
        if not data:
            code = robot.process.exitcode
            self.kill(name)
            return Obituary(name, f"its process ended ({_ending(code)})")
        robot.owes_since_s = None
        report = Report.from_wire(data)
        if report.final is not None:
            self.costs[name] = Cost(*report.final.pop("cost"))
        return report

    def kill(self, name: str) -> None:
        """End a robot's process with SIGKILL."""
        robot = self._robots.pop(name)
        robot.process.kill()
        robot.process.join()
        robot.process.close()

    def dismiss(self, name: str) -> None:
        """Let a process end that has given its last report; it ends by itself, or is ended."""
        self._robots[name].process.join(CLOSE_S)
        self.kill(name)

    def stop(self, name: str) -> None:
        """Hang a robot's process with SIGSTOP."""
        self._robots[name].stopped = True
        self._signal(name, signal.SIGSTOP)

    def resume(self, name: str) -> None:
        """Let a robot's process go on with SIGCONT."""
        self._robots[name].stopped = False
        self._signal(name, signal.SIGCONT)

    def _signal(self, name: str, number: signal.Signals) -> None:
        pid = self._robots[name].process.pid
        assert pid is not None
        os.kill(pid, number)  # the process was not joined yet, so the number is still its own

    def close(self) -> None:
        """End what is left: those that have given their last report by themselves, others not."""
        self._ended.set()
        deadline_s = time.monotonic() + CLOSE_S
        for name in list(self._robots):
            robot = self._robots[name]
            if robot.owes_since_s is None and not robot.stopped:
                robot.process.join(max(0.0, deadline_s - time.monotonic()))
            self.kill(name)
        self._watcher.join()
        self._hub.close()

    def _watch(self) -> None:
        """Announce processes that have ended, and end those that hang; in a thread of its own.

        It decides nothing about a sound run: only what has died outside the scenario is told.
        """
        told: set[int] = set()
        while not self._ended.wait(LAST_WORDS_S):
            for name, robot in list(self._robots.items()):
                with contextlib.suppress(ValueError):  # closed meanwhile
                    if robot.process.pid in told:
                        continue
                    if connection.wait([robot.process.sentinel], 0):
                        told.add(robot.process.pid or 0)
                        time.sleep(LAST_WORDS_S)
                        self._hub.put(f"world/report/{name}", b"")
                    elif self._hangs(robot):
                        robot.process.kill()

    def _hangs(self, robot: _Robot) -> bool:
        since_s = robot.owes_since_s
        return not robot.stopped and since_s is not None and time.monotonic() - since_s > HANG_S


def _ending(code: int | None) -> str:
    if code is not None and code < 0:
        return f"signal {signal.Signals(-code).name}"
    return f"exit code {code}"
