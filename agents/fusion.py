"""Estimates and how they are brought together: Sujan & Meggiolaro, Eqs. 14-16 and 19-21."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.errors import AgentError
from agents.geometry import Floats, Pose, wrap_angle
from agents.ports import Sighting

YAW = 3
"""Index of the yaw in a pose's state (x, y, z, yaw)."""


SHARES = tuple(float(share) for share in np.linspace(0.02, 0.98, 25))
"""Shares that are tried in covariance intersection."""


class FusionError(AgentError):
    """An estimate that can't be fused."""


@dataclass(frozen=True)
class Gaussian:
    """A mean (n,) and its covariance (n, n)."""

    mean: Floats
    covariance: Floats


def symmetric(matrix: NDArray[np.floating[Any]]) -> Floats:
    """Return the symmetric part of a matrix (n, n)."""
    return np.asarray(0.5 * (matrix + matrix.T), dtype=np.float64)


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


def pose_numbers(pose: Pose) -> Floats:
    """Return a pose as (x, y, z, yaw), (4,)."""
    return np.array((pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad), dtype=np.float64)


def offset_between(base: Pose, other: Pose) -> tuple[Floats, Floats, Floats]:
    """Return another pose in the frame of a base (4,), and Jacobians (4, 4) to both."""
    turn = yaw_matrix(-base.yaw_rad)
    apart = pose_numbers(other) - pose_numbers(base)
    apart[YAW] = wrap_angle(float(apart[YAW]))
    offset = turn @ apart
    to_base = -turn
    to_base[0, YAW], to_base[1, YAW] = offset[1], -offset[0]
    return offset, to_base, turn


def stand_of_seer(mate: Pose, mate_covariance: Floats, sighting: Sighting) -> tuple[Pose, Floats]:
    """Return where a robot stands that saw a mate at a known pose, with covariance (4, 4)."""
    yaw_rad = wrap_angle(mate.yaw_rad - sighting.bearing_rad)
    ahead, left, up = sighting.offset_m
    foot = Pose(mate.x_m, mate.y_m, mate.z_m, yaw_rad).moved(-ahead, -left, -up, 0.0)
    turn = yaw_matrix(yaw_rad)
    to_mate, to_sighting = np.eye(4), -turn
    to_mate[0, YAW], to_mate[1, YAW] = mate.y_m - foot.y_m, foot.x_m - mate.x_m
    to_sighting[:2, YAW] = -to_mate[:2, YAW]
    own = checked_covariance(mate_covariance, 4)
    seen = checked_covariance(sighting.covariance, 4)
    return foot, symmetric(to_mate @ own @ to_mate.T + to_sighting @ seen @ to_sighting.T)


def best_share(prior: Floats, h: Floats, seen: Floats, reference: Floats) -> float | None:
    """Return the share w of covariance intersection, or None where none makes the pose surer.

    Args:
        prior: (4, 4) of the pose, to be stretched by 1/w.
        h: (4, 4) Jacobian of the measurement.
        seen: (4, 4) the measurement's own noise.
        reference: (4, 4) of what is measured against, to be stretched by 1/(1-w).

    """
    sizes = [_size(_updated(prior / w, h, seen + reference / (1.0 - w))) for w in SHARES]
    best = int(np.argmin(sizes))
    return SHARES[best] if sizes[best] < _size(prior) else None


def _updated(prior: Floats, h: Floats, noise: Floats) -> Floats:
    s = h @ prior @ h.T + noise
    return symmetric(prior - prior @ h.T @ np.linalg.solve(s, h @ prior))


def _size(covariance: Floats) -> float:
    return float(np.linalg.slogdet(covariance)[1])
