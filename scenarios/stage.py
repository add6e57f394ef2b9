"""What stands before the first robot moves: the ground, where everybody starts, where to go."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from agents.geometry import Bools, Floats, Pose
from agents.stereo.shape import ShapeError, shape_of
from agents.voxel.ground import Build
from scenarios.dice import dice
from scenarios.recordings import recorded
from scenarios.records.summary import Truth
from scenarios.schema import MAPPERS, Scenario
from scenarios.scores.occupancy import PlanarTruth, VoxelTruth
from sim.camera import observable_cells, reachable_positions
from sim.errors import WorldError
from sim.ground import Footing, Terrain
from sim.planar import place_explorers, stands_free
from sim.planar_world import PlanarWorld, load_map, made_up, observable
from sim.recorded import Recording
from sim.settings import LandmarkSettings
from sim.terrain import descent_goal, make_terrain, place_team
from sim.voxel import world as space
from sim.voxel.cave import make_cave
from sim.voxel.files import read_world
from sim.voxel.robot import place_explorers as place_in_cave
from sim.voxel.world import VoxelWorld
from sim.worlds import World

LATTICE_M = 2.0
"""Positions from which cells count as observable lie on a lattice of this spacing."""


@dataclass
class Stage:
    """The world of one run at its start."""

    scenario: Scenario
    terrain: World
    starts: dict[str, Pose]
    """True start poses, by robot."""
    goal_m: tuple[float, float] | None
    landmarks: dict[str, Pose] = field(default_factory=dict[str, Pose])
    """Where they stand, by name."""

    def under(self, scenario: Scenario) -> "Stage":
        """Return the same world for a scenario that differs in what happens, and in its dice."""
        other = Stage(scenario, self.terrain, self.starts, self.goal_m, self.landmarks)
        other.truth = self.truth
        return other

    @cached_property
    def truth(self) -> Truth | PlanarTruth:
        """The world, and which cells the team's mappers could see from where they can drive."""
        terrain, sensor = self.terrain, self.scenario.sensor
        if isinstance(terrain, PlanarWorld):
            seen = observable(terrain, sensor, self.scenario.drive.footprint_m)
            return PlanarTruth(terrain.solid, seen)
        if isinstance(terrain, VoxelWorld):
            tilts = self.scenario.planner.tilts_deg
            seen = space.observable(terrain, sensor, self.scenario.drive, tilts)
            return VoxelTruth(terrain.solid, seen, terrain.frame)
        return self._truth_of_ground(terrain)

    def _truth_of_ground(self, terrain: Terrain) -> Truth:
        scenario, drive, sensor = self.scenario, self.scenario.drive, self.scenario.sensor
        seen: Bools = np.zeros(terrain.frame.shape, dtype=bool)
        done: list[Floats] = []
        for name, robot in scenario.robots.items():
            if robot.role not in MAPPERS:
                continue
            start = (self.starts[name].x_m, self.starts[name].y_m)
            places = reachable_positions(
                terrain, start, drive.max_slope_deg, drive.footprint_m, LATTICE_M
            )
            led = recorded(scenario, name, self.starts[name])
            if led is not None:
                places = led.recording.places_m(LATTICE_M)
            if any(len(p) == len(places) and np.array_equal(p[1:], places[1:]) for p in done):
                places = places[:1]  # the same ground as another's, but for the start
            done.append(places)
            seen |= observable_cells(
                terrain, places, sensor.height_m, sensor.range_m, sensor.near_m
            )
        return Truth(terrain.elevation_m, seen)


def set_stage(scenario: Scenario) -> Stage:
    """Make or read the ground (or the floor), and place the team on it.

    Raises:
        WorldError: the file is bad, or has no room for the team.

    """
    makers = {"planar": _floor, "voxel": _cave}
    return makers.get(scenario.map.kind, _ground)(scenario)


def _ground(scenario: Scenario) -> Stage:
    first = next(iter(scenario.robots))
    whole, ground_seed = scenario, scenario.world.seed
    if ground_seed is not None:
        scenario = scenario.model_copy(update={"seed": ground_seed})
    roles = [robot.role for robot in scenario.robots.values()]
    footprint_m = scenario.drive.footprint_m
    terrain = make_terrain(
        scenario.world, scenario.map.cell_m, dice(scenario, first, "terrain"), roles, footprint_m
    )
    poses = place_team(terrain, roles, footprint_m / 2, dice(scenario, first, "team"))
    starts = {name: poses[index] for index, name in enumerate(scenario.robots)}
    for name, robot in scenario.robots.items():
        if robot.start is not None:
            x_m, y_m, yaw_deg = robot.start
            starts[name] = _standing(terrain, x_m, y_m, math.radians(yaw_deg), footprint_m)
    for name in scenario.robots:
        led = recorded(scenario, name, starts[name] if scenario.robots[name].start else None)
        if led is not None:
            starts[name] = _led(led.recording, terrain, name)
    cliffbots = [name for name, robot in scenario.robots.items() if robot.role == "cliffbot"]
    goal = descent_goal(terrain, starts[cliffbots[0]], footprint_m) if cliffbots else None
    landmarks = {
        name: _landmark(terrain, mark, footprint_m)
        for name, mark in scenario.world.landmarks.items()
    }
    return Stage(whole, terrain, starts, goal, landmarks)


def _led(recording: Recording, terrain: Terrain, name: str) -> Pose:
    """Return where a recording begins.

    Raises:
        WorldError: no look of it was taken inside the window.

    """
    west, east, south, north = terrain.frame.extent_m
    poses = [take.pose for take in recording.takes]
    if not any(west <= p.x_m <= east and south <= p.y_m <= north for p in poses):
        x_m, y_m = poses[0].x_m, poses[0].y_m
        raise WorldError(
            f"the recording of {name} has its first look at x {x_m:g}, y {y_m:g} m, and none inside"
            f" the window, from x {west:g} to {east:g} and from y {south:g} to {north:g} m; say"
            f" where it begins by robots.{name}.start"
        )
    return recording.pose_at(0)


def _landmark(terrain: Terrain, mark: LandmarkSettings, footprint_m: float) -> Pose:
    yaw_rad = math.radians(mark.yaw_deg)
    if mark.mesh:
        try:
            shape_of(mark.mesh)
        except ShapeError as error:
            raise WorldError(f"world.landmarks mesh: {error}") from error
    if mark.z_m is not None:
        return Pose(mark.x_m, mark.y_m, mark.z_m, yaw_rad)
    return _standing(terrain, mark.x_m, mark.y_m, yaw_rad, footprint_m)


def _standing(terrain: Terrain, x_m: float, y_m: float, yaw_rad: float, footprint_m: float) -> Pose:
    """Return the pose of a robot that is put down at a point.

    Raises:
        WorldError: there is no ground there.

    """
    z_m = Footing(terrain, footprint_m, footprint_m).ground_m(x_m, y_m)
    if math.isnan(z_m):
        west, east, south, north = terrain.frame.extent_m
        raise WorldError(
            f"to stand at x {x_m:g}, y {y_m:g} m: there is no known ground; the window reaches "
            f"from x {west:g} to {east:g} and from y {south:g} to {north:g} m"
        )
    return Pose(x_m, y_m, z_m, yaw_rad)


def _floor(scenario: Scenario) -> Stage:
    """Make or read a floor, and place the team on it: the first robot's start is the team's."""
    world, first = _walls(scenario), next(iter(scenario.robots))
    footprint_m = scenario.drive.footprint_m
    poses = place_explorers(world, len(scenario.robots), footprint_m, dice(scenario, first, "team"))
    starts = dict(zip(scenario.robots, poses, strict=True))
    for name, robot in scenario.robots.items():
        if robot.start is not None:
            x_m, y_m, yaw_deg = robot.start
            if not stands_free(world, x_m, y_m, footprint_m):
                raise WorldError(
                    f"{name} would start at x {x_m:g}, y {y_m:g} m, which is not free for a robot"
                    f" of drive.footprint_m {footprint_m:g}; must be a free place of the floor"
                )
            starts[name] = Pose(x_m, y_m, 0.0, math.radians(yaw_deg))
    begin = starts[first]
    world = replace(world, start=world.frame.cell_of(begin.x_m, begin.y_m))
    return Stage(scenario, world, starts, None)


def _walls(scenario: Scenario) -> PlanarWorld:
    settings, footprint_m = scenario.world, scenario.drive.footprint_m
    if settings.map:
        return load_map(Path(settings.map), cell_m=settings.cell_m, footprint_m=footprint_m)
    return made_up(
        dice(scenario, next(iter(scenario.robots)), "terrain"),
        side_m=settings.window_m[0],
        cell_m=settings.cell_m,
        solid_share=settings.obstacle_share,
        footprint_m=footprint_m,
    )


def _cave(scenario: Scenario) -> Stage:
    """Make or read a world of cubes, and place the team in it: the first robot at its start."""
    settings, first = scenario.world, next(iter(scenario.robots))
    build = Build.of(scenario.drive, scenario.sensor, settings.cell_m)
    if settings.cave.file:
        world = read_world(Path(settings.cave.file), cell_m=settings.cell_m, build=build)
    else:
        rng = dice(scenario, first, "terrain")
        world = make_cave(
            rng, settings.cave, window_m=settings.window_m, cell_m=settings.cell_m, build=build
        )
    count = len(scenario.robots)
    poses = place_in_cave(world, build, count, dice(scenario, first, "team"))
    return Stage(scenario, world, dict(zip(scenario.robots, poses, strict=True)), None)
