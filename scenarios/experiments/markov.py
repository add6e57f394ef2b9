"""Unknown cells from known ones: Sujan & Meggiolaro, section 2.2, Fig. 7.

The paper's two samples (a sinusoid with unknown cells, a step of which one half is unknown) filled
in by our solver and by the paper's sweeps; how wrong the filling is, by the size of the holes; and
whether the sigma that a robot gives an estimated cell is that of its error, on rough ground.

All that is measured comes from the trial alone, but for the columns `..._cpu_s`.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from agents.geometry import Bools, Floats
from agents.ground import markov
from scenarios.experiments.frame import Experiment, Options
from scenarios.experiments.markov_claims import conclude
from scenarios.experiments.markov_figure import draw
from scenarios.experiments.markov_surfaces import (
    CELL_M,
    MADE_UP,
    ground_of,
    holes,
    measured,
    neighbour_mean,
    sample,
    sinusoid,
    swept,
    timed,
)
from scenarios.experiments.tables import Row

TIGHT_M, LOOSE_M = 1e-9, 1e-3
"""Tolerances: near enough to the fixed point, and what somebody might choose."""
DIAMETERS = (1, 2, 4, 8, 16, 32)
"""Of holes in the sinusoid, in cells."""
UNKNOWN_SHARE = 0.3
SIZE_SIDE, LARGE_SIDE = 128, 512
HOLES_M = (0.2, 0.5, 1.2, 3.0, 7.5)
"""Diameters of holes in rough ground of 0.1 m cells; in proportion where cells are larger."""
BINS = (0.5, 1.5, 3.0, 6.0, 12.0, 24.0, 48.0)
"""Bounds of the distance to known ground, in cells, by which sigmas are looked at."""


@dataclass(frozen=True)
class Trial:
    """One part of the experiment with one seed."""

    part: str
    """sample, size or ground."""
    surface: str
    """A sample's name, or ground: made up, or a file's path."""
    seed: int
    cell_m: float | None = None


def trials(options: Options) -> Sequence[Trial]:
    """Return trials for each seed, and one for each file."""
    cell_m = options.number("cell_m", CELL_M) if "cell_m" in options.sets else None
    files = [Trial("ground", path, 1, cell_m) for path in options.sets.get("ground", ())]
    for file in files:
        ground_of(file.surface, file.seed, file.cell_m)
    parts = [
        *(("sample", name) for name in ("sinusoid", "step", "step, low half")),
        ("size", "sinusoid"),
        *(("ground", kind) for kind in MADE_UP),
    ]
    seeds = range(1, options.seeds + 1)
    return [*(Trial(*part, seed) for part in parts for seed in seeds), *files]


def measure(trial: Trial) -> Sequence[Row]:
    """Return the rows of one trial."""
    rng = np.random.default_rng((trial.seed, 7))
    base: Row = {"part": trial.part, "surface": trial.surface, "seed": trial.seed}
    if trial.part == "sample":
        return [base | _sample(trial.surface, rng)]
    if trial.part == "size":
        return [base | row for row in _by_size(rng)]
    base["surface"] = trial.surface if trial.surface in MADE_UP else Path(trial.surface).stem
    elevation_m, cell_m = ground_of(trial.surface, trial.seed, trial.cell_m)
    return [base | row for row in _calibration(elevation_m, cell_m, rng)]


def _sample(name: str, rng: np.random.Generator) -> Row:
    """Fill one sample by the solver, by sweeps to the fixed point, and by sweeps cut short."""
    truth, known_m = sample(name, rng)
    unknown = np.isnan(known_m)
    markov.complete(known_m)  # whatever is compiled is compiled now
    ours, ours_s = timed(lambda: markov.complete(known_m, tolerance_m=LOOSE_M))
    tight = markov.complete(known_m, tolerance_m=TIGHT_M)
    counts: list[int] = []

    def paper(tolerance_m: float) -> Floats:
        filled, sweeps = swept(known_m, tolerance_m)
        counts.append(sweeps)
        return filled

    fixed, fixed_s = timed(lambda: paper(TIGHT_M))
    early, early_s = timed(lambda: paper(LOOSE_M))
    other, _ = swept(known_m, TIGHT_M, "highest")
    large = _large(name, rng)
    _, large_s = timed(lambda: markov.complete(large, tolerance_m=LOOSE_M))
    return {
        "unknown_share": float(unknown.mean()),
        "known_moved_m": float(np.abs(ours - known_m)[~unknown].max()),
        "residual_m": _most(tight - neighbour_mean(tight), unknown),
        "from_sweeps_m": _most(tight - fixed, unknown),
        "loose_m": _most(ours - tight, unknown),
        "early_m": _most(early - fixed, unknown),
        "start_matters_m": _most(other - fixed, unknown),
        "rmse_m": _rms((tight - truth)[unknown]),
        "bias_m": float((tight - truth)[unknown].mean()),
        "fixed_sweeps": counts[0],
        "early_sweeps": counts[1],
        "ours_cpu_s": ours_s,
        "ours_512_cpu_s": large_s,
        "fixed_cpu_s": fixed_s,
        "early_cpu_s": early_s,
    }


def _large(name: str, rng: np.random.Generator) -> Floats:
    """Return a surface (512, 512) with as much unknown as the sample has."""
    ground = sinusoid(rng, LARGE_SIDE)
    unknown = np.zeros(ground.shape, dtype=np.bool_)
    if name == "sinusoid":
        unknown = holes(ground.shape, 32, 0.5, rng)
    else:
        unknown[LARGE_SIDE // 2 :] = True
    return measured(ground, unknown, rng)


def _most(apart: Floats, where: Bools) -> float:
    return float(np.abs(apart)[where].max())


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _by_size(rng: np.random.Generator) -> Iterator[Row]:
    """Tell the error in holes of one size in the sinusoid; of the nearest cell's height too."""
    for diameter in DIAMETERS:
        ground = sinusoid(rng, SIZE_SIDE)
        unknown = holes(ground.shape, diameter, UNKNOWN_SHARE, rng)
        known_m = measured(ground, unknown, rng)
        filled = markov.complete(known_m)
        yield {
            "diameter_cells": diameter,
            "rmse_m": _rms((filled - ground)[unknown]),
            "nearest_rmse_m": _rms((nearest(known_m) - ground)[unknown]),
            "worst_m": _most(filled - ground, unknown),
        }


def nearest(known_m: Floats) -> Floats:
    """Return a map (H, W) whose unknown cells have the height of the nearest known one."""
    unknown = np.isnan(known_m)
    at = ndimage.distance_transform_edt(unknown, return_distances=False, return_indices=True)
    rows, cols = np.asarray(at, dtype=np.int64)
    return known_m[rows, cols]


def _calibration(elevation_m: Floats, cell_m: float, rng: np.random.Generator) -> Iterator[Row]:
    """Compare errors of estimated cells with the sigmas that a robot gives them, by distance.

    Holes of all sizes, or all that lies beyond a line; completed as planners do (border "low",
    which is why holes leave out the map's rim). Laws: the one in use, and one of the median.
    """
    shape = (elevation_m.shape[0], elevation_m.shape[1])
    rugged = np.zeros(shape, dtype=np.bool_)
    for diameter_m in HOLES_M:
        rugged |= holes(shape, diameter_m / CELL_M, UNKNOWN_SHARE / len(HOLES_M), rng)
    rugged[[0, -1]] = rugged[:, [0, -1]] = False
    beyond = np.zeros(shape, dtype=np.bool_)
    beyond[: shape[0] // 2] = True
    for kind, unknown in (("holes", rugged), ("beyond", beyond)):
        known_m = np.where(unknown, np.nan, elevation_m)
        error_m = markov.complete(known_m, border="low") - elevation_m
        distance_m = markov.distance_to_known_m(~np.isnan(known_m), cell_m)
        rough_m = markov.roughness_m(known_m, cell_m)
        laws = {
            "in use": markov.variogram_sigma(known_m, distance_m / cell_m),
            "median": markov.estimated_sigma(distance_m, sigma_at_1m=rough_m),
        }
        asked = unknown & np.isfinite(elevation_m)
        for law, sigma_m in laws.items():
            for row in _bins(error_m, sigma_m, distance_m / cell_m, asked):
                yield {"unknown": kind, "law": law, "roughness_m": rough_m} | row


def _bins(error_m: Floats, sigma_m: Floats, cells: Floats, asked: Bools) -> Iterator[Row]:
    for low, high in itertools.pairwise(BINS):
        chosen = asked & (cells > low) & (cells <= high)
        if not chosen.any():
            continue
        z = np.abs(error_m[chosen]) / sigma_m[chosen]
        yield {
            "from_cells": low,
            "to_cells": high,
            "cells": int(chosen.sum()),
            "rmse_m": _rms(error_m[chosen]),
            "sigma_m": _rms(sigma_m[chosen]),
            "z_rms": _rms(z),
            "within_1": float((z <= 1).mean()),
            "within_2": float((z <= 2).mean()),
            "within_3": float((z <= 3).mean()),
        }


EXPERIMENT = Experiment(
    trials=trials,
    measure=measure,
    conclude=conclude,
    draw=draw,
    settings={
        "ground": "an elevation file (.npz or GeoTIFF) for the sigmas; may be repeated",
        "cell_m": "the cell size that the files shall be taken to have",
    },
)
