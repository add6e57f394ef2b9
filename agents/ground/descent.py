"""Ground for a robot on tethers: what is barred to it, the odds of hidden rocks, what ways cost.

A steep smooth face is allowed. What bars the way is a rock or a ledge, ground that nobody has
measured, and ground measured so badly that it may hide a rock. Of all other ground the map tells
how likely each cell holds a rock after all; a way is the worse the more of that it sweeps.
"""

from typing import NamedTuple

import cv2
import numpy as np

from agents.geometry import Bools, Floats
from agents.ground import markov, surface

SURE = 0.9
"""Ground whose sigma exceeds this share of a wheel shows no rocks: no tethered robot goes there."""
ODDS = (0.4, 5.1, -1.0)
"""The logit of the odds that a cell holds a rock or a step too high to climb: a constant, and what
the logarithms of height and of sigma add, both as shares of the highest that it climbs. Fitted to
what the Cliff-bot was told in 17 missions on both sensors (docs/information.md)."""
LEAST_HEIGHT, LEAST_SIGMA = 0.02, 0.1
"""Below these shares the map tells nothing more."""
LEAST_ODDS, UNKNOWN_ODDS = 1e-4, 0.016
"""Odds of a rock where the map shows none for certain, and where it shows nothing: the share of all
cells that hold one. Between them they rise with sigma's square."""
BLIND = 2.0
"""What is as unsure as so many times the highest rock that it climbs shows nothing."""
ROCK = 0.2
"""What is a rock by these odds bars the way."""
CLEARANCE_WEIGHT = 3.0
"""By how much a metre beside what is barred costs more than open ground."""
RISK_WEIGHT = 50.0
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


def rock_odds(calm_m: Floats, sigma_m: Floats, climb_m: float) -> Floats:
    """Return the odds (H, W), in (0, 1), that cells hold what is too high to climb.

    Args:
        calm_m: height of what stands out after a 1-2-1 mean (`surface.standing_out`). Single cells
            say little: noise is as high there as rocks are.
        sigma_m: of each cell against its neighbours.
        climb_m: the highest rock or step that the wheels climb.
    """
    constant, of_height, of_sigma = ODDS
    logit = constant + of_height * np.log(np.maximum(calm_m / climb_m, LEAST_HEIGHT))
    logit += of_sigma * np.log(np.maximum(sigma_m / climb_m, LEAST_SIGMA))
    hidden = UNKNOWN_ODDS * np.minimum(sigma_m / (BLIND * climb_m), 1.0) ** 2
    return np.maximum(1.0 / (1.0 + np.exp(-logit)), LEAST_ODDS + hidden)


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
        return Barred(nothing, ~known, nothing, np.full(known.shape, UNKNOWN_ODDS))
    calm = surface.smoothed(markov.complete(elevation_m))
    sigma = np.where(known, sigma_m, 0.0)
    odds = rock_odds(surface.standing_out(calm, wheel_m, footprint_m, cell_m), sigma, climb_m)
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


def met_per_metre(odds: Floats, footprint_m: float, cell_m: float) -> Floats:
    """Return how many cells (H, W) with a rock a metre about each cell is expected to meet.

    Those under the circle, as a share of the way on which it stays over a cell.
    """
    disc = surface.disc(0.5 * footprint_m / cell_m).astype(np.float64)
    under = cv2.filter2D(odds, cv2.CV_64F, disc, borderType=cv2.BORDER_REFLECT)
    return np.asarray(under, dtype=np.float64) / (0.25 * np.pi * footprint_m)
