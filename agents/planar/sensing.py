"""How sure one look makes a cell, and what a fan of measured ranges says of a map.

A ray measures its range with sigma = S r^n (Sujan & Meggiolaro, Eq. 4, T = 1 along the ray). It
speaks truly of a cell as long as that error is less than half the cell, which has the probability

    c(r) = Phi(cell / (2 sigma(r)))

so a look that finds a cell free or occupied at range r moves its log-odds by l(r) = logit c(r),
at most `SUREST`. Near cells are sure after one look; far ones need two or more. Of the rays that
cross a cell in one look the majority decides: neighbours share their errors' causes, and a cell
that is measured by ten rays of one look is not ten times as sure.
"""

import math

import numpy as np
from scipy.special import ndtr

from agents.geometry import Floats, GridFrame, Pose
from agents.planar.rays import crossings, fan_rad
from agents.settings import SensorSettings
from comms import kernels
from comms.kernels import kernel

MAPPED = math.log(9.0)
"""Log-odds beyond which occupancy is off by more than 0.4 from 0.5."""
SUREST = 4.0
"""Log-odds that one look gives at most (p = 0.018)."""
LIMIT = 8.0
"""Log-odds that a map holds at most."""


def sigma_m(range_m: Floats, sensor: SensorSettings) -> Floats:
    """Return the standard deviation of a range (Eq. 4), metres."""
    return sensor.noise_s * np.asarray(range_m, dtype=np.float64) ** sensor.noise_n


def evidence(range_m: Floats, cell_m: float, sensor: SensorSettings) -> Floats:
    """Return l(r), the log-odds by which one look moves a cell at these ranges, elementwise."""
    spread = np.maximum(sigma_m(range_m, sensor), 1e-6)
    wrong = np.maximum(ndtr(-0.5 * cell_m / spread), 1e-12)
    return np.minimum(np.log((1.0 - wrong) / wrong), SUREST)


@kernel
def _sweep(
    votes: np.ndarray,
    eye: tuple[float, float],
    angles: np.ndarray,
    reach: np.ndarray,
    face: np.ndarray,
) -> None:
    """Count, per cell, rays that passed (votes[0]) and rays that ended there (votes[1]).

    A ray that came back (its `face` is finite) passed those cells whose middle lies before the
    face; what it crosses between there and its end it tells nothing of: beside a wall that it
    grazes it would else call half of the wall free.
    """
    rows, cols = votes.shape[1:]
    cells = np.empty((2 * int(np.max(reach)) + 8, 2), dtype=np.int64)
    entry = np.empty(len(cells))
    for k in range(len(angles)):
        count = crossings(eye[0], eye[1], angles[k], reach[k], cells, entry)
        for n in range(count):
            i, j = cells[n, 0], cells[n, 1]
            if i < 0 or j < 0 or i >= rows or j >= cols:
                break
            if n == count - 1:
                votes[1 if face[k] < np.inf else 0, i, j] += 1
            elif 0.5 * (entry[n] + entry[n + 1]) < face[k]:
                votes[0, i, j] += 1


def look_log_odds(frame: GridFrame, pose: Pose, ranges_m: Floats, sensor: SensorSettings) -> Floats:
    """Return what one look adds to the log-odds (rows, cols) of a map; 0 where it saw nothing.

    Args:
        frame: the map's.
        pose: of the camera; its yaw is the middle of the fan.
        ranges_m: (columns,) measured ranges along `rays.fan_rad(sensor)`; inf where nothing
            came back from within the sensor's range.
        sensor: its noise and range.
    """
    # A solid cell's face is where it is measured: the cell itself lies half a cell beyond.
    reach = np.where(
        np.isfinite(ranges_m), ranges_m / frame.cell_m + 0.5, sensor.range_m / frame.cell_m
    )
    x, y = (pose.x_m - frame.x_m) / frame.cell_m, (pose.y_m - frame.y_m) / frame.cell_m
    votes = np.zeros((2, *frame.shape), dtype=np.int32)
    _sweep(votes, (x, y), pose.yaw_rad + fan_rad(sensor), reach, ranges_m / frame.cell_m)
    row, col = np.nonzero(votes[0] + votes[1])
    away_m = np.hypot(row + 0.5 - y, col + 0.5 - x) * frame.cell_m
    sure = evidence(np.minimum(away_m, sensor.range_m), frame.cell_m, sensor)
    added = np.zeros(frame.shape)
    full = votes[1, row, col] >= votes[0, row, col]
    added[row, col] = np.where(full, sure, -sure)
    return added


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    sensor = SensorSettings(columns=4, range_m=2.0)
    frame = GridFrame(0.0, 0.0, 1.0, 6, 6)
    look_log_odds(frame, Pose(3.0, 3.0, 0.0, 0.0), np.full(4, np.inf), sensor)
