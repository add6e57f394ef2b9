"""What the paper's map codec costs and loses: its compressors and its cut-off, beside our codec.

Sujan & Meggiolaro say of compression (section 2.3) that it mends what a histogram can't see, and
that LZW comes near the best that can be; of their quadtree (section 2.4) that it leaves out what
has little information. The comparison of compressors that they announce is not in the paper; this
is one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agents.geometry import Bools, Floats, GridFrame
from comms.codec import decode_grid, encode_grid
from comms.errors import CodecError
from comms.paper.entropy import PASSES, bits_after
from comms.papercode import COMPRESSORS, encode_paper_map
from scenarios.errors import UsageError
from scenarios.experiments.compress_claims import CUTOFFS_BITS, conclude
from scenarios.experiments.compress_figure import draw
from scenarios.experiments.frame import Experiment, Options
from scenarios.experiments.tables import Row
from sim.errors import WorldError
from sim.relief import make_relief
from sim.settings import TerrainSettings
from sim.terrain_files import read_elevation

SIDE = 256
CELL_M = 0.1
MADE_UP = ("cliff", "plain")
MAX_ERRORS_M = (0.02, 0.05, 0.1, 0.25)
LARGEST_FILE_SIDE = 512
"""Of a larger file the middle is taken."""


@dataclass(frozen=True)
class Trial:
    """One piece of ground: made up from a seed, or a file's."""

    ground: str
    """A kind of made-up ground, or a path."""
    seed: int
    max_errors_m: tuple[float, ...]
    cell_m: float | None = None


def trials(options: Options) -> Sequence[Trial]:
    """Return a trial for each seed and kind of ground, and one for each file."""
    errors_m = _max_errors_m(options)
    cell_m = options.number("cell_m", CELL_M) if "cell_m" in options.sets else None
    files = [Trial(path, 1, errors_m, cell_m) for path in options.sets.get("ground", ())]
    for file in files:
        ground_of(file)
    seeds = range(1, options.seeds + 1)
    return [*(Trial(kind, seed, errors_m) for kind in MADE_UP for seed in seeds), *files]


def _max_errors_m(options: Options) -> tuple[float, ...]:
    texts = options.sets.get("max_error_m", ())
    if not texts:
        return MAX_ERRORS_M
    each = [Options(sets={"max_error_m": [text]}).number("max_error_m", 1.0) for text in texts]
    return tuple(sorted(set(each)))


def ground_of(trial: Trial) -> tuple[Floats, Bools]:
    """Return elevations (H, W), 0 where unknown, and which are known (H, W).

    Raises UsageError for a file that can't be read.
    """
    if trial.ground in MADE_UP:
        settings = TerrainSettings(kind="cliff" if trial.ground == "cliff" else "plain")
        frame = GridFrame(0.0, 0.0, CELL_M, SIDE, SIDE)
        made = make_relief(settings, frame, np.random.default_rng(trial.seed))
        elevation_m = made.elevation_m.astype(np.float64)
    else:
        try:
            elevation_m = _middle(read_elevation(trial.ground, trial.cell_m).elevation_m)
        except WorldError as error:
            raise UsageError(f"--set ground={trial.ground}: {error}") from error
    known = np.isfinite(elevation_m)
    return np.where(known, elevation_m, 0.0), known


def _middle(cells: Floats) -> Floats:
    rows, cols = (max(side - LARGEST_FILE_SIDE, 0) // 2 for side in cells.shape)
    return cells[rows : rows + LARGEST_FILE_SIDE, cols : cols + LARGEST_FILE_SIDE]


def measure(trial: Trial) -> Sequence[Row]:
    """Return a row for each way to send this ground, and for each way to tell its information."""
    elevation_m, known = ground_of(trial)
    name = trial.ground if trial.ground in MADE_UP else Path(trial.ground).stem
    base: Row = {"ground": name, "seed": trial.seed, "cells": int(known.sum())}
    rows: list[Row] = []
    for max_error_m in trial.max_errors_m:
        asked: Row = {**base, "max_error_m": max_error_m}
        try:
            sent = [
                *_paper(elevation_m, known, max_error_m),
                _ours(elevation_m, known, max_error_m),
            ]
        except CodecError as error:
            raise UsageError(f"{trial.ground} at {max_error_m:g} m: {error}") from error
        rows += [{**asked, **row, "bits_per_cell": _per_cell(row, known)} for row in sent]
        rows += [{**asked, **row} for row in _information(elevation_m, known, max_error_m, trial)]
    return rows


def _per_cell(row: Row, known: Bools) -> float:
    return 8 * float(row["bytes"]) / max(int(known.sum()), 1)


def _paper(elevation_m: Floats, known: Bools, max_error_m: float) -> Iterator[Row]:
    for cutoff_bits in CUTOFFS_BITS:
        ours_bytes = 0
        for compressor in COMPRESSORS:
            sent = encode_paper_map(
                elevation_m,
                known,
                max_error_m,
                cutoff_bits=cutoff_bits,
                compressor=compressor,
                pebble_m=0.0 if cutoff_bits == 0 else None,
            )
            # All compressors tell the same leaves, so the error is the same too.
            same_m = sent.max_error_m or max_error_m
            ours_bytes = ours_bytes or len(encode_grid(elevation_m, known, same_m))
            yield {
                "codec": "paper",
                "cutoff_bits": cutoff_bits,
                "compressor": compressor,
                "bytes": len(sent.data),
                "error_m": sent.max_error_m,
                "rmse_m": sent.rmse_m,
                "leaves": sent.leaves,
                "ours_at_this_error_bytes": ours_bytes,
            }


def _ours(elevation_m: Floats, known: Bools, max_error_m: float) -> Row:
    data = encode_grid(elevation_m, known, max_error_m)
    told_m, _ = decode_grid(data)
    error_m = np.abs(told_m.astype(np.float64) - elevation_m)[known]
    return {
        "codec": "ours",
        "bytes": len(data),
        "error_m": float(error_m.max()),
        "rmse_m": float(np.sqrt(np.mean(error_m**2))),
    }


def _information(
    elevation_m: Floats, known: Bools, max_error_m: float, trial: Trial
) -> Iterator[Row]:
    """Tell the information of the ground in bins, and of its cells in any order (Eqs. 1, 2)."""
    bins = np.floor(elevation_m / (2 * max_error_m) + 0.5).astype(np.int64)
    bins[~known] = bins[known].min()
    shuffled = np.random.default_rng(trial.seed).permutation(bins.ravel()).reshape(bins.shape)
    for name in PASSES:
        yield {
            "codec": "information",
            "compressor": name,
            "bits_per_cell": bits_after(bins, name),
            "shuffled_bits_per_cell": bits_after(shuffled, name),
        }


EXPERIMENT = Experiment(
    trials=trials,
    measure=measure,
    conclude=conclude,
    draw=draw,
    settings={
        "ground": "an elevation file (.npz or GeoTIFF) to be added; may be repeated",
        "cell_m": "the cell size that the files shall be taken to have",
        "max_error_m": "half the width of the bins; may be repeated",
    },
)
