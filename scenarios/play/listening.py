"""What robots report while a run goes on: rows, motion, what their sensors measured, their end."""

from abc import ABC, abstractmethod
from typing import Any

from comms.timebase import to_s
from scenarios.crews.crew import Obituary
from scenarios.play.actor import Actor
from scenarios.records.summary import RobotFinal
from scenarios.records.tables import EventRow, Records, Row, from_wire
from scenarios.schema import Scenario
from scenarios.scores.ledger import Ledger
from scenarios.view.reel import Reel
from scenarios.wire import Grant, Report
from sim.motion import Motions, Segment

KEPT_SEGMENTS = 64
"""Motion of each robot that a latecomer is told."""


class Listening(ABC):
    """A run as it is known from its robots' reports."""

    ledger: Ledger | None = None
    """What the team's sensors measured, where it is kept."""
    reel: Reel | None = None
    """What a page is shown of the run, where that is kept."""

    def __init__(self, scenario: Scenario) -> None:
        """Know the robots' names and roles; nothing was heard yet."""
        self.scenario = scenario
        self.roster = list(scenario.robots)
        self.records = Records(self.roster)
        self.motions = Motions()
        self.actors = {name: Actor(name, scenario.robots[name].role) for name in self.roster}
        self.tracks: dict[str, list[tuple[float, float]]] = {name: [] for name in self.roster}
        self.ending = ""
        """Why the run ended: settled, limit, fault, interrupted or nobody left."""
        self._segments: dict[str, list[Any]] = {name: [] for name in self.roster}
        self._news: dict[str, Grant] = {}
        """By robot that is there: what it has not been told yet."""
        self._counts: dict[str, int] = {}
        """Packets sent, by robot and incarnation."""
        self._finals: dict[str, dict[str, Any]] = {}

    @property
    @abstractmethod
    def now_ns(self) -> int:
        """The run's time."""

    @abstractmethod
    def bury(self, name: str, state: str = "killed") -> None:
        """Put on record that a robot is gone, and tell the others that it moves no more."""

    def note(self, name: str, what: str, detail: str = "") -> None:
        """Put something that happened on record."""
        self.add_row(EventRow(to_s(self.now_ns), name, what, detail))

    def add_row(self, row: Row) -> None:
        """Put a row on record."""
        self.records.add(row)
        if self.reel is not None:
            self.reel.row(row)

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

    def close_records(self) -> None:
        """Put the rest on record once all robots have ended."""
        for actor in self.actors.values():
            if actor.down_since_s is not None:
                self.records.add_downtime(actor.name, actor.down_since_s)

    def finals(self) -> list[RobotFinal]:
        """Return how each robot ended."""
        return [self.actors[name].final(self._finals.get(name)) for name in self.roster]
