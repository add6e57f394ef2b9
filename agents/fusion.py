"""Estimates and how they are brought together: Sujan & Meggiolaro, Eqs. 14-16 and 19-21."""

import math
from dataclasses import dataclass

import numpy as np

from agents.errors import AgentError
from agents.geometry import Floats, Pose, wrap_angle
from agents.ports import Odometry, Sighting

YAW = 3
"""Index of the yaw in a pose's state (x, y, z, yaw)."""


class FusionError(AgentError):
    """An estimate that can't be fused."""


@dataclass(frozen=True)
class Gaussian:
    """A mean (n,) and its covariance (n, n)."""

    mean: Floats
    covariance: Floats


def _symmetric(matrix: Floats) -> Floats:
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
    if np.abs(c - c.T).max() > 1e-6 * scale or np.linalg.eigvalsh(_symmetric(c))[0] < -1e-9 * scale:
        raise FusionError(f"a covariance must be symmetric and not negative; got {c.tolist()}")
    return _symmetric(c)


def ekf_predict(prior: Gaussian, mean: Floats, f: Floats, noise: Floats) -> Gaussian:
    """Return the state moved to `mean` with Jacobian f (n, n) and process noise (n, n) (Eq. 14)."""
    return Gaussian(mean, _symmetric(f @ prior.covariance @ f.T + noise))


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
    covariance = _symmetric(keep @ p @ keep.T + gain @ noise @ gain.T)
    return Gaussian(prior.mean + gain @ innovation, covariance), nis


def rotate_covariance(covariance: Floats, rotation: Floats) -> Floats:
    """Return `R C R'` (Eq. 19): a covariance turned into another frame."""
    return _symmetric(rotation @ covariance @ rotation.T)


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
    return Gaussian(mean, _symmetric(c1 - gain @ c1))


def _yaw_matrix(yaw_rad: float) -> Floats:
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
    covariance = f @ base_covariance @ f.T + rotate_covariance(noise, _yaw_matrix(base.yaw_rad))
    return base.moved(forward, left, up, turn), _symmetric(covariance)


class PoseFilter:
    """What a robot believes about its own pose: an extended Kalman filter on (x, y, z, yaw)."""

    def __init__(self, pose: Pose, covariance: Floats) -> None:
        """Begin at a pose with a covariance (4, 4) of (x, y, z, yaw), metres and radians."""
        mean = np.array((pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad))
        self._state = Gaussian(mean, checked_covariance(covariance, 4))

    @property
    def pose(self) -> Pose:
        """The most likely pose."""
        x, y, z, yaw = self._state.mean.tolist()
        return Pose(x, y, z, wrap_angle(yaw))

    @property
    def covariance(self) -> Floats:
        """(4, 4) of (x, y, z, yaw), metres and radians; a copy."""
        return self._state.covariance.copy()

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the horizontal position, the longer axis."""
        return math.sqrt(max(0.0, float(np.linalg.eigvalsh(self._state.covariance[:2, :2])[1])))

    def predict(self, odometry: Odometry) -> None:
        """Move by what odometry says (Eq. 14)."""
        offset = (odometry.forward_m, odometry.left_m, odometry.up_m, odometry.turn_rad)
        noise = checked_covariance(odometry.covariance, 4)
        pose, covariance = compose(self.pose, self._state.covariance, offset, noise)
        mean = np.array((pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad))
        self._state = Gaussian(mean, covariance)

    def fix(self, measured: Pose, covariance: Floats, *, gate: float = math.inf) -> float:
        """Take in a measured pose (Eqs. 15, 16); return its normalised innovation squared.

        A measurement whose value exceeds `gate` (chi-squared, 4 degrees of freedom) is not
        believed and changes nothing.
        """
        expected = self.pose
        innovation = np.array(
            (
                measured.x_m - expected.x_m,
                measured.y_m - expected.y_m,
                measured.z_m - expected.z_m,
                wrap_angle(measured.yaw_rad - expected.yaw_rad),
            )
        )
        return self._take(innovation, np.eye(4), checked_covariance(covariance, 4), gate)

    def seen_by(
        self,
        observer: Pose,
        observer_covariance: Floats,
        sighting: Sighting,
        *,
        gate: float = math.inf,
    ) -> float:
        """Take in that a team-mate at a known pose saw this robot; return as `fix` does.

        The observer's error must be independent of this robot's own: two robots that fix each
        other in turn without new outside knowledge would grow sure of nothing.
        """
        offset = (*sighting.offset_m, sighting.bearing_rad)
        noise = checked_covariance(sighting.covariance, 4)
        measured, covariance = compose(
            observer, checked_covariance(observer_covariance, 4), offset, noise
        )
        return self.fix(measured, covariance, gate=gate)

    def saw(
        self, mate: Pose, mate_covariance: Floats, sighting: Sighting, *, gate: float = math.inf
    ) -> float:
        """Take in that this robot saw a team-mate (or landmark) at a known pose; as `fix`.

        The measurement is where the mate stands in this robot's frame and its relative yaw.
        The mate's error must be independent of this robot's own.
        """
        here = self.pose
        c, s = math.cos(here.yaw_rad), math.sin(here.yaw_rad)
        dx, dy = mate.x_m - here.x_m, mate.y_m - here.y_m
        forward, left = c * dx + s * dy, -s * dx + c * dy
        innovation = np.array(
            (
                sighting.offset_m[0] - forward,
                sighting.offset_m[1] - left,
                sighting.offset_m[2] - (mate.z_m - here.z_m),
                wrap_angle(sighting.bearing_rad - (mate.yaw_rad - here.yaw_rad)),
            )
        )
        h = -_yaw_matrix(-here.yaw_rad)
        h[0, YAW], h[1, YAW] = left, -forward
        turned = rotate_covariance(
            checked_covariance(mate_covariance, 4), _yaw_matrix(-here.yaw_rad)
        )
        noise = checked_covariance(sighting.covariance, 4) + turned
        return self._take(innovation, h, noise, gate)

    def range_fix(
        self,
        anchor_xyz: tuple[float, float, float],
        length_m: float,
        sigma_m: float,
        *,
        gate: float = math.inf,
    ) -> float:
        """Take in the distance to a known point, e.g. by a *taut* tether; return as `fix` does.

        Raises:
            FusionError: the robot stands on the point (no direction), or a number is impossible.
        """
        if not (length_m >= 0 and sigma_m > 0):
            raise FusionError(f"length {length_m} m must be >= 0 and its sigma {sigma_m} m > 0")
        apart = self._state.mean[:3] - np.asarray(anchor_xyz, dtype=np.float64)
        distance = float(np.linalg.norm(apart))
        if distance < 1e-6:
            raise FusionError(f"a range to {anchor_xyz} says nothing about a robot that is there")
        h = np.zeros((1, 4))
        h[0, :3] = apart / distance
        innovation = np.array((length_m - distance,))
        return self._take(innovation, h, np.array(((sigma_m * sigma_m,),)), gate)

    def _take(self, innovation: Floats, h: Floats, noise: Floats, gate: float) -> float:
        state, nis = ekf_update(self._state, innovation, h, noise)
        if nis <= gate:
            mean = state.mean.copy()
            mean[YAW] = wrap_angle(float(mean[YAW]))
            self._state = Gaussian(mean, state.covariance)
        return nis
