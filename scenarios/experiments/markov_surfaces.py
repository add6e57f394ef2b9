"""Surfaces with unknown cells (Fig. 7), and the paper's own way to fill them, sweep by sweep."""

import math
import time
from collections.abc import Callable
from typing import Literal

import numpy as np

from agents.geometry import Bools, Floats, GridFrame
from scenarios.errors import UsageError
from sim.errors import WorldError
from sim.relief import make_relief
from sim.settings import TerrainSettings
from sim.terrain_files import read_elevation

CELL_M = 0.1
SIDE = 48
"""Cells of a side of Fig. 7's surfaces: sweeps take time by its fourth power."""
GROUND_SIDE = 256
LARGEST_FILE_SIDE = 512
"""Of a larger file the middle is taken."""
WAVE_CELLS = 32.0
"""Wavelength of the sinusoid."""
NOISE_M = 0.005
"""Known cells are measured with this deviation."""
MADE_UP = ("cliff", "plain")
SWEEPS = 400_000
"""Sweeps at most: several times what a surface of `SIDE` takes."""


def sinusoid(rng: np.random.Generator, side: int = SIDE) -> Floats:
    """Return two crossing waves of 0.5 m (side, side), their phases drawn."""
    y, x = np.mgrid[:side, :side] * (2 * np.pi / WAVE_CELLS)
    one, other = rng.uniform(0, 2 * np.pi, 2)
    return np.asarray(0.5 * (np.sin(x + one) + np.sin(y + other)), dtype=np.float64)


def step(rng: np.random.Generator, side: int = SIDE) -> Floats:
    """Return ground (side, side) that falls by 1 m from west to east, somewhere in the middle."""
    at = side // 2 + int(rng.integers(-side // 8, side // 8 + 1))
    ground = np.zeros((side, side))
    ground[:, :at] = 1.0
    return ground


def holes(shape: tuple[int, int], diameter: float, share: float, rng: np.random.Generator) -> Bools:
    """Return which cells (H, W) lie in round holes that together take a share of the map at least.

    A hole of one cell or less is a cell.
    """
    unknown = np.zeros(shape, dtype=np.bool_)
    reach = math.ceil(max(diameter, 1) / 2)
    while unknown.mean() < share:
        row, col = rng.uniform(0, shape[0]), rng.uniform(0, shape[1])
        if diameter <= 1:
            unknown[int(row), int(col)] = True
            continue
        rows = slice(max(0, int(row) - reach), int(row) + reach + 1)
        cols = slice(max(0, int(col) - reach), int(col) + reach + 1)
        y, x = np.mgrid[rows, cols][:, : shape[0] - rows.start, : shape[1] - cols.start] + 0.5
        unknown[rows, cols] |= np.hypot(y - row, x - col) <= diameter / 2
    return unknown


def measured(ground_m: Floats, unknown: Bools, rng: np.random.Generator) -> Floats:
    """Return ground (H, W) as it is known: with noise, NaN where unknown."""
    noisy = ground_m + rng.normal(0.0, NOISE_M, ground_m.shape)
    return np.where(unknown, np.nan, noisy)


def sample(name: str, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return one of Fig. 7's surfaces: the truth, and as it is known (both H, W)."""
    if name == "sinusoid":
        ground = sinusoid(rng)
        return ground, measured(ground, holes(ground.shape, 1, 0.5, rng), rng)
    ground = step(rng)
    unknown = np.zeros(ground.shape, dtype=np.bool_)
    if name == "step":
        unknown[SIDE // 2 :] = True
    else:
        unknown = ground < 0.5
    return ground, measured(ground, unknown, rng)


def ground_of(name: str, seed: int, cell_m: float | None = None) -> tuple[Floats, float]:
    """Return elevations (H, W), NaN where unknown, and their cell size: made up, or a file's.

    Raises UsageError for a file that can't be read.
    """
    if name in MADE_UP:
        settings = TerrainSettings(kind="cliff" if name == "cliff" else "plain")
        frame = GridFrame(0.0, 0.0, CELL_M, GROUND_SIDE, GROUND_SIDE)
        made = make_relief(settings, frame, np.random.default_rng(seed))
        return made.elevation_m.astype(np.float64), CELL_M
    try:
        file = read_elevation(name, cell_m)
    except WorldError as error:
        raise UsageError(f"--set ground={name}: {error}") from error
    rows, cols = (max(side - LARGEST_FILE_SIDE, 0) // 2 for side in file.elevation_m.shape)
    middle = file.elevation_m[rows : rows + LARGEST_FILE_SIDE, cols : cols + LARGEST_FILE_SIDE]
    return middle.astype(np.float64), file.cell_m


def swept(
    elevation_m: Floats, tolerance_m: float, start: Literal["lowest", "highest"] = "lowest"
) -> tuple[Floats, int]:
    """Return what Jacobi's sweeps fill in, and how many it took (section 2.2, as it is told).

    Unknown cells of (H, W) start at the lowest known elevation (or the highest), then all take the
    mean of their neighbours inside the grid, until none moves by more than the tolerance.
    """
    known = ~np.isnan(elevation_m)
    first = np.nanmin(elevation_m) if start == "lowest" else np.nanmax(elevation_m)
    filled = np.where(known, elevation_m, first)
    for sweep in range(1, SWEEPS + 1):
        moved = np.where(known, filled, neighbour_mean(filled))
        most = float(np.abs(moved - filled).max())
        filled = moved
        if most <= tolerance_m:
            return filled, sweep
    return filled, SWEEPS


def neighbour_mean(values: Floats) -> Floats:
    """Return the mean (H, W) of each cell's 4 neighbours inside the grid."""
    padded = np.pad(values, 1)
    total = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
    inside = np.pad(np.ones(values.shape), 1)
    count = inside[:-2, 1:-1] + inside[2:, 1:-1] + inside[1:-1, :-2] + inside[1:-1, 2:]
    return total / np.maximum(count, 1)


def timed(work: Callable[[], Floats]) -> tuple[Floats, float]:
    """Return what some work gives, and the processor seconds that it took."""
    start = time.process_time()
    result = work()
    return result, time.process_time() - start
