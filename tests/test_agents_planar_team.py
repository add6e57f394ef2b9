"""Our own way to choose looks: what it learns of walls, looks taken together, and team-mates."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_helpers import (
    MEANS,
    PLANNER,
    SURE,
    half_known,
    log_odds_of,
    points_east,
    scene_of,
    view_of,
)

from agents import planar
from agents.geometry import Pose
from agents.planar.hazard import PRIOR_CELLS, PRIOR_LOOKS, PRIOR_PERCENT, PRIOR_RATE, Hazard
from agents.planar.looksets import COARSE, look_sets
from agents.planar.sites import LOOK_WORTH_M, Sites, rates, survey
from agents.planar.view import PlanarLook

OURS = "team-information"


def chosen(
    log_odds: np.ndarray,
    cell: tuple[int, int],
    others: tuple[Pose, ...] = (),
    claims: tuple[tuple[float, float, float], ...] = (),
) -> PlanarLook:
    method = planar.method(OURS, MEANS)
    view = view_of(log_odds, cell, others=others, claims=claims)
    look = method.choose(view, np.random.default_rng(1))
    assert look is not None
    return look


# --- where rays end in the unknown ------------------------------------------------------------


def test_before_anything_is_seen_the_prior_holds() -> None:
    p = Hazard().take(view_of(np.zeros((30, 30)), (15, 15)))
    assert p == pytest.approx(np.full((30, 30), PRIOR_PERCENT[-1, -1] / 100))


def test_beside_a_wall_the_wall_goes_on_and_in_the_open_it_does_not() -> None:
    log_odds = np.zeros((30, 60))
    log_odds[:10] = -SURE
    log_odds[10, :20] = SURE
    p = Hazard().take(view_of(log_odds, (5, 5)))
    assert p[10, 20] > 0.4
    assert 0 < p[10, 50] < 0.1


def test_what_is_measured_is_counted_upon_the_prior_by_hand() -> None:
    hazard, blank = Hazard(), np.zeros((20, 20))
    hazard.take(view_of(blank, (10, 10)))
    seen = blank.copy()
    seen[:5] = SURE
    after = hazard.take(view_of(seen, (10, 10)))
    # 100 cells of the last bin were reached, all of them solid.
    rate = (100 + PRIOR_RATE * PRIOR_LOOKS) / (100 + PRIOR_LOOKS)

    def logit(p: float) -> float:
        return math.log(p / (1 - p))

    def moved(p: float) -> float:
        return 1 / (1 + math.exp(-(logit(p) + logit(rate) - logit(PRIOR_RATE))))

    beside = moved(PRIOR_PERCENT[0, -1] / 100)  # 0.5 m from solid, nothing free anywhere
    assert after[5, 0] == pytest.approx(beside)
    far = (100 + PRIOR_CELLS * moved(PRIOR_PERCENT[-1, -1] / 100)) / (100 + PRIOR_CELLS)
    assert float(hazard._probabilities()[-1]) == pytest.approx(far)  # pyright: ignore[reportPrivateUsage]


def test_a_cell_is_counted_when_it_is_first_measured_and_never_again() -> None:
    hazard = Hazard()
    hazard.take(view_of(np.zeros((20, 20)), (10, 10)))
    seen = np.zeros((20, 20))
    seen[:5] = SURE
    once = hazard.take(view_of(seen, (10, 10)))
    assert np.array_equal(hazard.take(view_of(1.1 * seen, (10, 10))), once)


# --- looks of one place, chosen together ------------------------------------------------------


def best_by_trying(ring: list[float], width: int, looks: int) -> float:
    """Return the most that some windows show of a ring: slow code, every choice tried."""
    count = len(ring)
    choices = itertools.combinations_with_replacement(range(count), looks)
    return max(
        sum(ring[k] for k in {(first + n) % count for first in firsts for n in range(width)})
        for firsts in choices
    )


@given(st.lists(st.integers(0, 9), min_size=8, max_size=8), st.integers(1, 4), st.integers(1, 3))
@settings(max_examples=40, deadline=None)
def test_no_set_of_looks_shows_more_than_the_one_chosen(
    ring: list[int], width: int, looks: int
) -> None:
    by_bearing = np.repeat(np.array(ring, dtype=np.float64) / COARSE, COARSE)[None]
    gain, first = look_sets(by_bearing, width * COARSE, 3)
    assert gain[0, looks - 1].sum() == pytest.approx(best_by_trying(list(ring), width, looks))
    assert (np.diff(gain[0], axis=1) <= 0).all()
    assert (first % COARSE == 0).all()


def test_looks_share_a_stretch_rather_than_leave_its_ends() -> None:
    by_bearing = np.zeros((1, 360))
    by_bearing[0, 90:270] = 1.0
    by_bearing[0, 150:210] = 2.0  # the single best look lies in the middle
    gain, first = look_sets(by_bearing, 90, 4)
    assert gain[0, 0, 0] == pytest.approx(150.0)
    assert gain[0, 1, :2] == pytest.approx([120.0, 120.0])
    assert sorted(first[0, 1, :2]) == [90, 180]
    assert gain[0, 3, 2:] == pytest.approx([0.0, 0.0]), "two show all"


def test_looks_that_show_too_little_count_as_nothing() -> None:
    scene = scene_of(view_of(half_known(), (20, 17)))
    sites = survey(scene, scene.worth, np.array([[20, 17]]), 20.0)
    assert ((sites.gain == 0) | (sites.gain >= 20)).all()
    none = survey(scene, scene.worth, np.array([[20, 17]]), 1e9)
    assert not none.gain.any()


def test_a_stop_is_worth_what_all_its_looks_yield_per_effort_by_hand() -> None:
    gain = np.zeros((2, 2, 2))
    gain[0] = [[30.0, 0.0], [30.0, 10.0]]
    gain[1] = [[30.0, 0.0], [30.0, 28.0]]
    told = Sites(np.array([[20, 17], [20, 18]]), gain, np.zeros((2, 2, 2), dtype=np.int64))
    rate, sets = rates(told, np.array([0.0, 4.0 * LOOK_WORTH_M]))
    assert sets.tolist() == [0, 1], "here one look, and there, after a drive, both"
    assert rate.tolist() == pytest.approx([30.0, 58.0 / 6.0])


@given(st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_what_a_place_promises_is_never_more_than_what_lacks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    log_odds = rng.choice([-SURE, -1.0, 0.0, SURE], size=(20, 20), p=[0.5, 0.1, 0.3, 0.1])
    log_odds[9:12, 9:12] = -SURE
    scene = scene_of(view_of(log_odds, (10, 10)))
    sites = survey(scene, scene.worth, np.array([[10, 10]]), 0.0)
    assert sites.total.max() <= scene.worth.sum() + 1e-6


# --- team-mates ---------------------------------------------------------------------------------


def corridor() -> np.ndarray:
    """Return a stretch of a corridor known in its middle; both ends go on unknown."""
    return log_odds_of("""
        #####################################
        ????????????.............????????????
        ????????????.............????????????
        ????????????.............????????????
        #####################################
    """)


def test_what_a_team_mate_said_it_will_look_at_counts_little() -> None:
    log_odds, middle = corridor(), (2, 18)
    free = chosen(log_odds, middle)
    east = points_east(free.pose.yaw_rad)
    x_m = 15.0 if east else 3.5
    elsewhere = chosen(log_odds, middle, claims=((x_m, 1.25, 3.0),))
    assert points_east(elsewhere.pose.yaw_rad) != east


def test_where_a_team_mate_is_nearer_it_goes_itself() -> None:
    log_odds, middle = corridor(), (2, 18)
    east = points_east(chosen(log_odds, middle).pose.yaw_rad)
    mate = Pose(12.0 if east else 6.5, 1.25, 0.0, 0.0)
    assert points_east(chosen(log_odds, middle, others=(mate,)).pose.yaw_rad) != east


def test_even_what_all_is_claimed_is_looked_at_when_nothing_else_is_left() -> None:
    look = chosen(half_known(), (20, 17), claims=((12.0, 10.0, 5.0),))
    assert points_east(look.pose.yaw_rad)


def test_places_and_headings_are_refined_off_the_lattice_of_candidates() -> None:
    lattice_only = 0
    for col in range(3, 17):
        log_odds = half_known()
        scene = scene_of(view_of(log_odds, (20, col)))
        lattice = scene.candidates(np.random.default_rng(1)).tolist()
        look = chosen(log_odds, (20, col))
        cell = scene.view.frame.cell_of(look.pose.x_m, look.pose.y_m)
        assert np.isfinite(scene.way_m[cell])
        turn = math.degrees(look.pose.yaw_rad) % (360 / PLANNER.headings)
        lattice_only += list(cell) in lattice and min(turn, 30 - turn) < 1e-6
    assert lattice_only <= 3
