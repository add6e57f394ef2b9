"""Eq. M: the completed map is the fixed point of the paper's neighbour averaging."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.ground.markov import (
    MarkovError,
    complete,
    distance_to_known_m,
    estimated_sigma,
    roughness_m,
    variogram_sigma,
)


def jacobi(elevation, border, tolerance=1e-9, sweeps=200_000):
    """The paper's own way, slowly: unknown cells start lowest and take their neighbours' mean."""
    known = ~np.isnan(elevation)
    lowest = np.nanmin(elevation)
    fixed = known.copy()
    if border == "low":
        fixed[0] = fixed[-1] = True
        fixed[:, 0] = fixed[:, -1] = True
    h = np.where(known, elevation, lowest)
    count = 4.0 * np.ones(h.shape)
    count[0] -= 1
    count[-1] -= 1
    count[:, 0] -= 1
    count[:, -1] -= 1
    for _ in range(sweeps):
        total = np.zeros_like(h)
        total[1:] += h[:-1]
        total[:-1] += h[1:]
        total[:, 1:] += h[:, :-1]
        total[:, :-1] += h[:, 1:]
        new = np.where(fixed, h, total / np.maximum(count, 1))
        moved = np.abs(new - h).max()
        h = new
        if moved < tolerance:
            break
    return h


@st.composite
def maps(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = draw(st.tuples(st.integers(1, 24), st.integers(1, 24)))
    elevation = rng.normal(scale=draw(st.sampled_from([0.1, 10.0])), size=shape)
    elevation += draw(st.sampled_from([0.0, -4470.0, 1e6]))
    unknown = rng.random(shape) < draw(st.sampled_from([0.05, 0.5, 0.95, 1.0]))
    unknown[rng.integers(shape[0]), rng.integers(shape[1])] = False
    return np.where(unknown, np.nan, elevation)


@given(maps(), st.sampled_from(["mirror", "low"]))
@settings(max_examples=60, deadline=None)
def test_the_solution_is_jacobis_fixed_point_and_known_cells_are_untouched(elevation, border):
    got = complete(elevation, border=border, tolerance_m=1e-3)
    known = ~np.isnan(elevation)
    assert np.array_equal(got[known], elevation[known])
    assert np.abs(got - jacobi(elevation, border)).max() <= 1e-3


def test_a_large_map_solved_loosely_is_within_tolerance_of_one_solved_tightly():
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:200, :200] * 0.1
    ground = 2 * np.sin(x / 3) + 3 * np.cos(y / 4)
    seen = (np.hypot(x - 8, y - 9) < 6) & (rng.random(x.shape) < 0.8)
    elevation = np.where(seen, ground, np.nan)
    loose, tight = complete(elevation), complete(elevation, tolerance_m=1e-10)
    total = np.zeros_like(tight)
    inner = tight[1:-1, 1:-1]
    total = tight[:-2, 1:-1] + tight[2:, 1:-1] + tight[1:-1, :-2] + tight[1:-1, 2:]
    residual = (inner - total / 4)[~seen[1:-1, 1:-1]]
    assert np.abs(residual).max() < 1e-9
    assert np.abs(loose - tight).max() < 1e-3


def test_half_a_step_unknown_fills_to_the_known_side_and_low_borders_pull_it_down():
    elevation = np.full((21, 21), np.nan)
    elevation[:, :10] = 5.0
    elevation[10, 3] = 1.0
    assert complete(elevation)[:, 12:] == pytest.approx(5.0, abs=0.1)
    low = complete(elevation, border="low")
    assert low[0, 20] == 1.0
    assert low[10, 20] == 1.0
    assert (np.diff(low[10, 10:]) < 0).all()


def test_a_map_of_which_nothing_is_known_is_refused():
    with pytest.raises(MarkovError, match="at least one known cell"):
        complete(np.full((4, 5), np.nan))
    with pytest.raises(MarkovError, match="finite"):
        complete(np.array([[1.0, np.inf], [np.nan, 2.0]]))


def test_distance_is_euclidean_between_centres():
    known = np.zeros((30, 40), dtype=bool)
    known[3, 4] = known[20, 33] = True
    y, x = np.mgrid[:30, :40]
    squares = np.minimum((y - 3) ** 2 + (x - 4) ** 2, (y - 20) ** 2 + (x - 33) ** 2)
    # To the last bit: OpenCV's own roots change with the place of the array in memory.
    assert np.array_equal(distance_to_known_m(known, 0.1), 0.1 * np.sqrt(squares))
    assert np.isinf(distance_to_known_m(np.zeros((3, 3), dtype=bool), 0.1)).all()


def test_sigma_grows_with_distance_by_the_stated_law_up_to_its_ceiling():
    got = estimated_sigma(np.array([0.0, 1.0, 2.0, np.inf]), sigma_at_1m=0.25)
    assert got == pytest.approx([0.0, 0.25, 0.25 * 2**0.8, 1.0])


def test_roughness_is_measured_one_metre_apart_and_guessed_where_little_is_known():
    rng = np.random.default_rng(1)
    white = rng.normal(scale=0.2, size=(80, 80))
    assert roughness_m(white, 0.1) == pytest.approx(0.2 * np.sqrt(2), rel=0.05)
    assert roughness_m(np.full((80, 80), np.nan), 0.1) == 0.25


def test_the_variogram_is_that_of_a_known_law():
    slope = np.add.outer(np.arange(64.0), np.arange(64.0))
    sigma = variogram_sigma(slope, np.array([[0.0, 1.0, 3.0, 16.0, 99.0]]))[0]
    assert sigma == pytest.approx([0.0, 1.0, 3.0, 16.0, 16.0])
    rng = np.random.default_rng(2)
    white = np.where(rng.random((90, 90)) < 0.3, np.nan, rng.normal(scale=2.0, size=(90, 90)))
    level = variogram_sigma(white, np.array([[1.0, 5.0, 20.0]]))[0]
    assert level == pytest.approx(2.0 * np.sqrt(2), rel=0.05)


def test_where_next_to_nothing_is_known_the_variogram_is_a_guess():
    nothing = np.full((40, 40), np.nan)
    nothing[3, 3:9] = 1.0
    got = variogram_sigma(nothing, np.array([[0.0, 1.0, np.inf]]))
    assert got.tolist() == [[0.0, 0.25, 0.25]]
