"""The paper's ways to choose a look on a floor: scenes, Eqs. 6-9 over what is in view, choices."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_helpers import (
    CELL_M,
    DRIVE,
    MEANS,
    PLANNER,
    SENSOR,
    SURE,
    half_known,
    log_odds_of,
    points_east,
    scene_of,
    view_of,
)

from agents import planar
from agents.occupancy.view import Means
from agents.planar import methods
from agents.planar.casting import HALF, first_ray
from agents.planar.methods import BINS, RINGS, Memory, Raster
from agents.planar.sensing import MAPPED
from agents.planning.information import binary_entropy, plogp, stretched
from comms.plugins import PluginError

RATED = ("max-new", "min-old", "information", "information-entropy", "information-voxel")
EAST = np.array([first_ray(0.0, 90)])
CORRIDOR = log_odds_of("..--??")
"""Two cells free, two half known to be, two unknown; all in one line of sight."""


def chosen(name: str, log_odds: np.ndarray, cell: tuple[int, int]):
    method = planar.method(name, MEANS)
    return method.choose(view_of(log_odds, cell), np.random.default_rng(1))


# --- what can be driven, and where one may look from ----------------------------------------


def test_a_way_keeps_the_robots_circle_off_what_is_not_known_to_be_free() -> None:
    scene = scene_of(view_of(log_odds_of("""
        #########
        #.......#
        #.......#
        #.......#
        ####.####
        #...?...#
        #########
    """), (4, 2)))  # fmt: skip
    assert np.isfinite(scene.way_m[3:6, 1:8]).all()
    assert np.isinf(scene.way_m[1]).all(), "the gate is narrow but free; behind it all is cut off"
    assert scene.way_m[4, 5] == pytest.approx(3 * CELL_M)
    wide = Means(SENSOR, DRIVE.model_copy(update={"footprint_m": 1.2}), PLANNER)
    assert np.isinf(scene_of(scene.view, wide).way_m[3, 1]), "a wider robot keeps off the wall"


def test_a_robot_may_leave_a_place_that_it_never_saw() -> None:
    log_odds = np.full((9, 9), -SURE)
    log_odds[4, 4] = 0.0
    scene = scene_of(view_of(log_odds, (4, 4)))
    assert np.isfinite(scene.way_m[1:-1, 1:-1]).all()


@given(st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_candidates_are_a_bounded_sample_of_what_can_be_reached(seed: int) -> None:
    scene = scene_of(view_of(half_known(), (20, 5)))
    cells = scene.candidates(np.random.default_rng(seed))
    assert cells[0].tolist() == [20, 5]
    assert len(np.unique(cells, axis=0)) == len(cells) <= PLANNER.max_candidates
    assert np.isfinite(scene.way_m[cells[:, 0], cells[:, 1]]).all()
    apart = cells[1:, None] - cells[None, 1:]
    assert (apart % 2 == 0).all(), "they lie on a lattice of 1 m"


def test_a_path_leads_along_straight_legs_round_a_wall() -> None:
    log_odds = np.full((11, 11), -SURE)
    log_odds[0:8, 5] = SURE
    scene = scene_of(view_of(log_odds, (2, 2)))
    path_m = scene.path_m((2, 8))
    assert path_m[0].tolist() == [1.25, 1.25]
    assert path_m[-1].tolist() == [4.25, 1.25]
    assert 3 <= len(path_m) <= 6
    for a, b in pairwise(path_m):
        for x, y in a + np.linspace(0, 1, 50)[:, None] * (b - a):
            assert log_odds[int(y / CELL_M), int(x / CELL_M)] < 0
    assert scene.path_m((2, 2)).tolist() == [[1.25, 1.25]]


def test_how_often_a_step_is_stopped_is_counted_from_free_cells_upon_a_prior() -> None:
    # Free beside free: two steps; free beside solid: one step, and it is stopped.
    scene = scene_of(view_of(np.array([[-SURE, -SURE, SURE]]), (0, 0)))
    assert scene.stop_p == pytest.approx((1 + 0.03 * 400) / (3 + 400))
    assert scene.through[0].tolist() == [1.0, 1.0, 0.0]


def test_cells_lack_what_they_need_to_be_mapped_weighed_by_interest() -> None:
    view = view_of(np.array([[-SURE, -1.0, 0.0, 0.0]]), (0, 0))
    scene = methods.Scene(view, MEANS, np.array([[1.0, 1.0, 1.0, 0.5]]))
    assert scene.lacking[0] == pytest.approx([0.0, MAPPED - 1.0, MAPPED, MAPPED])
    assert scene.worth[0] == pytest.approx([0.0, 1.0 - HALF, 1.0, 0.5])


# --- NI, by hand --------------------------------------------------------------------------------


def worth(name: str) -> tuple[float, np.ndarray, float]:
    """Return NI of the corridor looked along, p of its cells and N."""
    scene = scene_of(view_of(CORRIDOR, (0, 0)))
    method = planar.method(name, MEANS)
    assert isinstance(method, methods._Rated)  # pyright: ignore[reportPrivateUsage]
    found = method._worth(scene, np.array([[0, 0]]), EAST)  # pyright: ignore[reportPrivateUsage]
    reach = SENSOR.range_m / CELL_M
    most = 0.5 * math.radians(SENSOR.fov_deg) * reach * reach + 4 * reach
    return float(found[0, 0]), scene.occupancy_p[0], most


def chances() -> np.ndarray:
    """Return how likely each of the corridor's cells is to be seen: the last is behind another."""
    scene = scene_of(view_of(CORRIDOR, (0, 0)))
    return np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0 - scene.stop_p])


def test_unknown_cells_take_their_markov_estimates() -> None:
    _, p, _ = worth("information")
    measured = 1 / (1 + math.exp(SURE)), 1 / (1 + math.e)
    assert p == pytest.approx([measured[0]] * 2 + [measured[1]] * 4, abs=1e-3)


def test_eq_8_by_hand() -> None:
    found, p, most = worth("information")
    bins = np.rint(p * (BINS - 1)) / (BINS - 1)
    seen = chances()
    known = [(bins[0], 2.0), (bins[2], 2.0)]
    unknown = [(bins[4], float(seen[4:].sum()))]
    expected = sum(float(binary_entropy(b) * plogp(n / most)) for b, n in known + unknown)
    assert found == pytest.approx(expected)


def test_the_mended_eq_8_by_hand() -> None:
    found, p, most = worth("information-voxel")
    bins = np.rint(p * (BINS - 1)) / (BINS - 1)
    assert found == pytest.approx(float((binary_entropy(bins) * chances()).sum()) / most)


def test_eqs_6_and_7_by_hand() -> None:
    found, p, most = worth("information-entropy")
    ring = np.minimum((np.arange(6) * CELL_M / SENSOR.range_m * RINGS).astype(int), RINGS - 1)
    middle_m = (ring + 0.5) / RINGS * SENSOR.range_m
    bins = np.rint(stretched(p, middle_m, 0.5 * SENSOR.range_m) * (BINS - 1)).astype(int)
    counts = np.zeros((2, BINS))
    for n, seen in enumerate(chances()):
        counts[int(n >= 4), bins[n]] += seen
    assert found == pytest.approx(float(plogp(counts / most).sum()))


def test_what_is_new_and_old_by_hand() -> None:
    # Half-known and unknown cells are new, mapped ones old; unknown ones hide nothing.
    assert worth("max-new")[0] == pytest.approx(4.0)
    assert worth("min-old")[0] == pytest.approx(4.0 / 6.0)


def test_a_known_wall_hides_what_is_new_behind_it() -> None:
    scene = scene_of(view_of(log_odds_of("..#???"), (0, 0)))
    method = methods.MaxNew(MEANS)
    found = method._worth(scene, np.array([[0, 0]]), EAST)  # pyright: ignore[reportPrivateUsage]
    assert found[0, 0] == 0.0


def test_cells_that_proved_to_be_hidden_are_neither_new_nor_informative() -> None:
    view = view_of(CORRIDOR, (0, 0))
    dull = np.array([[1.0, 1.0, 1.0, 1.0, 0.1, 0.1]])
    scene = methods.Scene(view, MEANS, dull)
    args = scene, np.array([[0, 0]]), EAST
    assert methods.MaxNew(MEANS)._worth(*args)[0, 0] == pytest.approx(2.0)  # pyright: ignore[reportPrivateUsage]
    whole = worth("information-voxel")[0]
    left = methods.Voxel(MEANS)._worth(*args)[0, 0]  # pyright: ignore[reportPrivateUsage]
    assert 0 < left < whole


def test_a_cell_that_was_expected_and_not_measured_loses_interest_until_it_is() -> None:
    memory = Memory(beta=1.0)
    view = view_of(log_odds_of("..???"), (0, 0))
    assert (memory.interest(view) == 1.0).all()
    scene = scene_of(view)
    memory.expect(scene, (0, 0), int(EAST[0]))
    p = np.array([1.0, 1.0, 1.0, 1.0 - scene.stop_p, (1.0 - scene.stop_p) ** 2])
    after = view_of(log_odds_of("..-??"), (0, 0))
    expected = np.exp(-p)
    expected[:3] = 1.0  # mapped, or at least measured
    assert memory.interest(after)[0] == pytest.approx(expected)
    assert memory.interest(after)[0] == pytest.approx(expected), "no look, no loss"
    memory.expect(scene_of(after), (0, 0), int(EAST[0]))
    assert memory.interest(view_of(log_odds_of("....."), (0, 0)))[0, 4] == 1.0


# --- choices --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*RATED, "team-information"])
def test_where_one_half_is_unknown_the_look_goes_there(name: str) -> None:
    look = chosen(name, half_known(), (20, 17))
    assert look is not None
    # Eq. 6 counts what is known for certain too, and so looks along the border.
    assert points_east(look.pose.yaw_rad) or name == "information-entropy"
    assert look.pose.x_m > 10.0 - SENSOR.range_m
    assert look.gain >= PLANNER.min_gain_cells
    assert look.claim[0] > look.pose.x_m
    assert look.path_m[-1].tolist() == [look.pose.x_m, look.pose.y_m]


@pytest.mark.parametrize("name", planar.METHODS.names())
def test_a_method_ends_where_nothing_is_left_to_map(name: str) -> None:
    known = np.full((12, 12), -SURE)
    known[[0, -1]] = known[:, [0, -1]] = SURE
    assert chosen(name, known, (6, 6)) is None
    known[11, 5:8] = 0.0
    assert chosen(name, known, (6, 6)) is None, "three cells are less than is worth a look"
    known[8:11, 3:9] = 0.0
    assert chosen(name, known, (6, 6)) is not None


@pytest.mark.parametrize("name", planar.METHODS.names())
def test_a_method_ends_where_nothing_new_can_be_seen_from_where_one_can_go(name: str) -> None:
    shut = np.zeros((14, 14))
    shut[2:9, 2:9] = SURE
    shut[3:8, 3:8] = -SURE
    assert chosen(name, shut, (5, 5)) is None


@pytest.mark.parametrize("name", planar.METHODS.names())
def test_the_same_view_and_lot_give_the_same_look(name: str) -> None:
    one, again = (chosen(name, half_known(), (20, 10)) for _ in range(2))
    assert one is not None
    assert again is not None
    assert one.pose == again.pose
    assert np.array_equal(one.path_m, again.path_m)
    assert (one.gain, one.claim) == (again.gain, again.claim)


@pytest.mark.parametrize("name", planar.METHODS.names())
def test_looks_are_taken_where_a_robot_can_stand(name: str) -> None:
    log_odds = half_known()
    look = chosen(name, log_odds, (20, 10))
    assert look is not None
    frame = view_of(log_odds, (20, 10)).frame
    cell = frame.cell_of(look.pose.x_m, look.pose.y_m)
    assert np.isfinite(scene_of(view_of(log_odds, (20, 10))).way_m[cell])


def test_the_sensors_noise_and_the_way_count_in_eq_23() -> None:
    scene = scene_of(view_of(half_known(), (20, 5)))
    eyes = np.array([[20, 5], [20, 15]])
    rated = methods.rated(scene, eyes, np.array([[1.0], [1.0]]))
    way_m = 10 * CELL_M
    sigma_m = DRIVE.odometry_sigma * way_m
    p = scene.occupancy_p[20, 15]
    near = PLANNER.w_information
    far = PLANNER.w_information
    far -= PLANNER.w_distance * way_m / SENSOR.range_m
    far -= PLANNER.w_localisation * sigma_m / CELL_M
    assert rated[:, 0] == pytest.approx([near, far * (1 - p)])


def test_random_takes_any_candidate_and_raster_goes_row_by_row() -> None:
    log_odds, rng = half_known(), np.random.default_rng(3)
    method = planar.method("random", MEANS)
    looks = [method.choose(view_of(log_odds, (20, 10)), rng) for _ in range(30)]
    places = {(look.pose.x_m, look.pose.y_m) for look in looks if look}
    yaws = {round(math.degrees(look.pose.yaw_rad)) for look in looks if look}
    assert len(places) > 20
    assert len(yaws) > 6
    raster = Raster(MEANS)
    order = [raster.choose(view_of(log_odds, (20, 10)), rng) for _ in range(12)]
    spots = [(look.pose.x_m, look.pose.y_m) for look in order if look]
    apart = [math.dist(a, b) for n, a in enumerate(spots) for b in spots[:n]]
    assert min(apart) >= 0.5 * SENSOR.range_m - 1e-9
    bands = [int(y // 2.0) for _, y in spots]
    assert bands == sorted(bands), "it goes on to the next row when one is done"
    turns = [round(math.degrees(look.pose.yaw_rad)) for look in order if look]
    assert turns == [30 * n for n in range(12)]


def test_a_raster_that_is_shut_in_looks_all_around() -> None:
    log_odds = np.zeros_like(half_known())
    log_odds[18:23, 8:13] = -3.0
    raster, rng = Raster(MEANS), np.random.default_rng(3)
    order = [raster.choose(view_of(log_odds, (20, 10)), rng) for _ in range(12)]
    assert len({round(math.degrees(look.pose.yaw_rad)) for look in order if look}) == 12


def test_a_method_that_does_not_exist_is_refused() -> None:
    with pytest.raises(PluginError, match='"best"; there are: random, raster'):
        planar.method("best", MEANS)
