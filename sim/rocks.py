"""Rocks by Golombek's law, as measured at the Viking landing sites."""

import math
from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, GridFrame, Singles
from comms import kernels


def decay_per_m(fraction: float) -> float:
    """Return q(k) = 1.79 + 0.152/k of Golombek & Rapp (1997), 1/m."""
    return 1.79 + 0.152 / fraction


def covered_share(fraction: float, diameter_m: float) -> float:
    """Return F_k(D) = k exp(-q(k) D): the share of ground under rocks of diameter D and more."""
    return fraction * math.exp(-decay_per_m(fraction) * diameter_m)


@dataclass(frozen=True)
class Rocks:
    """Rocks as half ellipsoids on the ground; arrays of length N, metres and radians."""

    x_m: Floats
    y_m: Floats
    diameter_m: Floats
    """Diameter of the circle of the same area."""
    height_m: Floats
    stretch: Floats
    """Length over the diameter; the width is the diameter over it, so that the area stays."""
    heading_rad: Floats


def draw_rocks(
    fraction: float,
    least_m: float,
    most_m: float,
    extent_m: tuple[float, float, float, float],
    rng: np.random.Generator,
) -> Rocks:
    """Draw rocks of diameters in [least, most] over (west, east, south, north).

    Golombek's F_k gives the ground covered, so rocks of diameter D number
    -F_k'(D) / (pi D^2 / 4) per m^2 and m of diameter; their count is Poisson.
    """
    diameters = np.linspace(least_m, most_m, 2000)
    q = decay_per_m(fraction)
    density = fraction * q * np.exp(-q * diameters) / (np.pi * diameters**2 / 4)
    steps = (density[1:] + density[:-1]) / 2 * np.diff(diameters)
    cumulative = np.concatenate(([0.0], np.cumsum(steps)))
    west, east, south, north = extent_m
    count = int(rng.poisson(cumulative[-1] * (east - west) * (north - south)))
    ranks = rng.random(count) * cumulative[-1]
    diameter_m = np.interp(ranks, cumulative, diameters)
    return Rocks(
        x_m=rng.uniform(west, east, count),
        y_m=rng.uniform(south, north, count),
        diameter_m=diameter_m,
        height_m=diameter_m * rng.uniform(0.4, 0.65, count),
        stretch=rng.uniform(1.0, 1.3, count),
        heading_rad=rng.uniform(0.0, np.pi, count),
    )


def within(rocks: Rocks, x_m: float, y_m: float, radius_m: float) -> Rocks:
    """Return the rocks whose centres lie in a circle."""
    kept = np.hypot(rocks.x_m - x_m, rocks.y_m - y_m) <= radius_m
    return Rocks(
        rocks.x_m[kept],
        rocks.y_m[kept],
        rocks.diameter_m[kept],
        rocks.height_m[kept],
        rocks.stretch[kept],
        rocks.heading_rad[kept],
    )


@kernels.kernel
def _render(
    out: Singles,
    x_cells: Floats,
    y_cells: Floats,
    radius_cells: Floats,
    height_m: Floats,
    stretch: Floats,
    heading_rad: Floats,
) -> None:
    rows, cols = out.shape
    for k in range(x_cells.size):
        long, short = radius_cells[k] * stretch[k], radius_cells[k] / stretch[k]
        cosine, sine = np.cos(heading_rad[k]), np.sin(heading_rad[k])
        for i in range(max(0, int(y_cells[k] - long)), min(rows, int(y_cells[k] + long) + 2)):
            for j in range(max(0, int(x_cells[k] - long)), min(cols, int(x_cells[k] + long) + 2)):
                dx, dy = j + 0.5 - x_cells[k], i + 0.5 - y_cells[k]
                along = (cosine * dx + sine * dy) / long
                across = (cosine * dy - sine * dx) / short
                left = 1.0 - along * along - across * across
                if left > 0.0:
                    out[i, j] = max(out[i, j], height_m[k] * np.sqrt(left))


def rock_heights(rocks: Rocks, frame: GridFrame) -> Singles:
    """Return how far rocks stand above the ground at each cell centre, (rows, cols) in m."""
    out = np.zeros(frame.shape, dtype=np.float32)
    _render(
        out,
        (rocks.x_m - frame.x_m) / frame.cell_m,
        (rocks.y_m - frame.y_m) / frame.cell_m,
        rocks.diameter_m / 2 / frame.cell_m,
        rocks.height_m,
        rocks.stretch,
        rocks.heading_rad,
    )
    return out


@kernels.warmer
def _warm() -> None:
    one = np.ones(1)
    _render(np.zeros((2, 2), dtype=np.float32), one, one, one, one, one, one)
