"""One run as the runner sees it, whatever the clock: what happens when, and when it is over.

`play.virtual` and `play.realtime` say how time passes.
"""

import itertools
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

from comms.profiles import resolve
from comms.timebase import from_s, to_s
from scenarios.crews.crew import Crew
from scenarios.live import LiveView, Snapshot
from scenarios.play.agenda import Agenda
from scenarios.play.fates import Fates
from scenarios.records.tables import write_atomic
from scenarios.schema import dump
from scenarios.schema.events import Event
from scenarios.stage import Stage
from scenarios.view.desk import Desk
from scenarios.view.hand import Deed, DeedError, event_of, instant_ns, plain_events, with_event

CHECK_S = 5.0
"""How often it is looked at whether the mission is over."""


class Play(Fates):
    """One run."""

    desk: Desk | None = None
    """Where those who watch it ask for something, if anybody does."""

    def __init__(self, stage: Stage, out: Path, crew: Crew, view: LiveView) -> None:
        """Take the stage; nothing runs yet."""
        super().__init__(stage, out, crew)
        self.view = view
        self.limit_ns = from_s(stage.scenario.limit_s)
        self.agenda = Agenda()
        self.first_grant_s = 0.0
        """Performance counter when the robots were let go."""
        self.over_s = 0.0
        """Performance counter when all robots had ended."""
        self.launch_s = 0.0
        """Wall seconds from the order to start the first robots until all were up."""
        self.grants = 0
        """Windows of virtual time that were granted."""

    @abstractmethod
    def play(self) -> None:
        """Run until the mission is over and the maps have settled, or to the limit."""

    def interrupt(self) -> None:
        """End the run at the next instant, in order."""
        self.ending = self.ending or "interrupted"

    # --- the agenda -----------------------------------------------------------------------

    def at(self, t_ns: int, act: Callable[[], None], *, holds_end: bool = False) -> None:
        """Have something done at an instant; the run waits for it if it `holds_end`."""
        self.agenda.at(t_ns, act, holds_end=holds_end)

    def next_appointment_ns(self) -> int:
        """Return when something is due, or the limit."""
        next_ns = self.agenda.next_ns
        return self.limit_ns if next_ns is None else min(next_ns, self.limit_ns)

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
        while not self.ending and (act := self.agenda.pop_due(self.now_ns)) is not None:
            act()
        if not self.ending and self.now_ns >= self.limit_ns:
            self.ending = "limit"
        if not self.ending and not self._news and not self.agenda.holds_end:
            self.ending = "nobody left"

    def _joiner(self, name: str) -> Callable[[], None]:
        def act() -> None:
            if name not in self._news:  # of two restarts the shorter brings it back
                self.bring_up([name])

        return act

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
        at_ns = instant_ns(self.reached_ns(), self.agenda.instants_ns())
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

    # --- the end --------------------------------------------------------------------------------

    def _check(self) -> None:
        """See, every few seconds of simulated time, whether everything is done."""
        if self.scenario.ends == "descent" and self._descended():
            self.ending = "descended"
        elif not self.agenda.holds_end and self._settled():
            self.ending = "settled"
        else:
            self.at(self.now_ns + from_s(CHECK_S), self._check)

    def _descended(self) -> bool:
        """Say whether the Cliff-bots are down, or stay."""
        bots = [actor for actor in self.actors.values() if actor.role == "cliffbot"]
        last = {event.what for bot in bots for event in bot.events}
        return bool(last & {"reached", "stuck"})

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
