"""What one look covers, and how much of it: the camera's field of view over a map.

The camera is a pinhole on an arm that keeps it level: pan turns it about the vertical, tilt lifts
its axis. A cell may be in sight and still get no ray, because far ground lies so flat that the
sensor's rows pass over it; the chance that it gets one is `1 - exp(-n)` for n rays
expected by solid angle.
"""

import math
from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, Singles
from agents.settings import SensorSettings
from agents.visibility import Patch
from comms import kernels
from comms.kernels import kernel

AZIMUTH_BINS = 120
ANGLE_BINS = 90
"""Bins of elevation angle over [-90, +45] degrees, 1.5 degrees each."""
LOWEST_RAD = -0.5 * math.pi
ANGLE_STEP_RAD = 0.75 * math.pi / ANGLE_BINS


@dataclass(frozen=True)
class Lens:
    """A sensor's field of view as numbers."""

    tan_h: float
    tan_v: float
    ray_sr: float
    """Solid angle of one ray at the image's centre."""

    @staticmethod
    def of(sensor: SensorSettings) -> "Lens":
        """Return the lens of a sensor."""
        tan_h = math.tan(0.5 * math.radians(sensor.fov_deg))
        tan_v = math.tan(0.5 * math.radians(sensor.fov_vertical_deg))
        return Lens(tan_h, tan_v, 4.0 * tan_h * tan_v / (sensor.columns * sensor.rows))


def in_view(
    patch: Patch, heading_rad: float, tilt_rad: float, lens: Lens
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return the cells (h, w) of a patch that lie in the field of view of one look."""
    flat = np.cos(patch.elevation_angle_rad)
    turn = patch.azimuth_rad - heading_rad
    forward, left = flat * np.cos(turn), flat * np.sin(turn)
    up = np.sin(patch.elevation_angle_rad)
    depth = math.cos(tilt_rad) * forward + math.sin(tilt_rad) * up
    rise = -math.sin(tilt_rad) * forward + math.cos(tilt_rad) * up
    within = (np.abs(left) <= lens.tan_h * depth) & (np.abs(rise) <= lens.tan_v * depth)
    return within & (depth > 0)


def sampled(patch: Patch, gradient: tuple[Floats, Floats], cell_m: float, lens: Lens) -> Singles:
    """Return the chance (h, w) that a visible cell of side `cell_m` gets a ray at all.

    `gradient` holds dz/dy and dz/dx of the patch's surface. A cell that is turned away gets none.
    """
    flat = np.cos(patch.elevation_angle_rad)
    slope = gradient[1] * np.cos(patch.azimuth_rad) + gradient[0] * np.sin(patch.azimuth_rad)
    facing = np.maximum(0.0, slope * flat - np.sin(patch.elevation_angle_rad))
    rays = cell_m * cell_m * facing / (np.maximum(patch.range_m, 0.1) ** 2 * lens.ray_sr)
    return -np.expm1(-rays).astype(np.float32)


@kernel
def bin_gains(
    p: np.ndarray,
    surface: np.ndarray,
    gradient_y: np.ndarray,
    gradient_x: np.ndarray,
    weight: np.ndarray,
    geometry: tuple[int, int, float, float, float, float, float, float],
    out: np.ndarray,
) -> None:
    """Add each cell's new information (Eq. 3) to bins (elevation angle, azimuth) about the eye.

    p (h, w) is Eq. 5 of a patch; the other arrays are the whole map's. `geometry`: the patch's
    row0 and col0, the eye's row, column (cells) and height, the cell size, the side of a
    cell that a ray has to hit, and the solid angle of a ray. `weight` is what a cell is worth in
    bits if it is seen for certain. `out` (ANGLE_BINS, AZIMUTH_BINS) is added to.
    """
    row0, col0, eye_row, eye_col, eye_z, cell, target_cell, ray_sr = geometry
    h, w = p.shape
    for i in range(h):
        dy = (row0 + i - eye_row) * cell
        for j in range(w):
            worth = weight[row0 + i, col0 + j]
            if p[i, j] < 1e-3 or worth <= 0.0:
                continue
            dx = (col0 + j - eye_col) * cell
            dz = surface[row0 + i, col0 + j] - eye_z
            flat2 = dx * dx + dy * dy
            squared = flat2 + dz * dz
            distance = math.sqrt(squared)
            facing = (
                gradient_x[row0 + i, col0 + j] * dx + gradient_y[row0 + i, col0 + j] * dy - dz
            ) / distance
            if facing <= 0.0:
                continue
            hit = 1.0 - math.exp(-target_cell * target_cell * facing / (squared * ray_sr))
            half = 0.5 * p[i, j] * hit
            bits = 0.0
            if half > 1e-9:
                bits = -half * math.log2(half) - (1.0 - half) * math.log2(1.0 - half)
            angle = math.atan2(dz, math.sqrt(flat2))
            k = math.floor((angle + 0.5 * math.pi) / (0.75 * math.pi) * out.shape[0])
            if k < 0 or k >= out.shape[0]:
                continue
            turn = math.atan2(dy, dx) / (2.0 * math.pi)
            a = math.floor((turn - math.floor(turn)) * out.shape[1]) % out.shape[1]
            out[k, a] += worth * bits


@kernel
def _cumulative(row: np.ndarray, at: float) -> float:
    """Return the running sum of a periodic row (prefix sums, first 0) at a fractional bin."""
    n = len(row) - 1
    whole = math.floor(at / n)
    rest = at - whole * n
    k = min(int(rest), n - 1)
    return whole * row[n] + row[k] + (rest - k) * (row[k + 1] - row[k])


@kernel
def _window_sums(
    bins: np.ndarray, half_widths: np.ndarray, headings: np.ndarray, out: np.ndarray
) -> None:
    """Sum bins inside windows: half_widths (tilts, angles) in azimuth bins, 0 for none."""
    angles, turns = bins.shape
    prefix = np.zeros(turns + 1)
    out[:] = 0.0
    for k in range(angles):
        for a in range(turns):
            prefix[a + 1] = prefix[a] + bins[k, a]
        if prefix[turns] == 0.0:
            continue
        for t in range(half_widths.shape[0]):
            half = half_widths[t, k]
            if half <= 0.0:
                continue
            for c in range(len(headings)):
                low = _cumulative(prefix, headings[c] - half)
                out[c, t] += _cumulative(prefix, headings[c] + half) - low


def half_widths(tilts_rad: Floats, lens: Lens) -> Floats:
    """Return how far a look reaches to either side, in azimuth bins: (tilts, ANGLE_BINS).

    For each elevation angle, the largest azimuth off the camera's axis that is still in the
    pinhole's image; 0 where the angle is not in it. Found by walking the azimuth.
    """
    angle = LOWEST_RAD + (np.arange(ANGLE_BINS) + 0.5) * ANGLE_STEP_RAD
    turn = (np.arange(AZIMUTH_BINS) + 0.5) * math.pi / AZIMUTH_BINS
    tilt = tilts_rad[:, None, None]
    flat, up = np.cos(angle)[None, :, None], np.sin(angle)[None, :, None]
    forward, left = flat * np.cos(turn), flat * np.sin(turn)
    depth = np.cos(tilt) * forward + np.sin(tilt) * up
    rise = -np.sin(tilt) * forward + np.cos(tilt) * up
    within = (np.abs(left) <= lens.tan_h * depth) & (np.abs(rise) <= lens.tan_v * depth)
    return 0.5 * (within & (depth > 0)).sum(axis=2).astype(np.float64)


def look_gains(bins: Floats, widths: Floats, headings_rad: Floats) -> Floats:
    """Return the bits (headings, tilts) inside each look's field of view, from the bins."""
    out = np.empty((len(headings_rad), len(widths)))
    _window_sums(bins, widths, headings_rad / (2.0 * math.pi) * AZIMUTH_BINS, out)
    return out


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    whole = np.zeros((4, 4))
    bins = np.zeros((ANGLE_BINS, AZIMUTH_BINS))
    p = np.ones((3, 3), dtype=np.float32)
    geometry = (0, 0, 1.0, 1.0, 1.0, 0.2, 0.1, 1e-4)
    bin_gains(p, whole, whole, whole, whole + 1.0, geometry, bins)
    look_gains(bins, np.ones((1, ANGLE_BINS)), np.zeros(2))
