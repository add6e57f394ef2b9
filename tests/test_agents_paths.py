"""Travel fields against a slow Dijkstra, straight legs, and what ground can be driven."""

import heapq
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.ground.descent import barred, descent_cost
from agents.ground.paths import (
    PathError,
    length_m,
    path_to,
    straight_legs,
    travel_field,
)

SIZES = {"cell_m": 0.1, "footprint_m": 0.8, "wheel_m": 0.2, "climb_m": 0.15}


def slow_dijkstra(cost, starts, cell_m):
    h, w = cost.shape
    best = {tuple(s): 0.0 for s in starts}
    heap = [(0.0, s) for s in best]
    own = {s: cost[s] if np.isfinite(cost[s]) else 1.0 for s in best}
    while heap:
        d, (i, j) = heapq.heappop(heap)
        if d > best[i, j]:
            continue
        here = own.get((i, j), cost[i, j])
        for a in range(max(0, i - 1), min(h, i + 2)):
            for b in range(max(0, j - 1), min(w, j + 2)):
                if (a, b) == (i, j) or not np.isfinite(cost[a, b]):
                    continue
                slanted = a != i and b != j
                if slanted and not (np.isfinite(cost[a, j]) and np.isfinite(cost[i, b])):
                    continue
                there = d + (math.sqrt(2) if slanted else 1) * (here + cost[a, b]) / 2
                if there < best.get((a, b), math.inf) - 1e-12:
                    best[a, b] = there
                    heapq.heappush(heap, (there, (a, b)))
    out = np.full(cost.shape, np.inf)
    for (i, j), d in best.items():
        out[i, j] = d * cell_m
    return out


@st.composite
def costs(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = draw(st.tuples(st.integers(1, 12), st.integers(1, 12)))
    cost = rng.uniform(0.5, 4.0, shape)
    cost[rng.random(shape) < draw(st.sampled_from([0.0, 0.3, 0.6]))] = np.inf
    starts = [(int(rng.integers(shape[0])), int(rng.integers(shape[1])))]
    return cost, starts


@given(costs())
@settings(max_examples=60, deadline=None)
def test_distances_are_dijkstras_and_parents_lead_back(case):
    cost, starts = case
    distance, parent = travel_field(cost, np.array(starts), 0.1)
    assert distance == pytest.approx(slow_dijkstra(cost, starts, 0.1))
    for goal in np.argwhere(np.isfinite(distance)):
        way = path_to(parent, tuple(goal))
        assert tuple(way[0]) == starts[0]
        assert tuple(way[-1]) == tuple(goal)
        assert (np.abs(np.diff(way, axis=0)).max(axis=1, initial=0) <= 1).all()
        assert np.isfinite(cost[tuple(way[1:].T)]).all()


@given(costs())
@settings(max_examples=60, deadline=None)
def test_straight_legs_keep_the_ends_and_stay_on_allowed_cells(case):
    cost, starts = case
    distance, parent = travel_field(cost, np.array(starts), 1.0)
    goal = tuple(np.argwhere(np.isfinite(distance))[-1])
    way = path_to(parent, goal)
    legs = straight_legs(way, cost)
    assert tuple(legs[0]) == tuple(way[0])
    assert tuple(legs[-1]) == tuple(way[-1])
    for a, b in itertools.pairwise(legs):
        steps = max(1, math.ceil(2 * math.hypot(*(b - a))))
        for k in range(1, steps + 1):
            at = tuple(np.floor(a + k / steps * (b - a) + 0.5).astype(int))
            assert np.isfinite(cost[at]) or at == starts[0]


def test_open_ground_is_one_leg_and_a_wall_makes_it_go_round():
    cost = np.ones((30, 30))
    _, parent = travel_field(cost, np.array([[2, 2]]), 0.1)
    assert len(straight_legs(path_to(parent, (27, 11)), cost)) == 2
    cost[10, :25] = np.inf
    _, parent = travel_field(cost, np.array([[2, 2]]), 0.1)
    legs = straight_legs(path_to(parent, (20, 2)), cost)
    assert legs[:, 1].max() >= 25
    assert 3 <= len(legs) <= 5


def test_no_corner_is_cut():
    cost = np.ones((2, 2))
    cost[0, 1] = cost[1, 0] = np.inf
    distance, parent = travel_field(cost, np.array([[0, 0]]), 1.0)
    assert np.isinf(distance[1, 1])
    with pytest.raises(PathError, match="no way leads"):
        path_to(parent, (1, 1))


def test_a_robot_on_forbidden_ground_may_leave_it():
    cost = np.ones((5, 5))
    cost[2, 2] = np.inf
    distance, _ = travel_field(cost, np.array([[2, 2]]), 1.0)
    assert np.isfinite(distance).all()


def test_bad_input_is_refused():
    with pytest.raises(PathError, match="outside"):
        travel_field(np.ones((3, 3)), np.array([[3, 0]]), 1.0)
    with pytest.raises(PathError, match="negative or NaN"):
        travel_field(np.full((3, 3), -1.0), np.array([[0, 0]]), 1.0)


def test_length_is_the_sum_of_the_legs():
    assert length_m(np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]])) == pytest.approx(6)
    assert length_m(np.array([[1.0, 1.0]])) == 0


def slope(degrees, n=80):
    y, _ = np.mgrid[:n, :n] * 0.1
    return np.tan(np.radians(degrees)) * y


def cost_of(z, sigma=0.01):
    bars = barred(z, np.full(z.shape, sigma), **SIZES)
    return descent_cost(bars, cell_m=SIZES["cell_m"], footprint_m=SIZES["footprint_m"])


def test_a_steep_smooth_face_is_open_ground_on_tethers():
    assert np.isfinite(cost_of(slope(70))[10:70, 10:70]).all()


def test_a_rock_on_a_slope_is_forbidden_with_half_a_footprint_around_it():
    z = slope(20)
    z[38:42, 38:42] += 0.25
    cost = cost_of(z)
    y, x = np.mgrid[:80, :80] - 39.5
    apart = np.hypot(y, x)
    assert np.isinf(cost[apart < 4]).all()
    assert np.isfinite(cost[10:70, 10:70][apart[10:70, 10:70] > 11]).all()
    ring = cost[(apart > 8.5) & (apart < 11)]
    ring = ring[np.isfinite(ring)]
    far = cost[10:70, 10:70][apart[10:70, 10:70] > 20]
    assert ring.min() > far.max()


def test_unknown_ground_is_forbidden_beyond_one_wheel():
    z = slope(0).copy()
    z[:, 40:] = np.nan
    cost = cost_of(z)
    assert np.isinf(cost[:, 38:]).all()
    assert np.isfinite(cost[10:70, 10:36]).all()
    assert np.isinf(cost_of(np.full((5, 5), np.nan))).all()


def test_the_noise_of_single_cells_is_no_hazard_but_ground_that_nobody_is_sure_of_is():
    rng = np.random.default_rng(3)
    noisy = slope(5) + rng.normal(scale=0.03, size=(80, 80))
    assert np.isfinite(cost_of(noisy, sigma=0.075)).mean() > 0.95
    assert np.isinf(cost_of(slope(5), sigma=0.5)).all()


def on_tethers(height_m, side, sigma_m=0.05):
    """Return what a slope costs on tethers with one rock of so many cells a side in the middle."""
    z = slope(30)
    z[40 : 40 + side, 40 : 40 + side] += height_m
    return cost_of(z, sigma=sigma_m)


@pytest.mark.parametrize(
    ("height_m", "side", "barred"),
    [
        (0.17, 2, True),  # two by two cells show it, though the mean leaves little over half
        (0.10, 2, False),
        (0.40, 1, True),
        (0.14, 1, False),  # of single cells that stand out so few are rocks
    ],
)
def test_on_tethers_a_rock_is_barred_from_the_height_at_which_its_odds_say_so(
    height_m, side, barred
):
    here = on_tethers(height_m, side)[40, 40]
    assert np.isinf(here) == barred
    if not barred:
        assert here > 1.5 * on_tethers(0.0, 1)[40, 40], "what is almost a rock is gone round"


def test_a_way_on_tethers_keeps_clear_of_what_is_almost_a_rock():
    cost = on_tethers(0.15, 2)
    _, parent = travel_field(cost, np.array([[20, 40]]), 0.1)
    cells = straight_legs(path_to(parent, (60, 40)), cost)
    legs = [np.linspace(a, b, 50) for a, b in itertools.pairwise(cells)]
    apart = np.hypot(*(np.concatenate(legs) - 40.5).T)
    assert apart.min() > 0.5 * SIZES["footprint_m"] / 0.1


def test_what_cells_err_all_together_hides_no_rock_on_tethers():
    sigma_m = 0.09
    assert np.isinf(on_tethers(0.2, 3, sigma_m)[41, 41])
    apart = np.random.default_rng(4).normal(scale=0.35 * sigma_m, size=(80, 80))
    assert np.isfinite(cost_of(slope(30) + apart, sigma=sigma_m)).mean() > 0.9
