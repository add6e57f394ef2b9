"""Eqs. 1-3 and 6-9 against hand-worked values, limits and laws."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.planning import information as info
from agents.planning.rating import RatingError, configuration_distance, rate
from agents.settings import PlannerSettings

shares = st.floats(0, 1, allow_nan=False)


def test_a_constant_has_no_bits_and_n_equal_values_have_log2_n():
    assert info.data_entropy(np.full((5, 5), 7)) == 0
    assert info.data_entropy(np.arange(16)) == pytest.approx(4)
    assert info.histogram_entropy([1, 1, 2]) == pytest.approx(1.5)
    with pytest.raises(info.InformationError, match="sum > 0"):
        info.histogram_entropy([0, 0])


def test_a_histogram_sees_no_order():
    rng = np.random.default_rng(0)
    ramp = np.arange(100) // 10
    assert info.data_entropy(ramp) == info.data_entropy(rng.permutation(ramp))


@given(shares)
@settings(max_examples=60, deadline=None)
def test_binary_entropy_is_symmetric_within_0_and_1_and_1_at_a_half(p):
    h = float(info.binary_entropy(p))
    assert 0 <= h <= 1 + 1e-12
    assert h == pytest.approx(float(info.binary_entropy(1 - p)), abs=1e-9)
    assert float(info.binary_entropy(0.5)) == 1
    assert float(info.binary_entropy(0)) == float(info.binary_entropy(1)) == 0


def test_new_information_by_hand():
    got = info.new_information([0, 1, 3, 9, 0, 0], 3, [1.0, 1.0, 1.0, 1.0, 0.0, 0.5])
    quarter = -(0.25 * math.log2(0.25) + 0.75 * math.log2(0.75))
    assert got == pytest.approx([1, 2 / 3, 0, 0, 0, quarter])


@given(st.integers(0, 10), st.integers(1, 5), shares, shares)
@settings(max_examples=60, deadline=None)
def test_new_information_is_never_negative_and_grows_with_visibility(n, n_max, p, q):
    low, high = sorted((p, q))
    a = float(info.new_information(n, n_max, low))
    b = float(info.new_information(n, n_max, high))
    assert 0 <= a <= b + 1e-12 <= 1 + 2e-12


def test_the_paper_metric_is_blind_to_a_wholly_unknown_view_and_the_mended_one_is_not():
    p, none = np.full(100, 0.5), np.zeros(100, dtype=bool)
    assert info.voxel_information(p, none, 100) == 0
    assert info.mean_voxel_entropy(p, 100) == 1
    assert info.voxel_information(p[:50], none[:50], 100) == pytest.approx(0.5)


def test_certain_voxels_weigh_nothing():
    p = np.array([0.0, 1.0, 0.0, 1.0])
    known = np.array([True, True, False, False])
    assert info.voxel_information(p, known, 4) == 0
    assert info.mean_voxel_entropy(p, 4) == 0
    assert info.voxel_entropy(p, known, 4) == pytest.approx(4 * 0.25 * 2)


def test_voxels_of_both_histograms_count_over_the_same_n():
    p = np.array([0.5, 0.5, 0.0])
    known = np.array([True, False, False])
    assert info.voxel_entropy(p, known, 8) == pytest.approx(3 * (1 / 8) * 3)
    assert info.voxel_information(p, known, 8) == pytest.approx(2 * (1 / 8) * 3)
    with pytest.raises(info.InformationError):
        info.voxel_entropy(p, known, 2)


def test_stretching_keeps_the_ends_and_the_middle_and_draws_the_far_ones_in():
    at = info.stretched([0.0, 0.25, 0.5, 0.75, 1.0], 1.0, 2.0)
    assert at == pytest.approx([0, 1 / 6, 0.5, 5 / 6, 1])
    assert info.stretched(0.25, 4.0, 2.0) == pytest.approx(1 / 12)
    assert info.stretched(0.75, 4.0, 2.0) == pytest.approx(1 - 1 / 12)


@given(shares, st.floats(0, 100))
@settings(max_examples=60, deadline=None)
def test_stretched_probabilities_stay_within_0_and_1(p, distance):
    assert 0 <= float(info.stretched(p, distance, 3.0)) <= 1


def test_interest_falls_by_exp_beta_p_and_comes_back_when_measured():
    interest = info.Interest((1, 3), beta=2.0)
    p = np.array([[1.0, 0.25, 1.0]])
    interest.update(p, np.array([[False, False, True]]))
    interest.update(p, np.array([[False, False, False]]))
    assert interest.share[0] == pytest.approx([math.exp(-4), math.exp(-1), math.exp(-2)])
    interest.update(p, np.array([[True, False, False]]))
    assert interest.share[0, 0] == 1
    with pytest.raises(info.InformationError, match="beta"):
        info.Interest((1, 1), beta=-1.0)


def test_configurations_are_as_far_apart_as_eq_22_says_angles_wrapped():
    d = configuration_distance([0, 0, 3.1], [3, 4, -3.1], [1, 1, 0], angles=(2,))
    assert d == pytest.approx(5)
    wrapped = configuration_distance([0.0, 3.1], [0.0, -3.1], [1, 4], angles=(1,))
    assert wrapped == pytest.approx(2 * (2 * math.pi - 6.2))
    with pytest.raises(RatingError, match="weights >= 0"):
        configuration_distance([0], [1], [-1])


def test_the_rating_by_hand():
    planner = PlannerSettings(w_information=1.0, w_distance=0.25, w_localisation=0.1)
    got = rate(
        np.array([100.0, 50.0]),
        np.array([20.0, 0.0]),
        np.array([0.1, 0.0]),
        np.array([0.5, 0.0]),
        best_bits=100.0,
        range_m=10.0,
        cell_m=0.1,
        planner=planner,
    )
    assert got == pytest.approx([(1 - 0.5 - 0.1) * 0.5, 0.5])
    with pytest.raises(RatingError, match="best gain 0"):
        rate(
            np.zeros(1),
            np.zeros(1),
            np.zeros(1),
            np.zeros(1),
            best_bits=0.0,
            range_m=1.0,
            cell_m=0.1,
            planner=planner,
        )
