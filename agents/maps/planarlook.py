"""One look over a floor, cell by cell: what a planar map takes in."""

from dataclasses import dataclass

import numpy as np

from agents.geometry import Bools, Floats, GridFrame, Ints, Pose
from agents.planar.rays import crossings, fan_rad
from agents.planar.sensing import look_log_odds
from agents.settings import SensorSettings
from comms import kernels
from comms.kernels import kernel


@dataclass(frozen=True)
class LookOdds:
    """What one look adds to the log-odds of the cells that its rays crossed; arrays (N,)."""

    rows: Ints
    cols: Ints
    log_odds: Floats


def look_odds(
    ranges_m: Floats,
    pose: Pose,
    frame: GridFrame,
    sensor: SensorSettings,
    *,
    extra_variance: tuple[float, float, float, float],
) -> LookOdds:
    """Turn the ranges of one look into one measurement per cell (`agents.planar.sensing`).

    `pose` is the camera's, its yaw the middle of the fan. `extra_variance` is the pose's variance
    (x, y, z, yaw) beyond that of the submap's anchor: log-odds are divided by 1 + (variance of the
    cell's place) / cell^2, as in `PlanarKind.blurred`.
    """
    added = look_log_odds(frame, pose, ranges_m, sensor)
    rows, cols = np.nonzero(added)
    x_m = frame.x_m + (cols + 0.5) * frame.cell_m - pose.x_m
    y_m = frame.y_m + (rows + 0.5) * frame.cell_m - pose.y_m
    var_x, var_y, _, var_yaw = extra_variance
    shift = 0.5 * (var_x + var_y) + (x_m * x_m + y_m * y_m) * var_yaw
    return LookOdds(rows, cols, added[rows, cols] / (1.0 + shift / frame.cell_m**2))


@kernel
def _mark(solid: np.ndarray, x: float, y: float, angles: np.ndarray, reach: float) -> np.ndarray:
    """Return which cells (rows, cols) rays cross up to the first solid one, that one included."""
    rows, cols = solid.shape
    cells = np.empty((2 * int(reach) + 8, 2), dtype=np.int64)
    entry = np.empty(len(cells))
    seen = np.zeros(solid.shape, dtype=np.bool_)
    for k in range(len(angles)):
        for n in range(crossings(x, y, angles[k], reach, cells, entry)):
            i, j = cells[n, 0], cells[n, 1]
            if i < 0 or j < 0 or i >= rows or j >= cols:
                break
            seen[i, j] = True
            if solid[i, j] and n > 0:
                break
    return seen


def visible_cells(solid: Bools, frame: GridFrame, pose: Pose, sensor: SensorSettings) -> Bools:
    """Return the cells (rows, cols) that a look from a pose reaches if just these are solid."""
    x, y = (pose.x_m - frame.x_m) / frame.cell_m, (pose.y_m - frame.y_m) / frame.cell_m
    return _mark(solid, x, y, pose.yaw_rad + fan_rad(sensor), sensor.range_m / frame.cell_m)


@kernels.warmer
def _warm() -> None:
    visible_cells(
        np.zeros((4, 4), dtype=np.bool_),
        GridFrame(0.0, 0.0, 1.0, 4, 4),
        Pose(2.0, 2.0, 0.0, 0.0),
        SensorSettings(columns=4, range_m=2.0),
    )
