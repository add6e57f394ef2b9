"""A fix belongs to the place where the robot stood when it was seen, however late it comes."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_agents_fusion import drive

from agents.geometry import Pose
from agents.ports import Odometry
from agents.pose.posefilter import PoseFilter
from agents.pose.stops import MOST, Stops

FIX = np.diag([0.02, 0.02, 0.02, 0.01]) ** 2
EAST = Odometry(0.25, 0.0, 0.0, 0.0, np.diag([0.02, 0.005, 0.01, 0.005]) ** 2)


def begun() -> PoseFilter:
    return PoseFilter(Pose(0.0, 0.0, 0.0, 0.0), np.diag([0.05, 0.05, 0.05, 0.02]) ** 2)


def test_a_fix_of_a_former_stop_does_not_draw_the_robot_back_to_it() -> None:
    way, stops = begun(), Stops()
    stops.leave(way, 0.0, 10.0)
    way.predict(EAST)
    stop = stops.at(9.0)
    assert stop is not None
    way.fix_former(stop, Pose(0.0, 0.0, 0.0, 0.0), FIX)
    assert way.pose.x_m == pytest.approx(0.25, abs=1e-9)
    assert way.sigma_m < 0.03


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_late_or_at_once_a_fix_tells_the_same(seed: int) -> None:
    """On a straight way all is linear: the order of fix and drive does not matter."""
    rng = np.random.default_rng(seed)
    seen = Pose(*(float(v) for v in rng.normal(0.0, 0.03, 3)), 0.0)
    at_once, late, stops = begun(), begun(), Stops()
    at_once.fix(seen, FIX)
    at_once.predict(EAST)
    stops.leave(late, 0.0, 10.0)
    late.predict(EAST)
    stop = stops.at(5.0)
    assert stop is not None
    late.fix_former(stop, seen, FIX)
    assert late.pose.distance_m(at_once.pose) < 1e-3
    assert np.allclose(late.covariance, at_once.covariance, atol=1e-5)


def test_what_was_seen_while_it_drove_belongs_to_no_stop() -> None:
    way, stops = begun(), Stops()
    for since_s, until_s in ((0.0, 10.0), (14.0, 20.0)):
        stops.leave(way, since_s, until_s)
        way.predict(EAST)
    assert stops.at(12.0) is None
    assert stops.at(22.0) is None
    first, second = stops.at(3.0), stops.at(15.0)
    assert first is not None
    assert second is not None
    assert way.pose_of(second).x_m - way.pose_of(first).x_m == pytest.approx(0.25)


def test_the_oldest_stops_are_forgotten() -> None:
    rng, way, stops, truth = np.random.default_rng(1), begun(), Stops(), Pose(0.0, 0.0, 0.0, 0.0)
    for k in range(3 * MOST):
        stops.leave(way, 10.0 * k, 10.0 * k + 5.0)
        truth = drive(rng, way, truth)
    assert stops.at(10.0 * 2 * MOST - 9.0) is None
    assert stops.at(10.0 * (3 * MOST - 1) + 1.0) is not None
    assert math.isfinite(way.sigma_m)
