"""One run as the runner sees it, whatever the clock: agenda, robots' fates, reports, the end.

`scenarios.virtual` and `scenarios.realtime` say how time passes.
"""

import heapq
import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from comms.profiles import resolve
from comms.timebase import from_s, to_s
from scenarios.crew import Crew, Obituary
from scenarios.ending import Actor
from scenarios.events import Event
from scenarios.ledger import Ledger
from scenarios.live import LiveView, Snapshot
from scenarios.record import EventRow, Records, Row, from_wire, write_atomic
from scenarios.schema import dump
from scenarios.stage import Stage
from scenarios.summary import RobotFinal
from scenarios.view.desk import Desk
from scenarios.view.hand import Deed, DeedError, event_of, instant_ns, plain_events, with_event
from scenarios.view.reel import Reel
from scenarios.wire import Grant, Plan, Report
from sim.motion import Motions, Segment

KEPT_SEGMENTS = 64
"""Motion of each robot that a latecomer is told."""

CHECK_S = 5.0
"""How often it is looked at whether the mission is over."""


@dataclass(order=True)
class Appointment:
    """Something that happens at an instant; of one instant, in the order in which it was made."""

    t_ns: int
    order: int
    act: Callable[[], None] = field(compare=False)
    holds_end: bool = field(compare=False, default=False)
    """The run waits for this, even when everything else is done."""


class Play(ABC):
    """One run."""

    keeps_logs = True
    """Whether each robot writes its own log."""
    ledger: Ledger | None = None
    """What the team's sensors measured, where it is kept."""
    reel: Reel | None = None
    """What a page is shown of the run, where that is kept."""
    desk: Desk | None = None
    """Where those who watch it ask for something, if anybody does."""

    def __init__(self, stage: Stage, out: Path, crew: Crew, view: LiveView) -> None:
        """Take the stage; nothing runs yet."""
        scenario = stage.scenario
        self.stage, self.scenario, self.out = stage, scenario, out
        self.crew, self.view = crew, view
        self.roster = list(scenario.robots)
        self.limit_ns = from_s(scenario.limit_s)
        self.records = Records(self.roster)
        self.motions = Motions()
        self.actors = {name: Actor(name, scenario.robots[name].role) for name in self.roster}
        self.tracks: dict[str, list[tuple[float, float]]] = {name: [] for name in self.roster}
        self.link_events: list[int] = []
        self.trouble_events: list[int] = []
        self.ending = ""
        """Why the run ended: settled, limit, fault, interrupted or nobody left."""
        self.first_grant_s = 0.0
        """Performance counter when the robots were let go."""
        self.launch_s = 0.0
        """Wall seconds from the order to start the first robots until all were up."""
        self.grants = 0
        """Windows of virtual time that were granted."""
        self._segments: dict[str, list[Any]] = {name: [] for name in self.roster}
        self._news: dict[str, Grant] = {}
        """By robot that is there: what it has not been told yet."""
        self._counts: dict[str, int] = {}
        self._finals: dict[str, dict[str, Any]] = {}
        self._agenda: list[Appointment] = []
        self._order = itertools.count()

    @property
    @abstractmethod
    def now_ns(self) -> int:
        """The run's time."""

    @abstractmethod
    def play(self) -> None:
        """Run until the mission is over and the maps have settled, or to the limit."""

    @abstractmethod
    def bring_up(self, names: list[str]) -> None:
        """Bring robots to life now."""

    def interrupt(self) -> None:
        """End the run at the next instant, in order."""
        self.ending = self.ending or "interrupted"

    # --- the agenda -----------------------------------------------------------------------

    def at(self, t_ns: int, act: Callable[[], None], *, holds_end: bool = False) -> None:
        """Have something done at an instant; the run waits for it if it `holds_end`."""
        heapq.heappush(self._agenda, Appointment(t_ns, next(self._order), act, holds_end))

    def next_appointment_ns(self) -> int:
        """Return when something is due, or the limit."""
        return min(self._agenda[0].t_ns, self.limit_ns) if self._agenda else self.limit_ns

    def open_agenda(self) -> list[str]:
        """Put all that the scenario knows on the agenda; return who is there from the start."""
        for name in self.roster:
            join_s = self.scenario.joins_s(name)
            if join_s:
                self.actors[name].state = "waiting"
                self.actors[name].down_since_s = 0.0
            if self.scenario.robots[name].join_s:
                self.at(from_s(join_s), self._joiner(name), holds_end=True)
        for event in self.scenario.timeline():
            self._plan_event(event)
        self.at(from_s(CHECK_S / 2), self._check)
        return [name for name in self.roster if self.actors[name].state != "waiting"]

    def keep_appointments(self) -> None:
        """Do what is due by now, and see whether the run is over."""
        while self._agenda and self._agenda[0].t_ns <= self.now_ns and not self.ending:
            heapq.heappop(self._agenda).act()
        if not self.ending and self.now_ns >= self.limit_ns:
            self.ending = "limit"
        if not self.ending and not self._news and not self._held():
            self.ending = "nobody left"

    def _held(self) -> bool:
        return any(appointment.holds_end for appointment in self._agenda)

    def _joiner(self, name: str) -> Callable[[], None]:
        return lambda: self.bring_up([name])

    def _plan_event(self, event: Event) -> None:
        holds = event.kind in ("resume", "restart", "join", "link")
        self.at(from_s(event.at_s), self._happening(event), holds_end=holds)

    def _happening(self, event: Event) -> Callable[[], None]:
        def act() -> None:
            timeline = self.scenario.timeline()
            index = next((i for i, planned in enumerate(timeline) if planned is event), None)
            if index is None:
                return  # what was done by hand has made it impossible
            name = event.target
            self.note(name, event.kind, event.detail)
            match event.kind:
                case "kill":
                    self._kill(name)
                case "stop":
                    self.stop(name)
                case "resume":
                    self.resume(name)
                case "restart":
                    assert event.after_s is not None
                    self._kill(name)
                    back_ns = self.now_ns + from_s(event.after_s)
                    self.at(back_ns, self._joiner(name), holds_end=True)
                case "join":
                    self.bring_up([name])
                case "leave":
                    self.leave(name)
                case "link":
                    self.link_events.append(index)
                    self._tell_all(("link", index))
                case _:
                    self.trouble_events.append(index)
                    self._tell_all(("trouble", index))

        return act

    # --- what people do by hand -------------------------------------------------------------

    def due_ns(self) -> int | None:
        """Return when the next window begins; None on the wall clock."""
        return None

    def reached_ns(self) -> int:
        """Return the instant up to which robots may have run."""
        return self.now_ns

    def by_hand(self, deed: Deed, robot: str) -> int:
        """Do something to a robot as soon as can be, and put it into the run's `scenario.toml`.

        Returns the instant at which it happens.

        Raises:
            DeedError: it can't happen now.

        """
        if robot not in self.scenario.robots or self.ending:
            raise DeedError(f"{robot}: is not there any more")
        at_ns = instant_ns(self.reached_ns(), [appointment.t_ns for appointment in self._agenda])
        event = event_of(deed, robot, at_ns)
        self.scenario = with_event(self.scenario, event)
        self._tell_all(("events", plain_events(self.scenario)))
        self._plan_event(event)
        write_atomic(self.out / "scenario.toml", dump(self.scenario))
        return at_ns

    def attend(self) -> None:
        """Attend to those who watch, between two windows."""
        if self.desk is not None:
            self.desk.attend(self, self.due_ns())

    def note(self, name: str, what: str, detail: str = "") -> None:
        """Put something that happened on record."""
        self.add_row(EventRow(to_s(self.now_ns), name, what, detail))

    def add_row(self, row: Row) -> None:
        """Put a row on record."""
        self.records.add(row)
        if self.reel is not None:
            self.reel.row(row)

    # --- what happens to robots --------------------------------------------------------------

    def plans(self, names: list[str]) -> list[Plan]:
        """Return what robots are told that start now, and expect them."""
        plans = [self._plan(name) for name in names]
        for name in names:
            self._up_again(name)
            self.actors[name].lives += 1
            self._news[name] = Grant(0)
        return plans

    def _plan(self, name: str) -> Plan:
        now_ns = self.now_ns
        actor = self.actors[name]
        born_before = actor.lives > 0
        return Plan(
            scenario=self.scenario,
            name=name,
            terrain=self.stage.terrain,
            observable=self.stage.truth.observable,
            starts=self.stage.starts,
            goal_m=self.stage.goal_m,
            landmarks=self.stage.landmarks,
            folder=self.out,
            start_ns=now_ns,
            pose=self.motions.pose_at(name, now_ns) if born_before else None,
            tether_m=self.motions.tether_at(name, now_ns) if born_before else None,
            first_number=actor.next_number,
            baseline=dict(self._counts),
            segments=tuple(w for mate in self.roster for w in self._segments[mate]),
            link_events=tuple(self.link_events),
            trouble_events=tuple(self.trouble_events),
            keeps_log=self.keeps_logs,
            keeps_ledger=self.ledger is not None,
            keeps_growth=self.reel is not None,
        )

    def _up_again(self, name: str) -> None:
        actor = self.actors[name]
        if actor.down_since_s is not None:
            self.records.add_downtime(name, actor.down_since_s, to_s(self.now_ns))
            actor.down_since_s = None
        actor.state = "alive"
        self._tell_state(name)

    def _tell_state(self, name: str) -> None:
        if self.reel is not None:
            self.reel.state(name, to_s(self.now_ns), self.actors[name].state)

    def _kill(self, name: str) -> None:
        if name in self._news:
            self.crew.kill(name)
            self.bury(name)

    @abstractmethod
    def leave(self, name: str) -> None:
        """Let a robot end its work in order, now."""

    def bury(self, name: str, state: str = "killed") -> None:
        """Put on record that a robot is gone, and tell the others that it moves no more."""
        del self._news[name]
        self._down(name, state)
        self.motions.freeze(name, self.now_ns)
        if self.reel is not None:
            self.reel.freeze(name, self.now_ns)
        self._tell_all(("freeze", name, self.now_ns))

    def _down(self, name: str, state: str) -> None:
        """Note that a robot runs no more; a frame that it has in the air is lost."""
        actor = self.actors[name]
        actor.state = state
        actor.down_since_s = to_s(self.now_ns)
        self._tell_state(name)
        last = actor.last_tx
        if last is not None and from_s(last.end_s) >= self.now_ns:
            self.records.add_cut(name, last.seq, to_s(self.now_ns))

    def stop(self, name: str) -> None:
        """Hang a robot."""
        if name in self._news:
            self.crew.stop(name)
            self._down(name, "stopped")

    def resume(self, name: str) -> None:
        """Let a hung robot go on."""
        if name in self._news:
            self.crew.resume(name)
            self._up_again(name)

    def _tell_all(self, command: tuple[Any, ...]) -> None:
        for grant in self._news.values():
            grant.commands.append(command)

    # --- reports --------------------------------------------------------------------------------

    def take(self, told: Report | Obituary) -> None:
        """Take in what a robot reports, or that it died."""
        if told.name not in self._news:
            return
        if isinstance(told, Obituary):
            self.note(told.name, "died", told.reason)
            self.actors[told.name].death = told.reason
            self.bury(told.name)
            return
        self._counts[f"{told.name}#{told.incarnation}"] = told.sent
        self._take_segments(told)
        self._take_rows(told)
        if self.ledger is not None:
            self.ledger.add(told.name, told.measured)
        if self.reel is not None:
            self.reel.take(told)
        actor = self.actors[told.name]
        if told.status:
            actor.status = told.status
        if told.fault:
            actor.fault = told.fault
            self.ending = self.ending or "fault"
        if told.final is not None:
            self._finals[told.name] = told.final

    def _take_segments(self, told: Report) -> None:
        kept, way = self._segments[told.name], self.tracks[told.name]
        for wire in told.segments:
            segment = Segment.from_wire(wire)
            self.motions.add(segment)
            way.extend((p.x_m, p.y_m) for p in (segment.start, segment.end))
            kept.append(wire)
        del kept[:-KEPT_SEGMENTS]
        for mate, grant in self._news.items():
            if mate != told.name:
                grant.segments.extend(told.segments)

    def _take_rows(self, told: Report) -> None:
        for wire in told.rows:
            row = from_wire(wire)
            self.add_row(row)
            self.actors[told.name].learn(row)
        for number, t_s in told.cuts:
            self.records.add_cut(told.name, number, t_s)

    # --- the end --------------------------------------------------------------------------------

    def _check(self) -> None:
        """See, every few seconds of simulated time, whether everything is done."""
        if not self._held() and self._settled():
            self.ending = "settled"
        else:
            self.at(self.now_ns + from_s(CHECK_S), self._check)

    def _settled(self) -> bool:
        """Say whether all are done, and those who hear each other have the same maps."""
        running = [self.actors[name] for name in self._news if self.actors[name].state == "alive"]
        if not running or not all(a.status.get("settled") for a in running):
            return False
        changes = [self.scenario.timeline()[i].link_change() for i in self.link_events]

        def hear_each_other(a: str, b: str) -> bool:
            both = ((a, b), (b, a))
            return all(resolve(self.scenario.links, x, y, changes).carries for x, y in both)

        return all(
            a.status["digest"] == b.status["digest"]
            for a, b in itertools.combinations(running, 2)
            if hear_each_other(a.name, b.name)
        )

    def close_records(self) -> None:
        """Put the rest on record once all robots have ended."""
        for actor in self.actors.values():
            if actor.down_since_s is not None:
                self.records.add_downtime(actor.name, actor.down_since_s)

    def finals(self) -> list[RobotFinal]:
        """Return how each robot ended."""
        return [self.actors[name].final(self._finals.get(name)) for name in self.roster]

    def final_facts_of_clock(self) -> dict[str, Any]:
        """Return what the clock's own kind of run adds to `host.json`."""
        return {}

    def show(self) -> None:
        """Show the present moment to whoever watches."""
        if self.view.quiet:
            return
        now_s = to_s(self.now_ns)
        robots = tuple(actor.now(now_s) for actor in self.actors.values())
        self.view.update(Snapshot(now_s, self.scenario.limit_s, robots))
