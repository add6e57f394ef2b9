"""What stands before the first robot moves: the ground, where everybody starts, where to go."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from agents.geometry import Bools, Floats, Pose
from scenarios.dice import dice
from scenarios.schema import MAPPERS, Scenario
from scenarios.summary import Truth
from sim.camera import observable_cells, reachable_positions
from sim.errors import WorldError
from sim.ground import Footing, Terrain
from sim.terrain import descent_goal, make_terrain, place_team

LATTICE_M = 2.0
"""Positions from which cells count as observable lie on a lattice of this spacing."""


@dataclass
class Stage:
    """The world of one run at its start."""

    scenario: Scenario
    terrain: Terrain
    starts: dict[str, Pose]
    """True start poses, by robot."""
    goal_m: tuple[float, float] | None

    @cached_property
    def truth(self) -> Truth:
        """The ground, and which cells the team's mappers could see from where they can drive."""
        scenario, drive, sensor = self.scenario, self.scenario.drive, self.scenario.sensor
        seen: Bools = np.zeros(self.terrain.frame.shape, dtype=bool)
        done: list[Floats] = []
        for name, robot in scenario.robots.items():
            if robot.role not in MAPPERS:
                continue
            start = (self.starts[name].x_m, self.starts[name].y_m)
            places = reachable_positions(
                self.terrain, start, drive.max_slope_deg, drive.footprint_m, LATTICE_M
            )
            if any(len(p) == len(places) and np.array_equal(p[1:], places[1:]) for p in done):
                places = places[:1]  # the same ground as another's, but for the start
            done.append(places)
            seen |= observable_cells(
                self.terrain, places, sensor.height_m, sensor.range_m, sensor.near_m
            )
        return Truth(self.terrain.elevation_m, seen)


def set_stage(scenario: Scenario) -> Stage:
    """Make or read the ground, and place the team on it.

    Raises:
        WorldError: the terrain file is bad, or has no room for the team.

    """
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
    cliffbots = [name for name, robot in scenario.robots.items() if robot.role == "cliffbot"]
    goal = descent_goal(terrain, starts[cliffbots[0]], footprint_m) if cliffbots else None
    return Stage(whole, terrain, starts, goal)


def _standing(terrain: Terrain, x_m: float, y_m: float, yaw_rad: float, footprint_m: float) -> Pose:
    """Return the pose of a robot that is put down at a point.

    Raises:
        WorldError: there is no ground there.

    """
    z_m = Footing(terrain, footprint_m, footprint_m).ground_m(x_m, y_m)
    if math.isnan(z_m):
        west, east, south, north = terrain.frame.extent_m
        raise WorldError(
            f"start at x {x_m:g}, y {y_m:g} m: there is no known ground; the window reaches from "
            f"x {west:g} to {east:g} and from y {south:g} to {north:g} m"
        )
    return Pose(x_m, y_m, z_m, yaw_rad)
