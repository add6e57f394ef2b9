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

from agents.geometry import Bools, Floats, Singles
from agents.settings import SensorSettings
from agents.sight.visibility import Eye, Patch
from comms import kernels
from comms.kernels import kernel

BLIND_FACING = 0.03
CLEAR_FACING = 0.10
"""Cosines of incidence below which nothing is ranged, and above which all is."""
FACETS = 0.12
"""How far the facings of a cell's facets stray from that of its smoothed ground."""


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
def soft_facing(facing: float) -> float:
    """Return how squarely a cell is met by the facets of its ground that are turned to the eye.

    Ground that is turned away on the whole has some that are not: of visible cells whose smoothed
    ground is seen edge-on, a quarter were measured at 9 m.
    """
    return 0.5 * (facing + math.sqrt(facing * facing + FACETS * FACETS))


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
            p[i, j] *= hit_chance(soft_facing(facing), distance, flat, ground.target_m, ray_rad2)


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


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    flat = np.zeros((8, 8))
    eye = Eye(4.0, 4.0, 1.0)
    ground = Ground(flat, flat, flat, flat + 1.0, 0.5, 0.5)
    chance = np.ones((8, 8), dtype=np.float32)
    _chances(chance, ground, eye, (0, 0), 1e-4)
