"""How a camera moved, from points that it tracked: Sujan & Meggiolaro, section 2.3.4, Eqs. 10-12.

The closed form of `agents.pose.rigidmotion` inside RANSAC, then refined by what each point's own
covariance says.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from agents.geometry import Bools, Floats, Ints
from agents.pose import rotations
from agents.pose.rigidmotion import EgomotionError, Motion, checked, closed_form, fitted
from comms import kernels
from comms.kernels import kernel

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
    """Return what R and X leave (n, 3) and the inverses of its covariances (n, 3, 3)."""
    moved_m = tracks.before_m @ rotation.T + translation_m
    noise = tracks.after_noise + rotation @ tracks.before_noise @ rotation.T
    return tracks.after_m - moved_m, np.asarray(np.linalg.inv(noise), dtype=np.float64)


def distances(tracks: Tracks, rotation: Floats, translation_m: Floats) -> Floats:
    """Return each point's squared Mahalanobis distance (k, n) from where k motions take it.

    Args:
        tracks: n points.
        rotation: R of each motion, (k, 3, 3).
        translation_m: X of each, (k, 3).
    """
    out = np.empty((len(rotation), len(tracks.before_m)))
    plain = np.ascontiguousarray
    _far(
        plain(tracks.before_m),
        plain(tracks.after_m),
        plain(tracks.before_noise),
        plain(tracks.after_noise),
        plain(rotation),
        plain(translation_m),
        out,
    )
    return out


@kernel
def _far(
    before: np.ndarray,
    after: np.ndarray,
    before_noise: np.ndarray,
    after_noise: np.ndarray,
    rotation: np.ndarray,
    translation: np.ndarray,
    out: np.ndarray,
) -> None:
    e, turned, s = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for k in range(out.shape[0]):
        r = rotation[k]
        for i in range(out.shape[1]):
            for a in range(3):
                e[a] = after[i, a] - translation[k, a]
                for b in range(3):
                    e[a] -= r[a, b] * before[i, b]
                    turned[a, b] = 0.0
                    for c in range(3):
                        turned[a, b] += r[a, c] * before_noise[i, c, b]
            for a in range(3):
                for b in range(3):
                    s[a, b] = after_noise[i, a, b]
                    for c in range(3):
                        s[a, b] += turned[a, c] * r[b, c]
            # s^-1 = adjugate / determinant, both symmetric
            xx, yy = s[1, 1] * s[2, 2] - s[1, 2] ** 2, s[0, 0] * s[2, 2] - s[0, 2] ** 2
            zz, xy = s[0, 0] * s[1, 1] - s[0, 1] ** 2, s[0, 2] * s[1, 2] - s[0, 1] * s[2, 2]
            xz, yz = s[0, 1] * s[1, 2] - s[0, 2] * s[1, 1], s[0, 1] * s[0, 2] - s[0, 0] * s[1, 2]
            determinant = s[0, 0] * xx + s[0, 1] * xy + s[0, 2] * xz
            squares = xx * e[0] ** 2 + yy * e[1] ** 2 + zz * e[2] ** 2
            mixed = xy * e[0] * e[1] + xz * e[0] * e[2] + yz * e[1] * e[2]
            out[k, i] = (squares + 2 * mixed) / determinant


@kernels.warmer
def _warm() -> None:
    one, eye = np.zeros((1, 3)), np.eye(3)[None]
    _far(one, one, eye, eye, eye, one, np.zeros((1, 1)))


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
        again = distances(tracks, motion.rotation[None], motion.translation_m[None])[0] <= GATE
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
