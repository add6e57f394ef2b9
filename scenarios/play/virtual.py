"""A run on the virtual clock: windows of time, granted to robots that have something to do."""

import time
from pathlib import Path
from typing import Any

from scenarios.crews.crew import Crew, Obituary
from scenarios.hostradio import lookahead_ns
from scenarios.live import LiveView
from scenarios.play.play import Play
from scenarios.stage import Stage
from scenarios.wire import Grant, Plan, Report
from sim.conductor import Conductor


class VirtualRun(Play):
    """One run on the virtual clock."""

    def __init__(self, stage: Stage, out: Path, crew: Crew, view: LiveView) -> None:
        """Take the stage; nothing runs yet."""
        super().__init__(stage, out, crew, view)
        self._window_end_ns = 0
        self.conductor = Conductor(lookahead_ns(stage.scenario), self.limit_ns)

    @property
    def now_ns(self) -> int:
        """The start of the window that is open, or the barrier at which all stand."""
        return self.conductor.now_ns

    def due_ns(self) -> int | None:
        """Return when the next window begins, or what is planned comes about."""
        events_ns = self.conductor.next_due_ns()
        planned_ns = self.next_appointment_ns()
        return planned_ns if events_ns is None else min(events_ns, planned_ns)

    def reached_ns(self) -> int:
        """Return the end of the last window."""
        return max(self.now_ns, self._window_end_ns)

    def play(self) -> None:
        """Run until the mission is over and the maps have settled, or to the limit."""
        plans = self.plans(names := self.open_agenda())
        started_s = time.perf_counter()
        self._start(names, plans)
        self.first_grant_s = time.perf_counter()
        self.launch_s = self.first_grant_s - started_s
        while not self.ending:
            self.attend()
            if not self.ending:
                self._step()
        self._finish()

    def bring_up(self, names: list[str]) -> None:
        """Bring robots to life now, and wait until they are up."""
        self._start(names, self.plans(names))

    def _start(self, names: list[str], plans: list[Plan]) -> None:
        for name in names:
            self.conductor.join(name, self.now_ns)
            self.conductor.members[name].running = True
        self.crew.launch(plans)
        self._collect()

    def leave(self, name: str) -> None:
        """Let a robot end in order at this very instant, and take it out of the barrier."""
        if name in self._news:
            self.conductor.members[name].running = True
            self._grant(name, self.now_ns, ("finish",))
            self._collect()
            self.crew.dismiss(name)
            self.bury(name, "left")

    def bury(self, name: str, state: str = "killed") -> None:
        """Take a robot that is gone out of the barrier."""
        self.conductor.leave(name)
        super().bury(name, state)

    def stop(self, name: str) -> None:
        """Take a robot out of the barrier, and hang it."""
        if name in self.conductor.members:
            self.conductor.stop(name)
        super().stop(name)

    def resume(self, name: str) -> None:
        """Let a robot go on, and put it back into the barrier."""
        super().resume(name)
        if name in self.conductor.members:
            self.conductor.resume(name)

    def take(self, told: Report | Obituary) -> None:
        """Take in what a robot reports; it stands at the barrier then."""
        if isinstance(told, Report) and told.name in self.conductor.members:
            urgent = [(receiver, t_ns) for receiver, t_ns in told.urgent]
            self.conductor.report(told.name, told.next_ns, told.sent, urgent)
        super().take(told)

    def _step(self) -> None:
        window = self.conductor.open_window(self.next_appointment_ns())
        if window is None:
            self.keep_appointments()
            return
        self._window_end_ns = window.end_ns
        for name in window.members:
            self._grant(name, window.end_ns)
        self._collect()
        self.grants = self.conductor.grants
        self.show()

    def _grant(self, name: str, end_ns: int, *commands: tuple[Any, ...]) -> None:
        grant = self._news[name]
        self._news[name] = Grant(0)
        grant.end_ns = end_ns
        grant.floor_ns = self.conductor.members[name].floor_ns
        grant.counts = {k: v for k, v in self._counts.items() if k.split("#")[0] != name}
        grant.commands.extend(commands)
        self.crew.grant(name, grant)

    def _collect(self) -> None:
        """Take the reports of all robots that run, and the obituaries of those that died."""
        while waiting := self.conductor.waiting_for():
            self.take(self.crew.next_report(waiting))

    def _finish(self) -> None:
        """Let every robot that still runs end in order, at this very instant."""
        for name in list(self._news):
            member = self.conductor.members[name]
            if member.stopped:
                self.crew.kill(name)
                self.conductor.leave(name)
                continue
            member.running = True
            self._grant(name, self.now_ns, ("finish",))
        self._collect()
        self.close_records()
