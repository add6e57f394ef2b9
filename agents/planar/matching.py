"""Where a robot is on a floor, by a look's ranges (`agents.occupancy.matching`).

A corridor fixes what is across it and nothing along it.
"""

from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, GridFrame, Pose, wrap_angle
from agents.occupancy.matching import MOST, Match, Scales, chosen_rays, fitted, misfit_of
from agents.planar.rays import crossings, fan_rad
from agents.planar.sensing import MAPPED, sigma_m
from agents.settings import SensorSettings
from comms import kernels
from comms.kernels import kernel

MODEL_M = 0.05
"""Error of a predicted range besides the sensor's: what is solid is no square."""
FLOOR_M, FLOOR_RAD = 0.02, 0.003
"""No look tells more than this."""
STEP_M, STEP_RAD = 0.04, 0.01
"""Offsets at which the fall of the fit is measured."""
AXES = [0, 1, 3]
"""Of (x, y, z, yaw), those of an eye on a floor."""


def _scales(cell_m: float) -> Scales:
    return Scales(
        units=np.array((cell_m, cell_m, 1.0)),
        floor=np.array((FLOOR_M, FLOOR_M, FLOOR_RAD)),
        step=np.array((STEP_M, STEP_M, STEP_RAD)),
        rays=64,
        least_rays=12,
    )


@kernel
def _misfit(
    states: np.ndarray, eye: np.ndarray, fan: np.ndarray, seen: np.ndarray, reach: float
) -> tuple[float, int, int]:
    """Return the misfit of a pose, the rays with a prediction, and those that fit.

    `states` (rows, cols): 1 free, 2 occupied, 0 neither. `eye` is (x, y, yaw) in cells and radians.
    `seen` (rays, 2): measured range (inf: nothing) and its standard deviation, in cells.
    """
    rows, cols = states.shape
    cells = np.empty((2 * int(reach) + 8, 2), dtype=np.int64)
    entry = np.empty(len(cells))
    total, told, fitting = 0.0, 0, 0
    for k in range(len(fan)):
        expected = np.inf
        is_told = True
        count = crossings(eye[0], eye[1], eye[2] + fan[k], reach, cells, entry)
        for n in range(count):
            i, j = cells[n, 0], cells[n, 1]
            if i < 0 or j < 0 or i >= rows or j >= cols or states[i, j] == 0:
                is_told = n == 0
                if n > 0:
                    break
            elif states[i, j] == 2 and n > 0:
                expected = entry[n]
                break
        if not is_told:
            total += 0.5 * MOST
            continue
        told += 1
        error = misfit_of(seen[k, 0], seen[k, 1], expected)
        total += error
        fitting += error < MOST
    return total, told, fitting


@kernel
def _search(
    states: np.ndarray,
    eye: np.ndarray,
    span: np.ndarray,
    fan: np.ndarray,
    seen: np.ndarray,
    reach: float,
) -> np.ndarray:
    """Return the best of 7 x 7 x 7 poses within `span` of an eye; the nearest of equals."""
    best = eye.copy()
    least = np.inf
    at = np.empty(3)
    for a in range(-3, 4):
        at[0] = eye[0] + span[0] * a / 3.0
        for b in range(-3, 4):
            at[1] = eye[1] + span[1] * b / 3.0
            for c in range(-3, 4):
                at[2] = eye[2] + span[2] * c / 3.0
                misfit = _misfit(states, at, fan, seen, reach)[0] + 1e-3 * (a * a + b * b + c * c)
                if misfit < least:
                    least = misfit
                    best = at.copy()
    return best


@dataclass(frozen=True)
class _Fan:
    """`agents.occupancy.matching.Casting` on a floor; an eye is (x, y, yaw)."""

    states: np.ndarray
    fan: Floats
    seen: Floats
    reach: float

    def misfit(self, eye: Floats) -> tuple[float, int, int]:
        return _misfit(self.states, eye, self.fan, self.seen, self.reach)

    def search(self, eye: Floats, span: Floats) -> Floats:
        return _search(self.states, eye, span, self.fan, self.seen, self.reach)


def match(
    log_odds: Floats,
    frame: GridFrame,
    pose: Pose,
    covariance: Floats,
    ranges_m: Floats,
    sensor: SensorSettings,
) -> Match | None:
    """Return where the camera stood by a look's ranges, or None where they don't tell.

    Args:
        log_odds: (rows, cols) the map.
        frame: the map's.
        pose: the camera's believed pose; its yaw is the middle of the fan.
        covariance: (4, 4) of (x, y, z, yaw), metres and radians.
        ranges_m: (columns,) as `agents.ports.Exposure` has them.
        sensor: its fan, range and noise (Eq. 4).

    """
    cell_m, scales = frame.cell_m, _scales(frame.cell_m)
    states = np.where(log_odds > MAPPED, 2, np.where(log_odds < -MAPPED, 1, 0)).astype(np.int8)
    chosen = chosen_rays(len(ranges_m), scales.rays)
    ranges = ranges_m[chosen]
    error_m = np.hypot(sigma_m(np.where(np.isfinite(ranges), ranges, 0.0), sensor), MODEL_M)
    casting = _Fan(
        states,
        fan_rad(sensor)[chosen],
        np.column_stack((ranges, error_m)) / cell_m,
        sensor.range_m / cell_m,
    )
    eye = np.array([(pose.x_m - frame.x_m) / cell_m, (pose.y_m - frame.y_m) / cell_m, pose.yaw_rad])
    found = fitted(casting, eye, np.sqrt(np.diag(covariance))[AXES], scales, len(chosen))
    if found is None:
        return None
    x, y, yaw = (float(v) for v in found[0])
    stood = Pose(frame.x_m + x * cell_m, frame.y_m + y * cell_m, pose.z_m, wrap_angle(yaw))
    whole = np.diag([0.0, 0.0, 1.0, 0.0])
    whole[np.ix_(AXES, AXES)] = found[1]
    return Match(stood, whole)


@kernels.warmer
def _warm() -> None:
    sensor = SensorSettings(columns=16, range_m=3.0)
    frame = GridFrame(0.0, 0.0, 1.0, 6, 6)
    log_odds = np.where(np.indices((6, 6))[1] == 5, 4.0, -4.0)
    match(log_odds, frame, Pose(3.0, 3.0, 0.0, 0.0), np.eye(4), np.full(16, 2.0), sensor)
