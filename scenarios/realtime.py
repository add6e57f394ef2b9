"""A run on the wall clock: robots live by it, at any speed; the runner only listens and acts.

The same hosts as on the virtual clock, on a `ScaledLoop` instead. Packets go from robot to robot as
they come; grants carry no time here, only the motion of others and what happens to the world.
"""

import asyncio
import sys
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from comms.air import Packet
from comms.timebase import NS
from comms.zenoh_air import Wire
from scenarios.crew import Cost, Crew, Obituary, cpu_s
from scenarios.host import Host
from scenarios.hostradio import Outbox
from scenarios.live import LiveView
from scenarios.play import Play
from scenarios.stage import Stage
from scenarios.wire import Grant, Plan, Report
from sim.clock import ScaledLoop

REPORT_S = 0.1
"""Wall seconds between two reports of a robot, and between two rounds of the runner."""
READY_S = 0.05
"""Wall seconds from the last robot's readiness to the start of the run's clock."""
SWITCH_S = 0.0005
"""A robot that thinks in a thread must not keep its radio waiting: Python's usual 5 ms are much."""
FINISH_S = 10.0
"""Wall seconds that robots have to end in order."""


# --- in the robot's process -------------------------------------------------------------


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


# --- all in one process -----------------------------------------------------------------


class RealMemoryCrew:
    """All robots in this process, on one scaled loop, which runs while the runner waits."""

    def __init__(self) -> None:
        """Start without robots."""
        self.costs: dict[str, Cost] = {}
        self._hosts: dict[str, Host] = {}
        self._loop: ScaledLoop | None = None
        self._begun = False
        self._reports: deque[Report] = deque()
        self._told_s = 0.0

    def launch(self, plans: list[Plan]) -> None:
        """Bring robots to life."""
        for plan in plans:
            if self._loop is None:
                self._loop = ScaledLoop(plan.scenario.clock.speed)
            host = Host(plan, self._loop, _Everybody(self, plan.name))
            self._hosts[plan.name] = host
            self.costs.setdefault(plan.name, Cost())
            self._reports.append(host.report())
            if plan.epoch_s is not None:
                host.start()

    def carry(self, sender: str, packet: Packet) -> None:
        """Bring a packet to all but its sender."""
        for name, host in self._hosts.items():
            if name != sender and self._loop is not None:
                host.air.deliver(self._loop, packet, host.plan.start_ns)

    def grant(self, name: str, grant: Grant) -> None:
        """Tell a robot what is new."""
        host = self._hosts[name]
        host.take(grant, [])
        begun = [command[1] for command in grant.commands if command[0] == "begin"]
        if begun and self._loop is not None:
            self._loop.begin(begun[0])
            self._begun = True
            host.start()
        if any(command[0] == "finish" for command in grant.commands):
            self._reports.append(host.finish(host.now_ns()))
            self.kill(name)

    def next_report(self, waiting: list[str]) -> Report | Obituary:
        """Return the next report, as `poll` does, but wait for it."""
        del waiting
        while True:
            report = self.poll()
            if report is not None:
                return report

    def poll(self) -> Report | Obituary | None:
        """Let the robots run for a moment; return a report, if one is due."""
        if not self._reports and self._loop is not None and self._hosts and self._begun:
            speed = next(iter(self._hosts.values())).scenario.clock.speed
            before = cpu_s()
            self._loop.run_until_complete(asyncio.sleep(0.005 * speed))
            share = (cpu_s() - before) / len(self._hosts)
            for name in self._hosts:
                self.costs[name].cpu_s += share
            if time.monotonic() >= self._told_s + REPORT_S:
                self._told_s = time.monotonic()
                self._reports.extend(host.report() for host in self._hosts.values())
        elif not self._reports:
            time.sleep(0.005)
        return self._reports.popleft() if self._reports else None

    def kill(self, name: str) -> None:
        """Drop a robot as it is: nothing of its program runs any more."""
        host = self._hosts.pop(name)
        host.cancel()
        host.abandon()

    def dismiss(self, name: str) -> None:
        """Do nothing: who has given its last report was dropped then."""

    def stop(self, name: str) -> None:
        """Refuse: in one process and on the wall clock nobody can be hung alone."""
        raise AssertionError(f"{name} can't be stopped in one process on the wall clock")

    def resume(self, name: str) -> None:
        """Refuse, as `stop`."""
        raise AssertionError(f"{name} can't be resumed in one process on the wall clock")

    def close(self) -> None:
        """Drop all robots."""
        for name in list(self._hosts):
            self.kill(name)
        if self._loop is not None:
            self._loop.run_until_complete(asyncio.sleep(0))  # what was cancelled ends
            self._loop.close()


class _Everybody:
    def __init__(self, crew: RealMemoryCrew, name: str) -> None:
        self._crew, self._name = crew, name

    def put(self, packet: Packet) -> None:
        self._crew.carry(self._name, packet)


# --- in the runner ----------------------------------------------------------------------


class RealRun(Play):
    """One run on the wall clock."""

    def __init__(self, stage: Stage, out: Path, crew: Crew, view: LiveView) -> None:
        """Take the stage; nothing runs yet."""
        super().__init__(stage, out, crew, view)
        self._speed = stage.scenario.clock.speed
        self._epoch_s: float | None = None
        self._up: set[str] = set()
        self._end_ns: int | None = None

    @property
    def now_ns(self) -> int:
        """The run's time; it stands still once the run is over."""
        if self._end_ns is not None:
            return self._end_ns
        if self._epoch_s is None:
            return 0
        return max(0, round((time.monotonic() - self._epoch_s) * self._speed * NS))

    def play(self) -> None:
        """Run until the mission is over and the maps have settled, or to the limit."""
        self.bring_up(self.open_agenda())
        while self._news.keys() - self._up and not self.ending:
            self._listen()  # the clock starts once all are there
        epoch_s = time.monotonic() + READY_S
        for name in list(self._news):
            self.crew.grant(name, Grant(0, commands=[("begin", epoch_s)]))
        self._epoch_s = epoch_s
        self.first_grant_s = time.perf_counter() + READY_S
        while not self.ending:
            self._listen()
            self.attend()
            self.keep_appointments()
            self._tell()
            self.show()
        self._finish()

    def plans(self, names: list[str]) -> list[Plan]:
        """Return what robots are told that start now, the clock's start among it."""
        return [replace(plan, epoch_s=self._epoch_s) for plan in super().plans(names)]

    def bring_up(self, names: list[str]) -> None:
        """Bring robots to life; they are there a moment later."""
        self.crew.launch(self.plans(names))

    def leave(self, name: str) -> None:
        """Let a robot end in order; it is gone once its last report has come."""
        if name in self._news:
            self.crew.grant(name, Grant(self.now_ns, commands=[("finish",)]))
            deadline_s = time.monotonic() + FINISH_S
            while name not in self._finals and time.monotonic() < deadline_s:
                self._listen()
            self.crew.dismiss(name)
            self.bury(name, "left")

    def _listen(self) -> None:
        """Take all reports that have come."""
        told = self.crew.poll()
        while told is not None:
            self._up.add(told.name)
            self.take(told)
            told = self.crew.poll()

    def _tell(self) -> None:
        """Tell robots what they have not been told yet."""
        for name, grant in list(self._news.items()):
            if grant.segments or grant.commands:
                self._news[name] = Grant(0)
                self.crew.grant(name, grant)

    def _finish(self) -> None:
        """Let every robot that still runs end in order."""
        end_ns = self.now_ns
        for name in list(self._news):
            if self.actors[name].state == "stopped":
                self.crew.kill(name)
                del self._news[name]
                continue
            self.crew.grant(name, Grant(end_ns, commands=[("finish",)]))
        deadline_s = time.monotonic() + FINISH_S
        while self._news.keys() - self._finals.keys() and time.monotonic() < deadline_s:
            self._listen()
        self._end_ns = end_ns
        self.close_records()

    def final_facts_of_clock(self) -> dict[str, Any]:
        """Return how far deliveries were behind their due times, in wall seconds."""
        lags = np.array([lag for final in self._finals.values() for lag in final["lags_s"]])
        if lags.size == 0:
            return {"delivery_lag_s": None}
        return {
            "delivery_lag_s": {
                "frames": int(lags.size),
                "median": float(np.median(lags)),
                "p95": float(np.percentile(lags, 95)),
                "max": float(lags.max()),
            }
        }
