"""Rays on half-known floors: Eq. 5 in the plane, and the evidence of a look."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_helpers import SENSOR

from agents.geometry import GridFrame, Pose
from agents.planar.casting import (
    BEARINGS,
    HALF,
    LEAST,
    first_ray,
    gains,
    star_of,
    tallies,
    visibility,
    windows,
    yaw_of,
)
from agents.planar.rays import crossings, fan_rad, most_crossed, star
from agents.planar.sensing import MAPPED, SUREST, evidence, look_log_odds, sigma_m
from agents.settings import SensorSettings

EXACT = SensorSettings(fov_deg=90.0, range_m=4.0, near_m=0.0, noise_s=0.0, columns=90)
RAYS = star_of(EXACT, 1.0)


def walk(through: np.ndarray, eye: tuple[int, int], bearing: int) -> dict[tuple[int, int], float]:
    """Return each cell's chance of being reached by one ray of the star: slow code for Eq. 5."""
    chance, seen = 1.0, dict[tuple[int, int], float]()
    for n in range(int(RAYS.counts[bearing])):
        row, col = (int(v) for v in np.array(eye) + RAYS.steps[bearing, n])
        if not (0 <= row < through.shape[0] and 0 <= col < through.shape[1]) or chance < LEAST:
            break
        seen[row, col] = max(seen.get((row, col), 0.0), chance)
        if n > 0:
            chance *= float(through[row, col])
    return seen


def best_of(through: np.ndarray, eye: tuple[int, int], bearings: list[int]) -> np.ndarray:
    best = np.zeros(through.shape)
    for bearing in bearings:
        for cell, chance in walk(through, eye, bearing).items():
            best[cell] = max(best[cell], chance)
    return best


def mixed(seed: int, shape: tuple[int, int] = (9, 11)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.choice([1.0, 1.0, 0.9, 0.5, 0.0], size=shape)


# --- walking --------------------------------------------------------------------------------


@given(st.floats(0, 5), st.floats(0, 5), st.floats(-7, 7), st.floats(0.1, 9))
@settings(max_examples=100, deadline=None)
def test_a_ray_crosses_neighbouring_cells_and_enters_each_where_it_says(
    x: float, y: float, angle: float, reach: float
) -> None:
    most = most_crossed(reach)
    cells, entry = np.empty((most, 2), dtype=np.int64), np.empty(most)
    count = int(crossings(x, y, angle, reach, cells, entry))
    assert 1 <= count <= most
    assert (cells[0] == [math.floor(y), math.floor(x)]).all()
    assert (np.abs(np.diff(cells[:count], axis=0)).sum(axis=1) == 1).all()
    assert entry[0] == 0
    assert (np.diff(entry[:count]) >= 0).all()
    assert entry[count - 1] < reach
    leave = np.append(entry[1:count], reach)
    for (row, col), a, b in zip(cells[:count], entry[:count], leave, strict=True):
        if b - a > 1e-6 and count < most:
            middle = 0.5 * (a + b)
            there = (y + middle * math.sin(angle), x + middle * math.cos(angle))
            # A ray may run along an edge, to the last bit.
            assert row - 1e-9 <= there[0] <= row + 1 + 1e-9
            assert col - 1e-9 <= there[1] <= col + 1 + 1e-9


def test_a_star_leaves_the_middle_of_a_cell_all_around() -> None:
    steps, entry, counts = star(3.0, 8)
    assert (steps[:, 0] == 0).all()
    assert (entry[:, 1] >= 0.5).all()
    # Ray 0 points to 22.5 degrees: it enters the east at 0.5, the north at 0.5 / sin = 1.31.
    assert steps[0, 1].tolist() == [0, 1]
    assert steps[0, 2].tolist() == [1, 1]
    assert entry[0, 1] == pytest.approx(0.5 / math.cos(math.pi / 8))
    assert entry[0, 2] == pytest.approx(0.5 / math.sin(math.pi / 8))
    assert counts.min() > 3


@given(st.integers(0, BEARINGS - 1), st.integers(1, 180))
def test_a_heading_is_the_middle_of_its_rays(first: int, width: int) -> None:
    yaw = float(yaw_of(np.array(first), width))
    assert first_ray(yaw, width) == first


# --- Eq. 5 ----------------------------------------------------------------------------------


def test_a_ray_reaches_a_cell_if_all_before_it_let_it_pass_by_hand() -> None:
    corridor = np.array([[1.0, 1.0, 0.5, 0.5, 0.5, 1.0]])
    seen = visibility(corridor, RAYS, np.array([0, 0]), first_ray(0.0, RAYS.width))
    assert seen[0].tolist() == [1.0, 1.0, 1.0, 0.5, 0.25, 0.0]  # the last is 5 cells off


def test_a_solid_cell_is_seen_and_hides_what_is_behind() -> None:
    corridor = np.array([[1.0, 1.0, 0.0, 1.0, 1.0]])
    seen = visibility(corridor, RAYS, np.array([0, 0]), first_ray(0.0, RAYS.width))
    assert seen[0].tolist() == [1.0, 1.0, 1.0, 0.0, 0.0]
    behind = visibility(corridor, RAYS, np.array([0, 0]), first_ray(math.pi, RAYS.width))
    assert behind[0].tolist() == [1.0, 0.0, 0.0, 0.0, 0.0]


def test_a_robot_looks_out_of_a_cell_that_is_not_known_to_be_free() -> None:
    corridor = np.array([[0.0, 1.0, 1.0]])
    seen = visibility(corridor, RAYS, np.array([0, 0]), first_ray(0.0, RAYS.width))
    assert seen[0].tolist() == [1.0, 1.0, 1.0]


@given(st.integers(0, 10_000), st.integers(0, 8), st.integers(0, 10), st.integers(0, 359))
@settings(max_examples=40, deadline=None)
def test_visibility_is_the_best_of_the_rays_walked_one_by_one(
    seed: int, row: int, col: int, first: int
) -> None:
    through = mixed(seed)
    rays = [(first + k) % BEARINGS for k in range(RAYS.width)]
    got = visibility(through, RAYS, np.array([row, col]), first)
    assert got == pytest.approx(best_of(through, (row, col), rays))


def test_what_a_chance_is_taken_for_counts_and_the_ray_goes_on_as_it_was() -> None:
    corridor, blank = np.array([[1.0, 1.0, 0.5, 0.5, 1.0]]), np.zeros((1, 5))
    worth = np.array([[0.0, 0.0, 0.0, 1.0, 1.0]])
    eye, east = np.array([[0, 0]]), first_ray(0.0, 1)
    plain = gains(corridor, blank, worth, RAYS, eye, trust=np.array([0.0, 0.5, 1.0]))[0]
    # Odds add up: the fourth is reached with 1/2, the fifth with 1/3.
    bent = gains(corridor, blank, worth, RAYS, eye, trust=np.linspace(0.0, 1.0, 7) ** 2)[0]
    assert plain[east] == pytest.approx(0.5 + 0.5, abs=1e-6), "1/3 is nearest to 1/2 in halves"
    assert bent[east] == pytest.approx(1 / 4 + 1 / 9, abs=1e-6)


# --- sums over what is seen -------------------------------------------------------------------


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_gains_book_each_cell_once_with_its_best_chance(seed: int) -> None:
    through, rng = mixed(seed), np.random.default_rng(seed)
    worth = rng.choice([0.0, 0.25, 1.0], size=through.shape)
    eyes = np.array([[4, 5], [0, 0]])
    lacking = np.full(through.shape, MAPPED)
    found = gains(through, lacking, worth, star_of(EXACT, 1.0), eyes)
    for eye, by_bearing in zip(eyes, found, strict=True):
        whole = best_of(through, (int(eye[0]), int(eye[1])), list(range(BEARINGS)))
        assert by_bearing.sum() == pytest.approx((whole * worth).sum(), rel=1e-5)
        assert (by_bearing >= 0).all()


def test_a_cell_that_a_look_leaves_short_of_being_mapped_counts_in_part() -> None:
    far = SENSOR.model_copy(update={"noise_s": 0.03, "range_m": 4.0})
    rays = star_of(far, 1.0)
    corridor, eye = np.ones((1, 5)), np.array([[0, 0]])
    sure = evidence(np.arange(5.0), 1.0, far)
    assert sure[4] < MAPPED < sure[3]
    blank = np.full((1, 5), MAPPED)
    found = gains(corridor, blank, np.array([[0.0, 0.0, 0.0, 1.0, 1.0]]), rays, eye)
    assert found.sum() == pytest.approx(1.0 + HALF, rel=1e-6)
    lacks_little = np.array([[MAPPED] * 4 + [0.9 * sure[4]]])
    found = gains(corridor, lacks_little, np.array([[0.0] * 4 + [1.0 - HALF]]), rays, eye)
    assert found.sum() == pytest.approx(1.0 - HALF, rel=1e-6)


@given(st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_tallies_count_every_class_by_its_cells_chances(seed: int) -> None:
    through, rng = mixed(seed), np.random.default_rng(seed)
    classes = rng.integers(0, 3, size=through.shape)
    third = star_of(EXACT.model_copy(update={"fov_deg": 120.0}), 1.0)
    firsts = np.array([0, 120, 240])
    rings = np.zeros(third.range_m.shape, dtype=np.int64)
    got = tallies(through, classes[None], rings, third, np.array([[4, 5]]), firsts, 3)[0]
    whole = best_of(through, (4, 5), list(range(BEARINGS)))
    expected = [whole[classes == kind].sum() for kind in range(3)]
    assert got.sum(axis=0) == pytest.approx(expected, rel=1e-5)


@given(st.integers(0, 1000), st.integers(1, 12))
def test_windows_are_sums_over_neighbouring_bearings(seed: int, width: int) -> None:
    values = np.random.default_rng(seed).random((2, 12))
    found = windows(values, width)
    for first in range(12):
        around = values[:, [(first + k) % 12 for k in range(width)]]
        assert found[:, first] == pytest.approx(around.sum(axis=1))


# --- what a look says of a map ------------------------------------------------------------------


def test_evidence_by_hand() -> None:
    sensor = SENSOR.model_copy(update={"noise_s": 0.002, "noise_n": 2.0})
    assert sigma_m(np.array([10.0]), sensor)[0] == pytest.approx(0.2)
    # Half a cell of 0.4 m is one sigma there: Phi(1) = 0.841345, and its logit 1.6683.
    assert evidence(np.array([10.0]), 0.4, sensor)[0] == pytest.approx(1.6683, abs=1e-4)
    assert evidence(np.array([0.1]), 0.4, sensor)[0] == SUREST


@given(st.floats(0.01, 20), st.floats(0.01, 20))
def test_nearer_cells_are_never_less_sure(a: float, b: float) -> None:
    near, far = evidence(np.array(sorted((a, b))), 0.4, SENSOR)
    assert near >= far > 0


FRAME = GridFrame(0.0, 0.0, 0.5, 9, 9)
EAST = Pose(0.75, 2.25, 0.0, 0.0)


def looked(range_m: float) -> np.ndarray:
    one = EXACT.model_copy(update={"fov_deg": 2.0, "columns": 4})
    return look_log_odds(FRAME, EAST, np.full(4, range_m), one)


def test_a_ray_frees_what_it_passed_and_fills_where_it_ended() -> None:
    # From (1, 4) in cells, 1.25 m eastward: the face at x = 2.0 m is that of column 4.
    added = looked(1.25)
    assert added[4, 1:4].tolist() == [-SUREST] * 3
    assert added[4, 4] == SUREST
    assert np.count_nonzero(added) == 4


def test_where_nothing_comes_back_all_is_free_up_to_the_range() -> None:
    added = looked(math.inf)
    assert (added[4, 1:] == -SUREST).all()
    assert np.count_nonzero(added) == 8


def test_of_one_looks_rays_the_majority_decides() -> None:
    one = EXACT.model_copy(update={"fov_deg": 2.0, "columns": 5})
    few = np.array([math.inf, math.inf, math.inf, 1.25, 1.25])
    assert look_log_odds(FRAME, EAST, few, one)[4, 4] == -SUREST
    most = np.array([math.inf, math.inf, 1.25, 1.25, 1.25])
    assert look_log_odds(FRAME, EAST, most, one)[4, 4] == SUREST


def test_the_fan_is_even_and_about_its_middle() -> None:
    fan = np.degrees(fan_rad(SENSOR))
    assert fan == pytest.approx(-fan[::-1])
    assert np.diff(fan) == pytest.approx(np.ones(89))
