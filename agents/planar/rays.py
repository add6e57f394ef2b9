"""Walking rays through a grid cell by cell: each cell that a ray crosses, once, in order."""

import math

import numpy as np

from agents.geometry import Floats, Ints
from agents.settings import SensorSettings
from comms import kernels
from comms.kernels import kernel


@kernel
def crossings(
    x: float, y: float, angle: float, reach: float, cells: np.ndarray, entry: np.ndarray
) -> int:
    """Fill the cells (row, col) that a ray crosses and where it enters each; return their count.

    `x`, `y` and lengths are in cells, from the grid's south-west corner; cell (0, 0) spans [0, 1)
    both ways, and cells may lie outside any grid. The first is the one that holds the start, at
    entry 0; the last is entered before `reach`. `cells` (M, 2) and `entry` (M,) bound the walk.
    """
    dx, dy = math.cos(angle), math.sin(angle)
    col, row = math.floor(x), math.floor(y)
    step_c = 1 if dx > 0.0 else -1
    step_r = 1 if dy > 0.0 else -1
    per_c = 1.0 / abs(dx) if dx != 0.0 else np.inf
    per_r = 1.0 / abs(dy) if dy != 0.0 else np.inf
    next_c = (col + 1.0 - x if dx > 0.0 else x - col) * per_c if dx != 0.0 else np.inf
    next_r = (row + 1.0 - y if dy > 0.0 else y - row) * per_r if dy != 0.0 else np.inf
    at = 0.0
    count = 0
    while at < reach and count < len(entry):
        cells[count, 0], cells[count, 1], entry[count] = row, col, at
        count += 1
        if next_c < next_r:
            at = next_c
            next_c += per_c
            col += step_c
        else:
            at = next_r
            next_r += per_r
            row += step_r
    return count


def most_crossed(reach_cells: float) -> int:
    """Return how many cells a ray of this length can cross at most."""
    return 2 * math.ceil(reach_cells) + 4


@kernel
def _star(reach: float, steps: np.ndarray, entry: np.ndarray, counts: np.ndarray) -> None:
    bearings = len(counts)
    for b in range(bearings):
        angle = 2.0 * math.pi * (b + 0.5) / bearings
        counts[b] = crossings(0.5, 0.5, angle, reach, steps[b], entry[b])


def star(reach_cells: float, bearings: int) -> tuple[Ints, Floats, Ints]:
    """Return the rays that leave a cell's centre all around.

    Returns:
        steps (bearings, M, 2), rows and columns from that cell; entry (bearings, M), in cells;
        counts (bearings,), how many of the M each ray crosses. Ray b points half a bearing
        beyond `2 pi b / bearings`.
    """
    most = most_crossed(reach_cells)
    steps = np.zeros((bearings, most, 2), dtype=np.int64)
    entry = np.zeros((bearings, most))
    counts = np.zeros(bearings, dtype=np.int64)
    _star(reach_cells, steps, entry, counts)
    return steps, entry, counts


def fan_rad(sensor: SensorSettings) -> Floats:
    """Return the bearings (columns,) of the sensor's rays from its middle, ascending."""
    half = 0.5 * np.radians(sensor.fov_deg)
    return half * (2.0 * (np.arange(sensor.columns) + 0.5) / sensor.columns - 1.0)


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    star(2.0, 8)
