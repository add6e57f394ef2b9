"""Estimates and how they are brought together: Sujan & Meggiolaro, Eqs. 14-16 and 19-21."""

import math
from dataclasses import dataclass

import numpy as np

from agents.errors import AgentError
from agents.geometry import Floats, Pose

YAW = 3
"""Index of the yaw in a pose's state (x, y, z, yaw)."""


class FusionError(AgentError):
    """An estimate that can't be fused."""


@dataclass(frozen=True)
class Gaussian:
    """A mean (n,) and its covariance (n, n)."""

    mean: Floats
    covariance: Floats


def symmetric(matrix: Floats) -> Floats:
    """Return the symmetric part of a matrix (n, n)."""
    return 0.5 * (matrix + matrix.T)


def checked_covariance(covariance: Floats, size: int) -> Floats:
    """Return the covariance, symmetrised; refuse one that is none.

    Raises:
        FusionError: wrong shape, not finite, not symmetric or not positive semidefinite.
    """
    c = np.asarray(covariance, dtype=np.float64)
    if c.shape != (size, size) or not np.isfinite(c).all():
        raise FusionError(f"a covariance must be finite and {size} x {size}; got {c.tolist()}")
    scale = max(float(np.abs(c).max()), 1e-300)
    if np.abs(c - c.T).max() > 1e-6 * scale or np.linalg.eigvalsh(symmetric(c))[0] < -1e-9 * scale:
        raise FusionError(f"a covariance must be symmetric and not negative; got {c.tolist()}")
    return symmetric(c)


def ekf_predict(prior: Gaussian, mean: Floats, f: Floats, noise: Floats) -> Gaussian:
    """Return the state moved to `mean` with Jacobian f (n, n) and process noise (n, n) (Eq. 14)."""
    return Gaussian(mean, symmetric(f @ prior.covariance @ f.T + noise))


def ekf_update(
    prior: Gaussian, innovation: Floats, h: Floats, noise: Floats
) -> tuple[Gaussian, float]:
    """Return the state after a measurement, and its normalised innovation squared (Eqs. 15, 16).

    Args:
        prior: state of n numbers.
        innovation: (m,) measured less expected, angles wrapped.
        h: (m, n) Jacobian of the measurement.
        noise: (m, m) its covariance.

    The covariance is kept in Joseph's form, `(I-KH) P (I-KH)' + K R K'`, which stays symmetric
    and positive whatever rounding does to the gain K.
    """
    p = prior.covariance
    s = h @ p @ h.T + noise
    try:
        gain = np.linalg.solve(s, h @ p).T
        nis = float(innovation @ np.linalg.solve(s, innovation))
    except np.linalg.LinAlgError as error:
        raise FusionError(
            "a certain measurement of what is known for certain can't be fused: "
            f"innovation covariance {s.tolist()} has no inverse"
        ) from error
    keep = np.eye(len(p)) - gain @ h
    covariance = symmetric(keep @ p @ keep.T + gain @ noise @ gain.T)
    return Gaussian(prior.mean + gain @ innovation, covariance), nis


def rotate_covariance(covariance: Floats, rotation: Floats) -> Floats:
    """Return `R C R'` (Eq. 19): a covariance turned into another frame."""
    return symmetric(rotation @ covariance @ rotation.T)


def merge(one: Gaussian, other: Gaussian) -> Gaussian:
    """Return the product of two Gaussians (Eqs. 20, 21); for *independent* data only.

    `C = C1 - C1 (C1+C2)^-1 C1`, `x = x1 + C1 (C1+C2)^-1 (x2 - x1)`. Associative and
    commutative. Counting a measurement twice makes the result overconfident.
    """
    c1, both = one.covariance, one.covariance + other.covariance
    if one.mean.shape != other.mean.shape:
        raise FusionError(
            f"means of shapes {one.mean.shape} and {other.mean.shape} can't be merged"
        )
    try:
        gain = np.linalg.solve(both, c1).T
    except np.linalg.LinAlgError as error:
        raise FusionError(
            "two certain estimates can't be merged: C1 + C2 has no inverse"
        ) from error
    mean = one.mean + gain @ (other.mean - one.mean)
    return Gaussian(mean, symmetric(c1 - gain @ c1))


def yaw_matrix(yaw_rad: float) -> Floats:
    """Return the (4, 4) rotation of (x, y, z, yaw) by a yaw."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    matrix = np.eye(4)
    matrix[:2, :2] = ((c, -s), (s, c))
    return matrix


def compose(
    base: Pose, base_covariance: Floats, offset: tuple[float, float, float, float], noise: Floats
) -> tuple[Pose, Floats]:
    """Return the pose reached from a base by an offset (forward, left, up, turn), with covariance.

    First order: `C = F C_base F' + G noise G'`, both (4, 4), base and offset independent.
    """
    forward, left, up, turn = offset
    c, s = math.cos(base.yaw_rad), math.sin(base.yaw_rad)
    f = np.eye(4)
    f[0, YAW] = -s * forward - c * left
    f[1, YAW] = c * forward - s * left
    covariance = f @ base_covariance @ f.T + rotate_covariance(noise, yaw_matrix(base.yaw_rad))
    return base.moved(forward, left, up, turn), symmetric(covariance)
