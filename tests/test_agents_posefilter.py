"""One filter holds the whole way: what is learnt of its end is learnt of every place on it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_agents_fusion import STEP, drive, sighting

from agents.fusion import compose, offset_between, pose_numbers, stand_of_seer
from agents.geometry import Pose
from agents.ports import Odometry
from agents.pose.posefilter import MOST_REMEMBERED, PoseFilter, Remembered

seeds = st.integers(0, 2**32 - 1)
quick = settings(max_examples=30, deadline=None)
SEEN = np.diag([0.03, 0.03, 0.02, 0.03]) ** 2
SURE = np.eye(4) * 1e-10
START = Pose(1.0, -2.0, 0.5, 3.0)
MATE = Pose(2.0, 0.0, 0.3, 1.0)
RUNS = 200
BAND = (3.3, 4.8)
"""99.9 % of the means of 200 values of chi-squared with 4 degrees of freedom."""


def submap(index):
    return Remembered("submap", index)


def apart(pose, truth):
    error = pose_numbers(pose) - pose_numbers(truth)
    error[3] = math.remainder(error[3], 2 * math.pi)
    return error


def nees(mean, covariance, truth):
    x, y, z, yaw = mean
    error = apart(Pose(x, y, z, yaw), truth)
    return float(error @ np.linalg.solve(covariance, error))


def way(rng, filt, truth, legs=3, steps=3):
    """Drive, remembering the start of each leg; return where the robot truly was there."""
    been = []
    for leg in range(legs):
        filt.remember(submap(leg))
        been.append(truth)
        for _ in range(steps):
            truth = drive(rng, filt, truth)
    return been, truth


def test_a_fix_at_the_end_of_a_straight_way_moves_each_stop_by_its_share_of_the_error():
    """By hand: after 1, 2 and 3 equal steps a fix by 0.3 m moves the stops by 0.1, 0.2, 0.3 m."""
    filt = PoseFilter(Pose(0, 0, 0, 0), np.zeros((4, 4)))
    noise = np.diag([0.01, 1e-12, 1e-12, 1e-18])
    for stop in range(3):
        filt.predict(Odometry(1.0, 0.0, 0.0, 0.0, noise))
        filt.remember(submap(stop))
    filt.fix(Pose(3.3, 0, 0, 0), np.diag([1e-9, 1, 1, 1]))
    found = [filt.pose_of(submap(stop)).x_m for stop in range(3)]
    assert found == pytest.approx([1.1, 2.2, 3.3], abs=1e-4)
    # Between two known ends, what is left of the variance at k of 3 steps is k (3 - k) / 3 steps'.
    left = [filt.remembered(submap(stop)).covariance[0, 0] for stop in range(3)]
    assert left == pytest.approx([0.01 * 2 / 3, 0.01 * 2 / 3, 0.0], abs=1e-5)


def test_all_poses_of_the_way_are_as_wrong_as_the_filter_says_after_a_landmark():
    before, after, of_anchor, of_pose = 0.0, 0.0, 0.0, 0.0
    for k in range(RUNS):
        rng = np.random.default_rng(k)
        filt = PoseFilter(START, SURE)
        been, truth = way(rng, filt, START)
        middle = filt.remembered(submap(2))
        before += float(np.sum(apart(filt.pose_of(submap(2)), been[2])[:2] ** 2))
        filt.saw(MATE, SURE, sighting(rng, truth, MATE, SEEN))
        now = filt.remembered(submap(2))
        after += float(np.sum(apart(filt.pose_of(submap(2)), been[2])[:2] ** 2))
        assert np.trace(now.covariance) < np.trace(middle.covariance)
        of_anchor += nees(now.mean, now.covariance, been[2]) / RUNS
        of_pose += nees(pose_numbers(filt.pose), filt.covariance, truth) / RUNS
    assert BAND[0] < of_anchor < BAND[1]
    assert BAND[0] < of_pose < BAND[1]
    assert after < 0.8 * before, "a landmark at the end also tells of the middle"


@pytest.mark.parametrize("kind", ["introduced", "dependent"])
def test_what_a_mate_is_wrong_by_counts_once_however_often_it_is_seen(kind):
    unsure = np.diag([0.05, 0.05, 0.05, 0.05]) ** 2
    mean = 0.0
    for k in range(RUNS):
        rng = np.random.default_rng(k)
        filt = PoseFilter(START, SURE)
        _, truth = way(rng, filt, START)
        error = rng.multivariate_normal(np.zeros(4), unsure)
        said = Pose(*(pose_numbers(MATE) + error))
        name = Remembered("mate", 1)
        if kind == "introduced":
            filt.introduce(name, said, unsure)
        for _ in range(6):
            seen = sighting(rng, truth, MATE, SEEN)
            if kind == "introduced":
                filt.saw_again(name, seen)
            else:
                filt.saw_dependent(said, unsure, seen)
        mean += nees(pose_numbers(filt.pose), filt.covariance, truth) / RUNS
    if kind == "introduced":
        assert BAND[0] < mean < BAND[1]
    else:
        assert mean < BAND[1], "a bound may be too careful, but not too sure"


def test_two_robots_that_fix_each_other_in_turn_grow_sure_of_nothing():
    unsure = np.diag([0.2, 0.2, 0.2, 0.1]) ** 2
    robots = [PoseFilter(START, unsure), PoseFilter(MATE, unsure)]
    exact, back = (
        sighting(np.random.default_rng(0), *pair, np.eye(4) * 1e-12)
        for pair in ((START, MATE), (MATE, START))
    )
    together = PoseFilter(START, unsure)
    together.introduce(Remembered("mate", 1), MATE, unsure)
    together.saw_again(Remembered("mate", 1), exact)
    for _ in range(30):
        robots[0].saw_dependent(robots[1].pose, robots[1].covariance, exact)
        robots[1].saw_dependent(robots[0].pose, robots[0].covariance, back)
    # All that was ever known is two starts and one offset, and that is in `together`.
    surer = np.linalg.eigvalsh(robots[0].covariance - together.covariance)
    assert surer[0] > -1e-6
    naive = PoseFilter(START, unsure)
    for _ in range(30):
        naive.saw(MATE, unsure, exact)
    assert np.linalg.eigvalsh(naive.covariance - together.covariance)[0] < -1e-3


@given(seeds)
@quick
def test_what_fits_the_own_map_says_nothing_of_where_the_map_is(seed):
    rng = np.random.default_rng(seed)
    filt = PoseFilter(START, np.eye(4) * 0.04)
    way(rng, filt, START, legs=1)
    anchor, pose = filt.remembered(submap(0)), filt.covariance
    offset = filt.from_remembered(submap(0)).mean + rng.normal(0, 0.01, 4)
    filt.fix_against(submap(0), offset, np.eye(4) * 1e-6)
    now = filt.remembered(submap(0))
    assert now.mean == pytest.approx(anchor.mean, abs=1e-9)
    assert now.covariance == pytest.approx(anchor.covariance, abs=1e-9)
    assert np.trace(filt.covariance) < np.trace(pose)
    assert filt.from_remembered(submap(0)).mean == pytest.approx(offset, abs=0.002)


@given(seeds)
@quick
def test_to_be_located_carries_the_whole_way_along_in_one_piece(seed):
    rng = np.random.default_rng(seed)
    filt = PoseFilter(Pose(0, 0, 0, 0), SURE)
    way(rng, filt, Pose(0, 0, 0, 0))
    before = [filt.from_remembered(submap(k)) for k in range(3)]
    there = Pose(*rng.normal(0, 20, 3), rng.uniform(-3, 3))
    own = rng.normal(0, 0.1, (4, 4))
    filt.settle(there, own @ own.T)
    assert pose_numbers(filt.pose) == pytest.approx(pose_numbers(there))
    assert filt.covariance == pytest.approx(own @ own.T)
    for k in range(3):
        now = filt.from_remembered(submap(k))
        assert now.mean[:3] == pytest.approx(before[k].mean[:3], abs=1e-6)
        assert math.remainder(now.mean[3] - before[k].mean[3], 2 * math.pi) == pytest.approx(0)
        assert now.covariance == pytest.approx(before[k].covariance, abs=1e-6)


def test_a_lost_robot_that_sees_a_landmark_is_as_wrong_as_it_says_then_and_there_before():
    of_pose, of_anchor = 0.0, 0.0
    unsure = np.diag([0.02, 0.03, 0.02, 0.01]) ** 2
    for k in range(RUNS):
        rng = np.random.default_rng(k)
        filt = PoseFilter(Pose(0, 0, 0, 0), SURE)
        been, truth = way(rng, filt, START)
        said = Pose(*(pose_numbers(MATE) + rng.multivariate_normal(np.zeros(4), unsure)))
        filt.settle(*stand_of_seer(said, unsure, sighting(rng, truth, MATE, SEEN)))
        of_pose += nees(pose_numbers(filt.pose), filt.covariance, truth) / RUNS
        first = filt.remembered(submap(0))
        of_anchor += nees(first.mean, first.covariance, been[0]) / RUNS
    assert BAND[0] < of_pose < BAND[1]
    assert BAND[0] < of_anchor < BAND[1]


@given(seeds)
@settings(max_examples=3, deadline=None)
def test_the_covariance_stays_a_covariance_and_the_past_is_bounded(seed):
    rng = np.random.default_rng(seed)
    filt, truth = PoseFilter(START, SURE), START
    filt.introduce(Remembered("mate", 0), MATE, STEP)
    for k in range(MOST_REMEMBERED + 4):
        filt.remember(submap(k))
        truth = drive(rng, filt, truth)
        if k % 13 == 0:
            filt.saw_again(Remembered("mate", 0), sighting(rng, truth, MATE, SEEN))
    state = filt._state.covariance
    assert state.shape == (4 * (MOST_REMEMBERED + 1),) * 2
    assert np.array_equal(state, state.T)
    assert np.linalg.eigvalsh(state)[0] > -1e-12
    assert filt.holds(Remembered("mate", 0)), "who is let go would be taken for somebody new"
    assert not filt.holds(submap(3))


@given(seeds)
@quick
def test_an_offset_leads_back_to_the_pose_and_its_jacobians_are_its_slopes(seed):
    rng = np.random.default_rng(seed)
    base, other = (Pose(*rng.normal(0, 3, 3), rng.uniform(-3, 3)) for _ in range(2))
    offset, to_base, to_other = offset_between(base, other)
    back, _ = compose(base, SURE, tuple(offset), SURE)
    assert pose_numbers(back) == pytest.approx(pose_numbers(other))
    for axis in range(4):
        step = np.zeros(4)
        step[axis] = 1e-6
        moved = offset_between(Pose(*(pose_numbers(base) + step)), other)[0] - offset
        assert moved / 1e-6 == pytest.approx(to_base[:, axis], abs=1e-4)
        moved = offset_between(base, Pose(*(pose_numbers(other) + step)))[0] - offset
        assert moved / 1e-6 == pytest.approx(to_other[:, axis], abs=1e-4)


@pytest.mark.parametrize("learns", [False, True])
def test_what_slips_on_every_leg_alike_grows_with_the_way_and_can_be_learnt(learns):
    mean, found = 0.0, 0.0
    for k in range(RUNS):
        rng = np.random.default_rng(k)
        slip = rng.normal(0, 0.05)
        filt, truth = PoseFilter(START, SURE), START
        filt.doubt_slip(0.05)
        filt.remember(submap(0))
        for _ in range(10):
            error = rng.multivariate_normal(np.zeros(4), STEP / 4)
            truth = truth.moved(1.0 - slip + error[0], error[1], error[2], error[3])
            filt.predict(Odometry(1.0, 0.0, 0.0, 0.0, STEP / 4))
        if learns:
            filt.fix(truth, SURE)
            slipped = filt.remembered(Remembered("slip", 0))
            found += (slipped.mean[0] - slip) ** 2 / slipped.covariance[0, 0] / RUNS
            filt.predict(Odometry(5.0, 0.0, 0.0, 0.0, STEP))
            error = rng.multivariate_normal(np.zeros(4), STEP)
            truth = truth.moved(5.0 * (1.0 - slip) + error[0], error[1], error[2], error[3])
        mean += nees(pose_numbers(filt.pose), filt.covariance, truth) / RUNS
    assert BAND[0] < mean < BAND[1]
    assert not learns or 0.7 < found < 1.4
