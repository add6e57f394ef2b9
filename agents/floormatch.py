"""Where a robot is on a floor, by holding a look's ranges against the map that is there.

From a pose, the map predicts how far each ray goes: to the face of the first cell that is mapped
as occupied, as long as all cells before are mapped as free. The pose whose predictions fit best,
within three standard deviations of the believed one, is the measured pose; how sharply the fit
falls off around it is its covariance. A corridor fixes what is across it and nothing along it.
"""

import math
from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, GridFrame, Pose, wrap_angle
from agents.planar.rays import crossings, fan_rad
from agents.planar.sensing import MAPPED, sigma_m
from agents.settings import SensorSettings
from comms import kernels
from comms.kernels import kernel

RAYS = 64
"""So many rays of a look are held against the map."""
MODEL_M = 0.05
"""Error of a predicted range besides the sensor's: what is solid is no square."""
MOST = 9.0
"""A ray that does not fit at all counts like three standard deviations."""
INDEPENDENT = 12.0
"""All rays of a look tell as much as so many independent ones."""
FIT = 0.6
"""Share of the rays with a prediction that must fit, and how many there must be."""
LEAST_RAYS = 12
FLOOR_M, FLOOR_RAD = 0.02, 0.003
"""No look tells more than this."""
STEP_M, STEP_RAD = 0.04, 0.01
"""Offsets at which the fall of the fit is measured."""
VAGUE = 1e-3
"""Curvature (per unit squared, as a share of the sharpest) that says nothing."""


@dataclass(frozen=True)
class Match:
    """A measured pose and its covariance (4, 4) of (x, y, z, yaw)."""

    pose: Pose
    covariance: Floats


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
        measured, sigma = seen[k, 0], seen[k, 1]
        if np.isinf(measured) and np.isinf(expected):
            error = 0.0
        elif np.isinf(measured) or np.isinf(expected):
            error = MOST
        else:
            error = min(((measured - expected) / sigma) ** 2, MOST)
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
    states = np.where(log_odds > MAPPED, 2, np.where(log_odds < -MAPPED, 1, 0)).astype(np.int8)
    chosen = np.linspace(0, len(ranges_m) - 1, min(RAYS, len(ranges_m))).astype(np.int64)
    fan, cell_m = fan_rad(sensor)[chosen], frame.cell_m
    ranges = ranges_m[chosen]
    error_m = np.hypot(sigma_m(np.where(np.isfinite(ranges), ranges, 0.0), sensor), MODEL_M)
    seen = np.column_stack((ranges, error_m)) / cell_m
    reach = sensor.range_m / cell_m
    eye = np.array([(pose.x_m - frame.x_m) / cell_m, (pose.y_m - frame.y_m) / cell_m, pose.yaw_rad])
    sigmas = np.sqrt(np.diag(covariance))[[0, 1, 3]] / np.array([cell_m, cell_m, 1.0])
    span = 3.0 * np.maximum(sigmas, np.array([FLOOR_M / cell_m, FLOOR_M / cell_m, FLOOR_RAD]))
    for _ in range(4):
        eye = _search(states, eye, span, fan, seen, reach)
        span = span / 3.0
    misfit, told, fitting = _misfit(states, eye, fan, seen, reach)
    if told < LEAST_RAYS or fitting < FIT * told or not math.isfinite(misfit):
        return None
    spread = _spread(states, eye, fan, seen, reach, cell_m)
    x, y, yaw = (float(v) for v in eye)
    found = Pose(frame.x_m + x * cell_m, frame.y_m + y * cell_m, pose.z_m, wrap_angle(yaw))
    whole = np.diag([0.0, 0.0, 1.0, 0.0])
    whole[np.ix_([0, 1, 3], [0, 1, 3])] = spread
    return Match(found, whole)


def _spread(
    states: np.ndarray, eye: Floats, fan: Floats, seen: Floats, reach: float, cell_m: float
) -> Floats:
    """Return the covariance (3, 3) of (x, y, yaw), metres and radians, by the fit's curvature."""
    steps = np.array([STEP_M / cell_m, STEP_M / cell_m, STEP_RAD])

    def misfit(*axes: tuple[int, float]) -> float:
        at = eye.copy()
        for axis, sign in axes:
            at[axis] += sign * steps[axis]
        return float(_misfit(states, at, fan, seen, reach)[0])

    here, bend = misfit(), np.zeros((3, 3))
    for a in range(3):
        bend[a, a] = misfit((a, 1.0)) + misfit((a, -1.0)) - 2.0 * here
        for b in range(a):
            both = misfit((a, 1.0), (b, 1.0)) + misfit((a, -1.0), (b, -1.0))
            bend[a, b] = bend[b, a] = 0.25 * (
                both - misfit((a, 1.0), (b, -1.0)) - misfit((a, -1.0), (b, 1.0))
            )
    # In units of one step: the misfit is twice the negative log likelihood of the rays.
    information = 0.5 * bend * INDEPENDENT / len(fan)
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, VAGUE * max(float(values[-1]), 1e-6))
    units = np.array([STEP_M, STEP_M, STEP_RAD])
    covariance = (vectors / values) @ vectors.T * np.outer(units, units)
    return covariance + np.diag([FLOOR_M**2, FLOOR_M**2, FLOOR_RAD**2])


@kernels.warmer
def _warm() -> None:
    sensor = SensorSettings(columns=16, range_m=3.0)
    frame = GridFrame(0.0, 0.0, 1.0, 6, 6)
    log_odds = np.where(np.indices((6, 6))[1] == 5, 4.0, -4.0)
    match(log_odds, frame, Pose(3.0, 3.0, 0.0, 0.0), np.eye(4), np.full(16, 2.0), sensor)
