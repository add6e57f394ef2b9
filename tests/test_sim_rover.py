import asyncio
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim_helpers import ground, run

from agents.geometry import Pose, wrap_angle
from agents.ports import Odometry
from agents.settings import DriveSettings
from sim.drift import draw_leg, measure
from sim.ground import Terrain
from sim.motion import Motions, Segment
from sim.rover import RoverBody

SURE = DriveSettings(
    slip_sigma=0.0,
    slip_bias_sigma=0.0,
    odometry_sigma=0.0,
    yaw_sigma_deg_per_m=0.0,
    yaw_sigma_deg_per_turn=0.0,
)
FLAT = ground(lambda x, y: 0.0)
CLIFF = ground(lambda x, y: np.minimum(0.0, np.maximum(-8.0, -1.19 * (x - 6))))
"""A plateau, from x = 6 m a face of 50 deg down to -8 m at x = 12.7 m."""
NORTH = math.pi / 2


def rover(
    terrain: Terrain, start: Pose, drive: DriveSettings = SURE, seed: int = 0
) -> tuple[RoverBody, list[Segment]]:
    told: list[Segment] = []
    body = RoverBody("r", terrain, drive, start, told.append, np.random.default_rng(seed))
    return body, told


def test_an_order_is_carried_out_in_its_time_and_told_as_segments() -> None:
    body, told = rover(FLAT, Pose(5.0, 5.0, 0.0, 0.0))

    async def go() -> tuple[Odometry, float]:
        odometry = await body.drive(NORTH, 3.0)
        return odometry, asyncio.get_running_loop().time()

    odometry, t_s = run(go())
    assert t_s == pytest.approx(NORTH / SURE.turn_rate_radps + 3.0 / SURE.speed_mps, rel=1e-3)
    assert (odometry.forward_m, odometry.left_m) == pytest.approx((0.0, 3.0), abs=1e-9)
    assert odometry.turn_rad == pytest.approx(NORTH)
    assert odometry.halted == ""
    end = body.pose_at(10**15)
    assert (end.x_m, end.y_m) == pytest.approx((5.0, 8.0), abs=0.02)
    motions = Motions()
    for segment in told:
        motions.add(segment)
    assert motions.pose_at("r", 0) == Pose(5.0, 5.0, 0.0, 0.0)
    assert motions.pose_at("r", 10**15) == end
    for a, b in itertools.pairwise(told):
        assert b.start_ns == a.end_ns
        assert b.start.distance_m(a.end) < 0.02
        assert math.hypot(b.end.x_m - b.start.x_m, b.end.y_m - b.start.y_m) < 0.45


def test_backwards_and_more_than_half_a_turn() -> None:
    body, _ = rover(FLAT, Pose(10.0, 10.0, 0.0, 0.0))
    odometry = run(body.drive(1.5 * math.pi, -2.0))
    assert odometry.turn_rad == pytest.approx(-NORTH)
    assert odometry.left_m == pytest.approx(2.0)
    end = body.pose_at(10**15)
    assert (end.x_m, end.y_m) == pytest.approx((10.0, 12.0), abs=0.02)
    assert end.yaw_rad == pytest.approx(-NORTH, abs=0.01)


def test_nothing_ordered_moves_nothing_far() -> None:
    body, _ = rover(FLAT, Pose(5.0, 5.0, 0.0, 0.0), DriveSettings())
    odometry = run(body.drive(0.0, 0.0))
    assert odometry.forward_m == 0.0
    assert np.linalg.eigvalsh(odometry.covariance).min() > 0
    assert body.pose_at(10**15).distance_m(Pose(5.0, 5.0, 0.0, 0.0)) < 0.02


@given(turn=st.floats(-3.0, 3.0), forward=st.floats(-5.0, 5.0), share=st.floats(0.1, 1.0))
@settings(max_examples=12, deadline=None)
def test_odometry_is_as_good_as_its_covariance_says(
    turn: float, forward: float, share: float
) -> None:
    drive = DriveSettings()
    generator = np.random.default_rng(5)
    way_m = abs(forward) * share
    start = Pose(0.0, 0.0, 0.0, 0.3)
    nees = []
    for _ in range(300):
        bias = generator.normal(0.0, drive.slip_bias_sigma)
        leg = draw_leg(drive, bias, turn, forward, generator)
        end = leg.pose_after(start, way_m)
        odometry = measure(drive, leg, way_m, 0.0, generator)
        c, s = math.cos(0.3), math.sin(0.3)
        truth = (c * end.x_m + s * end.y_m, c * end.y_m - s * end.x_m)
        error = np.array(
            [
                truth[0] - odometry.forward_m,
                truth[1] - odometry.left_m,
                0.0 - odometry.up_m,
                wrap_angle(end.yaw_rad - 0.3 - odometry.turn_rad),
            ]
        )
        nees.append(error @ np.linalg.solve(odometry.covariance, error))
    assert np.mean(nees) == pytest.approx(4.0, abs=0.8)


def test_whole_drives_over_rolling_ground_are_as_good_as_their_covariance_says() -> None:
    terrain = ground(lambda x, y: 0.4 * np.sin(x / 2) + 0.3 * np.cos(y / 2))
    before = Pose(8.0, 9.0, terrain.height_m(8.0, 9.0), 0.4)
    nees = []
    for seed in range(60):
        body, _ = rover(terrain, before, DriveSettings(max_slope_deg=60.0), seed)
        start = body.pose_at(0)
        got = run(body.drive(0.8, 3.0))
        end = body.pose_at(10**15)
        c, s = math.cos(0.4), math.sin(0.4)
        dx, dy = end.x_m - start.x_m, end.y_m - start.y_m
        error = np.array(
            [
                c * dx + s * dy - got.forward_m,
                c * dy - s * dx - got.left_m,
                end.z_m - start.z_m - got.up_m,
                wrap_angle(end.yaw_rad - start.yaw_rad - got.turn_rad),
            ]
        )
        nees.append(error @ np.linalg.solve(got.covariance, error))
    assert 3.0 < np.mean(nees) < 5.2


def test_the_body_stands_on_the_ground_that_its_footprint_covers() -> None:
    terrain = ground(lambda x, y: 0.2 * x)
    body, _ = rover(terrain, Pose(5.0, 5.0, 99.0, 0.0))
    assert body.pose_at(0).z_m == pytest.approx(1.0, abs=1e-3)
    run(body.drive(0.0, 4.0))
    assert body.pose_at(10**15).z_m == pytest.approx(1.8, abs=0.01)


def test_an_untethered_rover_halts_before_the_cliff_and_can_back_off() -> None:
    body, _ = rover(CLIFF, Pose(3.0, 10.0, 0.0, 0.0))
    odometry = run(body.drive(0.0, 8.0))
    assert odometry.halted == "too steep"
    halted = body.pose_at(10**15)
    assert 5.0 < halted.x_m < 6.2
    assert odometry.forward_m == pytest.approx(halted.x_m - 3.0, abs=0.02)
    body, _ = rover(CLIFF, Pose(6.1, 10.0, 0.0, math.pi))  # put down too far over the lip
    assert run(body.drive(0.0, 2.0)).halted == ""
    assert body.pose_at(10**15).x_m == pytest.approx(4.1, abs=0.02)


def test_a_rover_halts_at_the_windows_border() -> None:
    body, _ = rover(FLAT, Pose(18.0, 10.0, 0.0, 0.0))
    assert run(body.drive(0.0, 5.0)).halted == "window's border"
    assert 19.3 < body.pose_at(10**15).x_m < 19.65


def test_a_cancelled_drive_stops_the_robot_where_it_is() -> None:
    body, told = rover(FLAT, Pose(5.0, 5.0, 0.0, 0.0))

    async def cut_short() -> None:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(10.0):
                await body.drive(0.0, 5.0)

    run(cut_short())
    assert told[-1].note == "halt"
    assert body.pose_at(10**15).x_m == pytest.approx(5.6, abs=0.02)


def test_each_rock_that_is_met_counts_once() -> None:
    def rocks(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        z = 0.0 * x
        for centre in (6.0, 9.0):
            z += 0.2 * (np.hypot(x - centre, y - 10) < 0.2)
        return z

    body, _ = rover(ground(rocks), Pose(4.0, 10.0, 0.0, 0.0), DriveSettings(max_slope_deg=60.0))
    run(body.drive(0.0, 6.5))
    assert body.hazards_hit == 2
    aside, _ = rover(ground(rocks), Pose(4.0, 12.0, 0.0, 0.0))
    run(aside.drive(0.0, 6.5))
    assert aside.hazards_hit == 0
