"""The rigid motion that fits two sets of points: Sujan & Meggiolaro, Eqs. 10 to 12.

A motion takes points of the frame before it to the frame after it: `after = R before + X` (Eq. 10).
Covariances (6, 6) of a motion are of (error of X in metres, error of R as a rotation vector in
radians), both in the axes of the frame after: `R_true = exp(error) R`, `X_true = X + error`.
"""

from dataclasses import dataclass

import numpy as np

from agents.errors import AgentError
from agents.geometry import Floats
from agents.pose import rotations

THIN = 1e-6
"""Points whose spread across a line is a smaller share of that along it don't tell a rotation."""


class EgomotionError(AgentError):
    """Points that don't tell a motion."""


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


def checked(before_m: Floats, after_m: Floats, least: int) -> int:
    """Return how many points there are, (n, 3) each.

    Raises EgomotionError for shapes that don't agree, too few points, and what is not finite.
    """
    shape = before_m.shape
    if shape != after_m.shape or len(shape) != 2 or shape[1] != 3 or shape[0] < least:
        raise EgomotionError(
            f"a motion takes two (n, 3) arrays of at least {least} points; got {shape} and"
            f" {after_m.shape}"
        )
    if not (np.isfinite(before_m).all() and np.isfinite(after_m).all()):
        raise EgomotionError("tracked points must be finite; got NaN or infinity among them")
    return shape[0]


def least_squares(before_m: Floats, after_m: Floats) -> tuple[Floats, Floats]:
    """Return R (3, 3) and X (3,) the paper's way (Eqs. 11, 12): twelve unknowns, no rotation asked.

    `g01 = u r^T (r r^T)^-1` of the points (n, 3), written with a 1 below; as printed its transposes
    are swapped. Its 3x3 block is no rotation: the nearest one is returned, and X as it comes.
    For comparison: `closed_form` needs a point less, and errs less.

    Raises:
        EgomotionError: fewer than 4 points, or all in one plane.
    """
    n = checked(before_m, after_m, 4)
    r = np.column_stack((before_m, np.ones(n))).T
    u = after_m.T
    square = r @ r.T
    spread = np.linalg.svd(before_m - before_m.mean(axis=0), compute_uv=False)
    if spread[2] <= THIN * spread[0]:
        raise EgomotionError(f"Eq. 12 needs points that lie in no plane; these {n} do")
    g01 = np.asarray(np.linalg.solve(square, r @ u.T).T, dtype=np.float64)
    return rotations.nearest(g01[:, :3]), g01[:, 3]


def closed_form(
    before_m: Floats, after_m: Floats, weights: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return the R (3, 3) and X (3,) of least weighted squares among rigid motions.

    Kabsch's and Umeyama's form: the rotation nearest to the points' weighted cross-covariance.
    `weights` (n,) are inverse variances; none given: all alike.

    Raises:
        EgomotionError: fewer than 3 points, or all on one line.
    """
    n = checked(before_m, after_m, 3)
    w = np.ones(n) if weights is None else weights
    centred = before_m - (w[:, None] * before_m).sum(axis=0) / w.sum()
    spread = np.linalg.svd(np.sqrt(w)[:, None] * centred, compute_uv=False)
    if spread[1] <= THIN * spread[0]:
        raise EgomotionError(f"a rotation needs points that lie on no line; these {n} do")
    return fitted(before_m, after_m, w)


def fitted(before_m: Floats, after_m: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return R (..., 3, 3) and X (..., 3) of points (..., n, 3) with weights (..., n)."""
    share = (weights / weights.sum(axis=-1, keepdims=True))[..., None]
    mean_before = (share * before_m).sum(axis=-2)
    mean_after = (share * after_m).sum(axis=-2)
    before = before_m - mean_before[..., None, :]
    after = after_m - mean_after[..., None, :]
    rotation = rotations.nearest(np.swapaxes(share * after, -1, -2) @ before)
    return rotation, mean_after - (rotation @ mean_before[..., None])[..., 0]
