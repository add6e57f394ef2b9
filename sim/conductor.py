"""Who may run until when: a conservative conductor of robots on virtual time.

Every robot tells when its next event is due and what it has sent. When all that were granted a
window are idle again, the next window opens at the earliest event of all and ends one lookahead
later: nothing sent inside it can arrive inside it. Only robots with something to do there are
granted it. Scripted events (a kill, a changed link) clip the window, so they fall on a barrier,
at their exact instant.

Pure: no clock, no I/O; `scenarios.runner` carries reports and grants.
"""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Window:
    """Permission for some robots to run their events before `end_ns`."""

    start_ns: int
    end_ns: int
    members: tuple[str, ...]


@dataclass
class Member:
    """What the conductor knows of one robot."""

    next_ns: int | None
    sent: int = 0
    urgent_ns: list[int] = field(default_factory=list[int])
    running: bool = False
    stopped: bool = False
    floor_ns: int = 0

    def due_ns(self) -> int | None:
        """Return when this robot next has something to do, or None for never."""
        if self.stopped:
            return None
        candidates = [t for t in (self.next_ns, *self.urgent_ns) if t is not None]
        return max(min(candidates), self.floor_ns) if candidates else None


class Conductor:
    """Grants windows of virtual time to the live robots of a run."""

    def __init__(self, lookahead_ns: int, limit_ns: int) -> None:
        """Make a conductor for links of at least `lookahead_ns` latency, up to `limit_ns`."""
        assert lookahead_ns > 0
        self.lookahead_ns = lookahead_ns
        self.limit_ns = limit_ns
        self.members: dict[str, Member] = {}
        self.now_ns = 0
        self.grants = 0
        self.rounds = 0

    def join(self, name: str, next_ns: int | None, sent: int = 0) -> None:
        """Add a robot that has just started, with the time of its first event.

        `sent` continues the count of packets of a robot that was here under this name before.
        """
        self.members[name] = Member(next_ns, sent=sent)

    def leave(self, name: str) -> None:
        """Forget a robot that was killed, died or left."""
        self.members.pop(name, None)

    def stop(self, name: str) -> None:
        """Take a robot out of the barrier; its packets and counts stay."""
        self.members[name].stopped = True

    def resume(self, name: str) -> None:
        """Put a stopped robot back now; its overdue timers fire at this instant."""
        member = self.members[name]
        member.stopped = False
        member.floor_ns = self.now_ns

    def report(
        self, name: str, next_ns: int | None, sent: int, urgent: list[tuple[str, int]]
    ) -> None:
        """Take a robot's report at the end of its window.

        `sent` counts its packets since the start, `urgent` are (receiver, arrival) of those sent
        in this window that wake their receiver.
        """
        member = self.members[name]
        member.running = False
        member.next_ns = next_ns
        member.sent = sent
        for receiver, arrive_ns in urgent:
            if receiver in self.members:
                self.members[receiver].urgent_ns.append(arrive_ns)

    def waiting_for(self) -> list[str]:
        """Return the robots whose report is still to come."""
        return [name for name, member in self.members.items() if member.running]

    def next_due_ns(self) -> int | None:
        """Return the earliest event of all robots, or None when nothing is left to happen."""
        due = [t for t in (m.due_ns() for m in self.members.values()) if t is not None]
        return min(due) if due else None

    def open_window(self, barrier_ns: int) -> Window | None:
        """Open the next window, which ends at `barrier_ns` at the latest.

        Returns None when no robot has an event before `barrier_ns`: then the barrier's own events
        are due, and the clock stands there.
        """
        assert not self.waiting_for()
        barrier_ns = min(barrier_ns, self.limit_ns)
        start_ns = self.next_due_ns()
        if start_ns is None or start_ns >= barrier_ns:
            self.now_ns = max(self.now_ns, barrier_ns)
            return None
        self.now_ns = start_ns
        end_ns = min(start_ns + self.lookahead_ns, barrier_ns)
        members: list[str] = []
        for name, member in self.members.items():
            due_ns = member.due_ns()
            if due_ns is not None and due_ns < end_ns:
                members.append(name)
                member.running = True
                member.urgent_ns.clear()
        self.rounds += 1
        self.grants += len(members)
        return Window(start_ns, end_ns, tuple(members))
