"""How often ways that the Cliff-bot's rule calls safe meet a rock, and how much ground it bars.

    python benchmarks/safe_ways.py [--seeds N] [--first N] [--looks N] [--ways N]

Per seed of the mission `cliff`, a camera looks at the face from places on the plateau, drawn at
random. Every quarter of the looks ways are planned between places drawn at random, as the Cliff-bot
plans them on the map of these looks, and held against the true ground: a hit is a stretch on which
its circle would touch a rock or step that is too high for its wheels.
"""

import argparse
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from agents.geometry import Bools, Floats, GridFrame, Ints, Pose
from agents.ground.descent import barred, descent_cost
from agents.ground.paths import path_to, straight_legs, travel_field
from agents.ground.surface import CLEARANCE_M
from agents.layers import Anchor
from agents.maps.elevation import Submap
from agents.maps.elevationlook import bin_look
from agents.settings import DriveSettings
from scenarios.schema import Scenario, load
from scenarios.stage import set_stage
from sim.camera import Scene as View
from sim.camera import expose, reachable_positions
from sim.ground import footing_on
from sim.terrain import Terrain

TILTS_DEG = (-15.0, -38.0)
STANDS = 6
"""Places from which ways are planned, on each map."""
NEAR_M = 9.0
"""Looks are taken from places so near to the middle of the face."""
PRIOR = (1e-6, 1e-6, 1e-6, 1e-8)


@dataclass
class Tally:
    """What was counted over all maps."""

    ways: int = 0
    """Ways that were asked for."""
    found: int = 0
    length_m: float = 0.0
    hits: int = 0
    allowed: int = 0
    """Cells that the rule allows."""
    false: int = 0
    """Those of them where the robot would touch a hazard."""

    def row(self, what: str) -> str:
        return (
            f"| {what} | {self.found / self.ways:.2f} | {self.length_m / 1000:.2f} | {self.hits} "
            f"| {1000 * self.hits / max(self.length_m, 1.0):.2f} "
            f"| {100 * self.false / max(self.allowed, 1):.2f} |"
        )

    def add(self, other: "Tally") -> None:
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)


def maps(
    scenario: Scenario, terrain: Terrain, places: Floats, middle: Floats, count: int
) -> Iterator[Submap]:
    """Yield what looks from places drawn at random towards the face have measured so far."""
    rng = np.random.default_rng(scenario.seed)
    view, sensor = View(terrain), scenario.sensor
    submap = Submap(terrain.frame, Anchor.at(Pose(0.0, 0.0, 0.0, 0.0), PRIOR))
    for n in range(count):
        x_m, y_m = (float(v) for v in places[rng.integers(len(places))][:2])
        pose = Pose(x_m, y_m, terrain.height_m(x_m, y_m), 0.0)
        aim = middle + rng.uniform(-5.0, 5.0, 2)
        heading = math.atan2(aim[1] - y_m, aim[0] - x_m)
        tilt = math.radians(float(rng.choice(TILTS_DEG)))
        cells = bin_look(
            expose(view, sensor, pose, heading, tilt, others={}, rng=rng),
            pose,
            terrain.frame,
            attitude_sigma_rad=math.radians(sensor.attitude_sigma_deg),
            extra_variance=(0.0, 0.0, 0.0, 0.0),
        )
        submap.observe(cells)
        if (n + 1) % max(1, count // 4) == 0:
            yield submap


def costs(submap: Submap, drive: DriveSettings, cell_m: float) -> Floats:
    """Return what a metre costs the Cliff-bot on a map."""
    elevation_m, variance = submap.estimate((slice(None), slice(None)))
    footprint_m = drive.footprint_m + 2 * CLEARANCE_M
    bars = barred(
        elevation_m,
        np.sqrt(variance),
        cell_m=cell_m,
        footprint_m=footprint_m,
        wheel_m=drive.wheel_m,
        climb_m=drive.climb_m,
    )
    return descent_cost(bars, cell_m=cell_m, footprint_m=footprint_m)


def held_against(
    contact: Bools, face: Bools, cost: Floats, frame: GridFrame, ways: int, seed: int
) -> Tally:
    """Plan ways on a map between allowed places of the face, and count what they would touch."""
    rng = np.random.default_rng(seed)
    allowed = np.isfinite(cost)
    tally = Tally(allowed=int((allowed & face).sum()), false=int((allowed & face & contact).sum()))
    free = np.argwhere(face & allowed & ~contact)
    for _ in range(STANDS if len(free) else 0):
        start = free[rng.integers(len(free))]
        distance, parent = travel_field(cost, start[None], frame.cell_m)
        for end in free[rng.integers(len(free), size=ways)]:
            tally.ways += 1
            if np.isfinite(distance[tuple(end)]):
                tally.found += 1
                walk(straight_legs(path_to(parent, tuple(end.tolist())), cost), contact, tally)
    tally.length_m *= frame.cell_m
    return tally


def walk(corners: Ints, contact: Bools, tally: Tally) -> None:
    """Count the length (in cells) and the hits of one way."""
    for a, b in itertools.pairwise(corners):
        length = float(np.hypot(*(b - a)))
        way = np.linspace(a, b, max(2, math.ceil(5 * length)))
        cells = np.floor(way + 0.5).astype(np.int64)
        touching = contact[cells[:, 0], cells[:, 1]].astype(np.int64)
        tally.hits += int((np.diff(touching) > 0).sum())
        tally.length_m += length


def one(seed: int, looks: int, ways: int) -> Tally:
    scenario = load("cliff", seed=seed)
    stage, drive = set_stage(scenario), scenario.drive
    terrain = stage.terrain
    assert isinstance(terrain, Terrain)
    assert stage.goal_m is not None
    frame, start = terrain.frame, stage.starts["recon"]
    places = reachable_positions(
        terrain, (start.x_m, start.y_m), drive.max_slope_deg, drive.footprint_m, 1.0
    )
    hung = stage.starts["cliffbot"]
    middle = 0.5 * (np.array([hung.x_m, hung.y_m]) + np.array(stage.goal_m))
    places = places[np.hypot(*(places[:, :2] - middle).T) < NEAR_M]
    rows, cols = np.indices(frame.shape)
    x_m = frame.x_m + (cols + 0.5) * frame.cell_m - middle[0]
    y_m = frame.y_m + (rows + 0.5) * frame.cell_m - middle[1]
    face = np.hypot(x_m, y_m) < 6.0
    contact = footing_on(terrain, drive.footprint_m, drive.wheel_m, drive.climb_m).contact
    total = Tally()
    for n, submap in enumerate(maps(scenario, terrain, places, middle, looks)):
        cost = costs(submap, drive, frame.cell_m)
        total.add(held_against(contact, face, cost, frame, ways, 100 * seed + n))
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--first", type=int, default=101)
    parser.add_argument("--looks", type=int, default=80)
    parser.add_argument("--ways", type=int, default=10, help="from each of six places")
    args = parser.parse_args()
    print("| seed | ways found | km | hits | hits per km | allowed ground that is not safe, % |")
    print("|---|---:|---:|---:|---:|---:|")
    total = Tally()
    for seed in range(args.first, args.first + args.seeds):
        tally = one(seed, args.looks, args.ways)
        total.add(tally)
        print(tally.row(str(seed)), flush=True)
    print(total.row("all"))


if __name__ == "__main__":
    main()
