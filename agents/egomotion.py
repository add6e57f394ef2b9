"""How a camera moved, from points that it tracked: Sujan & Meggiolaro, section 2.3.4, Eqs. 10-12.

The closed form of `agents.rigidmotion` inside RANSAC, then refined by what each point's own
covariance says. Covariances (6, 6) of a motion are of (error of X in metres, error of R as a
rotation vector in radians), both in the axes of the frame after: `R_true = exp(error) R`,
`X_true = X + error`.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from agents import rotations
from agents.geometry import Bools, Floats, Ints
from agents.rigidmotion import EgomotionError, checked, closed_form, fitted

GATE = 16.27
"""Squared Mahalanobis distance that 99.9 % of true points keep (chi-squared, 3 degrees)."""
SAMPLE_GATE = 4 * GATE
"""The same for a motion drawn through three points, whose own error is as large as a point's."""
SAMPLES = 100
"""Motions that are tried at most; 100 miss none in a million at 40 % of false points."""
ROUNDS = 6
"""Turns of choosing points and refining at most; two or three do."""
STEPS = 8
"""Gauss-Newton steps at most; two or three do."""
SETTLED = 1e-8
"""Square of the last step's length, in sigmas."""


@dataclass(frozen=True)
class Motion:
    """A rigid motion with the covariance of its error."""

    rotation: Floats
    """R, (3, 3)."""
    translation_m: Floats
    """X, (3,)."""
    covariance: Floats
    """(6, 6) of (X, R), as the module says."""

    @classmethod
    def none(cls) -> "Motion":
        """Return the motion that moves nothing, for certain."""
        return cls(np.eye(3), np.zeros(3), np.zeros((6, 6)))

    def moved(self, points_m: Floats) -> Floats:
        """Return points (n, 3) of the frame before in the frame after."""
        return points_m @ self.rotation.T + self.translation_m

    def then(self, following: "Motion") -> "Motion":
        """Return both motions one after the other, their errors independent (first order)."""
        turned_m = following.rotation @ self.translation_m
        carried = np.kron(np.eye(2), following.rotation)
        lever = np.eye(6)
        lever[:3, 3:] = -rotations.cross_matrix(turned_m)
        covariance = lever @ following.covariance @ lever.T + carried @ self.covariance @ carried.T
        return Motion(
            following.rotation @ self.rotation, turned_m + following.translation_m, covariance
        )

    def inverse(self) -> "Motion":
        """Return the motion back."""
        back = self.rotation.T
        jacobian = np.zeros((6, 6))
        jacobian[:3, :3] = jacobian[3:, 3:] = -back
        jacobian[:3, 3:] = -back @ rotations.cross_matrix(self.translation_m)
        covariance = jacobian @ self.covariance @ jacobian.T
        return Motion(back, -back @ self.translation_m, covariance)


@dataclass(frozen=True)
class Tracks:
    """The same n points measured before and after a motion, each in the camera's frame then."""

    before_m: Floats
    """r, (n, 3)."""
    after_m: Floats
    """u, (n, 3)."""
    before_noise: Floats
    """(n, 3, 3) covariances of `before_m`, m^2."""
    after_noise: Floats
    """(n, 3, 3) covariances of `after_m`, m^2."""

    def __post_init__(self) -> None:
        """Refuse shapes that don't agree, and what is not finite."""
        n = checked(self.before_m, self.after_m, 3)
        for noise in (self.before_noise, self.after_noise):
            if noise.shape != (n, 3, 3) or not np.isfinite(noise).all():
                raise EgomotionError(
                    f"noise must be finite and ({n}, 3, 3); got one of shape {noise.shape}"
                )

    def only(self, chosen: Bools) -> "Tracks":
        """Return the points that are marked (n,)."""
        return Tracks(
            self.before_m[chosen],
            self.after_m[chosen],
            self.before_noise[chosen],
            self.after_noise[chosen],
        )


def point_covariance(points_m: Floats, sigma_m: Floats, lateral: float) -> Floats:
    """Return the covariances (n, 3, 3) of points (n, 3) seen from the origin (Eq. 4).

    `sigma_m` (n,) is the deviation along the ray; across it, it is `lateral` times that.
    """
    length = np.linalg.norm(points_m, axis=1, keepdims=True)
    ray = points_m / np.maximum(length, 1e-12)
    along = ray[:, :, None] * ray[:, None, :]
    shape = (1 - lateral**2) * along + lateral**2 * np.eye(3)
    return sigma_m[:, None, None] ** 2 * shape


def refined(tracks: Tracks, rotation: Floats, translation_m: Floats) -> Motion:
    """Return the likeliest motion near a first guess, with its covariance (Gauss-Newton).

    Each point counts by the inverse of its own covariance, `A + R B R^T` of the two ends, so
    that what a stereo camera knows across its rays is not spoilt by what it doesn't along them.

    Raises:
        EgomotionError: the points don't tell all six numbers.
    """
    for _ in range(STEPS):
        step, information = _step(tracks, rotation, translation_m)
        translation_m = translation_m + step[:3]
        rotation = rotations.from_vector(step[3:]) @ rotation
        if step @ information @ step < SETTLED:
            break
    covariance = np.linalg.inv(_step(tracks, rotation, translation_m)[1])
    return Motion(rotation, translation_m, 0.5 * (covariance + covariance.T))


def _step(tracks: Tracks, rotation: Floats, translation_m: Floats) -> tuple[Floats, Floats]:
    """Return the step (6,) towards the likeliest motion, and the information (6, 6) there is."""
    error, weight = _residual(tracks, rotation, translation_m)
    turned = tracks.before_m @ rotation.T
    straight = np.broadcast_to(np.eye(3), (len(turned), 3, 3))
    jacobian = np.concatenate((straight, -rotations.cross_matrix(turned)), axis=2)
    pulled = np.swapaxes(jacobian, 1, 2) @ weight
    information = (pulled @ jacobian).sum(axis=0)
    pull = (pulled @ error[:, :, None]).sum(axis=0)[:, 0]
    try:
        return np.linalg.solve(information, pull), information
    except np.linalg.LinAlgError as wrong:
        raise EgomotionError(f"{len(turned)} points don't tell a motion") from wrong


def _residual(tracks: Tracks, rotation: Floats, translation_m: Floats) -> tuple[Floats, Floats]:
    """Return what R and X leave (..., n, 3) and the inverses of its covariances (..., n, 3, 3)."""
    turning = rotation[..., None, :, :]
    moved = (turning @ tracks.before_m[:, :, None])[..., 0] + translation_m[..., None, :]
    noise = tracks.after_noise + turning @ tracks.before_noise @ np.swapaxes(turning, -1, -2)
    return tracks.after_m - moved, np.asarray(np.linalg.inv(noise), dtype=np.float64)


def distances(tracks: Tracks, rotation: Floats, translation_m: Floats) -> Floats:
    """Return each point's squared Mahalanobis distance (..., n) from where a motion takes it."""
    error, weight = _residual(tracks, rotation, translation_m)
    return (error[..., None, :] @ weight @ error[..., None])[..., 0, 0]


@dataclass(frozen=True)
class Found:
    """A motion, and the points that speak for it."""

    motion: Motion
    inliers: Bools
    """(n,)."""


def find_motion(tracks: Tracks, rng: np.random.Generator) -> Found:
    """Return the motion on which most points agree, some of them being false (RANSAC).

    Motions through three points each (all triples, where they are few) are scored by the sum of
    their distances, cut off at `SAMPLE_GATE`; the best is refined on the points within `GATE`,
    and these are chosen anew, until they stay.

    Raises:
        EgomotionError: fewer than 4 points agree (3, where there are no more), or they don't
            tell a motion.
    """
    n = len(tracks.before_m)
    weights = _weights(tracks)
    triples = _triples(n, rng)
    rotation, translation_m = fitted(
        tracks.before_m[triples], tracks.after_m[triples], weights[triples]
    )
    far = distances(tracks, rotation, translation_m)
    best = int(np.argmin(np.minimum(far, SAMPLE_GATE).sum(axis=1)))
    inliers = far[best] <= SAMPLE_GATE
    motion = None
    for _ in range(ROUNDS):
        if inliers.sum() < min(4, n):
            raise EgomotionError(f"of {n} tracked points only {int(inliers.sum())} agree")
        kept = tracks.only(inliers)
        start = closed_form(kept.before_m, kept.after_m, weights[inliers])
        motion = refined(kept, *start)
        again = distances(tracks, motion.rotation, motion.translation_m) <= GATE
        if np.array_equal(again, inliers):
            break
        inliers = again
    assert motion is not None
    return Found(motion, inliers)


def _weights(tracks: Tracks) -> Floats:
    """Return inverse mean variances (n,), the closed form's best guess without a rotation."""
    noise = tracks.before_noise + tracks.after_noise
    return 3.0 / np.trace(noise, axis1=1, axis2=2)


def _triples(n: int, rng: np.random.Generator) -> Ints:
    """Return all triples of n points, or `SAMPLES` of them drawn, (k, 3)."""
    every = list(itertools.combinations(range(n), 3)) if n <= 9 else []
    if 0 < len(every) <= SAMPLES:
        return np.array(every, dtype=np.int64)
    return np.argsort(rng.random((SAMPLES, n)), axis=1)[:, :3]
