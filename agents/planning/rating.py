"""The rating function that weighs a look against its cost: Sujan & Meggiolaro, Eqs. 22 and 23.

`RF = (w_NI NI - w_d d - w_LE LE) (1 - P)`. The paper leaves scales open; ours:

- NI, new information in bits, as a share of the best candidate's (0..1);
- d, length of the path found, as a multiple of the sensor's range;
- LE, expected standard deviation of the robot's position at the goal, as a multiple of a cell;
- P, probability that the goal is occupied or unsafe.

With the default weights a robot drives four sensor ranges for the best look rather than
take a look that promises nothing here.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from agents.errors import AgentError
from agents.geometry import Floats, wrap_angle
from agents.settings import PlannerSettings


class RatingError(AgentError):
    """Candidates that can't be rated."""


def configuration_distance(
    here: ArrayLike, there: ArrayLike, alpha: ArrayLike, angles: tuple[int, ...] = ()
) -> float:
    """Return `sqrt(sum alpha_i (c_i - c'_i)^2)` (Eq. 22) of two configurations.

    `alpha` weighs each coordinate; those whose indices are in `angles` are radians and wrap.
    """
    a, b, weights = (np.asarray(v, dtype=np.float64) for v in (here, there, alpha))
    if a.shape != b.shape or a.shape != weights.shape or (weights < 0).any():
        raise RatingError(
            f"configurations of shapes {a.shape} and {b.shape} with {weights.size} weights: "
            "all must be alike, and weights >= 0"
        )
    apart = a - b
    for i in angles:
        apart[i] = wrap_angle(float(apart[i]))
    return math.sqrt(float((weights * apart * apart).sum()))


def rate(
    gain_bits: Floats,
    path_m: Floats,
    sigma_m: Floats,
    unsafe_p: Floats,
    *,
    best_bits: float,
    range_m: float,
    cell_m: float,
    planner: PlannerSettings,
) -> Floats:
    """Return the rating RF of candidates (Eq. 23); arrays of shapes that broadcast.

    Args:
        gain_bits: expected new information (Eq. 3, 8 or another).
        path_m: length of the path to the candidate.
        sigma_m: expected standard deviation of position there.
        unsafe_p: probability that the candidate is occupied or unsafe.
        best_bits: the largest gain among all candidates.
        range_m: the sensor's range.
        cell_m: cell size of the map.
        planner: the weights.
    """
    if not (best_bits > 0 and range_m > 0 and cell_m > 0):
        raise RatingError(
            f"best gain {best_bits} bits, range {range_m} m, cell {cell_m} m: all must be > 0"
        )
    worth = planner.w_information * gain_bits / best_bits
    cost = planner.w_distance * path_m / range_m + planner.w_localisation * sigma_m / cell_m
    return (worth - cost) * (1.0 - unsafe_p)
