"""Runs a scenario: starts the robots, pays out time, makes things happen, writes the records.

`run` is the whole of it. The clock's rules are `sim.conductor`'s, the robots' processes
`scenarios.processes`'; this file carries reports and grants between them, and knows the agenda.
"""

import contextlib
import heapq
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import scenarios
from comms import kernels
from comms.profiles import resolve
from comms.timebase import NS, from_s, to_s
from scenarios import folder
from scenarios.crew import Crew, MemoryCrew, Obituary, cpu_s
from scenarios.ending import Actor, conclude
from scenarios.events import Event
from scenarios.host import SAMPLE_S, lookahead_ns
from scenarios.live import LiveView, Snapshot
from scenarios.overview import Overview, draw
from scenarios.processes import ZenohCrew, peak_bytes, start_fork_server
from scenarios.record import EventRow, Records, from_wire, write_atomic
from scenarios.report import report
from scenarios.schema import Scenario, dump
from scenarios.stage import Stage, set_stage
from scenarios.summary import HostCost, ProcessCost, RobotFinal, host_facts, summarise, write_json
from scenarios.wire import Grant, Plan, Report
from sim.conductor import Conductor
from sim.motion import Motions, Segment

ROOT = Path(scenarios.__file__).parent.parent
KEPT_SEGMENTS = 64
"""Motion of each robot that a latecomer is told."""


@dataclass(frozen=True)
class RunResult:
    """What a run leaves."""

    outcome: str
    summary: dict[str, Any]
    out: Path


@dataclass(order=True)
class Appointment:
    """Something that happens at a barrier; of one instant, in the order in which it was made."""

    t_ns: int
    order: int
    act: Callable[[], None] = field(compare=False)
    holds_end: bool = field(compare=False, default=False)
    """The run waits for this, even when everything else is done."""


class VirtualRun:
    """One run on the virtual clock."""

    def __init__(self, stage: Stage, out: Path, crew: Crew, view: LiveView) -> None:
        """Take the stage; nothing runs yet."""
        scenario = stage.scenario
        self.stage, self.scenario, self.out = stage, scenario, out
        self.crew, self.view = crew, view
        self.roster = list(scenario.robots)
        self.limit_ns = from_s(scenario.limit_s)
        self.conductor = Conductor(lookahead_ns(scenario), self.limit_ns)
        self.records = Records(self.roster)
        self.motions = Motions()
        self.actors = {name: Actor(name, scenario.robots[name].role) for name in self.roster}
        self.link_events: list[int] = []
        self.first_grant_s = 0.0
        self.tracks: dict[str, list[tuple[float, float]]] = {name: [] for name in self.roster}
        self._segments: dict[str, list[Any]] = {name: [] for name in self.roster}
        self._news: dict[str, Grant] = {}
        self._counts: dict[str, int] = {}
        self._finals: dict[str, dict[str, Any]] = {}
        self._agenda: list[Appointment] = []
        self._over = ""

    # --- the agenda -----------------------------------------------------------------------

    def _at(self, t_ns: int, act: Callable[[], None], *, holds_end: bool = False) -> None:
        order = len(self._agenda) + self.conductor.rounds * 1000
        heapq.heappush(self._agenda, Appointment(t_ns, order, act, holds_end))

    def _make_agenda(self) -> None:
        joining = {e.target for e in self.scenario.events if e.kind == "join"}
        for name, robot in self.scenario.robots.items():
            if robot.join_s:
                self._at(from_s(robot.join_s), self._joiner(name), holds_end=True)
            elif name in joining:
                self.actors[name].state = "waiting"
            if robot.join_s:
                self.actors[name].state = "waiting"
        for index, event in enumerate(self.scenario.timeline()):
            holds = event.kind not in ("kill", "stop")
            self._at(from_s(event.at_s), self._happening(index, event), holds_end=holds)
        self._at(from_s(SAMPLE_S / 2), self._check)

    def _joiner(self, name: str) -> Callable[[], None]:
        return lambda: self._launch([name])

    def _happening(self, index: int, event: Event) -> Callable[[], None]:
        def act() -> None:
            name = event.target
            self._note(name, event.kind, "" if event.kind != "link" else str(event.link_change()))
            match event.kind:
                case "kill":
                    self._kill(name, "killed")
                case "stop":
                    self._stop(name)
                case "resume":
                    self._resume(name)
                case "restart":
                    assert event.after_s is not None
                    self._kill(name, "killed")
                    back_ns = self.conductor.now_ns + from_s(event.after_s)
                    self._at(back_ns, self._joiner(name), holds_end=True)
                case "join":
                    self._launch([name])
                case "link":
                    self.link_events.append(index)
                    self._tell_all(("link", index))

        return act

    def _note(self, name: str, what: str, detail: str = "") -> None:
        self.records.add(EventRow(to_s(self.conductor.now_ns), name, what, detail))

    # --- what happens to robots --------------------------------------------------------------

    def _plan(self, name: str) -> Plan:
        now_ns = self.conductor.now_ns
        actor = self.actors[name]
        born_before = actor.lives > 0
        return Plan(
            scenario=self.scenario,
            name=name,
            terrain=self.stage.terrain,
            starts=self.stage.starts,
            goal_m=self.stage.goal_m,
            folder=self.out,
            start_ns=now_ns,
            pose=self.motions.pose_at(name, now_ns) if born_before else None,
            tether_m=self.motions.tether_at(name, now_ns) if born_before else None,
            first_number=actor.next_number,
            baseline=dict(self._counts),
            segments=tuple(w for mate in self.roster for w in self._segments[mate]),
            link_events=tuple(self.link_events),
        )

    def _launch(self, names: list[str]) -> None:
        """Bring robots to life now, and wait until they are up."""
        now_s = to_s(self.conductor.now_ns)
        plans = [self._plan(name) for name in names]
        for name in names:
            actor = self.actors[name]
            if actor.down_since_s is not None:
                self.records.add_downtime(name, actor.down_since_s, now_s)
                actor.down_since_s = None
            actor.state = "alive"
            actor.lives += 1
            self._news[name] = Grant(0)
            self.conductor.join(name, self.conductor.now_ns)
            self.conductor.members[name].running = True
        self.crew.launch(plans)
        self._collect()

    def _kill(self, name: str, state: str) -> None:
        if name in self.conductor.members:
            self.crew.kill(name)
            self._buried(name, state)

    def _buried(self, name: str, state: str) -> None:
        """Put on record that a robot is gone, and tell the others that it moves no more."""
        now_ns = self.conductor.now_ns
        self.conductor.leave(name)
        self._news.pop(name, None)
        actor = self.actors[name]
        actor.state = state
        actor.down_since_s = to_s(now_ns)
        self._cut_short(actor, now_ns)
        self.motions.freeze(name, now_ns)
        self._tell_all(("freeze", name, now_ns))

    def _cut_short(self, actor: Actor, now_ns: int) -> None:
        """A frame that is in the air when its sender goes silent is lost."""
        last = actor.last_tx
        if last is not None and from_s(last.end_s) >= now_ns:
            self.records.add_cut(actor.name, last.seq, to_s(now_ns))

    def _stop(self, name: str) -> None:
        if name in self.conductor.members:
            self.conductor.stop(name)
            self.crew.stop(name)
            self.actors[name].state = "stopped"
            self.actors[name].down_since_s = to_s(self.conductor.now_ns)
            self._cut_short(self.actors[name], self.conductor.now_ns)

    def _resume(self, name: str) -> None:
        if name in self.conductor.members:
            self.crew.resume(name)
            self.conductor.resume(name)
            self.actors[name].state = "alive"
            self.actors[name].down_since_s = None

    def _tell_all(self, command: tuple[Any, ...]) -> None:
        for grant in self._news.values():
            grant.commands.append(command)

    # --- time ---------------------------------------------------------------------------------

    def play(self) -> None:
        """Run until the mission is over and the maps have settled, or to the limit."""
        self._make_agenda()
        for name in self.roster:
            if self.actors[name].state == "waiting":
                self.actors[name].down_since_s = 0.0
        self._launch([n for n in self.roster if self.actors[n].state != "waiting"])
        self.first_grant_s = time.perf_counter()
        while not self._over:
            self._step()
        self._finish()

    def interrupt(self) -> None:
        """End the run at the next instant, in order."""
        self._over = self._over or "interrupted"

    def _step(self) -> None:
        barrier_ns = min(self._agenda[0].t_ns, self.limit_ns) if self._agenda else self.limit_ns
        window = self.conductor.open_window(barrier_ns)
        if window is None:
            self._barrier()
            return
        for name in window.members:
            self._grant(name, window.end_ns)
        self._collect()
        self.view.update(self._snapshot())

    def _barrier(self) -> None:
        """Do what is due at this instant."""
        now_ns = self.conductor.now_ns
        while self._agenda and self._agenda[0].t_ns <= now_ns and not self._over:
            heapq.heappop(self._agenda).act()
        if not self._over and now_ns >= self.limit_ns:
            self._over = "limit"
        if not self._over and not self.conductor.members and not self._held():
            self._over = "nobody left"

    def _held(self) -> bool:
        return any(appointment.holds_end for appointment in self._agenda)

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
            told = self.crew.next_report(waiting)
            if isinstance(told, Obituary):
                if told.name in self.conductor.members:
                    self._note(told.name, "died", told.reason)
                    self.actors[told.name].death = told.reason
                    self._buried(told.name, "killed")
            else:
                self._take(told)

    def _take(self, told: Report) -> None:
        actor = self.actors[told.name]
        self._counts[f"{told.name}#{told.incarnation}"] = told.sent
        urgent = [(receiver, t_ns) for receiver, t_ns in told.urgent]
        self.conductor.report(told.name, told.next_ns, told.sent, urgent)
        for wire in told.segments:
            segment = Segment.from_wire(wire)
            self.motions.add(segment)
            way = self.tracks[told.name]
            way.extend((p.x_m, p.y_m) for p in (segment.start, segment.end))
            kept = self._segments[told.name]
            kept.append(wire)
            del kept[:-KEPT_SEGMENTS]
        for mate, grant in self._news.items():
            if mate != told.name:
                grant.segments.extend(told.segments)
        for wire in told.rows:
            row = from_wire(wire)
            self.records.add(row)
            actor.learn(row)
        for number, t_s in told.cuts:
            self.records.add_cut(told.name, number, t_s)
        if told.status:
            actor.status = told.status
        if told.fault:
            actor.fault = told.fault
            self._over = self._over or "fault"
        if told.final is not None:
            self._finals[told.name] = told.final

    # --- the end --------------------------------------------------------------------------------

    def _check(self) -> None:
        """See, every few seconds of simulated time, whether everything is done."""
        if not self._held() and self._settled():
            self._over = "settled"
        else:
            self._at(self.conductor.now_ns + from_s(SAMPLE_S), self._check)

    def _settled(self) -> bool:
        alive = [self.actors[name] for name in self.conductor.members]
        running = [a for a in alive if a.state == "alive"]
        if not running or not all(a.status.get("settled") for a in running):
            return False
        changes = [self.scenario.timeline()[i].link_change() for i in self.link_events]

        def hear_each_other(a: str, b: str) -> bool:
            both = ((a, b), (b, a))
            return all(resolve(self.scenario.links, x, y, changes).carries for x, y in both)

        return all(
            a.status["digest"] == b.status["digest"]
            for i, a in enumerate(running)
            for b in running[i + 1 :]
            if hear_each_other(a.name, b.name)
        )

    def _finish(self) -> None:
        """Let every robot that still runs end in order, at this very instant."""
        end_ns = self.conductor.now_ns
        for name in list(self.conductor.members):
            if self.conductor.members[name].stopped:
                self.crew.kill(name)
                self.conductor.leave(name)
                continue
            self.conductor.members[name].running = True
            self._grant(name, end_ns, ("finish",))
        self._collect()
        for actor in self.actors.values():
            if actor.down_since_s is not None:
                self.records.add_downtime(actor.name, actor.down_since_s)

    def finals(self) -> list[RobotFinal]:
        """Return how each robot ended."""
        return [self.actors[name].final(self._finals.get(name)) for name in self.roster]

    @property
    def ending(self) -> str:
        """Why the run ended: settled, limit, fault, interrupted or nobody left."""
        return self._over

    def _snapshot(self) -> Snapshot:
        now_s = to_s(self.conductor.now_ns)
        return Snapshot(
            now_s,
            self.scenario.limit_s,
            tuple(actor.now(now_s) for actor in self.actors.values()),
        )


# --- the whole of it -------------------------------------------------------------------------------


def run(
    scenario: Scenario, out: Path, *, quiet: bool = False, overwrite: bool = False
) -> RunResult:
    """Run a scenario and write its records to `out`.

    Raises:
        WorldError: the scenario's terrain can't be used; nothing was written.
        FolderError: `out` can't be written to.
        KeyboardInterrupt: Ctrl-C; the records up to then were written.
        RobotFault: a robot's own program failed; the records up to then were written.

    """
    started_s = time.perf_counter()
    title = scenario.title or scenario.name
    view = LiveView(title, quiet=quiet)
    compile_s = _compile(view)
    if scenario.air == "zenoh":
        start_fork_server()
    stage = set_stage(scenario)
    folder.prepare(out, overwrite=overwrite)
    write_atomic(out / "scenario.toml", dump(scenario))
    crew: Crew = ZenohCrew() if scenario.air == "zenoh" else MemoryCrew()
    play = VirtualRun(stage, out, crew, view)
    with view, _ctrl_c(play.interrupt):
        try:
            play.play()
        finally:
            crew.close()
    return _write_up(play, view, started_s + compile_s, compile_s)


@contextlib.contextmanager
def _ctrl_c(interrupt: Callable[[], None]) -> Iterator[None]:
    """Have the first Ctrl-C end the run in order; a second one ends it at once."""

    def asked(number: int, frame: object) -> None:
        del number, frame
        signal.signal(signal.SIGINT, signal.default_int_handler)
        interrupt()

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, asked)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _write_up(play: VirtualRun, view: LiveView, started_s: float, compile_s: float) -> RunResult:
    """Write all records of a run that has ended, and say what came out."""
    stage, out = play.stage, play.out
    simulated_s = to_s(play.conductor.now_ns)
    finals = play.finals()
    ending = conclude(stage.scenario, list(play.actors.values()), play.ending, simulated_s)
    summary = summarise(stage.scenario, play.records, finals, stage.truth, ending)
    play.records.write(out)
    write_json(out / "summary.json", summary)
    draw(
        out / "overview.png",
        Overview(
            title=stage.scenario.title or stage.scenario.name,
            summary=summary,
            frame=stage.terrain.frame,
            truth=stage.truth,
            robots=finals,
            records=play.records,
            tracks_m={name: np.array(way).reshape(-1, 2) for name, way in play.tracks.items()},
            goal_m=stage.goal_m,
        ),
    )
    costs = {name: ProcessCost(c.cpu_s, c.peak_memory_bytes) for name, c in play.crew.costs.items()}
    costs["runner"] = ProcessCost(cpu_s(), peak_bytes())
    host = HostCost(
        wall_s=time.perf_counter() - started_s,
        compile_s=compile_s,
        startup_s=play.first_grant_s - started_s,
        grants=play.conductor.grants,
        processes=costs,
    )
    write_json(out / "host.json", host_facts(host))
    view.say(report(summary, play.records, out))
    for actor in play.actors.values():
        if actor.fault:
            raise RobotFault(actor.name, actor.fault)
    if play.ending == "interrupted":
        raise KeyboardInterrupt
    return RunResult(ending.outcome, summary, out)


class RobotFault(Exception):
    """A robot's own program failed: a fault of ours."""

    def __init__(self, name: str, trace: str) -> None:
        """Name the robot, and keep its traceback."""
        super().__init__(f"{name}'s program failed:\n{trace}")


def _compile(view: LiveView) -> float:
    """Compile the kernels, where this source was never run on this machine."""
    if kernels.is_warm(ROOT):
        return 0.0
    view.say("Compiling kernels: once on this machine, about a minute ...")
    import scenarios.preload  # noqa: F401, PLC0415  (it warms them all)

    seconds = kernels.warm_all()
    kernels.mark_warm(ROOT)
    return seconds
