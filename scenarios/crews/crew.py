"""The robots of a run as the runner holds them, and the form in which all are in this process.

A crew takes grants and gives reports; a robot that is gone gives its obituary instead. Robots as
processes over Zenoh are in `scenarios.crews.processes`.
"""

import resource
from collections import deque
from dataclasses import dataclass
from typing import Protocol

from agents.recall import RECALL
from comms.air import Packet
from scenarios.host import Host
from scenarios.wire import Grant, Plan, Report
from sim.clock import VirtualLoop

PICTURES_EACH = 32
"""Decoded tiles that are kept for the others, for each robot of a team in one process."""


@dataclass(frozen=True)
class Obituary:
    """A robot's process has ended, or hung and was killed."""

    name: str
    reason: str


@dataclass
class Cost:
    """What a robot's process took of the computer."""

    cpu_s: float = 0.0
    peak_memory_bytes: int = 0
    unique_memory_bytes: int | None = None
    """What it shared with no other process in the end, where that is known."""


class Crew(Protocol):
    """The robots of a run."""

    costs: dict[str, Cost]

    def launch(self, plans: list[Plan]) -> None:
        """Bring robots to life; each gives a first report."""
        ...

    def grant(self, name: str, grant: Grant) -> None:
        """Let a robot run; it will give a report."""
        ...

    def next_report(self, waiting: list[str]) -> Report | Obituary:
        """Return the next report of one of the robots that owe one."""
        ...

    def poll(self) -> Report | Obituary | None:
        """Return a report or obituary that has come, or None after a short wait."""
        ...

    def kill(self, name: str) -> None:
        """End a robot at once, as it is."""
        ...

    def dismiss(self, name: str) -> None:
        """Let a robot go that has given its last report."""
        ...

    def stop(self, name: str) -> None:
        """Hang a robot."""
        ...

    def resume(self, name: str) -> None:
        """Let a hung robot go on."""
        ...

    def close(self) -> None:
        """End whatever is left, in order."""
        ...


class Inbox:
    """Packets that came to one robot, until they are to be taken."""

    def __init__(self, baseline: dict[str, int]) -> None:
        """Expect nothing of what was sent before: `baseline` counts that, by sender."""
        self.taken = dict(baseline)
        self.waiting: dict[str, deque[Packet]] = {}

    def add(self, sender: str, packet: Packet) -> None:
        """Keep a packet of a sender (name and incarnation)."""
        self.waiting.setdefault(sender, deque()).append(packet)

    def has(self, counts: dict[str, int]) -> bool:
        """Say whether all packets are here that are to be taken."""
        return all(
            len(self.waiting.get(sender, ())) >= count - self.taken.get(sender, 0)
            for sender, count in counts.items()
        )

    def take(self, counts: dict[str, int]) -> list[Packet]:
        """Return exactly the packets up to `counts`, sender by sender."""
        packets: list[Packet] = []
        for sender, count in counts.items():
            due = count - self.taken.get(sender, 0)
            packets.extend(self.waiting[sender].popleft() for _ in range(due))
            self.taken[sender] = count
        return packets


@dataclass
class _Member:
    host: Host
    inbox: Inbox


class _Broadcast:
    """Carries a host's packets to the inboxes of all others."""

    def __init__(self, crew: "MemoryCrew", name: str) -> None:
        self._crew, self._name = crew, name

    def put(self, packet: Packet) -> None:
        self._crew.carry(self._name, packet)


class MemoryCrew:
    """All robots in this process, each on a virtual loop of its own."""

    def __init__(self, *, counts_cost: bool = True) -> None:
        """Start without robots; asking for the CPU time of each window takes time itself."""
        self.costs: dict[str, Cost] = {}
        self._cpu_s = cpu_s if counts_cost else _none
        self._members: dict[str, _Member] = {}
        self._dead: list[Host] = []
        self._reports: deque[Report] = deque()

    def launch(self, plans: list[Plan]) -> None:
        """Bring robots to life, one after another."""
        for plan in plans:
            RECALL.keep(PICTURES_EACH * len(plan.scenario.robots))
            index = list(plan.scenario.robots).index(plan.name)
            loop = VirtualLoop(index, plan.start_ns)
            host = Host(plan, loop, _Broadcast(self, plan.name))
            self._members[plan.name] = _Member(host, Inbox(plan.baseline))
            self.costs.setdefault(plan.name, Cost())
            host.start()
            self._reports.append(host.report())

    def carry(self, sender: str, packet: Packet) -> None:
        """Bring a packet to all but its sender."""
        life = self._members[sender].host.robot.me.incarnation
        for name, member in self._members.items():
            if name != sender:
                member.inbox.add(f"{sender}#{life}", packet)

    def grant(self, name: str, grant: Grant) -> None:
        """Run a robot's window now."""
        member = self._members[name]
        before_s = self._cpu_s()
        self._reports.append(member.host.run_window(grant, member.inbox.take(grant.counts)))
        self.costs[name].cpu_s += self._cpu_s() - before_s

    def next_report(self, waiting: list[str]) -> Report | Obituary:
        """Return the oldest report that was not taken yet."""
        del waiting
        return self._reports.popleft()

    def poll(self) -> Report | Obituary | None:
        """Return the oldest report that was not taken yet, if there is one."""
        return self._reports.popleft() if self._reports else None

    def kill(self, name: str) -> None:
        """Drop a robot as it is: nothing of its program runs any more."""
        host = self._members.pop(name).host
        host.abandon()
        self._dead.append(host)

    def dismiss(self, name: str) -> None:
        """Drop a robot that has given its last report."""
        self.kill(name)

    def stop(self, name: str) -> None:
        """Do nothing: a robot that is granted nothing hangs."""

    def resume(self, name: str) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Drop all robots."""
        for name in list(self._members):
            self.kill(name)
        while self._dead:
            self._dead.pop().bury()
        RECALL.keep(0)


def cpu_s() -> float:
    """Return the CPU seconds of this process so far."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def _none() -> float:
    return 0.0
