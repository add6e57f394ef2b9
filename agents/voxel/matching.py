"""Where a robot is in space, by holding a look's ranges against the voxel map that is there.

As `agents.floormatch` on a floor: from a pose the map predicts how far each ray goes, to the face
of the first cell mapped as solid, as long as all cells before are mapped as free. The pose near the
believed one whose predictions fit best is the measured one, and how sharply the fit falls off about
it is its covariance. A level floor fixes the height and nothing else; walls fix the rest.
"""

import math
from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, Pose, wrap_angle
from agents.maps.voxellook import eye_of, world_rays
from agents.planar.sensing import sigma_m
from agents.settings import SensorSettings
from agents.voxel.frame import VoxelFrame
from agents.voxel.ground import States, state_at
from agents.voxel.rays import crossings
from comms import kernels
from comms.kernels import kernel

RAYS = 240
"""So many rays of a look, spread over all of it, are held against the map."""
MODEL_CELLS = 0.3
"""Error of a predicted range besides the sensor's: what is solid is no cube."""
MOST = 9.0
"""A ray that does not fit at all counts like three standard deviations."""
INDEPENDENT = 12.0
"""All rays of a look tell as much as so many independent ones."""
FIT = 0.6
"""Share of the rays with a prediction that must fit, and how many there must be."""
LEAST_RAYS = 30
FLOOR_M, FLOOR_RAD = 0.015, 0.003
"""No look tells more than this."""
STEP_M, STEP_RAD = 0.05, 0.012
"""Offsets at which the fall of the fit is measured."""
VAGUE = 1e-3
"""Curvature (per unit squared, as a share of the sharpest) that says nothing."""
LEVELS = 4
"""Times that the search is narrowed to a third."""


@dataclass(frozen=True)
class Match:
    """A measured pose and its covariance (4, 4) of (x, y, z, yaw)."""

    pose: Pose
    covariance: Floats


@kernel
def _misfit(
    index: np.ndarray,
    states: np.ndarray,
    eye: np.ndarray,
    rays: np.ndarray,
    seen: np.ndarray,
    reach: float,
) -> tuple[float, int, int]:
    """Return the misfit of an eye (layer, row, col, turn), the rays with a prediction and a fit.

    `rays` (N, 3) before the turn; `seen` (N, 2) range (inf: nothing) and sigma, in cells.
    """
    most = 3 * int(reach) + 10
    cells, entry = np.empty((most, 3), dtype=np.int64), np.empty(most)
    ray, start = np.empty(3), eye[:3].copy()
    c, s = math.cos(eye[3]), math.sin(eye[3])
    total, told, fitting = 0.0, 0, 0
    for k in range(len(rays)):
        ray[0] = rays[k, 0]
        ray[1] = s * rays[k, 2] + c * rays[k, 1]
        ray[2] = c * rays[k, 2] - s * rays[k, 1]
        expected, is_told = np.inf, True
        for n in range(crossings(start, ray, reach, cells, entry)):
            state = state_at(index, states, cells[n, 0], cells[n, 1], cells[n, 2])
            if state == 2 and n > 0:
                expected = entry[n]
                break
            if state == 0 and n > 0:
                is_told = False
                break
        if not is_told:
            total += 0.5 * MOST
            continue
        told += 1
        if np.isinf(seen[k, 0]) and np.isinf(expected):
            error = 0.0
        elif np.isinf(seen[k, 0]) or np.isinf(expected):
            error = MOST
        else:
            error = min(((seen[k, 0] - expected) / seen[k, 1]) ** 2, MOST)
        total += error
        fitting += error < MOST
    return total, told, fitting


@kernel
def _search(
    index: np.ndarray,
    states: np.ndarray,
    eye: np.ndarray,
    span: np.ndarray,
    rays: np.ndarray,
    seen: np.ndarray,
    reach: float,
) -> np.ndarray:
    """Return the best eye within `span` (4,): first by height, then along the ground, then turned.

    Of equals the nearest.
    """
    at, best = eye.copy(), eye.copy()
    for stage in range(3):
        middle, least = best.copy(), np.inf
        for a in range(-3, 4):
            for b in range(-3, 4):
                if stage != 1 and b != 0:
                    continue
                at[:] = middle
                if stage == 0:
                    at[0] += span[0] * a / 3.0
                elif stage == 1:
                    at[1] += span[1] * a / 3.0
                    at[2] += span[2] * b / 3.0
                else:
                    at[3] += span[3] * a / 3.0
                misfit = _misfit(index, states, at, rays, seen, reach)[0] + 1e-3 * (a * a + b * b)
                if misfit < least:
                    least = misfit
                    best = at.copy()
    return best


def match(
    index: np.ndarray,
    states: States,
    frame: VoxelFrame,
    pose: Pose,
    tilt_rad: float,
    covariance: Floats,
    ranges_m: Floats,
    sensor: SensorSettings,
) -> Match | None:
    """Return where the robot stood by a look's ranges, or None where they don't tell.

    Args:
        index: (layers, rows, cols) of blocks, -1 where there is none.
        states: (blocks, 16, 16, 16) what is mapped as free, solid or neither.
        frame: the map's.
        pose: the robot's as believed, its yaw where the camera points.
        tilt_rad: of the camera.
        covariance: (4, 4) of (x, y, z, yaw), metres and radians.
        ranges_m: (N,) as `agents.ports.Exposure` has them.
        sensor: its rays, range and noise (Eq. 4).
    """
    cell_m = frame.cell_m
    chosen = np.linspace(0, len(ranges_m) - 1, min(RAYS, len(ranges_m))).astype(np.int64)
    ranges = ranges_m[chosen] / cell_m
    near_m = np.where(np.isfinite(ranges), ranges, 0.0) * cell_m
    seen = np.column_stack((ranges, np.hypot(sigma_m(near_m, sensor) / cell_m, MODEL_CELLS)))
    rays = world_rays(sensor, pose.yaw_rad, tilt_rad)[chosen]
    reach = sensor.range_m / cell_m
    eye = np.append(frame.at(*eye_of(pose, sensor)), 0.0)
    sigma = np.sqrt(np.diag(covariance))
    floor = np.array((FLOOR_M, FLOOR_M, FLOOR_M, FLOOR_RAD))
    span = 3.0 * np.maximum(sigma, floor)[[2, 1, 0, 3]] / np.array((cell_m, cell_m, cell_m, 1.0))
    for _ in range(LEVELS):
        eye = _search(index, states, eye, span, rays, seen, reach)
        span = span / 3.0
    misfit, told, fitting = _misfit(index, states, eye, rays, seen, reach)
    if told < LEAST_RAYS or fitting < FIT * told or not math.isfinite(misfit):
        return None
    spread = _spread(index, states, eye, rays, seen, reach, cell_m)
    z, y, x = (float(v) * cell_m for v in eye[:3])
    stood = Pose(
        frame.x_m + x,
        frame.y_m + y,
        frame.z_m + z - sensor.height_m,
        wrap_angle(pose.yaw_rad + float(eye[3])),
    )
    return Match(stood, spread)


def _spread(
    index: np.ndarray,
    states: States,
    eye: Floats,
    rays: Floats,
    seen: Floats,
    reach: float,
    cell_m: float,
) -> Floats:
    """Return the covariance (4, 4) of (x, y, z, yaw), metres and radians, by the fit's fall."""
    units = np.array((STEP_M, STEP_M, STEP_M, STEP_RAD))
    steps = units / np.array((cell_m, cell_m, cell_m, 1.0))

    def misfit(*moves: tuple[int, float]) -> float:
        at = eye.copy()
        for axis, sign in moves:
            at[axis] += sign * steps[axis]
        return float(_misfit(index, states, at, rays, seen, reach)[0])

    here, bend = misfit(), np.zeros((4, 4))
    for a in range(4):
        bend[a, a] = misfit((a, 1.0)) + misfit((a, -1.0)) - 2.0 * here
        for b in range(a):
            both = misfit((a, 1.0), (b, 1.0)) + misfit((a, -1.0), (b, -1.0))
            bend[a, b] = bend[b, a] = 0.25 * (
                both - misfit((a, 1.0), (b, -1.0)) - misfit((a, -1.0), (b, 1.0))
            )
    values, vectors = np.linalg.eigh(0.5 * bend * INDEPENDENT / len(rays))
    values = np.maximum(values, VAGUE * max(float(values[-1]), 1e-6))
    covariance = (vectors / values) @ vectors.T * np.outer(units, units)
    floor = np.diag((FLOOR_M**2, FLOOR_M**2, FLOOR_M**2, FLOOR_RAD**2))
    order = [2, 1, 0, 3]
    return covariance[np.ix_(order, order)] + floor


@kernels.warmer
def _warm() -> None:
    sensor = SensorSettings(columns=16, rows=4, range_m=3.0)
    frame = VoxelFrame(0.0, 0.0, 1.0, 16, 16)
    states = np.ones((1, 16, 16, 16), dtype=np.int8)
    states[0, 0] = 2
    index = np.zeros((1, 1, 1), dtype=np.int32)
    ranges_m = np.full(64, 2.0)
    match(index, states, frame, Pose(8.0, 8.0, 1.0, 0.0), -0.5, np.eye(4), ranges_m, sensor)
