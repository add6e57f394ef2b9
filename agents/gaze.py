"""What one look covers, and how much of it: the camera's field of view over a map.

Pan turns the camera about the vertical, tilt lifts its axis, an arm keeps it level; its rays are
spread evenly over azimuth and elevation angle. A cell may be in sight and still give no point: far
ground lies so flat that the sensor's rows pass over it (the chance that a cell gets a ray is
`1 - exp(-n)` for n rays expected by solid angle), and ground that is met at a very flat
angle can't be ranged.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.geometry import Bools, Floats, Ints, Singles
from agents.settings import SensorSettings
from agents.visibility import Eye, Patch
from comms import kernels
from comms.kernels import kernel

AZIMUTH_BINS = 120
ANGLE_BINS = 90
"""Bins of elevation angle over [-90, +90] degrees, 2 degrees each."""
BLIND_FACING = 0.03
CLEAR_FACING = 0.10
"""Cosines of incidence below which nothing is ranged, and above which all is."""


class Lens(NamedTuple):
    """A sensor's field of view as numbers."""

    half_turn_rad: float
    half_rise_rad: float
    ray_rad2: float
    """Azimuth times elevation angle between neighbouring rays."""

    @staticmethod
    def of(sensor: SensorSettings) -> "Lens":
        """Return the lens of a sensor."""
        turn, rise = math.radians(sensor.fov_deg), math.radians(sensor.fov_vertical_deg)
        return Lens(0.5 * turn, 0.5 * rise, turn * rise / (sensor.columns * sensor.rows))


class Ground(NamedTuple):
    """A map that looks are rated on; arrays (H, W)."""

    height_m: Floats
    north: Floats
    """Its slope dz/dy."""
    east: Floats
    worth: Floats
    """Bits that a cell gives if it is seen for certain."""
    cell_m: float
    target_m: float
    """Side of the cells that a ray has to fall in (smaller than `cell_m` on a coarser map)."""


@kernel
def hit_chance(
    facing: float, distance_m: float, flat_m: float, side_m: float, ray_rad2: float
) -> float:
    """Return the chance that a visible cell is measured.

    `facing`: cosine between ray and ground normal, times 1 / (vertical part of the normal), i.e.
    the share of the cell's plan area that is seen; `flat_m`: horizontal distance.
    """
    share = (facing - BLIND_FACING) / (CLEAR_FACING - BLIND_FACING)
    if share <= 0.0:
        return 0.0
    spread = max(flat_m, 0.1) * distance_m * ray_rad2
    return min(share, 1.0) * (1.0 - math.exp(-side_m * side_m * facing / spread))


@kernel
def _chances(
    p: np.ndarray, ground: Ground, eye: Eye, corner: tuple[int, int], ray_rad2: float
) -> None:
    """Multiply visibilities p (h, w), from `corner` on, by the chance of being measured."""
    for i in range(p.shape[0]):
        dy = (corner[0] + i - eye.row) * ground.cell_m
        for j in range(p.shape[1]):
            a, b = corner[0] + i, corner[1] + j
            dx = (b - eye.col) * ground.cell_m
            dz = ground.height_m[a, b] - eye.z_m
            flat = math.sqrt(dx * dx + dy * dy)
            distance = math.sqrt(flat * flat + dz * dz)
            facing = (ground.east[a, b] * dx + ground.north[a, b] * dy - dz) / max(distance, 1e-6)
            p[i, j] *= hit_chance(facing, distance, flat, ground.target_m, ray_rad2)


def measured_chance(patch: Patch, ground: Ground, lens: Lens) -> Singles:
    """Return the chance (h, w) that a look which has a patch's cells in view measures them."""
    chance = patch.p.copy()
    _chances(chance, ground, patch.eye, (patch.row0, patch.col0), lens.ray_rad2)
    return chance


def in_view(patch: Patch, heading_rad: float, tilt_rad: float, lens: Lens) -> Bools:
    """Return the cells (h, w) of a patch that lie in the field of view of one look."""
    turn = (patch.azimuth_rad - heading_rad + math.pi) % (2.0 * math.pi) - math.pi
    rise = patch.elevation_angle_rad - tilt_rad
    return (np.abs(turn) <= lens.half_turn_rad) & (np.abs(rise) <= lens.half_rise_rad)


@kernel
def _bin_gains(
    chance: np.ndarray, ground: Ground, eye: Eye, corner: tuple[int, int], bins: np.ndarray
) -> None:
    """Add each cell's new information to bins (elevation angle, azimuth) about the eye."""
    angles, turns = bins.shape
    for i in range(chance.shape[0]):
        dy = corner[0] + i - eye.row
        for j in range(chance.shape[1]):
            a, b = corner[0] + i, corner[1] + j
            half = 0.5 * chance[i, j]
            if half < 1e-6 or ground.worth[a, b] <= 0.0:
                continue
            dx = b - eye.col
            rise = (ground.height_m[a, b] - eye.z_m) / ground.cell_m
            angle = math.atan2(rise, math.sqrt(dx * dx + dy * dy)) / math.pi + 0.5
            turn = math.atan2(dy, dx) / (2.0 * math.pi)
            k = min(max(math.floor(angle * angles), 0), angles - 1)
            t = math.floor((turn - math.floor(turn)) * turns) % turns
            bits = -half * math.log2(half) - (1.0 - half) * math.log2(1.0 - half)
            bins[k, t] += ground.worth[a, b] * bits


def gain_bins(patch: Patch, ground: Ground, lens: Lens) -> Floats:
    """Return the bits (Eq. 3) about an eye by (elevation angle, azimuth): (90, 120) bins.

    `patch` is Eq. 5 predicted on `ground`. Each cell gives `worth * h(P / 2)`, P = visibility
    times the chance of being measured.
    """
    bins = np.zeros((ANGLE_BINS, AZIMUTH_BINS))
    chance = measured_chance(patch, ground, lens)
    _bin_gains(chance, ground, patch.eye, (patch.row0, patch.col0), bins)
    return bins


def bins_of(rise_rad: Floats, azimuth_rad: Floats) -> Ints:
    """Return the flat indices (N,) of the bins in which elevation angles and azimuths fall."""
    angle = np.floor((rise_rad / math.pi + 0.5) * ANGLE_BINS).astype(np.int64)
    turn = np.floor(azimuth_rad / (2.0 * math.pi) * AZIMUTH_BINS).astype(np.int64) % AZIMUTH_BINS
    return np.clip(angle, 0, ANGLE_BINS - 1) * AZIMUTH_BINS + turn


@kernel
def _running(sums: np.ndarray, at: float) -> float:
    """Return running sums (first 0) interpolated at a fractional bin, clipped to the ends."""
    n = len(sums) - 1
    at = min(max(at, 0.0), float(n))
    k = min(math.floor(at), n - 1)
    return sums[k] + (at - k) * (sums[k + 1] - sums[k])


@kernel
def _window_sums(
    bins: np.ndarray, headings: np.ndarray, tilts: np.ndarray, half: tuple[float, float]
) -> np.ndarray:
    """Return the sums (headings, tilts) of bins inside windows; all lengths in bins."""
    angles, turns = bins.shape
    low = np.zeros(2 * turns + 1)
    rise = np.zeros(angles + 1)
    out = np.zeros((len(headings), len(tilts)))
    strip = np.zeros((len(headings), angles))
    for k in range(angles):
        for t in range(2 * turns):
            low[t + 1] = low[t] + bins[k, t % turns]
        for c in range(len(headings)):
            left = (headings[c] - half[0]) % turns
            strip[c, k] = _running(low, left + min(2.0 * half[0], float(turns))) - _running(
                low, left
            )
    for c in range(len(headings)):
        for k in range(angles):
            rise[k + 1] = rise[k] + strip[c, k]
        for t in range(len(tilts)):
            out[c, t] = _running(rise, tilts[t] + half[1]) - _running(rise, tilts[t] - half[1])
    return out


def look_gains(bins: Floats, headings_rad: Floats, tilts_rad: Floats, lens: Lens) -> Floats:
    """Return the bits (headings, tilts) inside each look's field of view, from the bins."""
    per_turn = AZIMUTH_BINS / (2.0 * math.pi)
    per_rise = ANGLE_BINS / math.pi
    return _window_sums(
        bins,
        headings_rad * per_turn,
        (tilts_rad + 0.5 * math.pi) * per_rise,
        (lens.half_turn_rad * per_turn, lens.half_rise_rad * per_rise),
    )


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    flat = np.zeros((8, 8))
    eye = Eye(4.0, 4.0, 1.0)
    ground = Ground(flat, flat, flat, flat + 1.0, 0.5, 0.5)
    chance = np.ones((8, 8), dtype=np.float32)
    _chances(chance, ground, eye, (0, 0), 1e-4)
    bins = np.zeros((ANGLE_BINS, AZIMUTH_BINS))
    _bin_gains(chance, ground, eye, (0, 0), bins)
    _window_sums(bins, np.zeros(1), np.zeros(1), (1.0, 1.0))
