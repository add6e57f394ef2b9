"""What surfaces look like: a pattern that is fixed in the world.

The pattern is a sum of value noises in three dimensions (steep faces are covered as level ground
is), from 0.8 m down to millimetres, of equal variance per octave, as in the power spectrum of
natural scenes. What is finer than a pixel's footprint is left out: a real lens blurs it, and one
ray per pixel would turn it into noise that the two images do not share.
"""

import math

import numpy as np

from agents.geometry import Floats, Singles
from comms import kernels

COARSEST_M = 0.8
OCTAVES = 9
"""Wavelengths of the pattern: 0.8 m, and each half of the one before."""
CONTRAST = 0.25
"""Standard deviation of fully textured ground's albedo, as a share of its mean."""
BLURRED, SHARP = 1.5, 4.0
"""Footprints per wavelength at which an octave is gone, and from which it is seen whole."""
LATTICE_SIGMA = 0.37
"""Standard deviation of one octave of smoothed value noise in [-1, 1] (a test measures it)."""
LIGHTEST, DARKEST = 2.2, 0.25
"""Bounds of a spot's albedo, as shares of the mean."""


@kernels.kernel
def lattice_value(i: int, j: int, k: int, salt: int) -> float:
    """Return a value in [-1, 1) for a lattice point: integer mixing, the same everywhere."""
    h = np.uint64(i * 73856093) ^ np.uint64(j * 19349663) ^ np.uint64(k * 83492791)
    h = h ^ np.uint64(salt)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    h = h ^ (h >> np.uint64(31))
    return float(h >> np.uint64(11)) * (2.0 / 9007199254740992.0) - 1.0


@kernels.kernel
def value_noise(x: float, y: float, z: float, salt: int) -> float:
    """Return smooth noise in [-1, 1] of unit wavelength at a point."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    a, b, c = x - i, y - j, z - k
    a, b, c = a * a * (3 - 2 * a), b * b * (3 - 2 * b), c * c * (3 - 2 * c)
    total = 0.0
    for corner in range(8):
        di, dj, dk = corner & 1, (corner >> 1) & 1, corner >> 2
        weight = (a if di else 1 - a) * (b if dj else 1 - b) * (c if dk else 1 - c)
        total += weight * lattice_value(i + di, j + dj, k + dk, salt)
    return total


@kernels.kernel
def pattern(points_m: Floats, footprint_m: Floats, texture: Floats, salt: int) -> Floats:
    """Return the albedo (N,) of points (N, 3), as a share of the mean albedo.

    `footprint_m` (N,) is the width that a pixel covers there, `texture` (N,) in [0, 1] how much
    of the contrast there is.
    """
    out = np.empty(points_m.shape[0])
    each = CONTRAST / (LATTICE_SIGMA * math.sqrt(OCTAVES))
    for n in range(points_m.shape[0]):
        total, wave_m = 0.0, COARSEST_M
        for octave in range(OCTAVES):
            sharp = (wave_m / footprint_m[n] - BLURRED) / (SHARP - BLURRED)
            if sharp <= 0.0:
                break
            x, y, z = points_m[n, 0] / wave_m, points_m[n, 1] / wave_m, points_m[n, 2] / wave_m
            total += min(sharp, 1.0) * value_noise(x, y, z, salt + octave)
            wave_m *= 0.5
        out[n] = min(max(1.0 + texture[n] * each * total, DARKEST), LIGHTEST)
    return out


@kernels.kernel
def sampled(grid: Singles, u: Floats, v: Floats) -> Floats:
    """Return a grid's bilinear values (N,) at columns u and rows v, held constant outside."""
    rows, cols = grid.shape
    out = np.empty(u.shape[0])
    for n in range(u.shape[0]):
        x, y = min(max(u[n], 0.0), cols - 1.0), min(max(v[n], 0.0), rows - 1.0)
        c, r = min(int(x), cols - 2), min(int(y), rows - 2)
        a, b = x - c, y - r
        south = (1 - a) * grid[r, c] + a * grid[r, c + 1]
        north = (1 - a) * grid[r + 1, c] + a * grid[r + 1, c + 1]
        out[n] = (1 - b) * south + b * north
    return out


@kernels.warmer
def _warm() -> None:
    points = np.zeros((1, 3))
    one = np.ones(1)
    pattern(points, one * 0.01, one, 1)
    sampled(np.zeros((2, 2), dtype=np.float32), one, one)
