"""How likely each cell of an elevation map holds a rock or a step that is too high for a wheel.

Stereo rounds rocks off and noise is as high as they are, so no height of a single cell tells them.
Three measures of a cell's surroundings do together, and better than any one: how far it bulges out
of the ground about it, whether that is itself a hump, and what stands out after a mean.
"""

from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import expit, ndtr

from agents.geometry import Floats
from agents.ground import surface

SWELL_NEAR, SWELL_FAR = 1.4, 4.0
"""Widths of the two means whose difference is a hump, in half wheels; of a bump 1 and 2."""
MOST_BUMP, MOST_SWELL, LEAST_HEIGHT, MOST_HEIGHT = 0.6, 0.8, 0.05, 1.2
"""Beyond these shares of the highest that a robot climbs the measures tell nothing more."""
TERMS = ("bump", "swell", "height")
LINEAR = (-5.95, 22.22, -5.14, 4.79)
"""The logit of the odds: a constant, and what bump, swell and ln(height) add, as shares of the
highest that it climbs;"""
SQUARE = (-8.56, 10.53, -21.0, -1.98, 3.18, 0.36)
"""and their products: bump with itself, with swell, with ln(height), swell with itself ... Fitted
by `benchmarks/rock_odds.py --fit` to what the Cliff-bot was told in missions on both sensors."""
HEIGHT_NOISE = 0.26
"""Share of a cell's sigma that is left in what stands out after a mean (`surface.roughness`)."""
SPIKE_NOISE, SPIKE_ODDS = 4.0, 0.5
"""A single cell that stands out by so many sigmas is as likely a rock as not: noise has long tails,
but a thin rock looks no other."""
LEAST_ODDS, UNKNOWN_ODDS = 1e-6, 0.016
"""Odds of a rock where the map shows none for certain, and where it shows nothing: the share of all
cells that hold one. Between them they rise with sigma's third power."""
BLIND = 3.0
"""What is as unsure as so many times the highest rock that it climbs shows nothing."""


class Shape(NamedTuple):
    """What each cell's surroundings look like; all (H, W), metres."""

    bump: Floats
    """How far the ground stands out of its surroundings, a wheel wide; the most within a cell."""
    swell: Floats
    """Likewise, two wheels wide, at the cell itself."""
    height: Floats
    """Height of what stands out after a 1-2-1 mean (`surface.standing_out`)."""
    near: Floats
    """The most of it within a cell."""
    raw: Floats
    """What stands out without a mean."""


def shape_of(surface_m: Floats, wheel_m: float, footprint_m: float, cell_m: float) -> Shape:
    """Measure the surroundings of each cell of a complete surface (H, W), metres.

    Where cells are much wider than half a wheel nothing bulges out: what a rock is to a wheel such
    a map can't show, and the lip of a hill is none.
    """
    unit = 0.5 * wheel_m / cell_m
    bump = _mean(surface_m, unit) - _mean(surface_m, 2.0 * unit)
    swell = _mean(surface_m, SWELL_NEAR * unit) - _mean(surface_m, SWELL_FAR * unit)
    calm = surface.smoothed(surface_m)
    height = surface.standing_out(calm, wheel_m, footprint_m, cell_m)
    raw = surface.standing_out(surface_m, wheel_m, footprint_m, cell_m)
    return Shape(_most(bump), swell, height, _most(height), raw)


def rock_odds(shape: Shape, sigma_m: Floats, climb_m: float) -> Floats:
    """Return the odds (H, W), in (0, 1), that cells hold what is too high to climb.

    What stands out by more than `climb_m` and its noise after a mean is sure to, whatever its
    surroundings look like; and it is as likely as not where single cells do, by far more than
    theirs.

    Args:
        shape: of the map.
        sigma_m: (H, W) of each cell against its neighbours.
        climb_m: the highest rock or step that the wheels climb.
    """
    constant, *linear = LINEAR
    traits = traits_of(shape, climb_m)
    logit = np.full(shape.bump.shape, constant)
    for weight, trait in zip((*linear, *SQUARE), traits, strict=True):
        logit += weight * trait
    noise_m = np.maximum(HEIGHT_NOISE * sigma_m, 1e-6)
    sure = 2.0 * ndtr((shape.height - climb_m) / noise_m) - 1.0
    spike = (shape.raw > climb_m) & (shape.raw > SPIKE_NOISE * sigma_m)
    sure = np.maximum(sure, np.where(spike, SPIKE_ODDS, 0.0))
    hidden = UNKNOWN_ODDS * np.minimum(sigma_m / (BLIND * climb_m), 1.0) ** 3
    most = 1.0 - LEAST_ODDS
    return np.asarray(np.clip(np.maximum(expit(logit), sure), LEAST_ODDS + hidden, most))


def traits_of(shape: Shape, climb_m: float) -> list[Floats]:
    """Return what `LINEAR` (after its constant) and then `SQUARE` weigh, (H, W) each."""
    bump = np.clip(shape.bump / climb_m, 0.0, MOST_BUMP)
    swell = np.clip(shape.swell / climb_m, -MOST_SWELL, MOST_SWELL)
    height = np.log(np.clip(shape.near / climb_m, LEAST_HEIGHT, MOST_HEIGHT))
    one = [bump, swell, height]
    return one + [one[i] * one[j] for i in range(3) for j in range(i, 3)]


def _mean(surface_m: Floats, width_cells: float) -> Floats:
    """Return a Gaussian mean (H, W); `width_cells` is its standard deviation."""
    mean = cv2.GaussianBlur(surface_m, (0, 0), width_cells, borderType=cv2.BORDER_REFLECT)
    return np.asarray(mean, dtype=np.float64)


def _most(values: Floats) -> Floats:
    """Return the largest of each cell and its eight neighbours (H, W)."""
    return np.asarray(cv2.dilate(values, np.ones((3, 3), np.uint8)), dtype=np.float64)
