"""What a scenario is: the settings of all rooms, a team, and what happens to it.

Keys are defined beside the code that reads them (`agents.settings`, `sim.terrain`,
`comms.profiles`); this file composes them and checks what concerns more than one.
"""

import json
from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any, Literal, Self, cast

import tomli_w
from pydantic import Field, ValidationError, model_validator

from agents.settings import (
    DriveSettings,
    MapSettings,
    PlannerSettings,
    SensorSettings,
    SharingSettings,
    TetherSettings,
)
from comms.linksettings import LinkChange, TeamLinks
from comms.occupancy.tile import LARGEST_BLOCK
from comms.profiles import least_latency_ns, tightest_turn_ns
from comms.settings import Settings
from comms.timebase import to_s
from scenarios.choices import choices
from scenarios.errors import ScenarioError
from scenarios.events import Event, check_events, in_order, no_such_robot
from scenarios.files import place_files
from scenarios.overrides import Override, apply_overrides, parse_override
from scenarios.problems import Conflict, plain, refuse, sentences
from scenarios.shelf import find, read
from sim.settings import RecordingSettings, WorldSettings

MAX_ROBOTS = 64
"""The largest team that the runner was tried with."""

Role = Literal["recon", "cliffbot", "anchor", "explorer"]
MAPPERS: tuple[Role, ...] = ("recon", "explorer")
"""Roles that map: they have a camera."""

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,31}$")]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


class ClockSettings(Settings):
    """Which clock the robots live by."""

    mode: Literal["virtual", "real"] = "virtual"
    """Virtual: simulated time, as fast as it goes; real: the wall clock."""
    speed: Annotated[float, Field(gt=0, le=1000)] = 1.0
    """Simulated seconds to one wall second, on the real clock."""


class RobotSettings(Settings):
    """One robot of the team."""

    role: Role
    start: tuple[float, float, float] | None = None
    """x, y (m, world frame) and yaw (degrees, counter-clockwise from east); left out: placed."""
    start_known: bool = True
    """Whether it knows where it starts. One that does not looks for a landmark or a team-mate, and
    nobody takes in its map before."""
    join_s: Annotated[float, Field(ge=0)] | None = None
    """When it starts; left out: with the others."""
    recording: RecordingSettings | None = None
    """Left out: it drives itself."""


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
        checks = (
            _check_team,
            _check_links,
            _check_numbers,
            _check_choices,
            _check_map,
            _check_places,
            _check_recordings,
        )
        refuse([conflict for check in checks for conflict in check(self)])
        joins_s = {name: robot.join_s or 0.0 for name, robot in self.robots.items()}
        refuse(check_events(self.events, joins_s, self.limit_s))
        refuse(_check_turns(self))
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


def expand_team(robots: Any) -> Any:
    """Write `count` (and `role`) out as one table per robot: explorer-1, explorer-2 ...

    Tables of single robots beside them add to the robots so named. What has no `count` is returned
    as it is.

    Raises:
        ValueError: the count or the role is none, or a table names a robot beyond them.

    """
    if not isinstance(robots, dict) or "count" not in robots:
        return cast("Any", robots)
    robots = cast("dict[str, Any]", robots)
    tables = {key: value for key, value in robots.items() if key not in ("count", "role")}
    count, role = robots["count"], robots.get("role", "explorer")
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MAX_ROBOTS:
        raise ValueError(f"count is {count!r}; must be a whole number from 1 to {MAX_ROBOTS}")
    if role not in MAPPERS:
        raise ValueError(f"role is {role!r}; beside count it must be one of {', '.join(MAPPERS)}")
    team: dict[str, Any] = {f"{role}-{number}": {"role": role} for number in range(1, count + 1)}
    strangers = sorted(tables.keys() - team.keys())
    if strangers:
        raise ValueError(f"count is {count}, which makes no robot {strangers[0]}")
    return {name: {**own, **tables.get(name, {})} for name, own in team.items()}


def _check_team(scenario: Scenario) -> list[Conflict]:
    roles = [robot.role for robot in scenario.robots.values()]
    counts = {role: roles.count(role) for role in ("cliffbot", "anchor")}
    conflicts: list[Conflict] = []
    if "all" in scenario.robots:
        conflicts.append(Conflict("robots.all", "all", "is no name: `all` means all robots"))
    if not any(role in MAPPERS for role in roles):
        sentence = f"nobody maps; at least one robot must be one of {', '.join(MAPPERS)}"
        conflicts.append(Conflict("robots", roles, sentence))
    if counts["cliffbot"] > 1:
        conflicts.append(Conflict("robots", roles, "at most one cliffbot is allowed"))
    if counts["anchor"] != 2 * min(counts["cliffbot"], 1):
        sentence = "a cliffbot hangs on two tethers: it needs exactly two anchors, others have none"
        conflicts.append(Conflict("robots", roles, sentence))
    for name, robot in scenario.robots.items():
        if (robot.join_s or 0.0) >= scenario.limit_s:
            sentence = f"must be below limit_s = {plain(scenario.limit_s)}"
            conflicts.append(Conflict(f"robots.{name}.join_s", robot.join_s, sentence))
    return conflicts


def _check_links(scenario: Scenario) -> list[Conflict]:
    team = list(scenario.robots)
    said = [(f"links.robots.{name}", name, (name,)) for name in scenario.links.robots]
    said += [(f"links.pairs.{pair}", pair, tuple(pair.split(">"))) for pair in scenario.links.pairs]
    return [
        Conflict(key, shown, no_such_robot(team))
        for key, shown, names in said
        if not all(name.strip() in team for name in names)
    ]


def _check_turns(scenario: Scenario) -> list[Conflict]:
    """Refuse turns in which not even an urgent frame can be sent, at any stage of the scenario."""
    team, changes = list(scenario.robots), scenario.link_changes()
    tightest = tightest_turn_ns(scenario.links, team, changes)
    if tightest is None or tightest[0] >= tightest[1]:
        return []
    slot_ns, need_ns = tightest
    sentence = (
        f"the shortest frame takes {to_s(need_ns):.6g} s at the slowest rate of the scenario;"
        " a turn must be at least as long"
    )
    return [Conflict("links.slot_s", to_s(slot_ns), sentence)]


def _check_numbers(scenario: Scenario) -> list[Conflict]:
    conflicts: list[Conflict] = []
    clock, sensor = scenario.clock, scenario.sensor
    if clock.mode == "virtual" and clock.speed != 1.0:
        sentence = 'must be 1, unless clock.mode = "real" (--clock real)'
        conflicts.append(Conflict("clock.speed", clock.speed, sentence))
    if clock.mode == "real" and scenario.air == "memory":
        sentence = 'nobody can be hung alone in one process on the wall clock; needs air = "zenoh"'
        conflicts += [
            Conflict(f"events.{index}.{event.kind}", event.target, sentence)
            for index, event in enumerate(scenario.events)
            if event.kind in ("stop", "resume")
        ]
    if clock.mode == "real":
        sentence = "how long thinking takes can only be said on the virtual clock"
        conflicts += [
            Conflict(f"events.{index}.slow", event.target, sentence)
            for index, event in enumerate(scenario.events)
            if event.kind == "slow"
        ]
    if sensor.near_m >= sensor.range_m:
        sentence = f"must be below sensor.range_m = {plain(sensor.range_m)}"
        conflicts.append(Conflict("sensor.near_m", sensor.near_m, sentence))
    return conflicts


def _check_choices(scenario: Scenario) -> list[Conflict]:
    return [
        Conflict(choice.key, choice.name, f"must be one of {', '.join(choice.allowed())}")
        for choice in choices(scenario)
        if not choice.is_allowed
    ]


def _check_places(scenario: Scenario) -> list[Conflict]:
    """Refuse landmarks that can't be told from robots or seen, and starts that can't be unknown."""
    conflicts: list[Conflict] = []
    for name in scenario.world.landmarks:
        if name in scenario.robots:
            conflicts.append(Conflict(f"world.landmarks.{name}", name, "is a robot's name"))
    if scenario.world.landmarks and scenario.map.kind == "planar":
        sentence = "can't be seen by the cameras of planar maps; must be left out"
        conflicts.append(Conflict("world.landmarks", list(scenario.world.landmarks), sentence))
    mappers = [name for name, robot in scenario.robots.items() if robot.role in MAPPERS]
    for name, robot in scenario.robots.items():
        if robot.start_known:
            continue
        key = f"robots.{name}.start_known"
        if robot.role not in MAPPERS or scenario.map.kind == "planar":
            sentence = f"only {' and '.join(MAPPERS)} on rough ground can look where they are"
            conflicts.append(Conflict(key, False, sentence))
        elif name == mappers[0]:
            sentence = "is the team's origin: by definition it knows where it starts"
            conflicts.append(Conflict(key, False, sentence))
    return conflicts


def _check_recordings(scenario: Scenario) -> list[Conflict]:
    """Refuse recordings for robots that need more of a body, or maps that need other looks."""
    conflicts: list[Conflict] = []
    for name, robot in scenario.robots.items():
        if robot.recording is None:
            continue
        key = f"robots.{name}.recording"
        if robot.role not in MAPPERS:
            sentence = f"only {' and '.join(MAPPERS)} can follow a recording"
            conflicts.append(Conflict(key, robot.role, sentence))
        if scenario.map.kind != "elevation":
            sentence = 'a recording can be mapped on map.kind = "elevation" only'
            conflicts.append(Conflict(key, scenario.map.kind, sentence))
        if not robot.start_known:
            sentence = "a recording tells where the robot is: must be true"
            conflicts.append(Conflict(f"robots.{name}.start_known", False, sentence))
    return conflicts


def _check_map(scenario: Scenario) -> list[Conflict]:
    kind, world = scenario.map.kind, scenario.world
    conflicts: list[Conflict] = []
    if kind != "planar" and world.map:
        sentence = 'is a floor: it needs map.kind = "planar"'
        conflicts.append(Conflict("world.map", world.map, sentence))
    if kind != "voxel" and world.cave.file:
        sentence = 'is a world of cubes: it needs map.kind = "voxel"'
        conflicts.append(Conflict("world.cave.file", world.cave.file, sentence))
    if kind == "elevation":
        return conflicts
    roles = [robot.role for robot in scenario.robots.values()]
    if not all(role in MAPPERS for role in roles):
        sentence = f"on a {kind} map every robot must be one of {', '.join(MAPPERS)}"
        conflicts.append(Conflict("robots", roles, sentence))
    if world.terrain.file:
        needs = {"planar": "a floor, world.map", "voxel": "a cave, world.cave.file"}[kind]
        sentence = f"is ground: a {kind} map needs {needs} or none"
        conflicts.append(Conflict("world.terrain.file", world.terrain.file, sentence))
    if kind == "voxel" and scenario.map.tile_cells > LARGEST_BLOCK:
        sentence = f"of cubes at most {LARGEST_BLOCK} cells a side can be sent"
        conflicts.append(Conflict("map.tile_cells", scenario.map.tile_cells, sentence))
    placed = [name for name, robot in scenario.robots.items() if robot.start is not None]
    if kind == "voxel" and placed:
        key, sentence = f"robots.{placed[0]}.start", "is for ground and floors: leave it out"
        conflicts.append(Conflict(key, list(scenario.robots[placed[0]].start or ()), sentence))
    is_floor = kind == "planar" and not world.map
    if is_floor and world.window_m[0] != world.window_m[1]:
        sentence = "a made-up floor is a square: both sides must be equal"
        conflicts.append(Conflict("world.window_m", list(world.window_m), sentence))
    return conflicts


def load(
    name_or_path: str,
    overrides: Sequence[str | Override] = (),
    seed: int | None = None,
) -> Scenario:
    """Return the scenario of a library name or file, changed by `key=value` overrides.

    Raises:
        ScenarioError: with one sentence per problem.

    """
    path = find(name_or_path)
    changes = [parse_override(o) if isinstance(o, str) else o for o in overrides]
    if seed is not None:
        changes.append(Override(f"--seed {seed}", ("seed",), seed))
    tables = read(path)
    apply_overrides(tables, changes)
    place_files(tables, path, changes)
    return parse(tables, str(path), changes)


def parse(tables: dict[str, Any], source: str, changes: Sequence[Override] = ()) -> Scenario:
    """Check a scenario's tables; `source` and `changes` say in errors where a key came from.

    Raises:
        ScenarioError: with one sentence per problem.

    """

    def place(key: str) -> str:
        whole = [c.option for c in changes if f"{key}.".startswith(f"{c.key}.")]
        parts = [c.option for c in changes if c.key.startswith(f"{key}.")]
        return whole[-1] if whole else " with ".join([source, *parts])

    try:
        tables = (
            {**tables, "robots": expand_team(tables["robots"])} if "robots" in tables else tables
        )
    except ValueError as error:
        raise ScenarioError([f"{place('robots')}: robots: {error}"]) from error
    try:
        # As JSON: strict about types, and lists are taken for tuples.
        return Scenario.model_validate_json(json.dumps(tables, default=_refuse_date))
    except ValueError as error:
        if not isinstance(error, ValidationError):
            raise ScenarioError([f"{source}: {error}"]) from error
        raise ScenarioError(sentences(error, Scenario, place)) from error


def _refuse_date(value: object) -> str:
    raise ValueError(f"holds the date {value}; no key takes one (text stands in quotes)")


def dump(scenario: Scenario) -> str:
    """Return a scenario as TOML that loads back equal.

    Every key is written out, and events come last: more `[[events]]` may be added at the end.
    """
    tables = scenario.model_dump(mode="json", exclude_none=True)
    events: list[dict[str, Any]] = tables.pop("events")
    tables["links"] = {key: value for key, value in tables["links"].items() if value != {}}
    head = "# The complete scenario, defaults included. [[events]] may be added at the end.\n"
    parts = [
        head,
        tomli_w.dumps(tables),
        *(f"[[events]]\n{tomli_w.dumps(event)}" for event in events),
    ]
    return "\n".join(parts)
