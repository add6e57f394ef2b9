"""Kinds of map: the same laws for each, and what planar occupancy is by itself."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_helpers import measure, robot_on, save
from team_helpers import (
    FRAME,
    FRAMES,
    GRID,
    KINDS,
    LOOKS,
    START,
    SUBMAPS,
    SURE,
    cells_of,
    certainty,
    certainty_of,
    chunks_of,
    cut,
    hear,
    hear_anchors,
    known_in,
    layer,
    looks_in,
    nowhere,
    planar_look,
    team_map,
)

from agents.geometry import GridFrame, Pose
from agents.layers import Anchor, OwnLayer
from agents.maps.occupancy import LARGEST, MAPPED, probability
from agents.maps.planar import Occupancy, PlanarKind, PlanarSubmap, add_up, nothing, surest
from agents.maps.planarlook import LookOdds, look_odds, visible_cells
from agents.payloads import OccupancyPyramid, RawOccupancy
from agents.planning.information import binary_entropy
from agents.settings import SensorSettings
from agents.store import AnchorKey, Origin
from agents.teammap import TeamMap

quick = settings(max_examples=20, deadline=None)
seeds = st.integers(0, 2**32 - 1)
ME, MATE, THIRD = Origin(0, 0), Origin(1, 0), Origin(2, 0)
kinds = pytest.mark.parametrize("kind", KINDS)
PAYLOADS = [OccupancyPyramid(), RawOccupancy()]


def same(one: TeamMap, other: TeamMap) -> bool:
    a, b = one.fused(), other.fused()
    return np.array_equal(certainty(a), certainty(b)) and np.array_equal(looks_in(a), looks_in(b))


# --- laws of all kinds ----------------------------------------------------------------------


@given(seed=seeds, luck=st.randoms(use_true_random=False))
@quick
@kinds
def test_equal_stores_give_equal_maps_whatever_came_first_and_how_often(
    kind: str, seed: int, luck
) -> None:
    rng = np.random.default_rng(seed)
    theirs, third = layer(rng, submaps=2, kind=kind), layer(rng, kind=kind)
    chunks = [*chunks_of(theirs, MATE), *chunks_of(third, THIRD)]
    heard = [piece for chunk in chunks for piece in cut(chunk, 23)]
    maps: list[TeamMap] = []
    for repeats in (1, 2):
        maps.append(team_map(ME, kind=kind))
        for _ in range(repeats):
            hear(maps[-1], heard)
            hear_anchors(maps[-1], theirs, MATE)
            hear_anchors(maps[-1], third, THIRD)
            luck.shuffle(heard)
    assert maps[0].store.digest() == maps[1].store.digest()
    assert same(*maps)


@given(seed=seeds)
@quick
@kinds
def test_a_team_is_never_surer_than_its_robots_looks(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    measured, owns = nowhere(kind), []
    for _ in range(2):
        own = OwnLayer(FRAMES[kind], SUBMAPS[kind])
        own.begin_submap(START, SURE)
        for _ in range(3):
            look = LOOKS[kind](rng)
            own.submaps[-1].observe(look)
            measured[cells_of(look)] += certainty_of(look)
        owns.append(own)
    team = team_map(ME, owns[0], kind=kind)
    hear(team, chunks_of(owns[1], MATE))
    hear_anchors(team, owns[1], MATE)
    fused, heard = team.fused(), team.as_heard()
    assert np.all(certainty(fused) <= measured * (1 + 1e-9))
    assert np.all(certainty(heard) <= certainty(fused) * (1 + 1e-6) + 1e-9)
    assert np.array_equal(known_in(fused), measured > 0)
    assert np.array_equal(known_in(heard), measured > 0)


@given(seed=seeds, size=st.integers(6, 40))
@quick
@kinds
def test_no_piece_of_news_makes_a_cell_less_sure_or_loses_it(
    kind: str, seed: int, size: int
) -> None:
    """All looks are true here, so a newer version is surer everywhere."""
    rng = np.random.default_rng(seed)
    own = layer(rng, kind=kind)
    older = chunks_of(own, MATE, version=1)
    own.submaps[0].observe(LOOKS[kind](rng))
    team = team_map(ME, kind=kind)
    hear_anchors(team, own, MATE)
    for chunk in [*older, *chunks_of(own, MATE, version=2)]:
        before, complete = team.tile_estimate(chunk.key), chunk.version == 1
        for piece in cut(chunk, size)[: None if complete else -1]:
            hear(team, [piece])
            after = team.tile_estimate(chunk.key)
            assert np.all(certainty(after) >= certainty(before) * (1 - 1e-9))
            assert not (before.known & ~after.known).any()
            before = after


@kinds
def test_a_robot_comes_back_from_disk_with_what_it_measured(kind: str, tmp_path: Path) -> None:
    first = robot_on(tmp_path, kind=kind)
    for seed in range(3):
        measure(first, LOOKS[kind](np.random.default_rng(seed)))
    save(first)
    second = robot_on(tmp_path, kind=kind)
    assert second.me == Origin(0, 1)
    assert np.array_equal(certainty(second.team.fused()), certainty(first.team.fused()))
    assert second.own.submaps[0].cells() == first.own.submaps[0].cells()


# --- occupancy ------------------------------------------------------------------------------


def one_cell(log_odds: float, looks: int = 1) -> Occupancy:
    return Occupancy(np.array([[log_odds]]), np.array([[looks]], dtype=np.uint16))


def test_looks_add_up_to_a_limit_and_a_cell_is_mapped_beyond_nine_to_one() -> None:
    submap = PlanarSubmap(FRAME, Anchor.at(START, (0.0,) * 4))
    at = np.array([3]), np.array([4])
    for log_odds, total in ((1.5, 1.5), (0.6, 2.1), (0.2, 2.3), (4.0, LARGEST), (-8.0, -2.71)):
        submap.observe(LookOdds(*at, np.array([log_odds])))
        assert submap.log_odds[3, 4] == pytest.approx(total)
        drawn = PlanarKind().drawn(submap, GRID.window(0))
        assert drawn.mapped[3, 4] == (abs(total) > MAPPED)
    assert submap.looks[3, 4] == 5
    assert np.count_nonzero(submap.known) == 1
    assert probability(np.array([MAPPED, -MAPPED])) == pytest.approx([0.9, 0.1])


@pytest.mark.parametrize(("first", "second", "best"), [(1, -2, -2), (3, -2, 3), (-1, 1, 1)])
def test_of_one_origin_the_surest_counts_whatever_it_says(
    first: float, second: float, best: float
) -> None:
    for pair in ((first, second), (second, first)):
        assert surest(*(one_cell(v) for v in pair)).log_odds[0, 0] == best


def test_over_origins_log_odds_add_up_and_who_knows_nothing_adds_nothing() -> None:
    fused = add_up([one_cell(1.0), one_cell(-2.5), nothing((1, 1))], (1, 1))
    assert (fused.log_odds[0, 0], fused.looks[0, 0]) == (-1.5, 2)
    certain = add_up([one_cell(4.0), one_cell(4.0)], (1, 1))
    assert certain.log_odds[0, 0] == LARGEST
    # Bayes: two independent opinions of 0.8 make 16 to 1.
    two = add_up([one_cell(math.log(4.0))] * 2, (1, 1))
    assert probability(two.log_odds)[0, 0] == pytest.approx(16 / 17)


def test_information_is_what_a_cell_is_surer_by_than_one_half() -> None:
    log_odds = np.array([[0.0, math.log(9.0), -math.log(9.0), 5.0]])
    looks = np.array([[1, 1, 1, 0]], dtype=np.uint16)
    bits = Occupancy(log_odds, looks).information_bits
    assert bits == pytest.approx(2 * (1 - float(binary_entropy(0.9))))
    assert PlanarKind().bits(nothing((3, 3))) == 0


def test_a_map_that_does_not_know_where_it_lies_knows_of_no_cell_for_certain() -> None:
    unsure = Anchor.at(Pose(16.25, 1.25, 0.0, 0.0), (FRAME.cell_m**2, FRAME.cell_m**2, 0.0, 0.0))
    drawing = Occupancy(np.full(FRAME.shape, 4.0), np.ones(FRAME.shape, dtype=np.uint16))
    blurred = PlanarKind().blurred(drawing, unsure, FRAME)
    assert np.all((blurred.log_odds > 1.8) & (blurred.log_odds <= 2.0))
    turning = Anchor.at(Pose(10.25, -3.75, 0.0, 0.0), (0.0, 0.0, 0.0, 0.01))
    by_distance = PlanarKind().blurred(drawing, turning, FRAME).log_odds
    assert by_distance[0, 0] > by_distance[0, 10] > by_distance[10, 10]


def test_a_moved_anchor_moves_the_floor() -> None:
    own = layer(np.random.default_rng(3), kind="planar")
    team = team_map(ME, kind="planar")
    hear(team, chunks_of(own, MATE))
    hear_anchors(team, own, MATE)
    before, anchor = team.fused().log_odds, own.submaps[0].anchor
    pose = anchor.pose
    east = Pose(pose.x_m + 2 * FRAME.cell_m, pose.y_m, pose.z_m, pose.yaw_rad)
    team.store.offer_anchor(AnchorKey(*MATE, 0), anchor.moved_to(east, anchor.variance))
    team.own_changed()
    assert np.allclose(team.fused().log_odds[:, 2:], before[:, :-2])


# --- on the air -----------------------------------------------------------------------------


@pytest.mark.parametrize("payloads", PAYLOADS, ids=lambda p: type(p).__name__)
@given(seed=seeds, size=st.integers(5, 50))
@quick
def test_occupancy_is_told_no_surer_than_it_is_and_never_the_other_way_round(
    payloads, seed: int, size: int
) -> None:
    rng = np.random.default_rng(seed)
    known = rng.random((16, 12)) < 0.7
    log_odds = np.where(known, np.clip(rng.normal(0, 3, known.shape), -LARGEST, LARGEST), 0.0)
    encoded = payloads.encode(log_odds, known)
    for end in {*range(0, len(encoded.data), size), len(encoded.data)}:
        told = payloads.decode(encoded.data[:end], known.shape)
        if told is None:
            continue
        assert not (told.known & ~known).any()
        assert np.all(np.abs(told.log_odds) <= np.abs(log_odds) + 1e-9)
        assert np.all(told.log_odds * log_odds >= 0)
    whole = payloads.decode(encoded.data, known.shape)
    assert whole is not None
    assert np.array_equal(whole.known, known)
    assert np.array_equal(whole.log_odds, payloads.as_sent(log_odds, known))
    assert np.array_equal(payloads.as_sent(whole.log_odds, known), whole.log_odds)
    mapped, told_mapped = np.abs(log_odds) > 2.21, np.abs(whole.log_odds) > MAPPED
    lost = mapped & ~told_mapped if isinstance(payloads, OccupancyPyramid) else mapped & False
    assert not lost.any(), "what is mapped is told as mapped"
    assert payloads.decode(encoded.data, (16, 13)) is None or isinstance(payloads, RawOccupancy)


@pytest.mark.parametrize("payloads", PAYLOADS, ids=lambda p: type(p).__name__)
@given(data=st.binary(max_size=80))
@quick
def test_bytes_that_are_no_floor_tell_nothing_or_some_floor(payloads, data: bytes) -> None:
    told = payloads.decode(data, (8, 8))
    assert told is None or (told.known.shape == (8, 8) and np.isfinite(told.log_odds).all())


# --- a look ---------------------------------------------------------------------------------

ROOM = GridFrame(0.0, 0.0, 0.5, 9, 11)
SENSOR = SensorSettings(fov_deg=90.0, range_m=4.0, columns=64, noise_s=0.0008)


def test_a_look_frees_the_way_to_what_it_meets() -> None:
    solid = np.zeros(ROOM.shape, dtype=bool)
    solid[:, 7] = True
    pose = Pose(1.25, 2.25, 0.0, 0.0)
    fan = math.radians(90.0) * ((np.arange(64) + 0.5) / 64 - 0.5)
    ranges = (3.5 - pose.x_m) / np.cos(fan)
    ranges = np.where(ranges <= 4.0, ranges, np.inf)
    look = look_odds(ranges, pose, ROOM, SENSOR, extra_variance=(0.0,) * 4)
    found = np.zeros(ROOM.shape)
    found[look.rows, look.cols] = look.log_odds
    assert np.all(found[4, 2:7] < -MAPPED), "free up to the wall"
    assert np.all(found[3:6, 7] > MAPPED), "and the wall itself"
    assert not found[:, 8:].any(), "nothing is known behind it"
    visible = visible_cells(solid, ROOM, pose, SENSOR)
    assert np.array_equal(visible, found != 0)


def test_an_unsure_pose_makes_a_look_unsure() -> None:
    arguments = (np.full(64, 2.0), Pose(1.25, 2.25, 0.0, 0.0), ROOM, SENSOR)
    sure = look_odds(*arguments, extra_variance=(0.0,) * 4)
    unsure = look_odds(*arguments, extra_variance=(0.25, 0.25, 9.0, 0.0))
    assert np.allclose(unsure.log_odds, sure.log_odds / 2)
    turned = look_odds(*arguments, extra_variance=(0.0, 0.0, 0.0, 0.1))
    assert np.all(np.abs(turned.log_odds) <= np.abs(sure.log_odds))


def test_the_helpers_look_is_true() -> None:
    look = planar_look(np.random.default_rng(1))
    assert look.log_odds.size > 0
