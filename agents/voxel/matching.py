"""Where a robot is in space, by a look's ranges (`agents.occupancy.matching`).

A level floor fixes the height and nothing else; walls fix the rest.
"""

import math
from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, Pose, wrap_angle
from agents.maps.voxellook import eye_of, world_rays
from agents.occupancy.matching import MOST, Match, Scales, chosen_rays, fitted, misfit_of
from agents.planar.sensing import sigma_m
from agents.settings import SensorSettings
from agents.voxel.frame import VoxelFrame
from agents.voxel.ground import States, state_at
from agents.voxel.rays import crossings
from comms import kernels
from comms.kernels import kernel

MODEL_CELLS = 0.3
"""Error of a predicted range besides the sensor's: what is solid is no cube."""
FLOOR_M, FLOOR_RAD = 0.015, 0.003
"""No look tells more than this."""
STEP_M, STEP_RAD = 0.05, 0.012
"""Offsets at which the fall of the fit is measured."""
AXES = [2, 1, 0, 3]
"""Of (x, y, z, yaw), those of an eye, which is (layer, row, col, turn); and the other way round."""


def _scales(cell_m: float) -> Scales:
    return Scales(
        units=np.array((cell_m, cell_m, cell_m, 1.0)),
        floor=np.array((FLOOR_M, FLOOR_M, FLOOR_M, FLOOR_RAD)),
        step=np.array((STEP_M, STEP_M, STEP_M, STEP_RAD)),
        rays=240,
        least_rays=30,
    )


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
        error = misfit_of(seen[k, 0], seen[k, 1], expected)
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


@dataclass(frozen=True)
class _Rays:
    """`agents.occupancy.matching.Casting` in space; an eye is (layer, row, col, turn)."""

    index: np.ndarray
    states: States
    rays: Floats
    seen: Floats
    reach: float

    def misfit(self, eye: Floats) -> tuple[float, int, int]:
        return _misfit(self.index, self.states, eye, self.rays, self.seen, self.reach)

    def search(self, eye: Floats, span: Floats) -> Floats:
        return _search(self.index, self.states, eye, span, self.rays, self.seen, self.reach)


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
    cell_m, scales = frame.cell_m, _scales(frame.cell_m)
    chosen = chosen_rays(len(ranges_m), scales.rays)
    ranges = ranges_m[chosen] / cell_m
    near_m = np.where(np.isfinite(ranges), ranges, 0.0) * cell_m
    casting = _Rays(
        index,
        states,
        world_rays(sensor, pose.yaw_rad, tilt_rad)[chosen],
        np.column_stack((ranges, np.hypot(sigma_m(near_m, sensor) / cell_m, MODEL_CELLS))),
        sensor.range_m / cell_m,
    )
    eye = np.append(frame.at(*eye_of(pose, sensor)), 0.0)
    found = fitted(casting, eye, np.sqrt(np.diag(covariance))[AXES], scales, len(chosen))
    if found is None:
        return None
    z, y, x = (float(v) * cell_m for v in found[0][:3])
    stood = Pose(
        frame.x_m + x,
        frame.y_m + y,
        frame.z_m + z - sensor.height_m,
        wrap_angle(pose.yaw_rad + float(found[0][3])),
    )
    return Match(stood, found[1][np.ix_(AXES, AXES)])


@kernels.warmer
def _warm() -> None:
    sensor = SensorSettings(columns=16, rows=4, range_m=3.0)
    frame = VoxelFrame(0.0, 0.0, 1.0, 16, 16)
    states = np.ones((1, 16, 16, 16), dtype=np.int8)
    states[0, 0] = 2
    index = np.zeros((1, 1, 1), dtype=np.int32)
    ranges_m = np.full(64, 2.0)
    match(index, states, frame, Pose(8.0, 8.0, 1.0, 0.0), -0.5, np.eye(4), ranges_m, sensor)
