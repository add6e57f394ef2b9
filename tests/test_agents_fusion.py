"""Eqs. 14-16 and 19-21: filters tell the truth about their own error, merges obey their laws."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.fusion import FusionError, Gaussian, ekf_update, merge, rotate_covariance
from agents.geometry import Pose
from agents.ports import Odometry, Sighting
from agents.pose.posefilter import PoseFilter

seeds = st.integers(0, 2**32 - 1)


def spd(rng, n):
    a = rng.normal(size=(n, n))
    return a @ a.T + 0.1 * np.eye(n)


def some(rng, n=3):
    return Gaussian(rng.normal(size=n), spd(rng, n))


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_merging_is_commutative_associative_and_adds_information(seed):
    rng = np.random.default_rng(seed)
    a, b, c = some(rng), some(rng), some(rng)
    ab, ba = merge(a, b), merge(b, a)
    assert ab.mean == pytest.approx(ba.mean)
    assert ab.covariance == pytest.approx(ba.covariance)
    one, other = merge(ab, c), merge(a, merge(b, c))
    assert one.mean == pytest.approx(other.mean)
    assert one.covariance == pytest.approx(other.covariance)
    inverse = np.linalg.inv
    added = inverse(a.covariance) + inverse(b.covariance)
    assert inverse(ab.covariance) == pytest.approx(added, rel=1e-6, abs=1e-6)


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_an_update_with_a_whole_measurement_is_a_merge(seed):
    rng = np.random.default_rng(seed)
    a, z = some(rng), some(rng)
    got, nis = ekf_update(a, z.mean - a.mean, np.eye(3), z.covariance)
    want = merge(a, z)
    assert got.mean == pytest.approx(want.mean)
    assert got.covariance == pytest.approx(want.covariance)
    assert nis >= 0


def test_the_covariance_stays_symmetric_and_positive_within_rounding():
    state = Gaussian(np.zeros(2), np.diag([1e4, 1e4]))
    h = np.array([[1.0, 1.0 + 1e-9]])
    for _ in range(50):
        state, _ = ekf_update(state, np.zeros(1), h, np.array([[1e-6]]))
        least, most = np.linalg.eigvalsh(state.covariance)
        assert least >= -1e-15 * most
        assert np.array_equal(state.covariance, state.covariance.T)


def test_a_scalar_update_by_hand():
    state, nis = ekf_update(
        Gaussian(np.array([1.0]), np.array([[4.0]])),
        np.array([2.0]),
        np.array([[1.0]]),
        np.array([[4.0]]),
    )
    assert state.mean == pytest.approx([2.0])
    assert state.covariance == pytest.approx(2.0)
    assert nis == pytest.approx(0.5)


def test_covariances_turn_with_their_frame():
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    assert rotate_covariance(np.diag([4.0, 1.0]), quarter) == pytest.approx(np.diag([1.0, 4.0]))


STEP = np.diag([0.02, 0.01, 0.01, 0.02]) ** 2
START = Pose(1.0, -2.0, 0.5, 3.0)


def drive(rng, filt, truth):
    forward, turn = rng.uniform(0, 1), rng.uniform(-1, 1)
    error = rng.multivariate_normal(np.zeros(4), STEP)
    truth = truth.moved(forward, 0.0, 0.0, turn)
    filt.predict(Odometry(forward + error[0], error[1], error[2], turn + error[3], STEP))
    return truth


def error_of(filt, truth):
    d = filt.pose
    apart = np.array([d.x_m - truth.x_m, d.y_m - truth.y_m, d.z_m - truth.z_m, 0.0])
    apart[3] = math.remainder(d.yaw_rad - truth.yaw_rad, 2 * math.pi)
    return apart


def sighting(rng, eye, mate, covariance):
    c, s = math.cos(eye.yaw_rad), math.sin(eye.yaw_rad)
    dx, dy = mate.x_m - eye.x_m, mate.y_m - eye.y_m
    error = rng.multivariate_normal(np.zeros(4), covariance)
    offset = (
        c * dx + s * dy + error[0],
        -s * dx + c * dy + error[1],
        mate.z_m - eye.z_m + error[2],
    )
    turn = math.remainder(mate.yaw_rad - eye.yaw_rad + error[3], 2 * math.pi)
    return Sighting("m", offset, turn, covariance)


@pytest.mark.parametrize("kind", ["none", "fix", "saw", "seen_by", "range"])
def test_the_filter_is_as_wrong_as_it_says(kind):
    """NEES has mean 4 over many runs: 99.9 % bounds for 200 runs of 4 degrees of freedom."""
    runs, nees = 200, 0.0
    seen = np.diag([0.03, 0.03, 0.02, 0.03]) ** 2
    for k in range(runs):
        rng = np.random.default_rng(k)
        filt, truth = PoseFilter(START, np.eye(4) * 1e-8), START
        for _ in range(6):
            truth = drive(rng, filt, truth)
        mate = Pose(2.0, 0.0, 0.3, 1.0)
        if kind == "fix":
            e = rng.multivariate_normal(np.zeros(4), seen)
            measured = Pose(
                truth.x_m + e[0], truth.y_m + e[1], truth.z_m + e[2], truth.yaw_rad + e[3]
            )
            filt.fix(measured, seen)
        elif kind == "saw":
            filt.saw(mate, np.eye(4) * 1e-8, sighting(rng, truth, mate, seen))
        elif kind == "seen_by":
            filt.seen_by(mate, np.eye(4) * 1e-8, sighting(rng, mate, truth, seen))
        elif kind == "range":
            length = math.dist((truth.x_m, truth.y_m, truth.z_m), (5, 5, 5)) + rng.normal(0, 0.02)
            filt.range_fix((5.0, 5.0, 5.0), length, 0.02)
        e = error_of(filt, truth)
        nees += float(e @ np.linalg.solve(filt.covariance, e)) / runs
    assert 3.3 < nees < 4.8


def test_a_yaw_measured_across_the_cut_pulls_the_short_way():
    filt = PoseFilter(Pose(0, 0, 0, 3.1), np.eye(4) * 0.01)
    filt.fix(Pose(0, 0, 0, -3.1), np.eye(4) * 0.01)
    assert abs(filt.pose.yaw_rad) == pytest.approx(math.pi, abs=1e-9)


def test_what_the_gate_refuses_changes_nothing():
    filt = PoseFilter(START, np.eye(4) * 1e-4)
    before = filt.covariance
    assert filt.fix(Pose(50, 0, 0, 0), np.eye(4) * 1e-4, gate=25.0) > 25
    assert filt.pose == START
    assert np.array_equal(filt.covariance, before)


def test_a_range_tightens_only_along_its_direction():
    filt = PoseFilter(Pose(3.0, 0.0, 0.0, 0.0), np.diag([1.0, 1.0, 1.0, 0.1]))
    filt.range_fix((0.0, 0.0, 0.0), 3.5, 0.01)
    assert filt.pose.x_m == pytest.approx(3.5, abs=1e-3)
    assert np.diag(filt.covariance) == pytest.approx([1e-4, 1.0, 1.0, 0.1], rel=1e-3)
    assert filt.sigma_m == pytest.approx(1.0)


def test_bad_input_is_named():
    with pytest.raises(FusionError, match="4 x 4"):
        PoseFilter(START, np.eye(3))
    with pytest.raises(FusionError, match="not negative"):
        PoseFilter(START, -np.eye(4))
    filt = PoseFilter(START, np.eye(4))
    with pytest.raises(FusionError, match="says nothing"):
        filt.range_fix((START.x_m, START.y_m, START.z_m), 1.0, 0.1)
    with pytest.raises(FusionError, match="sigma"):
        filt.range_fix((0.0, 0.0, 0.0), 1.0, 0.0)
    with pytest.raises(FusionError, match="can't be merged"):
        merge(Gaussian(np.zeros(1), np.zeros((1, 1))), Gaussian(np.zeros(1), np.zeros((1, 1))))
