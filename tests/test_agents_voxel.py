"""Voxel maps: sets of cells, looks, ground, what rays show, where to look, where one is."""

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter
from team_helpers import SPACE, voxel_look
from voxel_helpers import (
    BUILD,
    CELL_M,
    EXACT,
    MEANS,
    PLANNER,
    SENSOR,
    explored,
    hall,
    map_of,
    standing,
)

from agents.geometry import Pose
from agents.layers import Anchor
from agents.maps.occupancy import LARGEST, MAPPED
from agents.maps.voxel import Cube, VoxelKind, VoxelOccupancy, VoxelSubmap, add_up
from agents.maps.voxellook import VoxelLook, chances, look_odds
from agents.payloads import OccupancyPyramid, RawOccupancy
from agents.voxel.casting import BEARINGS, DISTANCES, Kinds, Matter, cast, first_bearing, star_of
from agents.voxel.choosing import METHODS, method
from agents.voxel.frame import VoxelFrame, VoxelSet, by_block
from agents.voxel.ground import AWAY, FREE, SOLID, UNKNOWN, Build, Ground, corners_of, way_back
from agents.voxel.markov import SWEEPS, relaxed
from agents.voxel.matching import match
from agents.voxel.methods import CLAIM_AHEAD, CLAIM_RADIUS
from agents.voxel.rays import crossings, most_crossed
from agents.voxel.scene import Scene
from agents.voxel.sense import ALL_MISSED, MISSED_POWER, VoxelSense
from agents.voxel.team import CLAIMED, THEIRS, not_theirs
from agents.voxel.view import VoxelView
from agents.voxelcast import SIDE
from comms.plugins import PluginError
from sim.voxel.world import look, observable

HALL = hall()
SURE = Anchor.at(Pose(0.0, 0.0, 0.0, 0.0), (0.0,) * 4)
quick = settings(max_examples=25, deadline=None)
seeds = st.integers(0, 2**32 - 1)


# --- sets and rays --------------------------------------------------------------------------


@given(seed=seeds)
@settings(max_examples=8, deadline=None)
def test_sets_of_voxels_are_as_masks_of_all_cells(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (32, 48, 16)
    dense = [rng.random(shape) < rng.choice([0.0, 0.001, 0.2]) for _ in range(2)]
    one, other = (VoxelSet.of(np.argwhere(mask)) for mask in dense)
    for found, mask in (
        (one & other, dense[0] & dense[1]),
        (one & ~other, dense[0] & ~dense[1]),
        (~(~one & ~other), dense[0] | dense[1]),
    ):
        assert found.any() == mask.any()
        assert found.sum() == mask.sum()
        assert {*map(tuple, found.cells())} == {*map(tuple, np.argwhere(mask))}
    assert (~one).any()


@given(seed=seeds)
@quick
def test_a_ray_crosses_cells_one_beside_the_other_and_each_holds_its_part(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, ray = rng.uniform(-5, 5, 3), rng.normal(size=3)
    if rng.random() < 0.3:
        ray[int(rng.integers(3))] = 0.0
    ray /= np.linalg.norm(ray)
    reach = float(rng.uniform(0.5, 12))
    most = most_crossed(reach)
    cells, entry = np.empty((most, 3), dtype=np.int64), np.empty(most)
    count = crossings(start, ray, reach, cells, entry)
    assert count < most
    ends = np.append(entry[:count], reach)
    middles = start + 0.5 * (ends[1:] + ends[:-1])[:, None] * ray
    assert np.array_equal(np.floor(middles + 1e-12).astype(int), cells[:count])
    assert (np.abs(np.diff(cells[:count], axis=0)).sum(axis=1) == 1).all()


# --- a look ---------------------------------------------------------------------------------


def test_a_look_frees_the_way_to_what_it_meets_and_knows_nothing_behind_it() -> None:
    pose = standing(HALL, (4, 7, 6))
    ranges_m = look(HALL, pose, 0.0, SENSOR, None)
    found = look_odds(ranges_m, pose, 0.0, HALL.frame, SENSOR, extra_variance=(0.0,) * 4)
    assert len({*map(tuple, found.cells)}) == len(found.cells)
    solid = HALL.solid[tuple(found.cells.T)]
    sure = np.abs(found.log_odds) > MAPPED
    assert ((found.log_odds > 0) == solid)[sure].mean() > 0.995
    assert sure.mean() > 0.9
    beside_free = maximum_filter(~HALL.solid, 3)
    assert beside_free[tuple(found.cells.T)].all(), "no ray goes into the rock"
    assert (found.cells[solid][:, 2] == 22).any(), "the wall with the door is met"


def test_who_does_not_know_where_it_stands_is_unsure_of_all_that_it_sees() -> None:
    pose = standing(HALL, (4, 7, 6))
    ranges_m = look(HALL, pose, 0.0, SENSOR, None)
    looks = [
        look_odds(ranges_m, pose, 0.0, HALL.frame, SENSOR, extra_variance=variance)
        for variance in ((0.0,) * 4, (0.0, 0.0, CELL_M**2, 0.0), (CELL_M**2,) * 2 + (0.0, 0.0))
    ]
    for unsure in looks[1:]:
        assert np.allclose(unsure.log_odds, looks[0].log_odds / 2)


def test_chances_are_certain_up_to_what_is_known_and_none_behind_it() -> None:
    everything = map_of(HALL, np.ones(HALL.solid.shape, dtype=bool))
    pose = standing(HALL, (4, 7, 6))
    scene = Scene(VoxelView(HALL.frame, everything, pose=pose), MEANS)
    cells, p = chances(scene.packed.index, scene.through, 0.9, pose, 0.0, HALL.frame, SENSOR)
    assert np.all(p == 1.0)
    truly = np.zeros(HALL.solid.shape, dtype=bool)
    found = look_odds(
        look(HALL, pose, 0.0, SENSOR, None), pose, 0.0, HALL.frame, SENSOR,
        extra_variance=(0.0,) * 4,
    )  # fmt: skip
    truly[tuple(found.cells.T)] = True
    assert truly[tuple(cells.T)].mean() > 0.97
    nothing = Scene(VoxelView(HALL.frame, VoxelOccupancy({}), pose=pose), MEANS)
    _, vague = chances(nothing.packed.index, nothing.through, 0.9, pose, 0.0, HALL.frame, SENSOR)
    assert vague.max() <= 1.0
    assert vague.min() >= 0.02 * 0.9


# --- the map --------------------------------------------------------------------------------


def test_only_blocks_are_kept_in_which_something_was_seen() -> None:
    huge = VoxelFrame(0.0, 0.0, 0.1, 100_000, 100_000, 0.0, 10_000)
    submap = VoxelSubmap(huge, SURE)
    cells = np.array([(5, 7, 9), (5000, 70_000, 90_000), (5, 7, 10)])
    submap.observe(VoxelLook(cells, np.array([1.0, -2.0, 3.0])))
    assert sorted(submap.cubes) == [(0, 0, 0), (312, 4375, 5625)]
    assert submap.known.sum() == 3
    assert VoxelKind().drawn(submap, (slice(0, 16),) * 3).known.sum() == 2


def test_looks_add_up_to_a_limit() -> None:
    submap = VoxelSubmap(SPACE, SURE)
    for odds, total in ((1.5, 1.5), (0.6, 2.1), (4.0, LARGEST), (-8.0, -2.71)):
        submap.observe(VoxelLook(np.array([(3, 4, 17)]), np.array([odds])))
        assert submap.cubes[0, 0, 1].log_odds[3, 4, 1] == pytest.approx(total)


def one(odds: float) -> VoxelOccupancy:
    cube = Cube(np.zeros((16, 16, 16)), np.zeros((16, 16, 16), dtype=np.uint16))
    cube.log_odds[0, 0, 0], cube.looks[0, 0, 0] = odds, 1
    return VoxelOccupancy({(1, 2, 3): cube})


def test_over_origins_log_odds_add_up_and_within_one_the_surest_counts() -> None:
    kind = VoxelKind()
    both = add_up([one(1.0), one(-2.5), VoxelOccupancy({})])
    assert both.cubes[1, 2, 3].log_odds[0, 0, 0] == -1.5
    assert both.known.sum() == 1
    for pair in ((one(1.0), one(-1.0)), (one(-1.0), one(1.0))):
        assert kind.surest(*pair).cubes[1, 2, 3].log_odds[0, 0, 0] == 1.0
    assert kind.surest(one(1.0), one(-2.0)).cubes[1, 2, 3].log_odds[0, 0, 0] == -2.0


def test_a_moved_anchor_moves_the_map_and_lifts_it() -> None:
    submap = VoxelSubmap(SPACE, Anchor.at(Pose(16.0, 1.0, 0.0, 0.0), (1e-8,) * 4))
    submap.observe(voxel_look(np.random.default_rng(3)))
    drawn = VoxelKind().drawn(submap, (slice(None), slice(None)))
    there = Pose(16.0 + 2 * SPACE.cell_m, 1.0, SPACE.cell_m, 0.0)
    moved = VoxelKind().moved(drawn, submap.anchor.moved_to(there, (1e-8,) * 4), SPACE)
    before, after = drawn.dense(SPACE), moved.dense(SPACE)
    assert np.array_equal(after[1:, :, 2:], before[:-1, :, :-2], equal_nan=True)
    turned = submap.anchor.moved_to(Pose(16.0, 1.0, 0.0, math.pi / 2), (1e-8,) * 4)
    spun = VoxelKind().moved(drawn, turned, SPACE)
    assert 0.5 * drawn.known.sum() < spun.known.sum() <= 1.2 * drawn.known.sum()


def test_a_map_that_does_not_know_how_high_it_lies_knows_of_no_cell_for_certain() -> None:
    unsure = Anchor.at(Pose(16.0, 1.0, 0.0, 0.0), (0.0, 0.0, SPACE.cell_m**2, 0.0))
    blurred = VoxelKind().blurred(one(4.0), unsure, SPACE)
    assert 1.8 < blurred.cubes[1, 2, 3].log_odds[0, 0, 0] <= 2.0


@pytest.mark.parametrize("payloads", [OccupancyPyramid(), RawOccupancy()], ids=["levels", "raw"])
@given(seed=seeds)
@settings(max_examples=8, deadline=None)
def test_a_cube_comes_back_as_it_was_said_to_be_sent(payloads, seed: int) -> None:
    kind, submap = VoxelKind(payloads), VoxelSubmap(SPACE, SURE)
    submap.observe(voxel_look(np.random.default_rng(seed)))
    window = (slice(0, 16),) * 3
    encoded = kind.encode(submap, window)
    told = kind.decode(encoded.data, (16, 16, 16))
    if submap.cubes.get((0, 0, 0)) is None:
        assert told is None or not told.known.any()
        return
    assert told is not None
    sent = kind.as_sent(submap, window).cubes[0, 0, 0]
    assert np.allclose(told.cubes[0, 0, 0].log_odds, sent.log_odds)
    assert np.array_equal(told.cubes[0, 0, 0].looks > 0, sent.looks > 0)
    assert kind.level(encoded.data, (16, 16, 16)) == len(encoded.level_ends) - 1
    assert kind.decode(encoded.data, (32, 32, 32)) is None or isinstance(payloads, RawOccupancy)


# --- where one can stand --------------------------------------------------------------------


def ground_of(
    solid: np.ndarray, build: Build = BUILD, unknown: tuple[tuple[int, int, int], ...] = ()
) -> Ground:
    """Return the ground of a small world (layers, rows, cols) that fits in one block."""
    states = np.full((1, SIDE, SIDE, SIDE), SOLID, dtype=np.int8)
    place = tuple(slice(0, n) for n in solid.shape)
    states[0][place] = np.where(solid, SOLID, FREE)
    for cell in unknown:
        states[(0, *cell)] = UNKNOWN
    index = np.zeros((1, 1, 1), dtype=np.int32)
    return Ground(index, states, np.zeros((1, 3), dtype=np.int64), build)


def room() -> np.ndarray:
    solid = np.ones((14, 10, 12), dtype=bool)
    solid[2:7, 1:9, 1:11] = False
    return solid


def test_a_robot_stands_where_there_is_floor_headroom_and_room_beside() -> None:
    assert Build(4, 1, 0.8) == BUILD
    solid = room()
    solid[5, 1:9, 8:11] = True  # a shelf under which there are three free cells
    ground = ground_of(solid)
    stands = {tuple(cell) for cell in ground.cells}
    assert (2, 4, 5) in stands
    assert (2, 4, 9) not in stands, "too low under the shelf"
    assert (2, 4, 7) not in stands, "its disc would touch the shelf"
    assert (2, 1, 5) not in stands, "or the wall"
    assert (6, 4, 9) not in stands, "and no headroom on the shelf"
    assert ground.place_at(3, 4, 5, 1) >= 0
    assert ground.place_at(4, 4, 5, 1) == AWAY


def test_a_small_gap_in_what_is_known_of_a_floor_is_floor_and_a_large_one_is_not() -> None:
    assert ground_of(room(), unknown=((1, 4, 5),)).place_at(2, 4, 5, 0) >= 0
    hole = tuple((1, row, col) for row in range(2, 7) for col in range(3, 8))
    gap = ground_of(room(), unknown=hole)
    assert gap.place_at(2, 2, 5, 0) >= 0, "at its edge"
    assert gap.place_at(2, 4, 5, 0) == AWAY
    solid = room()
    solid[1, 4, 5] = False
    assert ground_of(solid).place_at(2, 4, 5, 0) == AWAY, "what is seen to be a hole is one"


def test_where_wheels_have_stood_is_floor_whatever_looks_said() -> None:
    told = map_of(HALL, np.ones(HALL.solid.shape, dtype=bool))
    cell = (4, 7, 10)
    told.cubes[0, 0, 0].log_odds[3, 7, 10] = -4.0
    view = VoxelView(HALL.frame, told, pose=standing(HALL, (4, 7, 6)))
    assert Scene(view, MEANS).ground.place_at(*cell, 0) == AWAY
    stood = replace(view, stood=np.array([cell]))
    assert Scene(stood, MEANS).ground.place_at(*cell, 0) >= 0


def test_a_robot_climbs_one_step_and_not_two() -> None:
    for rise, reached in ((1, True), (2, False)):
        solid = room()
        solid[2 : 2 + rise, :, 6:] = True
        ground = ground_of(solid, replace(BUILD, tall=3))
        low, high = ground.place_at(2, 4, 3, 0), ground.place_at(2 + rise, 4, 8, 0)
        assert min(low, high) >= 0
        assert ground.reachable(low)[high] == reached
        assert ground.reachable(high)[low] == reached


def test_floors_lie_over_each_other_and_ways_do_not_mix_them() -> None:
    solid = np.ones((16, 10, 12), dtype=bool)
    solid[2:6, 1:9, 1:11] = False
    solid[8:12, 1:9, 1:11] = False
    ground = ground_of(solid)
    low, high = ground.place_at(2, 4, 5, 0), ground.place_at(8, 4, 5, 0)
    assert min(low, high) >= 0
    assert not ground.reachable(low)[high]


def test_ways_are_as_long_as_they_are_and_cut_no_corner() -> None:
    solid = room()
    solid[2:7, 4, 1:7] = True
    ground = ground_of(solid, replace(BUILD, reach=0.4))
    start, end = ground.place_at(2, 2, 2, 0), ground.place_at(2, 6, 2, 0)
    way, parent = ground.field(start)
    cells = ground.cells[way_back(parent, end)]
    assert (cells[0] == (2, 2, 2)).all()
    assert (cells[-1] == (2, 6, 2)).all()
    # Four cells along the wall and one askew, two across its end, one askew and four back.
    assert way[end] == pytest.approx(10 + 2 * math.sqrt(2))
    steps = np.abs(np.diff(cells[:, 1:], axis=0))
    assert steps.max() == 1
    for a, b in itertools.pairwise(cells):
        assert not solid[2, a[1], b[2]]
        assert not solid[2, b[1], a[2]]
    corners = corners_of(cells)
    assert len(corners) < len(cells)
    assert np.abs(np.diff(corners[:, 1:], axis=0)).max() > 1


# --- what rays show -------------------------------------------------------------------------


def test_a_look_into_the_open_shows_as_many_cells_as_fit_in_its_view() -> None:
    star = star_of(SENSOR, PLANNER, CELL_M)
    blank = np.zeros((0, SIDE, SIDE, SIDE), dtype=np.float32)
    matter = Matter(np.full((4, 4, 4), -1, dtype=np.int32), (64, 64, 64), blank, blank, (1.0, 1.0))
    classes = np.zeros((DISTANCES, 1), dtype=np.int64)
    kinds = Kinds(blank.astype(np.uint8), 0, classes, 1)
    gain, tally = cast(matter, kinds, star, np.array([[32, 32, 32]]))
    level = star.window(tally.astype(np.float64), 0.0)[0, :, 0]
    assert level == pytest.approx(np.full(BEARINGS, star.most_cells), rel=0.05)
    volume = math.radians(90.0) * 2 * math.sin(math.radians(37.5)) * (5.0 / CELL_M) ** 3 / 3
    assert star.most_cells == pytest.approx(volume)
    assert gain.shape == (1, len(star.counts))


def test_a_wall_hides_what_lies_behind_it_and_half_lets_half_through() -> None:
    star = star_of(SENSOR, PLANNER, CELL_M)
    index = np.full((4, 4, 4), -1, dtype=np.int32)
    index[:, :, 2] = np.arange(16).reshape(4, 4)
    found = []
    for passes in (1.0, 0.5, 0.0):
        through = np.ones((16, SIDE, SIDE, SIDE), dtype=np.float32)
        through[..., 8] = passes
        lacking = np.zeros_like(through)
        lacking[..., 9:] = 1.0
        matter = Matter(index, (64, 64, 64), through, lacking, (1.0, 0.0))
        kinds = Kinds(np.zeros(through.shape, dtype=np.uint8), 0,
                      np.zeros((DISTANCES, 1), dtype=np.int64), 1)  # fmt: skip
        gain, _ = cast(matter, kinds, star, np.array([[32, 32, 31]]))
        found.append(star.window(gain, 0.0)[0, first_bearing(0.0, star.width)])
    assert found[2] == 0.0
    assert 0.25 * found[0] < found[1] < 0.5 * found[0], "askew it is thicker"
    assert found[0] > 100


def test_unknown_cells_take_after_their_neighbours_and_known_ones_stay() -> None:
    rng = np.random.default_rng(0)
    p = rng.uniform(0, 1, (2, SIDE, SIDE, SIDE)).astype(np.float32)
    known = np.zeros(p.shape, dtype=bool)
    known[0, :4] = True
    p[0, :4] = 0.9
    index = np.full((1, 1, 3), -1, dtype=np.int32)
    index[0, 0, 0], index[0, 0, 1] = 0, 1
    corners = np.array([(0, 0, 0), (0, 0, SIDE)])
    found = relaxed(index, p, known, corners)
    assert np.array_equal(found[known], p[known])
    column = found[0, 4:, 8, 8]
    assert (np.diff(column) <= 1e-6).all(), "farther off it is less sure"
    assert column[0] > 0.6
    assert found[0, 4 + SWEEPS, 8, 8] == 0.5, "and no farther than so many cells"
    assert found[1, 2, 8, 0] > found[1, 2, 8, 1] > 0.5, "across the edge of a block"


# --- choosing -------------------------------------------------------------------------------

SEEN = observable(HALL, SENSOR, EXACT, PLANNER.tilts_deg)


def view_of(share: int, cell: tuple[int, int, int] = (4, 7, 6)) -> VoxelView:
    """Return what a robot knows that has seen all west of a column."""
    west = SEEN & (np.arange(HALL.frame.cols) < share)[None, None, :]
    return VoxelView(HALL.frame, map_of(HALL, west), pose=standing(HALL, cell))


@pytest.mark.parametrize("name", METHODS.own)
def test_every_method_looks_where_something_is_to_be_seen_until_nothing_is(name: str) -> None:
    chooser = method(name, MEANS)
    choice = chooser.choose(view_of(22), np.random.default_rng(1))
    assert choice is not None
    path = choice.path_m
    assert len(path) <= len(choice.cells)
    ground = HALL.ground(BUILD)
    for x, y in path:
        layer, row, col = HALL.frame.voxel_of(float(x), float(y), 0.1)
        assert ground.place_at(layer, row, col, 2) >= 0
    assert math.dist(path[0], (view_of(22).pose.x_m, view_of(22).pose.y_m)) < 1e-9
    if name not in ("random", "raster"):
        assert choice.gain >= PLANNER.min_gain_cells
    assert chooser.choose(view_of(44), np.random.default_rng(1)) is None


def test_what_proved_not_to_be_visible_is_not_looked_for() -> None:
    view = view_of(22)
    dull = {block: np.zeros((16, 16, 16)) for block in np.ndindex(2, 1, 3)}
    chooser = method("information-voxel", MEANS)
    assert chooser.choose(view, np.random.default_rng(1)) is not None
    assert chooser.choose(replace(view, interest=dull), np.random.default_rng(1)) is None


def test_a_team_mates_claim_turns_the_others_look_elsewhere() -> None:
    # In the middle of the hall, in the dark: east is as good as west.
    alone = VoxelView(HALL.frame, VoxelOccupancy({}), pose=standing(HALL, (5, 7, 22)))
    ours = method("team-information", MEANS)
    first = ours.choose(alone, np.random.default_rng(1))
    assert first is not None
    claimed = ours.choose(replace(alone, claims=(first.claim,)), np.random.default_rng(1))
    assert claimed is not None
    assert math.dist(first.claim[:2], claimed.claim[:2]) > 1.0
    silent = ours.choose(alone, np.random.default_rng(1))
    assert silent is not None
    assert silent.claim == first.claim, "it is free again when the claim is gone"


def test_what_a_team_mate_stands_nearer_to_counts_half_and_what_it_claims_a_tenth() -> None:
    view = view_of(22)
    scene = Scene(view, MEANS)
    here = np.array([scene.place])
    assert not_theirs(scene, here) == pytest.approx(np.ones((1, BEARINGS)))
    east_m = CLAIM_AHEAD * SENSOR.range_m
    mate = replace(view.pose, x_m=view.pose.x_m + 1.5 * east_m)
    share = not_theirs(Scene(replace(view, others=(mate,)), MEANS), here)[0]
    assert share[0] == THEIRS
    assert share[BEARINGS // 2] == 1.0, "away from it"
    eye = scene.view.frame.centres_m(scene.eyes(here))[0]
    ahead = (float(eye[0]) + east_m, float(eye[1]), CLAIM_RADIUS * SENSOR.range_m)
    share = not_theirs(Scene(replace(view, claims=(ahead,)), MEANS), here)[0]
    assert share[0] == pytest.approx(CLAIMED, abs=0.05)
    assert share[BEARINGS // 2] > 0.99


def test_no_method_ends_because_the_lot_left_out_the_one_place_that_shows_something() -> None:
    few = replace(MEANS, planner=PLANNER.model_copy(update={"max_candidates": 1}))
    west = SEEN & (np.arange(HALL.frame.cols) < 26)[None, None, :]
    view = VoxelView(HALL.frame, map_of(HALL, west), pose=standing(HALL, (4, 3, 3)))
    own = Scene(view, few)
    assert len(own.candidates(np.random.default_rng(1))) == 1
    assert len(own.everywhere()) > 5
    for name in METHODS.own:
        assert method(name, few).choose(view, np.random.default_rng(1)) is not None


def sense_of() -> VoxelSense:
    told = {"frame": HALL.frame, "sensor": SENSOR, "drive": EXACT, "planner": PLANNER}
    return VoxelSense(SimpleNamespace(**told, method="max-new"))  # type: ignore[arg-type]


def test_a_look_that_shows_nothing_of_what_it_was_expected_to_is_not_chosen_for_ever() -> None:
    sense, nothing = sense_of(), VoxelOccupancy({})
    view = VoxelView(HALL.frame, nothing, pose=standing(HALL, (4, 7, 6)))
    sense.expect(view, view.pose, 0.0)
    cells, p = sense._expected
    unlikely = cells[np.argmin(p)]
    block, at = tuple(int(n) // SIDE for n in unlikely), tuple(unlikely % SIDE)
    sense.fused(nothing)
    assert sense._interest[block][at] == pytest.approx(
        math.exp(-max(ALL_MISSED, float(p.min())) * PLANNER.beta)
    )


def test_a_look_that_shows_most_blames_what_it_missed_by_its_chance() -> None:
    sense, nothing = sense_of(), VoxelOccupancy({})
    view = VoxelView(HALL.frame, nothing, pose=standing(HALL, (4, 7, 6)))
    sense.expect(view, view.pose, 0.0)
    cells, p = sense._expected
    seen = np.zeros(HALL.solid.shape, dtype=bool)
    seen[tuple(cells[p > np.median(p)].T)] = True
    sense.fused(map_of(HALL, seen))
    missed = ~seen[tuple(cells.T)]
    share = p[missed].sum() / p.sum()
    blamed = np.maximum(p[missed], ALL_MISSED * share**MISSED_POWER)
    found = [
        sense._interest[tuple(int(n) // SIDE for n in cell)][tuple(cell % SIDE)]
        for cell in cells[missed]
    ]
    assert found == pytest.approx(np.exp(-PLANNER.beta * blamed))


@pytest.mark.parametrize("name", ["max-new", "min-old", "team-information"])
def test_a_method_ends_by_itself_and_not_before_all_is_mapped(name: str) -> None:
    looks, known, ended = explored(HALL, MEANS, name, 150)
    assert ended
    sure = np.zeros(HALL.solid.shape, dtype=bool)
    for block, cube in known.cubes.items():
        layer, row, col = (n * SIDE for n in block)
        part = sure[layer : layer + SIDE, row : row + SIDE, col : col + SIDE]
        part[:] = (np.abs(cube.log_odds) > MAPPED)[tuple(slice(n) for n in part.shape)]
    assert (sure & SEEN).sum() > 0.97 * SEEN.sum(), looks


def test_a_robot_in_the_dark_stands_where_it_stands_and_can_look() -> None:
    view = VoxelView(HALL.frame, VoxelOccupancy({}), pose=standing(HALL, (4, 7, 6)))
    scene = Scene(view, MEANS)
    assert scene.place >= 0
    choice = method("information-voxel", MEANS).choose(view, np.random.default_rng(1))
    assert choice is not None
    assert choice.gain > PLANNER.min_gain_cells


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(PluginError, match='none is named "best"'):
        method("best", MEANS)


# --- where one is ---------------------------------------------------------------------------


@pytest.mark.parametrize("cell", [(4, 7, 6), (5, 7, 38)])
def test_a_look_tells_where_it_was_taken(cell: tuple[int, int, int]) -> None:
    scene = Scene(VoxelView(HALL.frame, map_of(HALL, SEEN), pose=standing(HALL, cell)), MEANS)
    rng = np.random.default_rng(2)
    for turn in (0.3, 2.0, -1.5):
        true = standing(HALL, cell, turn)
        ranges_m = look(HALL, true, -0.3, SENSOR, rng)
        off = rng.normal(size=4) * (0.05, 0.05, 0.05, 0.01)
        believed = Pose(
            true.x_m + off[0], true.y_m + off[1], true.z_m + off[2], true.yaw_rad + off[3]
        )
        prior = np.diag([0.05**2, 0.05**2, 0.05**2, 0.01**2])
        found = match(
            scene.packed.index, scene.charted, HALL.frame, believed, -0.3, prior, ranges_m, SENSOR
        )
        assert found is not None
        error = np.array(
            (found.pose.x_m - true.x_m, found.pose.y_m - true.y_m, found.pose.z_m - true.z_m)
        )
        sigma = np.sqrt(np.diag(found.covariance))
        assert np.abs(error[2]) < 0.02, "the floor tells the height"
        assert (np.abs(error) < np.maximum(4 * sigma[:3], 0.04)).all()
        assert (np.linalg.eigvalsh(found.covariance) > 0).all()


def test_where_nothing_is_mapped_a_look_tells_nothing() -> None:
    scene = Scene(VoxelView(HALL.frame, VoxelOccupancy({}), pose=standing(HALL, (4, 7, 6))), MEANS)
    pose = standing(HALL, (4, 7, 6))
    ranges_m = look(HALL, pose, 0.0, SENSOR, None)
    found = match(
        scene.packed.index, scene.charted, HALL.frame, pose, 0.0, np.eye(4), ranges_m, SENSOR
    )
    assert found is None


def test_cells_are_told_apart_by_block_in_order() -> None:
    cells = np.array([(0, 0, 17), (20, 1, 1), (0, 0, 18), (0, 0, 1)])
    parts = by_block(cells)
    assert [block for block, _, _ in parts] == [(0, 0, 0), (0, 0, 1), (1, 0, 0)]
    assert [which.tolist() for _, which, _ in parts] == [[3], [0, 2], [1]]
    assert parts[1][2].tolist() == [1, 2]
    assert by_block(np.zeros((0, 3), dtype=np.int64)) == []
