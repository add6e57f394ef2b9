"""Robots as processes: forked from a warm server, joined by a Zenoh router in the runner.

Grants, reports and packets go through the same router, in order: a report arrives behind the
packets that it counts, so a robot that is granted a window finds them waiting. What such a process
does is in `scenarios.crews.robotprocess`; processes on other computers are in `scenarios.hosts`.
"""

import contextlib
import os
import shutil
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing import connection, forkserver, get_context
from multiprocessing.context import ForkServerProcess
from typing import Any, Protocol

from comms.zenoh_air import Wire, open_hub
from scenarios.crews.crew import Cost, Obituary
from scenarios.crews.robotprocess import robot_main
from scenarios.records.folder import make_folder_in_memory
from scenarios.wire import Grant, Plan, Report

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
OBITUARY = b"\xc1"
"""A report that begins so is none (MessagePack never does): which process ended, and why."""


def obituary(number: int, why: str) -> bytes:
    """Return what is told, in place of a report, of a process by the number of its start."""
    return OBITUARY + number.to_bytes(4, "big") + why.encode()


def start_fork_server() -> None:
    """Set the fork server going in the background, so that it is warm when robots are forked."""
    get_context("forkserver").set_forkserver_preload(PRELOAD)
    forkserver.ensure_running()


class Process(Protocol):
    """A robot's process, wherever it runs."""

    def kill(self) -> None:
        """End it at once (SIGKILL); what is left of it is cleared away by `forget`."""
        ...

    def forget(self) -> None:
        """Clear away a process that was killed."""
        ...

    def join(self, most_s: float) -> None:
        """Wait until it has ended by itself, or for so long (wall)."""
        ...

    def stop(self) -> None:
        """Hang it (SIGSTOP)."""
        ...

    def resume(self) -> None:
        """Let it go on (SIGCONT)."""
        ...

    def ended(self) -> str | None:
        """Return why it has ended; None while it has not."""
        ...


class LocalProcess:
    """A robot's process on this computer, forked from the warm server."""

    def __init__(self, name: str, main: Callable[..., None], *args: Any) -> None:
        """Fork it."""
        context = get_context("forkserver")
        self._process: ForkServerProcess = context.Process(target=main, args=args, name=name)
        self._process.start()

    @property
    def pid(self) -> int:
        """Its number."""
        assert self._process.pid is not None
        return self._process.pid

    def kill(self) -> None:
        """See `Process`."""
        self._process.kill()

    def forget(self) -> None:
        """See `Process`."""
        self._process.join()
        self._process.close()

    def join(self, most_s: float) -> None:
        """See `Process`."""
        self._process.join(most_s)

    def stop(self) -> None:
        """See `Process`."""
        self._signal(signal.SIGSTOP)

    def resume(self) -> None:
        """See `Process`."""
        self._signal(signal.SIGCONT)

    def _signal(self, number: signal.Signals) -> None:
        os.kill(self.pid, number)  # the process was not joined yet, so the number is still its own

    def ended(self) -> str | None:
        """See `Process`."""
        try:
            has_ended = connection.wait([self._process.sentinel], 0)
        except ValueError:
            return None  # it was forgotten meanwhile
        return _ending(self._process.exitcode) if has_ended else None


# --- in the runner ----------------------------------------------------------------------


@dataclass
class _Robot:
    process: Process
    number: int
    """Of all processes that were started: a robot's next life has another."""
    owes_since_s: float | None
    stopped: bool = False
    told: bool = False
    """Its end was announced."""


class ZenohCrew:
    """A process per robot."""

    def __init__(self, wire: Wire | None = None) -> None:
        """Open the router (or take a wire to one), and watch over the processes to come."""
        self.costs: dict[str, Cost] = {}
        self._hub = wire or open_hub()
        self._pictures = make_folder_in_memory()
        self._reports = self._hub.channel("world/report/*")
        self._robots: dict[str, _Robot] = {}
        self._started = 0
        self._ended = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="watcher", daemon=True)
        self._watcher.start()

    def pids(self) -> dict[str, int]:
        """Return the processes of robots on this computer, by name."""
        found = {name: robot.process for name, robot in self._robots.items()}
        return {name: p.pid for name, p in found.items() if isinstance(p, LocalProcess)}

    def begin(self, plan: Plan, number: int) -> Process:
        """Start the process of one robot, the so manieth of all."""
        del number
        whole = replace(plan, endpoint=self._hub.endpoint, pictures=self._pictures)
        return LocalProcess(plan.name, robot_main, whole)

    def launch(self, plans: list[Plan]) -> None:
        """Start robots, all at once."""
        for plan in plans:
            self._started += 1
            process = self.begin(plan, self._started)
            self._robots[plan.name] = _Robot(process, self._started, time.monotonic())
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
        if data.startswith(OBITUARY):
            if int.from_bytes(data[1:5], "big") != robot.number:
                return None  # of a former life, whose end was known
            self.kill(name)
            return Obituary(name, f"its process ended ({data[5:].decode()})")
        robot.owes_since_s = None
        report = Report.from_wire(data)
        if report.final is not None:
            self.costs[name] = Cost(*report.final.pop("cost"))
        return report

    def kill(self, name: str) -> None:
        """End a robot's process with SIGKILL."""
        process = self._robots.pop(name).process
        process.kill()
        process.forget()

    def dismiss(self, name: str) -> None:
        """Let a process end that has given its last report; it ends by itself, or is ended."""
        self._robots[name].process.join(CLOSE_S)
        self.kill(name)

    def stop(self, name: str) -> None:
        """Hang a robot's process with SIGSTOP."""
        self._robots[name].stopped = True
        self._robots[name].process.stop()

    def resume(self, name: str) -> None:
        """Let a robot's process go on with SIGCONT."""
        self._robots[name].stopped = False
        self._robots[name].process.resume()

    def close(self) -> None:
        """End what is left: those that have given their last report by themselves, others not."""
        self.end_robots()
        self._hub.close()

    def end_robots(self) -> None:
        """End all processes, and the watch over them."""
        self._ended.set()
        deadline_s = time.monotonic() + CLOSE_S
        for name in list(self._robots):
            robot = self._robots[name]
            if robot.owes_since_s is None and not robot.stopped:
                robot.process.join(max(0.0, deadline_s - time.monotonic()))
            self.kill(name)
        self._watcher.join()
        shutil.rmtree(self._pictures, ignore_errors=True)

    def tend(self) -> None:
        """Do what is to be done now and then, on the watcher's thread."""

    def _watch(self) -> None:
        """Announce processes that have ended, and end those that hang; in a thread of its own.

        It decides nothing about a sound run: only what has died outside the scenario is told.
        """
        while not self._ended.wait(LAST_WORDS_S):
            self.tend()
            for name, robot in list(self._robots.items()):
                with contextlib.suppress(ValueError):  # closed meanwhile
                    why = robot.process.ended()
                    if why is not None and not robot.told:
                        robot.told = True
                        time.sleep(LAST_WORDS_S)
                        self._hub.put(f"world/report/{name}", obituary(robot.number, why))
                    elif why is None and self._hangs(robot):
                        robot.process.kill()

    def _hangs(self, robot: _Robot) -> bool:
        since_s = robot.owes_since_s
        return not robot.stopped and since_s is not None and time.monotonic() - since_s > HANG_S


def _ending(code: int | None) -> str:
    if code is not None and code < 0:
        return f"signal {signal.Signals(-code).name}"
    return f"exit code {code}"
