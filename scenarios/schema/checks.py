"""What a scenario's keys must be to each other, where that concerns more than one of them."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from comms.occupancy.tile import LARGEST_BLOCK
from comms.profiles import tightest_turn_ns
from comms.timebase import to_s
from scenarios.schema.choices import choices
from scenarios.schema.events import no_such_robot
from scenarios.schema.problems import Conflict, plain
from scenarios.schema.team import MAPPERS

if TYPE_CHECKING:
    from scenarios.schema.scenario import Scenario


def _team(scenario: "Scenario") -> list[Conflict]:
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
    if scenario.ends == "descent" and not counts["cliffbot"]:
        sentence = "nobody goes down; without a cliffbot it must be maps"
        conflicts.append(Conflict("ends", scenario.ends, sentence))
    for name, robot in scenario.robots.items():
        if (robot.join_s or 0.0) >= scenario.limit_s:
            sentence = f"must be below limit_s = {plain(scenario.limit_s)}"
            conflicts.append(Conflict(f"robots.{name}.join_s", robot.join_s, sentence))
    return conflicts


def _links(scenario: "Scenario") -> list[Conflict]:
    team = list(scenario.robots)
    said = [(f"links.robots.{name}", name, (name,)) for name in scenario.links.robots]
    said += [(f"links.pairs.{pair}", pair, tuple(pair.split(">"))) for pair in scenario.links.pairs]
    return [
        Conflict(key, shown, no_such_robot(team))
        for key, shown, names in said
        if not all(name.strip() in team for name in names)
    ]


def check_turns(scenario: "Scenario") -> list[Conflict]:
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


def _numbers(scenario: "Scenario") -> list[Conflict]:
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


def _choices(scenario: "Scenario") -> list[Conflict]:
    return [
        Conflict(choice.key, choice.name, f"must be one of {', '.join(choice.allowed())}")
        for choice in choices(scenario)
        if not choice.is_allowed
    ]


def _places(scenario: "Scenario") -> list[Conflict]:
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
        if robot.role not in MAPPERS:
            sentence = f"only {' and '.join(MAPPERS)} can look where they are"
            conflicts.append(Conflict(key, False, sentence))
        elif name == mappers[0]:
            sentence = "is the team's origin: by definition it knows where it starts"
            conflicts.append(Conflict(key, False, sentence))
    return conflicts


def _recordings(scenario: "Scenario") -> list[Conflict]:
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


def _map(scenario: "Scenario") -> list[Conflict]:
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


CHECKS: tuple[Callable[["Scenario"], list[Conflict]], ...] = (
    _team,
    _links,
    _numbers,
    _choices,
    _map,
    _places,
    _recordings,
)
"""All that can be said before events and turns are looked at."""
