"""How many looks a planner needs that already knows the map, beside those that do not.

The oracle is offline maximum coverage with free travel: every noise-free look from a lattice of
positions at a cycle of headings is known beforehand, and each time that one is taken which maps
the most cells not yet mapped. A cell that a look leaves half sure gives it no weight. Neither ways
nor time cost it anything; as a yardstick for distances, the length of a tour through all its
places (nearest next, then 2-opt) is told too. The others explore as in `ropeteam experiment`.

Run:  python benchmarks/planar_oracle.py --seeds 3
      python benchmarks/planar_oracle.py --seeds 4 --first-seed 101 --side-m 60
      python benchmarks/planar_oracle.py --map building.yaml --fov-deg 75 --range-m 10
"""

import argparse
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from agents.geometry import Bools, Floats, GridFrame, Ints, Pose
from agents.ground import paths
from agents.planar.sensing import LIMIT, MAPPED, look_log_odds
from agents.settings import SensorSettings
from comms.kernels import kernel
from scenarios.errors import StudyError
from scenarios.experiments.planar_runs import (
    DRIVE,
    GOAL,
    SIDE_M,
    Trial,
    measure,
    sensor_of,
    world_of,
)
from sim.errors import WorldError
from sim.planar_world import HEADINGS, LATTICE_M, PlanarWorld, lattice, look, standable

METHODS = ("information", "information-voxel", "team-information")


@dataclass(frozen=True)
class Looks:
    """All looks that the oracle may take."""

    eyes: Ints
    """(E, 2) cells; look n is taken from eye n // headings."""
    first: Ints
    """(L + 1,) where in the lists each look's cells begin."""
    cells: Ints
    """(M,) flat indices."""
    added: Floats
    """(M,) log-odds that the look adds there."""


def all_looks(
    world: PlanarWorld, sensor: SensorSettings, eyes: Ints, headings: int = HEADINGS
) -> Looks:
    """Return what noise-free looks from cells (E, 2) add to a map, at headings all around."""
    reach = math.ceil(sensor.range_m / world.frame.cell_m) + 1
    cells: list[Ints] = []
    added: list[Floats] = []
    for row, col in eyes:
        top, left = max(0, int(row) - reach), max(0, int(col) - reach)
        part = _cut(world, top, left, int(row) + reach + 1, int(col) + reach + 1)
        x_m, y_m = world.frame.centre_of(int(row), int(col))
        for k in range(headings):
            pose = Pose(x_m, y_m, 0.0, 2.0 * math.pi * k / headings)
            ranges_m, _ = look(part, pose, sensor, None)
            told = look_log_odds(part.frame, pose, ranges_m, sensor)
            i, j = np.nonzero(told)
            cells.append((i + top) * world.frame.cols + j + left)
            added.append(told[i, j])
    first = np.concatenate(([0], np.cumsum([len(part) for part in cells])))
    return Looks(eyes, first, np.concatenate(cells), np.concatenate(added))


def _cut(world: PlanarWorld, top: int, left: int, below: int, right: int) -> PlanarWorld:
    """Return a part of a world, for speed: rays leave it no nearer than their reach."""
    solid = world.solid[top:below, left:right]
    frame = world.frame
    x_m, y_m = frame.x_m + left * frame.cell_m, frame.y_m + top * frame.cell_m
    return PlanarWorld(GridFrame(x_m, y_m, frame.cell_m, *solid.shape), solid, (0, 0))


@kernel
def _newly_mapped(
    first: np.ndarray, cells: np.ndarray, added: np.ndarray, log_odds: np.ndarray,
    wanted: np.ndarray, limit: float, out: np.ndarray,
) -> None:  # fmt: skip
    for n in range(len(out)):
        count = 0
        for m in range(first[n], first[n + 1]):
            at = cells[m]
            if wanted[at] and abs(log_odds[at]) <= limit < abs(log_odds[at] + added[m]):
                count += 1
        out[n] = count


def oracle(
    world: PlanarWorld, observable: Bools, looks: Looks, goal: float
) -> tuple[list[int], float]:
    """Return the looks taken, in order, and the share of the observable cells mapped by them.

    It ends at the goal, or when no look maps one more cell.
    """
    log_odds = np.zeros(world.solid.size)
    wanted = observable.ravel()
    taken: list[int] = []
    gain = np.zeros(len(looks.first) - 1, dtype=np.int64)
    mapped = 0
    while mapped < goal * wanted.sum():
        _newly_mapped(looks.first, looks.cells, looks.added, log_odds, wanted, MAPPED, gain)
        best = int(gain.argmax())
        if gain[best] == 0:
            break
        taken.append(best)
        part = slice(int(looks.first[best]), int(looks.first[best + 1]))
        at = looks.cells[part]
        log_odds[at] = np.clip(log_odds[at] + looks.added[part], -LIMIT, LIMIT)
        mapped = int((wanted & (np.abs(log_odds) > MAPPED)).sum())
    return taken, mapped / float(wanted.sum())


def tour_m(world: PlanarWorld, stops: Ints, footprint_m: float) -> float:
    """Return how long a way is from the world's start through all stops (N, 2), in any order."""
    frame = world.frame
    cost = np.where(standable(world.solid, frame.cell_m, footprint_m), 1.0, np.inf)
    places = np.unique(np.concatenate((np.array([world.start]), stops)), axis=0)
    places = np.concatenate((np.array([world.start]), places[(places != world.start).any(axis=1)]))
    fields = [paths.travel_field(cost, place[None], frame.cell_m)[0] for place in places]
    apart = np.array([field[places[:, 0], places[:, 1]] for field in fields])
    order = [0]
    while len(order) < len(places):
        left = [n for n in range(len(places)) if n not in order]
        order.append(min(left, key=lambda n: float(apart[order[-1], n])))
    return _two_opt(apart, order)


def _two_opt(apart: Floats, order: list[int]) -> float:
    """Return the length of an open tour after turning stretches round as long as that helps."""
    way = np.array(order)
    better = True
    while better:
        better = False
        for i in range(1, len(way) - 1):
            for j in range(i + 1, len(way)):
                after = apart[way[j], way[j + 1]] if j + 1 < len(way) else 0.0
                turned = apart[way[i], way[j + 1]] if j + 1 < len(way) else 0.0
                saved = apart[way[i - 1], way[i]] + after - apart[way[i - 1], way[j]] - turned
                if saved > 1e-9:
                    way[i : j + 1] = way[i : j + 1][::-1]
                    better = True
    return float(sum(apart[a, b] for a, b in pairwise(way)))


@dataclass(frozen=True)
class Line:
    """What one planner needed in one world."""

    world: str
    planner: str
    looks: float
    """To the goal; inf if never."""
    ratio: float
    """Of the oracle's looks."""
    driven_m: float
    cpu_s: float

    def told(self) -> str:
        """Return it as a line of Markdown."""
        if not math.isfinite(self.looks):
            return f"| {self.world} | {self.planner} | never | | | {self.cpu_s:.0f} |"
        looks = f"{self.looks:.4g} | {self.ratio:.2f} | {self.driven_m:.0f}"
        return f"| {self.world} | {self.planner} | {looks} | {self.cpu_s:.0f} |"


def compare(args: argparse.Namespace, path: str, seed: int) -> list[Line]:
    """Return the table's lines for one world; the oracle's metres are those of a tour."""
    sensor = sensor_of(args.fov_deg, args.range_m)
    begun_s = time.process_time()
    world, seen = world_of(path, 0 if path else seed, args.fov_deg, args.range_m, args.side_m)
    name = Path(path).stem if path else f"made-up, {args.side_m:g} m, {seed}"
    looks = all_looks(world, sensor, lattice(world, DRIVE.footprint_m, args.lattice_m))
    taken, share = oracle(world, seen, looks, GOAL)
    tour = tour_m(world, looks.eyes[np.array(taken) // HEADINGS], DRIVE.footprint_m)
    count = float(len(taken)) if share >= GOAL else math.inf
    lines = [Line(name, "oracle (a tour)", count, 1.0, tour, time.process_time() - begun_s)]
    for method in args.method or METHODS:
        trial = Trial(
            path, seed, method, 1, args.fov_deg, args.range_m, args.looks, GOAL, args.side_m
        )
        run = measure(trial)[0]
        needed, driven_m = float(run["looks_to_goal"]), float(run["driven_to_goal_m"])
        spent_s = float(run["run_cpu_s"])
        lines.append(Line(name, method, needed, needed / count, driven_m, spent_s))
    return lines


def means(lines: Sequence[Line]) -> list[Line]:
    """Return a line for each planner: means over worlds of looks, of ratios and of metres."""
    found: list[Line] = []
    for planner in dict.fromkeys(line.planner for line in lines):
        mine = [line for line in lines if line.planner == planner]
        mean = [
            float(np.mean([getattr(line, key) for line in mine]))
            for key in ("looks", "ratio", "driven_m", "cpu_s")
        ]
        found.append(Line(f"mean of {len(mine)}", planner, *mean))
    return found


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    told = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    told.add_argument("--seeds", type=int, default=2, help="made-up worlds, or runs per map")
    told.add_argument("--first-seed", type=int, default=1)
    told.add_argument("--side-m", type=float, default=SIDE_M, help="of the made-up worlds")
    told.add_argument("--map", action="append", default=[], help="a map_server yaml file instead")
    told.add_argument("--method", action="append", help=f"besides the oracle ({METHODS})")
    told.add_argument("--fov-deg", type=float, default=90.0)
    told.add_argument("--range-m", type=float, default=15.0)
    told.add_argument("--lattice-m", type=float, default=LATTICE_M, help="of the oracle's places")
    told.add_argument("--looks", type=int, default=400, help="that a method may take")
    return told


def main(argv: Sequence[str] | None = None) -> int:
    """Print a table in Markdown."""
    args = parser().parse_args(argv)
    print("| world | planner | looks to 90 % | of the oracle's | driven, m | CPU, s |")
    print("|---|---|---:|---:|---:|---:|")
    lines: list[Line] = []
    for path in args.map or [""]:
        for seed in range(args.first_seed, args.first_seed + args.seeds):
            try:
                found = compare(args, path, seed)
            except (StudyError, WorldError) as error:
                print(error, file=sys.stderr)
                return 2
            for line in found:
                print(line.told(), flush=True)
            lines += found
    for line in means(lines) if len(lines) > len({line.planner for line in lines}) else []:
        print(line.told())
    return 0


if __name__ == "__main__":
    sys.exit(main())
