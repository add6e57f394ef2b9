"""Our own way to choose looks: what it learns of walls, looks taken together, and team-mates."""

import itertools
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_helpers import (
    CELL_M,
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
from agents.planar.casting import onward
from agents.planar.hazard import (
    FAR_OFF,
    PRIOR_CELLS,
    PRIOR_SHARE,
    SIZES,
    Hazard,
    network,
    packed,
    unpacked,
)
from agents.planar.looksets import COARSE, look_sets, sectors
from agents.planar.prospects import SECTORS, Prospects
from agents.planar.routes import Prices, Router, Stop
from agents.planar.surroundings import RUN_CELLS, surroundings
from agents.planar.trust import EDGES, STEPS, Trust
from agents.planar.trust import PRIOR_CELLS as PRIOR_SEEN
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


def test_what_lies_about_a_cell_by_hand() -> None:
    log_odds = log_odds_of("""
        ??????
        ??????
        ?..?##
        ??????
    """)
    numbers = surroundings(log_odds, np.array([[1, 3]]), view_of(log_odds, (1, 1)).frame)[0]
    solid, free, run = numbers[:8], numbers[8:16], numbers[16:24]
    assert solid.tolist() == [1.0, 0, 0, 0, 0, 0, 0, 0], "to the east, at once"
    assert run[0] == pytest.approx(1 / RUN_CELLS), "and one more beyond"
    assert free.tolist() == [0, 0, 0, 0, 1.0, 0, 0, 0], "to the west"


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_surroundings_turn_with_the_map(seed: int) -> None:
    log_odds = np.random.default_rng(seed).choice([-SURE, 0.0, SURE], size=(9, 9))
    log_odds[4, 4] = 0.0
    frame, cell = view_of(log_odds, (4, 4)).frame, np.array([[4, 4]])
    there = surroundings(log_odds, cell, frame)[0]
    # A quarter turn to the left, row 0 south: what was east is north, two directions on.
    turned = surroundings(np.rot90(log_odds, -1), cell, frame)[0]
    for kind in range(3):
        part = slice(8 * kind, 8 * kind + 8)
        assert turned[part] == pytest.approx(np.roll(there[part], 2))
    assert turned[24:] == pytest.approx(there[24:])


def test_before_anything_is_seen_all_cells_are_alike() -> None:
    p = Hazard().take(view_of(np.zeros((30, 30)), (15, 15)))
    assert p == pytest.approx(np.full((30, 30), 1 / (1 + math.exp(-FAR_OFF))))


def test_beside_a_wall_the_wall_goes_on_and_in_the_open_it_does_not() -> None:
    log_odds = np.zeros((30, 60))
    log_odds[:10] = -SURE
    log_odds[10, :20] = SURE
    p = Hazard().take(view_of(log_odds, (5, 5)))
    assert p[10, 20] > 0.4
    assert 0 < p[10, 50] < 0.2


def test_a_gap_between_two_ends_of_a_wall_is_wall() -> None:
    log_odds = np.zeros((30, 60))
    log_odds[:10] = -SURE
    log_odds[10] = SURE
    log_odds[10, 30] = 0.0
    assert Hazard().take(view_of(log_odds, (5, 5)))[10, 30] > 0.8


def test_guesses_move_to_what_was_found_by_hand() -> None:
    hazard, blank = Hazard(), np.zeros((20, 20))
    hazard.take(view_of(blank, (10, 10)))
    seen = blank.copy()
    seen[:5] = SURE
    after = hazard.take(view_of(seen, (10, 10)))

    def logit(p: float) -> float:
        return math.log(p / (1 - p))

    # 100 cells, guessed alike, and all of them solid.
    guessed, total = 1 / (1 + math.exp(-FAR_OFF)), 100 + PRIOR_CELLS
    before = PRIOR_CELLS * PRIOR_SHARE
    whole = logit((100 + before) / total) - logit((100 * guessed + before) / total)
    expected = 1 / (1 + math.exp(-(FAR_OFF + whole)))
    mine = (100 + PRIOR_CELLS * expected) / total
    assert after[19, 0] == pytest.approx(mine), "nothing free is near: guessed as before"


def test_a_cell_is_counted_when_it_is_first_measured_and_never_again() -> None:
    hazard = Hazard()
    hazard.take(view_of(np.zeros((20, 20)), (10, 10)))
    seen = np.zeros((20, 20))
    seen[:5] = SURE
    once = hazard.take(view_of(seen, (10, 10)))
    assert np.array_equal(hazard.take(view_of(1.1 * seen, (10, 10))), once)


def test_a_network_is_packed_as_text_and_comes_back() -> None:
    rng = np.random.default_rng(3)
    layers = [(rng.normal(size=(a, b)), rng.normal(size=b)) for a, b in pairwise(SIZES)]
    for told, kept in zip(unpacked(packed(layers)), layers, strict=True):
        for a, b in zip(told, kept, strict=True):
            assert a == pytest.approx(b, rel=1e-3, abs=1e-3)


def test_a_network_s_answer_by_hand() -> None:
    layers = [(np.array([[1.0, -1.0]]), np.array([0.0, 0.5])), (np.ones((2, 1)), np.array([2.0]))]
    assert network(np.array([[3.0], [-3.0]]), layers).tolist() == [5.0, 5.5]


# --- what is beyond a cell that may be solid ---------------------------------------------------


@given(st.lists(st.floats(0.05, 1.0), min_size=1, max_size=20))
@settings(max_examples=30, deadline=None)
def test_what_stands_or_falls_together_lets_no_less_pass(chances: list[float]) -> None:
    alone, together = 1.0, 1.0
    for n, chance in enumerate(chances):
        alone, together = onward(alone, chance, False), onward(together, chance, True)
        assert together >= alone - 1e-9
        assert n > 0 or together == pytest.approx(chance), "of one cell both say the same"
        assert together <= min(chances[: n + 1]) + 1e-9
    assert onward(together, 0.0, True) == 0.0


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
    gain, first = look_sets(np.array([ring], dtype=np.float64), width, 3)
    assert gain[0, looks - 1].sum() == pytest.approx(best_by_trying(list(ring), width, looks))
    assert (np.diff(gain[0], axis=1) <= 0).all()
    assert ((first >= 0) & (first < len(ring))).all()


def test_looks_share_a_stretch_rather_than_leave_its_ends() -> None:
    by_bearing = np.zeros((1, 360))
    by_bearing[0, 90:270] = 1.0
    by_bearing[0, 150:210] = 2.0  # the single best look lies in the middle
    gain, first = look_sets(sectors(by_bearing), 90 // COARSE, 4)
    assert gain[0, 0, 0] == pytest.approx(150.0)
    assert gain[0, 1, :2] == pytest.approx([120.0, 120.0])
    assert sorted(first[0, 1, :2] * COARSE) == [90, 180]
    assert gain[0, 3, 2:] == pytest.approx([0.0, 0.0]), "two show all"


# --- how far chances can be trusted ---------------------------------------------------------------


def test_before_any_look_chances_are_what_the_model_says() -> None:
    assert Trust().table() == pytest.approx(np.arange(STEPS + 1) / STEPS, abs=1e-3)


def test_chances_move_to_what_was_seen_by_hand() -> None:
    trust, blank = Trust(), np.zeros((100, 100))
    trust.expect(np.full((100, 100), 0.25), blank)
    seen = blank.copy()
    seen[:75] = -SURE
    trust.take(seen)

    def logit(p: float) -> float:
        return math.log(p / (1 - p))

    # As a whole: of 10,000 cells and the prior's 2,500 were guessed and 7,500 seen.
    half = 0.5 * PRIOR_SEEN
    whole = logit((7500 + half) / (1e4 + PRIOR_SEEN)) - logit((2500 + half) / (1e4 + PRIOR_SEEN))
    expected = 1 / (1 + math.exp(-logit(0.25) - whole))
    found = (7500 + PRIOR_SEEN * expected) / (1e4 + PRIOR_SEEN)
    bins = np.searchsorted(EDGES, logit(0.25))
    middle = 0.5 * (EDGES[bins - 1] + EDGES[bins])
    at = round(STEPS / (1 + math.exp(-middle)))
    shift = logit(float(trust.table()[at])) - logit(at / STEPS)
    assert shift == pytest.approx(logit(found) - logit(0.25), abs=0.02)


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_a_greater_chance_is_never_taken_for_a_smaller_one(seed: int) -> None:
    rng, trust = np.random.default_rng(seed), Trust()
    for _ in range(3):
        log_odds = rng.choice([0.0, -SURE, SURE], size=(60, 60))
        trust.expect(rng.random((60, 60)), np.zeros((60, 60)))
        trust.take(log_odds)
    table = trust.table()
    assert (np.diff(table) >= 0).all()
    assert (table[0], table[-1]) == (0.0, 1.0)


def test_cells_that_are_known_already_teach_nothing() -> None:
    trust = Trust()
    trust.expect(np.full((50, 50), 0.5), np.full((50, 50), SURE))
    trust.take(np.full((50, 50), SURE))
    assert trust.table() == pytest.approx(Trust().table())


# --- when nothing is left -------------------------------------------------------------------------


@pytest.mark.parametrize("name", planar.METHODS.names())
def test_nobody_stops_in_a_corridor_that_the_lattice_steps_over(name: str) -> None:
    # One cell wide: few lattices of sixteen cells have a place in it, but for the robot's own.
    log_odds = np.zeros((41, 80))
    log_odds[20, 1:60] = -SURE
    log_odds[[19, 21], 0:56] = log_odds[20, 0] = SURE
    planner = PLANNER.model_copy(update={"candidate_step_m": 16 * CELL_M})
    means = planar.Means(MEANS.sensor, MEANS.drive, planner)
    method = planar.method(name, means)
    looks = [
        method.choose(view_of(log_odds, (20, 5)), np.random.default_rng(seed)) for seed in range(4)
    ]
    assert all(look is not None for look in looks)


def test_one_place_of_each_square_by_hand() -> None:
    log_odds = np.full((9, 12), -SURE)
    log_odds[:, 6:] = 0.0
    scene = scene_of(view_of(log_odds, (1, 1)), MEANS)  # squares of two cells
    places = scene.everywhere()
    assert places[0].tolist() == [1, 1]
    assert len({(int(r) // 2, int(c) // 2) for r, c in places[1:]}) == len(places) - 1
    reached = np.argwhere(np.isfinite(scene.way_m))
    assert {(int(r) // 2, int(c) // 2) for r, c in places} == {
        (int(r) // 2, int(c) // 2) for r, c in reached
    }


# --- routes --------------------------------------------------------------------------------------


def prospects_of(log_odds: np.ndarray, cell: tuple[int, int]) -> tuple[Router, Prospects]:
    scene = scene_of(view_of(log_odds, cell))
    prospects = Prospects(scene, scene.lattice(np.random.default_rng(1)), Trust().table())
    return Router(scene, prospects), prospects


@given(st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_what_looks_show_together_is_no_more_than_what_lacks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    log_odds = rng.choice([-SURE, -1.0, 0.0, SURE], size=(20, 20), p=[0.5, 0.1, 0.3, 0.1])
    log_odds[9:12, 9:12] = -SURE
    _, prospects = prospects_of(log_odds, (10, 10))
    left = prospects.worth.copy()
    before = float(prospects.rings(left)[0].sum())
    total = sum(prospects.take(left, 0, (first,)) for first in range(0, SECTORS, prospects.width))
    assert total == pytest.approx(before, rel=1e-5), "looks side by side show all there is"
    assert total == pytest.approx(prospects.worth.sum() - left.sum(), rel=1e-6)
    assert (left >= -1e-9).all()
    again = prospects.take(left, 0, (0,))
    assert again <= total


def test_a_route_is_worth_its_looks_less_their_price_by_hand() -> None:
    router, prospects = prospects_of(half_known(), (20, 17))
    place = len(prospects.places) - 1
    route = (Stop(0, (0,)), Stop(place, (0,)))
    left = prospects.worth.copy()
    gain = prospects.take(left, 0, (0,)) + prospects.take(left, place, (0,))
    length_m = router.length_m(route)
    assert router.worth(route, Prices(3.0, 2.0)) == pytest.approx(gain - 6.0 - 2.0 * length_m)
    assert length_m == pytest.approx(
        CELL_M * math.hypot(*(prospects.places[place] - prospects.places[0])), rel=0.1
    )


def test_the_best_route_is_worth_more_than_any_single_stop() -> None:
    router, prospects = prospects_of(half_known(), (20, 10))
    prices = Prices(10.0, 1.0)
    best = router.best(prices)
    gain, first = prospects.sets(prospects.worth, 1)
    alone = [
        router.worth((Stop(n, (int(first[n, 0, 0]),)),), prices)
        for n in range(len(prospects.places))
        if gain[n, 0, 0] > 0
    ]
    assert router.worth(best, prices) >= max(alone)
    assert len(best) > 1
    assert len({stop.place for stop in best}) == len(best), "a place is on a route but once"


def test_no_route_is_worth_any_price() -> None:
    router, _ = prospects_of(half_known(), (20, 10))
    assert router.best(Prices(1e9, 1e9)) == ()


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
