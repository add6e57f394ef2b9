"""How right a run's team map is, where it ought to be right: near looks and on gentle ground."""

import math
from collections.abc import Sequence

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from agents.geometry import Bools, Floats, GridFrame
from scenarios.experiments.tables import Row
from scenarios.records.summary import survivors, union_map
from scenarios.runner import RunResult
from sim.ground import Terrain, filled

NEAR_M = 5.0
FAR_M = 10.0
GENTLE_DEG = 30.0


def accuracy(result: RunResult, eyes_m: Sequence[tuple[float, float]]) -> Row:
    """Return root mean square errors of the team map, in metres.

    `near_rmse_m`: height, on slopes below 30 degrees within 5 m of a look. `far_rmse_m`: distance
    of the mapped point to the true surface, all else within 10 m of a look. Empty without cells.
    """
    terrain = result.stage.terrain
    assert isinstance(terrain, Terrain)
    shape = terrain.frame.shape
    map_m = union_map(survivors(result.finals), shape).astype(np.float64)
    truth_m = terrain.elevation_m.astype(np.float64)
    both = np.isfinite(map_m) & np.isfinite(truth_m)
    away_m = _away_m(terrain.frame, eyes_m)
    near = both & (away_m <= NEAR_M) & (slope_deg(truth_m, terrain.frame.cell_m) < GENTLE_DEG)
    far = both & (away_m <= FAR_M) & ~near
    told: Row = {}
    if near.any():
        told["near_rmse_m"] = math.sqrt(float(np.mean((map_m - truth_m)[near] ** 2)))
    if far.any():
        off_m = to_surface_m(map_m, truth_m, far, terrain.frame)
        told["far_rmse_m"] = math.sqrt(float(np.mean(off_m**2)))
    return told


def _away_m(frame: GridFrame, eyes_m: Sequence[tuple[float, float]]) -> Floats:
    """Return each cell's distance (H, W) on the ground to the nearest place of a look."""
    unseen = np.ones(frame.shape, dtype=np.bool_)
    for x_m, y_m in eyes_m:
        row, col = frame.cell_of(x_m, y_m)
        unseen[row, col] = False
    return np.asarray(ndimage.distance_transform_edt(unseen), dtype=np.float64) * frame.cell_m


def slope_deg(truth_m: Floats, cell_m: float) -> Floats:
    """Return the slope (H, W) of true ground, by central differences."""
    north, east = np.gradient(filled(truth_m), cell_m)
    return np.degrees(np.arctan(np.hypot(north, east)))


def to_surface_m(map_m: Floats, truth_m: Floats, where: Bools, frame: GridFrame) -> Floats:
    """Return the distance (N,) of mapped cells to the true surface, in metres.

    The surface is sampled five times finer than the cells, bilinearly, and no farther than the
    error of height allows.
    """
    rows, cols = np.nonzero(where)
    points = np.column_stack((cols, rows, map_m[where] / frame.cell_m))
    fine = np.arange(-0.4, 0.41, 0.2)
    grid_r, grid_c = np.nonzero(np.isfinite(truth_m) & ndimage.binary_dilation(where, iterations=8))
    full = filled(truth_m)
    samples = [
        np.column_stack((c, r, ndimage.map_coordinates(full, (r, c), order=1, mode="nearest")))
        for r, c in ((grid_r + a, grid_c + b) for a in fine for b in fine)
    ]
    surface = np.concatenate(samples)
    surface[:, 2] /= frame.cell_m
    distance, _ = KDTree(surface).query(points)
    upright = np.abs(map_m[where] - truth_m[where])
    return np.minimum(np.asarray(distance) * frame.cell_m, upright)
