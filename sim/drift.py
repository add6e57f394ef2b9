"""What a drive does and what the robot's sensors say of it: slip, drift, and their covariance."""

import math
from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, Pose, wrap_angle
from agents.ports import Odometry
from agents.settings import DriveSettings

SHIFT_SIGMA_M = 0.003
"""How far a turn on the spot, or starting and stopping, moves the robot unnoticed."""
TURN_FLOOR_RAD = math.radians(0.02)
UP_SIGMA_M = 0.004
"""Error of the climb that the inclinometer gives: so much, and 1 % of sqrt(metres)."""
UP_SIGMA_PER_ROOT_M = 0.01
SLIDE_SIGMA = 0.1
"""Share of a slide that the robot mismeasures, in every direction."""


@dataclass(frozen=True)
class Leg:
    """One drive as it truly goes: what was ordered, and the errors drawn for it.

    The wheels don't notice slip and drift, so the odometry tells the order, and its covariance is
    that of these errors. What is per metre is a random walk (its variance grows with the way).
    """

    turn_rad: float
    forward_m: float
    turn_error_rad: float
    shift_m: tuple[float, float]
    """(forward, left) displacement by turning and starting, in the frame before the drive."""
    slip: float
    """Share of the way that is lost."""
    left_drift: float
    """Metres to the left per metre of way, in the leg's own frame."""
    yaw_drift_rad_per_m: float
    encoder: float
    """Share by which the encoders mismeasure the way."""

    def pose_after(self, start: Pose, way_m: float) -> Pose:
        """Return the true pose after `way_m` of the ordered way (z not yet that of the ground).

        The heading drifts evenly along the way, so the way is an arc.
        """
        sign = math.copysign(1.0, self.forward_m)
        bend = self.yaw_drift_rad_per_m * way_m
        along = sign * way_m * (1 - self.slip)
        turned = start.moved(*self.shift_m, 0.0, self.turn_rad + self.turn_error_rad)
        left = self.left_drift * way_m + along * bend / 2
        return turned.moved(along, left, 0.0, bend)


def draw_leg(
    drive: DriveSettings,
    slip_bias: float,
    turn_rad: float,
    forward_m: float,
    rng: np.random.Generator,
) -> Leg:
    """Draw the errors of a drive; always the same number of draws."""
    e = rng.standard_normal(7)
    root = math.sqrt(max(abs(forward_m), 1e-9))
    return Leg(
        turn_rad=turn_rad,
        forward_m=forward_m,
        turn_error_rad=float(e[0]) * _turn_sigma(drive, turn_rad),
        shift_m=(float(e[1]) * SHIFT_SIGMA_M, float(e[2]) * SHIFT_SIGMA_M),
        slip=slip_bias + float(e[3]) * drive.slip_sigma,
        left_drift=float(e[4]) * drive.odometry_sigma / root,
        yaw_drift_rad_per_m=float(e[5]) * math.radians(drive.yaw_sigma_deg_per_m) / root,
        encoder=float(e[6]) * drive.odometry_sigma / root,
    )


def _turn_sigma(drive: DriveSettings, turn_rad: float) -> float:
    return math.hypot(math.radians(drive.yaw_sigma_deg_per_turn) * abs(turn_rad), TURN_FLOOR_RAD)


def measure(
    drive: DriveSettings,
    leg: Leg,
    way_m: float,
    up_m: float,
    rng: np.random.Generator,
    *,
    halted: str = "",
    slide: tuple[float, float] = (0.0, 0.0),
) -> Odometry:
    """Return the odometry of a leg of which `way_m` was driven and which truly climbed `up_m`.

    `slide` is a displacement (forward, left; in the frame before the drive) that the robot did not
    drive but felt. The covariance is that of the true errors, to first order.
    """
    e = rng.standard_normal(3)
    sign = math.copysign(1.0, leg.forward_m)
    along = sign * way_m * (1 + leg.encoder)
    slid_m = math.hypot(*slide)
    up_sigma = math.hypot(UP_SIGMA_M, UP_SIGMA_PER_ROOT_M * math.sqrt(way_m), SLIDE_SIGMA * slid_m)
    return Odometry(
        forward_m=along * math.cos(leg.turn_rad) + slide[0] + float(e[1]) * SLIDE_SIGMA * slid_m,
        left_m=along * math.sin(leg.turn_rad) + slide[1] + float(e[2]) * SLIDE_SIGMA * slid_m,
        up_m=up_m + float(e[0]) * up_sigma,
        turn_rad=wrap_angle(leg.turn_rad),
        covariance=covariance(
            drive, leg.turn_rad, leg.forward_m, way_m, up_sigma_m=up_sigma, slid_m=slid_m
        ),
        halted=halted,
    )


def covariance(
    drive: DriveSettings,
    turn_rad: float,
    forward_m: float,
    way_m: float,
    *,
    up_sigma_m: float,
    slid_m: float = 0.0,
) -> Floats:
    """Return the (4, 4) covariance of (forward, left, up, turn) of a drive of `way_m` metres.

    A leg that was cut short keeps the drift rates that were drawn for all of it: variances then go
    with the square of the share that was driven.
    """
    ordered = max(abs(forward_m), 1e-9)
    walk = way_m**2 / ordered  # variance per (unit per root metre)^2
    along = (drive.slip_sigma**2 + drive.slip_bias_sigma**2) * way_m**2
    along += drive.odometry_sigma**2 * walk
    turn_var = _turn_sigma(drive, turn_rad) ** 2
    bend_var = math.radians(drive.yaw_sigma_deg_per_m) ** 2 * walk
    sideways = math.copysign(way_m, forward_m)
    left = drive.odometry_sigma**2 * walk + sideways**2 * (turn_var + bend_var / 4)
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    across_turn = sideways * (turn_var + bend_var / 2)
    felt = SHIFT_SIGMA_M**2 + (SLIDE_SIGMA * slid_m) ** 2
    result = np.zeros((4, 4))
    result[0, 0] = c * c * along + s * s * left + felt
    result[1, 1] = s * s * along + c * c * left + felt
    result[0, 1] = result[1, 0] = c * s * (along - left)
    result[2, 2] = up_sigma_m**2
    result[3, 3] = turn_var + bend_var
    result[0, 3] = result[3, 0] = -s * across_turn
    result[1, 3] = result[3, 1] = c * across_turn
    return result
