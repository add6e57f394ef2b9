"""Ground for a robot on tethers: what is barred to it, the odds of hidden rocks, what ways cost.

A steep smooth face is allowed. What bars the way is a rock or a ledge, ground that nobody has
measured, and ground measured so badly that it may hide a rock. Of all other ground the map tells
how likely each cell holds a rock after all; a way is the worse the more of that it sweeps.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import ndtr

from agents.geometry import Bools, Floats
from agents.ground import markov, rocks, surface

SURE = 0.9
"""Ground whose sigma exceeds this share of a wheel shows no rocks: no tethered robot goes there."""
ROCK = 0.2
"""What is a rock by these odds bars the way."""
CLEARANCE_WEIGHT = 3.0
"""By how much a metre beside what is barred costs more than open ground."""
RISK_WEIGHT = 100.0
"""Metres that it goes round so as not to meet a rock."""


class Barred(NamedTuple):
    """Why a robot on tethers may not go somewhere; all (H, W)."""

    rock: Bools
    """A rock or a ledge, as far as the map can tell."""
    unseen: Bools
    """Farther than a wheel from measured ground."""
    blurred: Bools
    """Measured too badly to show rocks."""
    odds: Floats
    """In (0, 1): that a cell holds a rock or a ledge, where it was measured."""

    @property
    def any(self) -> Bools:
        """(H, W) where it may not go."""
        return self.rock | self.unseen | self.blurred


def barred(
    elevation_m: Floats,
    sigma_m: Floats,
    *,
    cell_m: float,
    footprint_m: float,
    wheel_m: float,
    climb_m: float,
) -> Barred:
    """Return what bars the way of a robot on tethers; a steep smooth face does not.

    Barred are rocks and ledges, cells unknown farther than one wheel from measured ground, and
    ground whose sigma exceeds 0.9 of a wheel (rocks must be seen).

    Args:
        elevation_m: (H, W), NaN where unknown.
        sigma_m: (H, W) standard deviation; only read where the elevation is known.
        cell_m: cell size.
        footprint_m: diameter of the circle that the robot covers.
        wheel_m: diameter of a wheel.
        climb_m: highest rock or step that it climbs.
    """
    known = ~np.isnan(elevation_m)
    if not known.any():
        nothing = np.zeros(known.shape, dtype=np.bool_)
        return Barred(nothing, ~known, nothing, np.full(known.shape, rocks.UNKNOWN_ODDS))
    sigma = np.where(known, sigma_m, 0.0)
    shape = rocks.shape_of(markov.complete(elevation_m), wheel_m, footprint_m, cell_m)
    odds = rocks.rock_odds(shape, sigma, climb_m)
    # A single unsure cell hides no rock that matters; what is unsure with its neighbours may.
    blurred = known & (surface.mean_over(sigma, 3) > SURE * wheel_m)
    unseen = markov.distance_to_known_m(known, cell_m) > wheel_m
    return Barred(odds > ROCK, unseen, blurred, odds)


def descent_cost(bars: Barred, *, cell_m: float, footprint_m: float) -> Floats:
    """Return what a metre costs a robot on tethers (H, W): 1 on open ground, inf where it may not.

    Forbidden is whatever is nearer than half a footprint to what is barred; up to one footprint
    farther the cost rises towards it (by up to 3). All ground costs `RISK_WEIGHT` more for each
    cell with a rock that a metre on it is expected to meet.
    """
    gap_m = markov.distance_to_known_m(bars.any, cell_m) - 0.5 * footprint_m
    nearness = np.clip(1.0 - gap_m / footprint_m, 0.0, 1.0)
    risk = RISK_WEIGHT * met_per_metre(bars.odds, footprint_m, cell_m)
    return np.where(gap_m > 0, 1.0 + CLEARANCE_WEIGHT * nearness**2 + risk, np.inf)


def met_at(away_m: Floats, footprint_m: float) -> Floats:
    """Return the odds that the robot's circle meets what lies so far beside its way, as planned.

    `footprint_m` has the robot's room about it (`surface.CLEARANCE_M`), which is one sigma of how
    well it keeps to a way.
    """
    room_m = surface.CLEARANCE_M
    return np.asarray(ndtr((0.5 * footprint_m - 0.5 * room_m - away_m) / room_m), dtype=np.float64)


def met_per_metre(odds: Floats, footprint_m: float, cell_m: float) -> Floats:
    """Return how many cells (H, W) with a rock a metre about each cell is expected to meet.

    Those under the circle, as a share of the way on which it stays over a cell.
    """
    reach = math.ceil((0.5 * footprint_m + 2.0 * surface.CLEARANCE_M) / cell_m)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    circle = met_at(cell_m * np.hypot(x, y), footprint_m)
    under = cv2.filter2D(odds, cv2.CV_64F, circle, borderType=cv2.BORDER_REFLECT)
    return np.asarray(under, dtype=np.float64) / (0.25 * np.pi * footprint_m)
