"""Are the odds of a rock by which the Cliff-bot chooses its way what they say?

    python benchmarks/rock_odds.py [--seeds N] [--first N] [--sensor range|stereo|both] [--fit]

Runs the mission `cliff` to its descent's end, and holds the odds of each cell of the face, by what
the Cliff-bot was told last (`agents.ground.rocks`), against the rocks that are there. With `--fit`
it fits the odds' weights to these missions instead, and prints them.
"""

import argparse
import itertools
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from agents.geometry import Bools, Floats
from agents.ground import markov, rocks
from agents.ground.descent import SURE
from agents.ground.surface import CLEARANCE_M, mean_over
from scenarios.runner import RECORDS_ONLY, run
from scenarios.schema import load
from sim.ground import Terrain, hazard_mask

EDGES = (0.0, 1e-4, 1e-3, 0.01, 0.03, 0.1, 0.2, 0.5, 1.0)
ABOVE_M = 1.0
"""So far above the Cliff-bot's stand the face begins."""
HELD = 1e-6
"""Weight of the squares of the standardised weights in the fit: it only keeps them finite."""


class Cells(NamedTuple):
    """The cells of the face that were measured, of one mission or of many; (N,) each."""

    odds: Floats
    traits: Floats
    """(N, 9): what the odds weigh (`rocks.traits_of`)."""
    rock: Bools


def cells_of(seed: int, sensor: str) -> Cells:
    """Run one mission, and return what it had of the face."""
    scenario = load("cliff", ("air=memory", "ends=descent", f"sensor.kind={sensor}"), seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        result = run(scenario, Path(folder) / "run", RECORDS_ONLY)
    drive, terrain = scenario.drive, result.stage.terrain
    assert isinstance(terrain, Terrain)
    told = next(final for final in result.finals if final.name == "cliffbot")
    assert told.elevation_m is not None
    assert told.sigma_m is not None
    elevation_m, cell_m = told.elevation_m.astype(np.float64), terrain.frame.cell_m
    known = np.isfinite(elevation_m)
    sigma_m = np.where(known, told.sigma_m.astype(np.float64), 0.0)
    foot_m = drive.footprint_m + 2 * CLEARANCE_M
    shape = rocks.shape_of(markov.complete(elevation_m), drive.wheel_m, foot_m, cell_m)
    odds = rocks.rock_odds(shape, sigma_m, drive.climb_m)
    there = hazard_mask(terrain, drive.wheel_m, drive.footprint_m, drive.climb_m)
    rows = np.indices(terrain.frame.shape)[0]
    y_m = terrain.frame.y_m + (rows + 0.5) * cell_m
    face = known & (y_m < result.stage.starts["cliffbot"].y_m + ABOVE_M)
    face &= mean_over(sigma_m, 3) <= SURE * drive.wheel_m
    traits = np.stack([trait[face] for trait in rocks.traits_of(shape, drive.climb_m)], axis=1)
    return Cells(odds[face], traits, there[face])


def fitted(cells: Cells) -> Floats:
    """Return the weights (10,) that make the rocks likeliest, a constant first."""
    mean, spread = cells.traits.mean(axis=0), cells.traits.std(axis=0)
    known = np.column_stack((np.ones(len(cells.rock)), (cells.traits - mean) / spread))
    rock = cells.rock.astype(np.float64)

    def loss(weights: Floats) -> tuple[float, Floats]:
        logit = known @ weights
        value = np.mean(np.logaddexp(0.0, logit) - rock * logit) + HELD * weights @ weights
        return float(value), known.T @ (expit(logit) - rock) / len(rock) + 2.0 * HELD * weights

    found = minimize(loss, np.zeros(known.shape[1]), jac=True, method="L-BFGS-B").x
    weights = found[1:] / spread
    return np.concatenate(([found[0] - weights @ mean], weights))


def table(cells: Cells) -> str:
    """Return what the odds say beside what is there."""
    lines = ["| odds | cells | their mean | rocks among them | share of all rocks |"]
    lines += ["|---|---:|---:|---:|---:|"]
    for low, high in itertools.pairwise(EDGES):
        mine = (cells.odds >= low) & (cells.odds < high)
        if mine.any():
            there = cells.rock[mine]
            lines.append(
                f"| {low:g} to {high:g} | {mine.sum()} | {cells.odds[mine].mean():.5f}"
                f" | {there.mean():.5f} | {there.sum() / cells.rock.sum():.3f} |"
            )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=21)
    parser.add_argument("--sensor", default="range", choices=("range", "stereo", "both"))
    parser.add_argument("--fit", action="store_true", help="fit the weights to these missions")
    args = parser.parse_args()
    sensors = ("range", "stereo") if args.sensor == "both" else (args.sensor,)
    seeds = range(args.first, args.first + args.seeds)
    missions = [cells_of(seed, sensor) for sensor in sensors for seed in seeds]
    cells = Cells(*(np.concatenate(parts) for parts in zip(*missions, strict=True)))
    print(f"{len(cells.odds)} cells of {len(missions)} missions on {args.sensor}")
    if args.fit:
        weights = [float(round(weight, 2)) for weight in fitted(cells)]
        print(f"LINEAR = {tuple(weights[:4])}")
        print(f"SQUARE = {tuple(weights[4:])}")
    else:
        print(table(cells))


if __name__ == "__main__":
    main()
