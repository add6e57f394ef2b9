"""Odds of rocks: by hand, on rocks and ledges made by hand, and laws that they keep."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.geometry import Floats
from agents.ground import rocks
from agents.ground.descent import ROCK
from agents.ground.rocks import LEAST_ODDS, UNKNOWN_ODDS, Shape, rock_odds, shape_of

WHEEL_M, FOOTPRINT_M, CLIMB_M, CELL_M = 0.2, 1.0, 0.15, 0.1


def shape(bump: float, swell: float, height: float, raw: float = 0.0) -> Shape:
    """Return one cell's surroundings, in shares of what is climbed."""
    values = (bump, swell, height, height, raw)
    return Shape(*(np.full((1, 1), CLIMB_M * value) for value in values))


def odds(*args: float, sigma_m: float = 0.0) -> float:
    return float(rock_odds(shape(*args), np.full((1, 1), sigma_m), CLIMB_M)[0, 0])


def odds_of(ground: Floats, sigma_m: float = 0.02) -> Floats:
    measured = shape_of(ground, WHEEL_M, FOOTPRINT_M, CELL_M)
    return rock_odds(measured, np.full(ground.shape, sigma_m), CLIMB_M)


def test_the_odds_by_hand() -> None:
    """The constant, three weights, and six of products: bump 0.3, swell 0.2, height 0.5."""
    bump, swell, height = 0.3, 0.2, math.log(0.5)
    constant, *linear = rocks.LINEAR
    logit = constant + linear[0] * bump + linear[1] * swell + linear[2] * height
    bb, bs, bh, ss, sh, hh = rocks.SQUARE
    logit += bb * bump * bump + bs * bump * swell + bh * bump * height
    logit += ss * swell * swell + sh * swell * height + hh * height * height
    assert odds(0.3, 0.2, 0.5) == pytest.approx(1 / (1 + math.exp(-logit)))


def test_beyond_their_range_measures_tell_nothing_more() -> None:
    assert odds(0.7, 0.0, 0.9) == odds(5.0, 0.0, 0.9)
    assert odds(0.3, 2.0, 0.9) == odds(0.3, 0.9, 0.9)
    assert odds(-1.0, 0.0, 0.01) == odds(0.0, 0.0, 0.05)


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.0, 1.0), st.floats(0.0, 0.5), st.floats(-0.5, 0.8), st.floats(0.0, 2.0),
    st.floats(0.0, 0.4),
)  # fmt: skip
def test_what_bulges_out_more_is_likelier_a_rock(
    bump: float, more: float, swell: float, height: float, sigma_m: float
) -> None:
    few = odds(bump, swell, height, sigma_m=sigma_m)
    assert 0.0 < few <= odds(bump + more, swell, height, sigma_m=sigma_m) < 1.0


def test_what_stands_out_of_its_noise_is_sure_whatever_is_about_it() -> None:
    assert odds(0.0, 0.8, 1.3, sigma_m=0.03) > 0.99
    assert odds(0.0, 0.8, 1.0, sigma_m=0.03) < 0.01
    assert odds(0.0, 0.8, 1.3, sigma_m=0.3) < 0.5, "by more than its noise"


def test_a_single_cell_is_a_rock_only_far_out_of_its_noise() -> None:
    assert odds(0.0, 0.0, 0.3, 1.2, sigma_m=0.04) == 0.5
    assert odds(0.0, 0.0, 0.3, 1.2, sigma_m=0.05) < 0.01
    assert odds(0.0, 0.0, 0.3, 0.9, sigma_m=0.0) < 0.01, "it climbs that"


def test_what_hides_in_noise_rises_with_it() -> None:
    flat = [odds(0.0, 0.0, 0.0, sigma_m=sigma_m) for sigma_m in (0.0, 0.1, 0.2, 0.45, 5.0)]
    assert flat == sorted(flat)
    assert (flat[0], flat[-1]) == (LEAST_ODDS, pytest.approx(LEAST_ODDS + UNKNOWN_ODDS))
    assert flat[1] == pytest.approx(LEAST_ODDS + UNKNOWN_ODDS * (0.1 / 0.45) ** 3)


@settings(max_examples=20, deadline=None)
@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.integers(0, 2**32 - 1))
def test_a_slope_is_no_rock(east: float, north: float, seed: int) -> None:
    """What the surroundings look like does not change where all of the ground is tilted."""
    rough = np.random.default_rng(seed).normal(scale=0.03, size=(60, 60))
    rows, cols = np.indices(rough.shape)
    tilted = rough + CELL_M * (east * cols + north * rows)
    inside = np.s_[22:38, 22:38]
    for level, steep in zip(
        shape_of(rough, WHEEL_M, FOOTPRINT_M, CELL_M),
        shape_of(tilted, WHEEL_M, FOOTPRINT_M, CELL_M),
        strict=True,
    ):
        assert np.abs(level - steep)[inside].max() < 1e-9


@pytest.mark.parametrize("height_m", [0.2, 0.4, 1.0])
@pytest.mark.parametrize("width", [1, 2, 4])
def test_rocks_are_rocks_and_the_ground_beside_them_is_none(height_m: float, width: int) -> None:
    ground = np.zeros((60, 60))
    ground[30 : 30 + width, 30 : 30 + width] = height_m
    found = odds_of(ground)
    assert found[30 : 30 + width, 30 : 30 + width].max() > ROCK
    assert found[:18].max() < 1e-4
    assert found[44:].max() < 1e-4


@pytest.mark.parametrize("height_m", [0.25, 0.5, 2.0])
def test_ledges_bar_the_way_all_along(height_m: float) -> None:
    ground = np.zeros((60, 60))
    ground[:30] = height_m
    found = odds_of(ground)
    assert found[28:32, 20:40].max(axis=0).min() > ROCK
    assert found[:18].max() < 1e-4
    assert found[42:].max() < 1e-4


def test_where_cells_are_coarse_the_lip_of_a_hill_is_no_rock_and_a_ledge_is_one() -> None:
    south_m = 0.5 * np.arange(30)
    hill = np.tile(-np.logaddexp(0.0, south_m - 7.0)[:, None], (1, 30))
    measured = shape_of(hill, WHEEL_M, 0.7, 0.5)
    assert rock_odds(measured, np.full(hill.shape, 0.05), CLIMB_M).max() < 0.5 * ROCK
    hill[15:] -= 1.0
    measured = shape_of(hill, WHEEL_M, 0.7, 0.5)
    assert (rock_odds(measured, np.full(hill.shape, 0.05), CLIMB_M)[14:16] > ROCK).any(axis=0).all()
