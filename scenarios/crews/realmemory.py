"""The robots of a run on the wall clock, all in this process."""

import asyncio
import time
from collections import deque

from comms.air import Packet
from scenarios.crews.crew import Cost, Obituary, cpu_s
from scenarios.crews.realserve import REPORT_S
from scenarios.host import Host
from scenarios.wire import Grant, Plan, Report
from sim.clock import ScaledLoop


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
