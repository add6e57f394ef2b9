"""What a scenario is: the settings of all rooms, a team, and what happens to it.

Keys are defined beside the code that reads them (`agents.settings`, `sim.terrain`,
`comms.profiles`); this file composes them and checks what concerns more than one.
"""

from functools import cached_property
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from agents.settings import (
    DriveSettings,
    MapSettings,
    PlannerSettings,
    SensorSettings,
    SharingSettings,
    TetherSettings,
)
from comms.linksettings import LinkChange, TeamLinks
from comms.profiles import least_latency_ns
from comms.settings import Settings
from scenarios.schema.checks import CHECKS, check_turns
from scenarios.schema.events import Event, check_events, in_order
from scenarios.schema.problems import refuse
from scenarios.schema.team import MAX_ROBOTS, RobotSettings
from sim.settings import WorldSettings

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,31}$")]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


class ClockSettings(Settings):
    """Which clock the robots live by."""

    mode: Literal["virtual", "real"] = "virtual"
    """Virtual: simulated time, as fast as it goes; real: the wall clock."""
    speed: Annotated[float, Field(gt=0, le=1000)] = 1.0
    """Simulated seconds to one wall second, on the real clock."""


class Scenario(Settings):
    """One study: a team, its world, its radios, and what happens."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    """Letters, digits, '.', '-' and '_', at most 64; the run's folder is called after it."""
    title: str = ""
    """One line for people."""
    seed: Seed = 1
    """Of all randomness."""
    limit_s: Annotated[float, Field(gt=0, le=2_592_000)]
    """Simulated time at which the run ends at the latest."""
    ends: Literal["maps", "descent"] = "maps"
    """When it is over: when all are done and their maps have settled, or as soon as the Cliff-bot
    is down, or has said that it stays."""
    sample_s: Annotated[float, Field(ge=0.1, le=60)] = 5.0
    """How often each robot's map is weighed for the record, in simulated seconds."""
    air: Literal["zenoh", "memory"] = "zenoh"
    """Zenoh: one process per robot; memory: all in one process."""
    method: str = "information-interest"
    """How the mappers choose their next look."""
    clock: ClockSettings = ClockSettings()
    world: WorldSettings = WorldSettings()
    map: MapSettings = MapSettings()
    sensor: SensorSettings = SensorSettings()
    drive: DriveSettings = DriveSettings()
    planner: PlannerSettings = PlannerSettings()
    sharing: SharingSettings = SharingSettings()
    tether: TetherSettings = TetherSettings()
    links: TeamLinks = TeamLinks()
    robots: Annotated[dict[Name, RobotSettings], Field(min_length=1, max_length=MAX_ROBOTS)]
    """By name; in a file also `count` (and `role`) for explorer-1, explorer-2 ..."""
    events: tuple[Event, ...] = ()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        refuse([conflict for check in CHECKS for conflict in check(self)])
        joins_s = {name: robot.join_s or 0.0 for name, robot in self.robots.items()}
        refuse(check_events(self.events, joins_s, self.limit_s))
        refuse(check_turns(self))
        return self

    def joins_s(self, name: str) -> float:
        """Return when a robot starts: with the others, at its `join_s`, or by an event."""
        by_event = [e.at_s for e in self.events if e.kind == "join" and e.target == name]
        return by_event[0] if by_event else self.robots[name].join_s or 0.0

    def timeline(self) -> list[Event]:
        """Return the events by time, those of one moment in the order of the file."""
        return in_order(self.events)

    def link_changes(self) -> list[LinkChange]:
        """Return all changes of links, by time."""
        return [event.link_change() for event in self.timeline() if event.kind == "link"]

    @cached_property
    def lookahead_ns(self) -> int:
        """The least latency of any link at any stage: nothing travels faster."""
        return least_latency_ns(self.links, list(self.robots), self.link_changes())
