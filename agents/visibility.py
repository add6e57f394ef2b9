"""Which cells an eye is likely to see: Sujan & Meggiolaro, Eq. 5.

The paper multiplies Phi((ray_z(j) - h_j) / sigma_j) over the cells j under the ray to a target,
as if the errors of neighbouring heights were independent. They are not: ground is smooth, an
estimate errs for a whole stretch at once, and a look's levelling error lifts all of it. On open
ground every cell just in front of a grazing target would count about 0.5, and a hundred of them
hide everything. So here

    P_i = product over blocks b of min over cells j in b of Phi((ray_z(j) - h_j) / sigma_j)

where a block is a stretch of `BLOCK_M` of the ray counted from the eye (errors inside it are
taken as fully correlated, errors of different blocks as independent), and the last `REACH_M`
before the target share the target's own error, so they hide it by geometry only where they rise
`RISE_SIGMAS` above it. Both lengths were set by comparison with frequencies on fractal ground
with rocks, partly known.

Heights under the ray are those of the cells that the ray's points, one cell length apart, fall
in; the ray's bearing is the nearest of a fan whose neighbours are one cell apart at full range, so it
passes a target's centre within half a cell.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from agents.errors import AgentError
from agents.geometry import Floats, GridFrame, Singles
from comms import kernels
from comms.kernels import kernel

BLOCK_M = 4.0
"""Length of the stretches of a ray whose errors are taken as independent of each other."""
REACH_M = 0.3
"""Obstructions this near to the target share its error."""
CERTAIN = 4.0
"""Sigmas of clearance that count as certainty (1 - Phi = 3e-5)."""
HIDDEN = 1e-4
"""A probability below this is taken as 0."""
LEAST_SIGMA_M = 1e-4


class VisibilityError(AgentError):
    """An eye or a range that no visibility can be predicted for."""


@dataclass(frozen=True)
class Patch:
    """The part of a map that an eye can reach, with each cell's probability of being seen."""

    row0: int
    col0: int
    p: Singles
    """(h, w) Eq. 5; 0 beyond the range and nearer than the sensor's near limit."""
    frame: GridFrame
    eye_m: tuple[float, float, float]
    surface_m: Floats
    """(h, w) heights of the targets."""

    @cached_property
    def _offsets_m(self) -> tuple[Floats, Floats, Floats]:
        h, w = self.p.shape
        x0, y0 = self.frame.centre_of(self.row0, self.col0)
        dx = x0 - self.eye_m[0] + np.arange(w) * self.frame.cell_m
        dy = y0 - self.eye_m[1] + np.arange(h) * self.frame.cell_m
        return np.broadcast_to(dx, (h, w)), np.broadcast_to(dy[:, None], (h, w)), self._rise_m

    @property
    def _rise_m(self) -> Floats:
        return self.surface_m - self.eye_m[2]

    @cached_property
    def azimuth_rad(self) -> Floats:
        """(h, w) bearing of each cell from the eye, counter-clockwise from +x."""
        dx, dy, _ = self._offsets_m
        return np.arctan2(dy, dx)

    @cached_property
    def elevation_angle_rad(self) -> Floats:
        """(h, w) angle of each cell above the eye's horizon."""
        dx, dy, dz = self._offsets_m
        return np.arctan2(dz, np.hypot(dx, dy))

    @cached_property
    def range_m(self) -> Floats:
        """(h, w) distance from the eye."""
        dx, dy, dz = self._offsets_m
        return np.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def phi(z: float) -> float:
    """Return the standard normal distribution function."""
    return 0.5 * math.erfc(-z * 0.7071067811865476)


@kernel
def _fan(
    surface: np.ndarray,
    sigma: np.ndarray,
    eye: tuple[float, float, float],
    cell: float,
    block: int,
    slope: np.ndarray,
    weight: np.ndarray,
    top: np.ndarray,
) -> None:
    """Lay rays from the eye: slope and 1/sigma in slope units per point, top per block.

    `eye` is (row, column) in cells and height; points off the map obstruct nothing.
    """
    bearings, points = slope.shape
    h, w = surface.shape
    for b in range(bearings):
        angle = 2.0 * math.pi * b / bearings
        dy, dx = math.sin(angle), math.cos(angle)
        for k in range(top.shape[1]):
            top[b, k] = -1e30
        for k in range(points):
            steps = k + 1.0
            i = math.floor(eye[0] + steps * dy + 0.5)
            j = math.floor(eye[1] + steps * dx + 0.5)
            slope[b, k] = -1e30
            weight[b, k] = 1.0
            if i < 0 or j < 0 or i >= h or j >= w:
                continue
            distance = steps * cell
            spread = max(sigma[i, j], 1e-4) / distance
            slope[b, k] = (surface[i, j] - eye[2]) / distance
            weight[b, k] = 1.0 / spread
            top[b, k // block] = max(top[b, k // block], slope[b, k] + 4.0 * spread)


@kernel
def _clear(
    target: float,
    count: int,
    block: int,
    slope: np.ndarray,
    weight: np.ndarray,
    top: np.ndarray,
) -> float:
    """Return the probability that a ray of a slope clears the first `count` points."""
    chance = 1.0
    for b in range((count + block - 1) // block):
        if top[b] <= target:
            continue
        least = 4.0
        for k in range(b * block, min(count, (b + 1) * block)):
            least = min(least, (target - slope[k]) * weight[k])
        if least < 4.0:
            chance *= phi(least)
            if chance < 1e-4:
                return 0.0
    return chance


@kernel
def _predict(
    surface: np.ndarray,
    sigma: np.ndarray,
    eye: tuple[float, float, float],
    cell: float,
    limits_m: tuple[float, float],
    sizes: tuple[int, int],
    corner: tuple[int, int],
    bearings: int,
    out: np.ndarray,
) -> None:
    """Fill `out` with Eq. 5 for the cells from `corner` on; sizes: block and reach in points."""
    block, reach = sizes
    near, far = limits_m
    points = int(far / cell) + 1
    slope = np.empty((bearings, points))
    weight = np.empty((bearings, points))
    top = np.empty((bearings, (points + block - 1) // block))
    _fan(surface, sigma, eye, cell, block, slope, weight, top)
    turn = bearings / (2.0 * math.pi)
    h, w = out.shape
    for i in range(h):
        dy = corner[0] + i - eye[0]
        for j in range(w):
            dx = corner[1] + j - eye[1]
            flat = math.sqrt(dx * dx + dy * dy)
            rise = surface[corner[0] + i, corner[1] + j] - eye[2]
            distance = math.sqrt(flat * flat * cell * cell + rise * rise)
            out[i, j] = 0.0
            if distance > far or distance < near:
                continue
            if flat < 1.0:
                out[i, j] = 1.0
                continue
            b = math.floor(math.atan2(dy, dx) * turn + 0.5) % bearings
            target = rise / (flat * cell)
            count = math.floor(flat + 0.5) - 1
            far_count = max(0, count - reach)
            chance = _clear(target, far_count, block, slope[b], weight[b], top[b])
            if chance > 0.0:
                chance = _shaded(target, far_count, count, slope[b], weight[b], chance)
            out[i, j] = chance


@kernel
def _shaded(
    target: float, start: int, end: int, slope: np.ndarray, weight: np.ndarray, chance: float
) -> float:
    """Return `chance`, or 0 where a point start..end-1 rises clearly above the ray."""
    for k in range(start, end):
        if (slope[k] - target) * weight[k] > 2.0:
            return 0.0
    return chance


def predict(
    completed_m: Floats,
    sigma_m: Floats,
    frame: GridFrame,
    eye_xyz: tuple[float, float, float],
    *,
    range_m: float,
    near_m: float,
) -> Patch:
    """Return each cell's probability of being visible from an eye, over all bearings (Eq. 5).

    Args:
        completed_m: (H, W) elevation without NaN, row 0 south.
        sigma_m: (H, W) standard deviation of each cell's elevation.
        frame: where the grid lies.
        eye_xyz: the camera's centre, metres.
        range_m: depth of field, along the ray.
        near_m: nearest distance at which the sensor measures.

    Raises:
        VisibilityError: the eye lies outside the map, or `range_m` is not positive.
    """
    row, col = frame.cell_of(eye_xyz[0], eye_xyz[1])
    if not frame.holds(row, col):
        raise VisibilityError(f"the eye at {eye_xyz} lies outside the map {frame.extent_m}")
    if not range_m > 0:
        raise VisibilityError(f"a range of {range_m} m sees nothing: it must be more than 0")
    reach = math.ceil(range_m / frame.cell_m)
    row0, col0 = max(0, row - reach), max(0, col - reach)
    rows = slice(row0, min(frame.rows, row + reach + 1))
    cols = slice(col0, min(frame.cols, col + reach + 1))
    targets = completed_m[rows, cols]
    p = np.empty(targets.shape, dtype=np.float32)
    eye = (
        (eye_xyz[1] - frame.y_m) / frame.cell_m - 0.5,
        (eye_xyz[0] - frame.x_m) / frame.cell_m - 0.5,
        eye_xyz[2],
    )
    _predict(
        completed_m,
        sigma_m,
        eye,
        frame.cell_m,
        (near_m, range_m),
        lengths(frame.cell_m),
        (row0, col0),
        fan_size(range_m, frame.cell_m),
        p,
    )
    return Patch(row0, col0, p, frame, eye_xyz, targets)


def lengths(cell_m: float) -> tuple[int, int]:
    """Return a block and the target's reach in points of a ray."""
    return max(1, round(BLOCK_M / cell_m)), round(REACH_M / cell_m)


def fan_size(range_m: float, cell_m: float) -> int:
    """Return the number of bearings: one cell apart at full range, at least 16."""
    return max(16, math.ceil(2.0 * math.pi * range_m / cell_m))


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    frame = GridFrame(0.0, 0.0, 1.0, 8, 8)
    ground = np.zeros(frame.shape)
    predict(ground, ground + 0.1, frame, (4.0, 4.0, 1.0), range_m=4.0, near_m=0.1)
