"""Elevation as a picture: warm colours by height, lit from the north-west, unknown in grey."""

import math

import numpy as np

from agents.geometry import Floats, Singles

UNKNOWN_RGB = (0.84, 0.86, 0.885)
"""Neutral and cool: no height has it."""
# Lightness rises with height from end to end, so the scale reads without telling hues apart.
_STOPS_RGB = np.array(
    [
        (0.306, 0.157, 0.180),
        (0.478, 0.239, 0.204),
        (0.663, 0.373, 0.247),
        (0.820, 0.545, 0.353),
        (0.918, 0.729, 0.533),
        (0.973, 0.898, 0.788),
    ]
)
_SUN_AZIMUTH_RAD = math.radians(135.0)
_SUN_HEIGHT_RAD = math.radians(45.0)
_EXAGGERATION = 1.6
"""Slopes are lit as if they were this much steeper; on gentle ground nothing would show."""


def colours(share: Floats) -> Floats:
    """Return the colours (..., 3) of heights given as a share (...) of the scale, 0 to 1."""
    at = np.linspace(0.0, 1.0, len(_STOPS_RGB))
    return np.stack([np.interp(share, at, _STOPS_RGB[:, i]) for i in range(3)], axis=-1)


def hillshade(elevation_m: Singles, cell_m: float) -> Floats:
    """Return how bright (H, W) each cell is lit, 0 to 1; 0.5 where its slope is unknown.

    Args:
        elevation_m: (H, W), row 0 south, NaN unknown.
        cell_m: cell size.

    """
    z = _calmed(elevation_m.astype(np.float64))
    if min(z.shape) < 2:
        return np.full(z.shape, 0.5)
    north, east = np.gradient(z * _EXAGGERATION, cell_m)
    normal = np.stack((-east, -north, np.ones_like(z)), axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    flat = math.cos(_SUN_HEIGHT_RAD)
    sun = np.array(
        [
            math.cos(_SUN_AZIMUTH_RAD) * flat,
            math.sin(_SUN_AZIMUTH_RAD) * flat,
            math.sin(_SUN_HEIGHT_RAD),
        ]
    )
    # Level ground is lit to 0.5, whatever the sun's height.
    lit = 0.5 + (normal @ sun - math.sin(_SUN_HEIGHT_RAD)) * 0.75
    return np.where(np.isfinite(lit), np.clip(lit, 0.0, 1.0), 0.5)


def _calmed(elevation_m: Floats) -> Floats:
    """Return the mean of the known cells among each cell and its eight neighbours.

    Light shows slopes, and slopes show every centimetre of measurement noise.
    """
    known = np.pad(np.isfinite(elevation_m), 1).astype(np.float64)
    height = np.pad(np.nan_to_num(elevation_m), 1)
    rows, cols = elevation_m.shape
    shifts = [(r, c) for r in range(3) for c in range(3)]
    count = sum(known[r : r + rows, c : c + cols] for r, c in shifts)
    total = sum(height[r : r + rows, c : c + cols] for r, c in shifts)
    mean = total / np.maximum(count, 1.0)
    return np.where(np.isfinite(elevation_m), mean, np.nan)


def relief(elevation_m: Singles, cell_m: float, low_m: float, high_m: float) -> Floats:
    """Return the picture (H, W, 3) of an elevation map on a colour scale from low to high.

    Args:
        elevation_m: (H, W), row 0 south, NaN unknown.
        cell_m: cell size.
        low_m: height that gets the darkest colour.
        high_m: height that gets the lightest one.

    """
    share = (elevation_m.astype(np.float64) - low_m) / max(high_m - low_m, 1e-9)
    known = np.isfinite(share)
    base = colours(np.clip(np.where(known, share, 0.0), 0.0, 1.0))
    light = hillshade(elevation_m, cell_m)[..., None]
    shaded = np.where(light < 0.5, base * (0.35 + 1.3 * light), base + (1 - base) * (light - 0.5))
    return np.where(known[..., None], np.clip(shaded, 0.0, 1.0), UNKNOWN_RGB)
