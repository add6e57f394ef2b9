"""Ground for a robot on tethers: what is barred to it, what is only not known to be safe, and ways.

A steep smooth face is allowed. What bars the way is a rock or a ledge, ground that nobody has
measured, and ground measured so badly that it may hide a rock. Of the last two a further look may
show that they are safe: so they are kept apart.
"""

from typing import NamedTuple

import numpy as np

from agents.geometry import Bools, Floats
from agents.ground import markov, surface

CLEARANCE_WEIGHT = 3.0
"""By how much a cell beside a hazard costs more than open ground."""
DOUBT_WEIGHT = 100.0
"""By how much ground costs more that is all as rough as a hazard, but within the map's noise."""
SURE = 0.5
"""Ground whose sigma exceeds this share of a wheel may hide rocks: no tethered robot goes there."""
LOW = 0.8
"""On tethers, what stands out by this share of a wheel is a rock, though it might be noise, if two
by two cells show it (after a mean, `surface.CALM_ROCK` of it); a single cell by a whole wheel."""
SHARPER = 0.35
"""As `SURE`, by the strict rule."""


class Barred(NamedTuple):
    """Why a robot on tethers may not go somewhere; all (H, W)."""

    rock: Bools
    """A rock or a ledge, as far as the map can tell."""
    unseen: Bools
    """Farther than a wheel from measured ground."""
    blurred: Bools
    """Measured too badly to show rocks."""
    doubt: Floats
    """In [0, 1], averaged over the footprint: how nearly the ground is as rough as a hazard."""

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
    strict: bool = False,
) -> Barred:
    """Return what bars the way; arguments as of `descent_cost`. At least one cell is known."""
    known = ~np.isnan(elevation_m)
    whole = markov.complete(elevation_m)
    sigma = np.where(known, sigma_m, 0.0)
    rough = surface.roughness(whole, wheel_m, footprint_m, cell_m, sigma)
    rock = rough.hazard | (rough.raw_m > wheel_m)
    rock |= rough.calm_m > surface.CALM_ROCK * LOW * wheel_m
    if strict:
        rock |= rough.likely
    # A single unsure cell hides no rock that matters; what is unsure with its neighbours may.
    blurred = known & (surface.mean_over(sigma, 3) > (SHARPER if strict else SURE) * wheel_m)
    unseen = markov.distance_to_known_m(known, cell_m) > wheel_m
    side = surface.odd_cells(footprint_m, cell_m)
    return Barred(rock, unseen, blurred, surface.mean_over(rough.doubt, side))


def descent_cost(
    elevation_m: Floats,
    sigma_m: Floats,
    *,
    cell_m: float,
    footprint_m: float,
    wheel_m: float,
    strict: bool = False,
) -> Floats:
    """Return what a metre costs a robot on tethers (H, W): 1 on open ground, inf where it may not.

    A steep smooth face is allowed. Forbidden are rocks and ledges higher than half a wheel, cells
    unknown farther than one wheel from measured ground, ground whose sigma exceeds half a wheel
    (rocks must be seen), and whatever is nearer than half a footprint to one of these; up to one
    footprint farther the cost rises towards the hazard (by up to 3). Ground that is rough under the
    footprint, but not surely a hazard, costs up to 100 more: a way round is worth it.

    Args:
        elevation_m: (H, W), NaN where unknown.
        sigma_m: (H, W) standard deviation; only read where the elevation is known.
        cell_m: cell size.
        footprint_m: diameter of the circle that the robot covers.
        wheel_m: diameter of a wheel.
        strict: bar also what stands out by `surface.LIKELY` of a wheel and may be noise, and ground
            that is less sure than `SHARPER`.
    """
    if np.isnan(elevation_m).all():
        return np.full(elevation_m.shape, np.inf)
    bars = barred(
        elevation_m,
        sigma_m,
        cell_m=cell_m,
        footprint_m=footprint_m,
        wheel_m=wheel_m,
        strict=strict,
    )
    return _with_clearance(bars.any, footprint_m, cell_m) + DOUBT_WEIGHT * bars.doubt


def _with_clearance(blocked: Bools, footprint_m: float, cell_m: float) -> Floats:
    """Return 1 far from blocked cells, up to 1 + CLEARANCE_WEIGHT near them, inf too near."""
    gap_m = markov.distance_to_known_m(blocked, cell_m) - 0.5 * footprint_m
    nearness = np.clip(1.0 - gap_m / footprint_m, 0.0, 1.0)
    return np.where(gap_m > 0, 1.0 + CLEARANCE_WEIGHT * nearness**2, np.inf)
