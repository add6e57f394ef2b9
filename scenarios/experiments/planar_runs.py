"""Trials of the planar experiments: one world, one way of choosing, looked at until all is seen."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from agents import planar
from agents.geometry import Bools
from agents.settings import DriveSettings, PlannerSettings, SensorSettings
from scenarios.errors import StudyError, UsageError
from scenarios.experiments.frame import Options
from scenarios.experiments.planar_trial import Exploration, Setup
from scenarios.experiments.tables import Row
from sim.errors import WorldError
from sim.planar_world import PlanarWorld, load_map, made_up, observable

PAPER = ("random", "raster", "max-new", "min-old", "information")
VARIANTS = ("information-entropy", "information-voxel")
OURS = "team-information"
METHODS = (*PAPER, *VARIANTS, OURS)
GOAL = 0.9
"""The share of the observable cells to which ways of choosing are compared."""
LOOKS = 200
"""A robot takes at most so many."""
DRIVE = DriveSettings(speed_mps=0.3, turn_rate_radps=0.5, footprint_m=0.3)
PLANNER = PlannerSettings(candidate_step_m=1.6, max_candidates=300, min_gain_cells=10.0)
LOOK_S = 5.0
SIDE_M = 100.0
"""Of a made-up world."""
LEAST_SIDE_M = 10.0

SETTINGS = {
    "map": "a map_server yaml file to explore instead of made-up worlds; may be repeated",
    "method": f"only this one ({', '.join(METHODS)}); may be repeated",
    "looks": f"looks that a robot may take ({LOOKS})",
    "side": f"side of the made-up worlds, m ({SIDE_M:g}; at least 10)",
}


@dataclass(frozen=True)
class Trial:
    """One exploration."""

    world: str
    """A map's file, or empty: made up from the seed."""
    seed: int
    method: str
    robots: int
    fov_deg: float
    range_m: float
    looks: int = LOOKS
    goal: float = 1.0
    """Explore until so much is mapped, or nothing more can be gained."""
    side_m: float = SIDE_M
    """Of a made-up world."""

    @property
    def place(self) -> str:
        """What the world is called."""
        if self.world:
            return Path(self.world).stem
        return "made-up" if self.side_m == SIDE_M else f"made-up-{self.side_m:g}m"


def trials_of(options: Options, robots: int, fov_deg: float, range_m: float) -> list[Trial]:
    """Return the explorations that are asked for, seed by seed."""
    chosen = options.sets.get("method", METHODS)
    known = planar.METHODS.names()
    unknown = [name for name in chosen if name not in known]
    if unknown:
        raise UsageError(f"--set method={unknown[0]}: must be one of {', '.join(known)}")
    maps = options.sets.get("map", ("",))
    for path in maps:
        if path:
            _from_file(path)  # bad files are refused before anything runs
    looks = options.sets.get("looks", (str(LOOKS),))[-1]
    if not looks.isdecimal() or int(looks) < 1:
        raise UsageError(f"--set looks={looks}: must be a whole number, at least 1")
    side_m = options.number("side", SIDE_M)
    if side_m < LEAST_SIDE_M:
        raise UsageError(f"--set side={side_m:g}: must be at least {LEAST_SIDE_M:g}, in m")
    return [
        Trial(path, seed, method, robots, fov_deg, range_m, int(looks), side_m=side_m)
        for path in maps
        for seed in range(1, options.seeds + 1)
        for method in chosen
    ]


def sensor_of(fov_deg: float, range_m: float) -> SensorSettings:
    """Return a trial's camera."""
    return SensorSettings(fov_deg=fov_deg, range_m=range_m, near_m=0.0, look_s=LOOK_S)


def _from_file(path: str) -> PlanarWorld:
    try:
        return load_map(Path(path), footprint_m=DRIVE.footprint_m)
    except WorldError as error:
        raise StudyError(str(error)) from error


@lru_cache(maxsize=4)
def world_of(
    path: str, seed: int, fov_deg: float, range_m: float, side_m: float = SIDE_M
) -> tuple[PlanarWorld, Bools]:
    """Return a world and its observable cells; a made-up one depends on the seed alone."""
    if path:
        world = _from_file(path)
    else:
        rng = np.random.default_rng([seed, 20])
        world = made_up(rng, side_m=side_m, footprint_m=DRIVE.footprint_m)
    sensor = sensor_of(fov_deg, range_m)
    return world, observable(world, sensor, DRIVE.footprint_m)


def measure(trial: Trial) -> Sequence[Row]:
    """Explore; return one row in all, and one for each look."""
    sensor = sensor_of(trial.fov_deg, trial.range_m)
    seed = 0 if trial.world else trial.seed
    world, seen = world_of(trial.world, seed, trial.fov_deg, trial.range_m, trial.side_m)
    planner = PLANNER.model_copy(update={"max_looks": trial.looks})
    setup = Setup(trial.method, sensor, DRIVE, planner, trial.robots, trial.goal)
    exploration = Exploration(world, seen, setup)
    begun_s = time.process_time()
    exploration.run(np.random.default_rng([trial.seed, 21]))
    spent_s = time.process_time() - begun_s
    taken = exploration.taken
    base: Row = {
        "world": trial.place,
        "seed": trial.seed,
        "method": trial.method,
        "robots": trial.robots,
    }
    at = next((n for n, look in enumerate(taken) if look.coverage >= GOAL), None)
    reached = taken[at] if at is not None else None
    last = taken[-1]
    area_m2 = float(seen.sum()) * world.frame.cell_m**2
    run: Row = {
        **base,
        "row": "run",
        "looks_to_goal": math.inf if at is None else at + 1,
        "driven_to_goal_m": math.inf if reached is None else reached.driven_m,
        "time_to_goal_s": math.inf if reached is None else reached.t_s,
        "looks": len(taken),
        "driven_m": last.driven_m,
        "coverage": last.coverage,
        "area_m2": area_m2 * last.coverage,
        "wrong_share": last.wrong,
        "ended": exploration.ended,
        "bumps": exploration.bumps,
        "run_cpu_s": spent_s,
        "choice_cpu_s": max(look.choice_s for look in taken),
    }
    series: list[Row] = [
        {
            **base,
            "row": "look",
            "look": n + 1,
            "driven_m": look.driven_m,
            "coverage": look.coverage,
        }
        for n, look in enumerate(taken)
    ]
    return [run, *series]
