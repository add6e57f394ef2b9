"""Walking rays through a grid of cubes cell by cell: each cell that a ray crosses, in order."""

import math

import numpy as np

from agents.geometry import Floats
from agents.settings import SensorSettings
from comms import kernels
from comms.kernels import kernel


def ray_directions(sensor: SensorSettings, pan_rad: float, tilt_rad: float) -> Floats:
    """Return (rows * columns, 3) unit vectors in the levelled robot frame, top row first.

    They are spread evenly over azimuth (pan +- fov/2) and elevation (tilt +- fov_vertical/2).
    """
    half_h, half_v = math.radians(sensor.fov_deg) / 2, math.radians(sensor.fov_vertical_deg) / 2
    across = (np.arange(sensor.columns) + 0.5) / sensor.columns * 2 - 1
    down = (np.arange(sensor.rows) + 0.5) / sensor.rows * 2 - 1
    azimuth = pan_rad - half_h * across
    elevation = np.clip(tilt_rad - half_v * down, -math.pi / 2, math.pi / 2)
    flat = np.cos(elevation)[:, None]
    rays = np.empty((sensor.rows, sensor.columns, 3))
    rays[..., 0] = flat * np.cos(azimuth)
    rays[..., 1] = flat * np.sin(azimuth)
    rays[..., 2] = np.sin(elevation)[:, None]
    return rays.reshape(-1, 3)


def most_crossed(reach_cells: float) -> int:
    """Return how many cells a ray of this length can cross at most."""
    return 3 * math.ceil(reach_cells) + 6


@kernel
def crossings(
    start: np.ndarray, ray: np.ndarray, reach: float, cells: np.ndarray, entry: np.ndarray
) -> int:
    """Fill the cells (layer, row, col) that a ray crosses and where it enters each; count them.

    `start` (3,) and lengths are in cells, `ray` (3,) is a unit vector, both (layer, row, col).
    The first cell is the one that holds the start, at entry 0; the last is entered before `reach`.
    """
    z, y, x = math.floor(start[0]), math.floor(start[1]), math.floor(start[2])
    dz, dy, dx = (1 if ray[0] > 0 else -1), (1 if ray[1] > 0 else -1), (1 if ray[2] > 0 else -1)
    gz, gy, gx = abs(1.0 / ray[0]), abs(1.0 / ray[1]), abs(1.0 / ray[2])
    tz = (z + 1.0 - start[0] if ray[0] > 0 else start[0] - z) * gz if ray[0] != 0.0 else np.inf
    ty = (y + 1.0 - start[1] if ray[1] > 0 else start[1] - y) * gy if ray[1] != 0.0 else np.inf
    tx = (x + 1.0 - start[2] if ray[2] > 0 else start[2] - x) * gx if ray[2] != 0.0 else np.inf
    at = 0.0
    count = 0
    while at < reach and count < len(entry):
        cells[count, 0], cells[count, 1], cells[count, 2] = z, y, x
        entry[count] = at
        count += 1
        if tx <= ty and tx <= tz:
            at, x, tx = tx, x + dx, tx + gx
        elif ty <= tz:
            at, y, ty = ty, y + dy, ty + gy
        else:
            at, z, tz = tz, z + dz, tz + gz
    return count


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    cells, entry = np.empty((16, 3), dtype=np.int64), np.empty(16)
    crossings(np.array((0.5, 0.5, 0.5)), np.array((0.0, 0.6, 0.8)), 3.0, cells, entry)
