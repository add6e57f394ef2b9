"""Where a robot is, by holding a look's ranges against the occupancy map that is there.

From a pose the map predicts how far each ray goes: to the face of the first cell that is mapped as
solid, as long as all cells before are mapped as free. The pose whose predictions fit best, within
three standard deviations of the believed one, is the measured pose; how sharply the fit falls off
around it is its covariance. How rays are cast is handed in: `agents.planar.matching` on a floor,
`agents.voxel.matching` in space.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from agents.geometry import Floats, Ints, Pose
from comms.kernels import kernel

MOST = 9.0
"""A ray that does not fit at all counts like three standard deviations."""
INDEPENDENT = 12.0
"""All rays of a look tell as much as so many independent ones."""
FIT = 0.6
"""Share of the rays with a prediction that must fit."""
VAGUE = 1e-3
"""Curvature (per unit squared, as a share of the sharpest) that says nothing."""
LEVELS = 4
"""Times that the search is narrowed to a third."""


@dataclass(frozen=True)
class Match:
    """A measured pose and its covariance (4, 4) of (x, y, z, yaw)."""

    pose: Pose
    covariance: Floats


@dataclass(frozen=True)
class Scales:
    """What is fine and what is coarse along each axis of an eye, (A,) metres and radians."""

    units: Floats
    """Metres in one unit of each axis of the eye; 1 of an angle."""
    floor: Floats
    """No look tells more than this."""
    step: Floats
    """Offsets at which the fall of the fit is measured."""
    rays: int
    """How many of a look are held against the map."""
    least_rays: int
    """How many must have a prediction."""


class Casting(Protocol):
    """A look's rays, and the map through which they are cast."""

    def misfit(self, eye: Floats) -> tuple[float, int, int]:
        """Return the misfit at an eye (A,), the rays with a prediction, and those that fit."""
        ...

    def search(self, eye: Floats, span: Floats) -> Floats:
        """Return the eye (A,) of the least misfit within `span` (A,) of an eye."""
        ...


@kernel
def misfit_of(measured: float, sigma: float, expected: float) -> float:
    """Return how ill one measured range fits its prediction; inf is nothing within range."""
    if np.isinf(measured) and np.isinf(expected):
        return 0.0
    if np.isinf(measured) or np.isinf(expected):
        return MOST
    return min(((measured - expected) / sigma) ** 2, MOST)


def chosen_rays(count: int, most: int) -> Ints:
    """Return which of a look's rays are held against the map, spread over all of it."""
    return np.linspace(0, count - 1, min(most, count)).astype(np.int64)


def fitted(
    casting: Casting, eye: Floats, sigma: Floats, scales: Scales, rays: int
) -> tuple[Floats, Floats] | None:
    """Return the eye (A,) that fits best and its covariance (A, A), or None where none fits well.

    Args:
        casting: the look and the map.
        eye: as it is believed, in the casting's units.
        sigma: (A,) standard deviations of that, metres and radians.
        scales: of the eye's axes.
        rays: how many there are.
    """
    span = 3.0 * np.maximum(sigma, scales.floor) / scales.units
    for _ in range(LEVELS):
        eye = casting.search(eye, span)
        span = span / 3.0
    misfit, told, fitting = casting.misfit(eye)
    if told < scales.least_rays or fitting < FIT * told or not math.isfinite(misfit):
        return None
    return eye, _spread(casting, eye, scales, rays)


def _spread(casting: Casting, eye: Floats, scales: Scales, rays: int) -> Floats:
    """Return the covariance (A, A) of an eye, metres and radians, by the fit's curvature."""
    steps, axes = scales.step / scales.units, len(eye)

    def misfit(*moves: tuple[int, float]) -> float:
        at = eye.copy()
        for axis, sign in moves:
            at[axis] += sign * steps[axis]
        return float(casting.misfit(at)[0])

    here, bend = misfit(), np.zeros((axes, axes))
    for a in range(axes):
        bend[a, a] = misfit((a, 1.0)) + misfit((a, -1.0)) - 2.0 * here
        for b in range(a):
            both = misfit((a, 1.0), (b, 1.0)) + misfit((a, -1.0), (b, -1.0))
            bend[a, b] = bend[b, a] = 0.25 * (
                both - misfit((a, 1.0), (b, -1.0)) - misfit((a, -1.0), (b, 1.0))
            )
    # In units of one step: the misfit is twice the negative log likelihood of the rays.
    values, vectors = np.linalg.eigh(0.5 * bend * INDEPENDENT / rays)
    values = np.maximum(values, VAGUE * max(float(values[-1]), 1e-6))
    covariance = (vectors / values) @ vectors.T * np.outer(scales.step, scales.step)
    return covariance + np.diag(scales.floor**2)
