"""How right a run's team map is, where it ought to be right: near looks and on gentle ground."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True)
class Class:
    """Cells of one kind of ground, by slope and by distance from the nearest look."""

    name: str
    steep: bool
    beyond_m: float
    within_m: float

    @property
    def words(self) -> str:
        """Return what it is, for a table."""
        slope = "30 deg and more" if self.steep else "below 30 deg"
        return f"{slope}, {self.beyond_m:g} to {self.within_m:g} m"


CLASSES = (
    Class("gentle_near", steep=False, beyond_m=0.0, within_m=NEAR_M),
    Class("gentle_far", steep=False, beyond_m=NEAR_M, within_m=FAR_M),
    Class("steep_near", steep=True, beyond_m=0.0, within_m=NEAR_M),
    Class("steep_far", steep=True, beyond_m=NEAR_M, within_m=FAR_M),
)


@dataclass(frozen=True)
class _Compared:
    """A team map beside the ground."""

    map_m: Floats
    truth_m: Floats
    both: Bools
    """(H, W) where the two are known."""
    away_m: Floats
    """(H, W) to the nearest look, on the ground."""
    gentle: Bools
    frame: GridFrame

    def of(self, one: Class) -> Bools:
        """Return the cells (H, W) of a class."""
        ring = (self.away_m > one.beyond_m) | (one.beyond_m == 0)
        return self.both & ring & (self.away_m <= one.within_m) & (self.gentle != one.steep)


def accuracy(result: RunResult, eyes_m: Sequence[tuple[float, float]]) -> Row:
    """Return root mean square errors of the team map, in metres.

    `near_rmse_m`: height, on slopes below 30 degrees within 5 m of a look. `far_rmse_m`: distance
    of the mapped point to the true surface, all else within 10 m of a look. Empty without cells.
    """
    on = _compared(result, eyes_m)
    near = on.of(CLASSES[0])
    far = on.both & (on.away_m <= FAR_M) & ~near
    told: Row = {}
    if near.any():
        told["near_rmse_m"] = _rms((on.map_m - on.truth_m)[near])
    if far.any():
        told["far_rmse_m"] = _rms(to_surface_m(on.map_m, on.truth_m, far, on.frame))
    return told


def by_class(result: RunResult, eyes_m: Sequence[tuple[float, float]]) -> Row:
    """Return of each of `CLASSES` its cells, and their r.m.s. errors of height and to the surface.

    Keys are `NAME_cells`, `NAME_height_m` and `NAME_surface_m`; the last two are 0 without cells.
    """
    on = _compared(result, eyes_m)
    told: Row = {}
    for one in CLASSES:
        cells = on.of(one)
        some = bool(cells.any())
        off_m = to_surface_m(on.map_m, on.truth_m, cells, on.frame) if some else np.zeros(0)
        told[f"{one.name}_cells"] = int(cells.sum())
        told[f"{one.name}_height_m"] = _rms((on.map_m - on.truth_m)[cells])
        told[f"{one.name}_surface_m"] = _rms(off_m)
    return told


def _compared(result: RunResult, eyes_m: Sequence[tuple[float, float]]) -> _Compared:
    terrain = result.stage.terrain
    assert isinstance(terrain, Terrain)
    elevation_m, _ = union_map(survivors(result.finals), terrain.frame.shape)
    map_m = elevation_m.astype(np.float64)
    truth_m = terrain.elevation_m.astype(np.float64)
    return _Compared(
        map_m,
        truth_m,
        np.isfinite(map_m) & np.isfinite(truth_m),
        _away_m(terrain.frame, eyes_m),
        slope_deg(truth_m, terrain.frame.cell_m) < GENTLE_DEG,
        terrain.frame,
    )


def _rms(errors_m: Floats) -> float:
    return math.sqrt(float(np.mean(errors_m**2))) if errors_m.size else 0.0


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
