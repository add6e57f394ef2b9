"""Are the odds of a rock by which the Cliff-bot chooses its way what they say?

    python benchmarks/rock_odds.py [--seeds N] [--first N] [--sensor range|stereo]

Runs the mission `cliff` to its descent's end, and holds the odds of each cell of the face, by what
the Cliff-bot was told last (`agents.ground.descent.rock_odds`), against the rocks that are there.
"""

import argparse
import itertools
import tempfile
from pathlib import Path

import numpy as np

from agents.geometry import Floats
from agents.ground.descent import barred
from agents.ground.surface import CLEARANCE_M
from scenarios.runner import RECORDS_ONLY, run
from scenarios.schema import load
from sim.ground import Terrain, hazard_mask

EDGES = (0.0, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.2, 0.5, 1.0)
ABOVE_M = 1.0
"""So far above the Cliff-bot's stand the face begins."""


def odds_and_rocks(seed: int, sensor: str) -> Floats:
    """Return the odds of cells and whether they hold a rock, (N, 2)."""
    scenario = load("cliff", ("air=memory", "ends=descent", f"sensor.kind={sensor}"), seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        result = run(scenario, Path(folder) / "run", RECORDS_ONLY)
    drive, terrain = scenario.drive, result.stage.terrain
    assert isinstance(terrain, Terrain)
    told = next(final for final in result.finals if final.name == "cliffbot")
    assert told.elevation_m is not None
    assert told.sigma_m is not None
    bars = barred(
        told.elevation_m.astype(np.float64),
        told.sigma_m.astype(np.float64),
        cell_m=terrain.frame.cell_m,
        footprint_m=drive.footprint_m + 2 * CLEARANCE_M,
        wheel_m=drive.wheel_m,
        climb_m=drive.climb_m,
    )
    rocks = hazard_mask(terrain, drive.wheel_m, drive.footprint_m, drive.climb_m)
    rows = np.indices(terrain.frame.shape)[0]
    y_m = terrain.frame.y_m + (rows + 0.5) * terrain.frame.cell_m
    face = np.isfinite(told.elevation_m) & (y_m < result.stage.starts["cliffbot"].y_m + ABOVE_M)
    face &= ~bars.unseen & ~bars.blurred
    return np.column_stack((bars.odds[face], rocks[face]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=21)
    parser.add_argument("--sensor", default="range", choices=("range", "stereo"))
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    odds, rocks = np.concatenate([odds_and_rocks(seed, args.sensor) for seed in seeds]).T
    print(f"{len(odds)} cells of {args.seeds} missions on {args.sensor}")
    print("| odds | cells | their mean | rocks among them | share of all rocks |")
    print("|---|---:|---:|---:|---:|")
    for low, high in itertools.pairwise(EDGES):
        mine = (odds >= low) & (odds < high)
        if mine.any():
            print(
                f"| {low:g} to {high:g} | {mine.sum()} | {odds[mine].mean():.4f}"
                f" | {rocks[mine].mean():.4f} | {rocks[mine].sum() / rocks.sum():.3f} |"
            )


if __name__ == "__main__":
    main()
