import asyncio
import math

import numpy as np
import pytest
from sim_helpers import ground, run

from agents.geometry import Pose
from agents.ports import Odometry
from agents.settings import DriveSettings
from sim.tethered import TetheredBody

SURE = DriveSettings(
    slip_sigma=0.0,
    slip_bias_sigma=0.0,
    odometry_sigma=0.0,
    yaw_sigma_deg_per_m=0.0,
    yaw_sigma_deg_per_turn=0.0,
)
CLIFF = ground(lambda x, y: np.minimum(0.0, np.maximum(-8.0, -1.19 * (x - 6))))
"""A plateau, from x = 6 m a face of 50 deg down to -8 m at x = 12.7 m."""


class Tethers:
    """Anchors on the plateau whose tethers run out by a schedule of (time in s, length in m)."""

    def __init__(self, *anchors: tuple[Pose, list[tuple[float, float]]]) -> None:
        self.anchors = anchors

    def __call__(self, t_ns: int) -> list[tuple[Pose, float]]:
        return [
            (pose, [length for t_s, length in plan if t_s * 1e9 <= t_ns][-1])
            for pose, plan in self.anchors
        ]


LEFT, RIGHT = Pose(4.0, 12.0, 0.0, 0.0), Pose(4.0, 8.0, 0.0, 0.0)


def climber(tethers: Tethers, x_m: float = 5.0) -> TetheredBody:
    return TetheredBody(
        "c",
        CLIFF,
        SURE,
        Pose(x_m, 10.0, 0.0, 0.0),
        lambda segment: None,
        np.random.default_rng(0),
        tethers=tethers,
    )


def down(body: TetheredBody, forward_m: float) -> tuple[Odometry, Pose, float]:
    async def go() -> tuple[Odometry, float]:
        return await body.drive(0.0, forward_m), asyncio.get_running_loop().time()

    odometry, t_s = run(go())
    return odometry, body.pose_at(10**15), t_s


def reach(anchor: Pose, robot: Pose) -> float:
    return math.dist((anchor.x_m, anchor.y_m, anchor.z_m), (robot.x_m, robot.y_m, robot.z_m))


def test_on_tethers_it_goes_down_where_no_rover_would() -> None:
    plan = [(0.0, 2.5), *((20.0 + k, 2.5 + 0.04 * k) for k in range(400))]
    odometry, end, _ = down(climber(Tethers((LEFT, plan), (RIGHT, plan))), 5.0)
    assert odometry.halted == ""
    assert end.x_m == pytest.approx(10.0, abs=0.05)
    assert end.z_m < -4.0


def test_the_shorter_tether_holds_it_and_the_order_is_given_up_after_20_s() -> None:
    body = climber(Tethers((LEFT, [(0.0, 20.0)]), (RIGHT, [(0.0, 3.1)])))
    odometry, end, t_s = down(body, 5.0)
    assert odometry.halted == "tether taut"
    assert 2.85 < reach(RIGHT, end) <= 3.15 + 1e-9
    assert t_s > 20.0
    # upwards is always allowed, and the covariance knows how far it got
    back, up, _ = down(body, -1.0)
    assert back.halted == ""
    assert up.x_m < end.x_m - 0.9
    assert odometry.forward_m == pytest.approx(end.x_m - 5.0, abs=0.02)


def test_a_tether_that_is_paid_out_in_time_lets_it_go_on() -> None:
    plan = [(0.0, 3.0), *((35.0 + k, 3.0 + 0.04 * k) for k in range(99))]
    odometry, end, t_s = down(climber(Tethers((LEFT, plan), (RIGHT, [(0.0, 9.0)]))), 3.0)
    assert odometry.halted == ""
    assert end.x_m == pytest.approx(8.0, abs=0.05)
    assert 35.0 + (reach(LEFT, end) - 3.0) / 0.04 - 3 < t_s < 130.0


def test_with_slack_tethers_on_the_face_it_slides_until_one_holds() -> None:
    body = climber(Tethers((LEFT, [(0.0, 6.0)]), (RIGHT, [(0.0, 7.0)])))
    odometry, end, _ = down(body, 4.0)
    assert odometry.halted == "slid"
    assert 5.7 < reach(LEFT, end) <= 6.0
    driven = odometry.forward_m
    assert driven == pytest.approx(end.x_m - 5.0, abs=6 * math.sqrt(odometry.covariance[0, 0]))
    assert odometry.covariance[0, 0] > 0.01


def test_without_tethers_it_is_a_rover_and_falls_if_put_on_the_face() -> None:
    odometry, end, _ = down(climber(Tethers()), 5.0)
    assert odometry.halted == "too steep"
    assert end.x_m < 6.2
    fallen, at, _ = down(climber(Tethers(), x_m=8.0), 1.0)
    assert fallen.halted == "slid"
    assert at.z_m < -7.0
