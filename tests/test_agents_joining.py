"""A late-comer's map is found on the team's where it lies, and nowhere else."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.geometry import Floats, GridFrame, Pose, wrap_angle
from agents.joining import Joined, Joiner, NotFound, placed
from agents.joining.fitting import Field, Fit, Moving, fit
from agents.joining.searching import Strewn, alike, around, search, turning
from agents.joining.verdict import Judged, Needs, verdict
from agents.joining.walls import Lines
from agents.maps.elevation import Estimate
from agents.maps.planar import Occupancy

CELL_M = 0.2
SIDE = 120
FRAME = GridFrame(0.0, 0.0, CELL_M, SIDE, SIDE)
SIGMA_M = 0.03


def relief_m(xy_m: Floats, seed: int = 1) -> Floats:
    """Return heights of rough ground that goes on for ever, smooth over half a metre."""
    rng = np.random.default_rng(seed)
    waves = rng.normal(0.0, 1.0, (40, 2)) * (1.6, 1.6)
    phases, sizes = rng.uniform(0, 2 * math.pi, 40), rng.uniform(0.01, 0.06, 40)
    return (sizes * np.sin(xy_m @ waves.T + phases)).sum(axis=1)


def cells_m(frame: GridFrame = FRAME) -> Floats:
    rows, cols = np.indices(frame.shape)
    x, y = frame.x_m + (cols + 0.5) * frame.cell_m, frame.y_m + (rows + 0.5) * frame.cell_m
    return np.column_stack((x.ravel(), y.ravel())).astype(np.float64)


def disc(middle_m: tuple[float, float], radius_m: float) -> np.ndarray:
    return (np.hypot(*(cells_m() - middle_m).T) < radius_m).reshape(FRAME.shape)


def ground_of(height, known: np.ndarray, truth: Pose, seed: int) -> Estimate:
    """Return a noisy map of cells of a frame whose origin truly lies at a pose."""
    there = cells_m() @ turning(truth.yaw_rad).T + (truth.x_m, truth.y_m)
    noise = np.random.default_rng(seed).normal(0.0, SIGMA_M, len(there))
    level = (height(there) - truth.z_m + noise).reshape(FRAME.shape)
    variance = np.where(known, SIGMA_M**2, np.inf)
    return Estimate(np.where(known, level, np.nan), variance, known.astype(np.uint16))


def rooms(frame: GridFrame = FRAME) -> np.ndarray:
    """Return walls of rooms of many sizes, none like another."""
    rng = np.random.default_rng(3)
    solid = np.zeros(frame.shape, dtype=bool)
    for _ in range(14):
        row, col = rng.integers(4, SIDE - 4, 2)
        size = rng.integers(8, 40)
        if rng.random() < 0.5:
            solid[row, col : col + size] = True
        else:
            solid[row : row + size, col] = True
    return solid


def floor_of(solid: np.ndarray, known: np.ndarray, truth: Pose) -> Occupancy:
    there = FRAME.cells_of(cells_m() @ turning(truth.yaw_rad).T + (truth.x_m, truth.y_m))
    inside = ((there >= 0) & (there < FRAME.shape)).all(axis=1).reshape(FRAME.shape)
    row, col = np.clip(there, 0, SIDE - 1).T
    state = np.where(solid[row, col].reshape(FRAME.shape), 4.0, -4.0)
    seen = known & inside
    return Occupancy(np.where(seen, state, 0.0), seen.astype(np.uint16))


def off_by(found: Joined, truth: Pose) -> Floats:
    """Return the error (x, y, z, yaw) in the middle of the overlap."""
    origin = found.origin
    own = turning(-origin.yaw_rad) @ (found.middle_m - (origin.x_m, origin.y_m))
    there = turning(truth.yaw_rad) @ own + (truth.x_m, truth.y_m)
    turn = wrap_angle(origin.yaw_rad - truth.yaw_rad)
    return np.array((*(found.middle_m - there), origin.z_m - truth.z_m, turn))


HERE = Pose(0.0, 0.0, 0.0, 0.0)
AWAY = Pose(23.3, 2.9, 1.37, 2.1)
"""Turns the frame's middle to where it lies within the frame again."""


def test_ground_is_found_to_a_part_of_a_cell_and_its_covariance_covers_the_error() -> None:
    team = ground_of(relief_m, disc((10.0, 12.0), 8.0), HERE, 1)
    own = ground_of(relief_m, disc((12.0, 12.0), 8.0), AWAY, 2)
    found = placed(own, team, FRAME)
    assert isinstance(found, Joined), found
    off = off_by(found, AWAY)
    assert np.hypot(off[0], off[1]) < 0.5 * CELL_M
    assert abs(off[2]) < 0.01
    assert abs(off[3]) < 0.005
    assert off @ np.linalg.solve(found.covariance, off) < 18.5  # chi2(4): 0.1 %


def test_a_floor_is_found_where_it_lies() -> None:
    solid = rooms()
    team = floor_of(solid, disc((11.0, 12.0), 9.0), HERE)
    own = floor_of(solid, disc((12.0, 12.0), 9.0), AWAY)
    found = placed(own, team, FRAME)
    assert isinstance(found, Joined), found
    off = off_by(found, AWAY)
    assert np.hypot(off[0], off[1]) < CELL_M
    assert abs(off[3]) < 0.03


@pytest.mark.parametrize(
    ("height", "why"),
    [
        (lambda xy: 0.0 * xy[:, 0], "agrees"),
        (lambda xy: 0.2 * xy[:, 0], "as well"),
        (lambda xy: 0.2 * np.sin(2.5 * xy[:, 0]) + 0.2 * np.sin(2.0 * xy[:, 1]), "elsewhere"),
    ],
    ids=["flat", "slope", "ripples"],
)
def test_ground_that_is_alike_everywhere_is_not_found_and_says_why(height, why) -> None:
    known = disc((12.0, 12.0), 8.0)
    found = placed(ground_of(height, known, AWAY, 2), ground_of(height, known, HERE, 1), FRAME)
    assert isinstance(found, NotFound)


def test_other_ground_is_not_found() -> None:
    for seed in range(2, 7):
        other = ground_of(lambda xy, n=seed: relief_m(xy, n), disc((12.0, 12.0), 8.0), AWAY, seed)
        team = ground_of(relief_m, disc((10.0, 12.0), 8.0), HERE, 1)
        assert isinstance(placed(other, team, FRAME), NotFound)


def test_of_rooms_that_are_alike_none_is_taken_for_the_one_that_the_team_knows() -> None:
    """The team knows one room only: it is the own map that shows how many there are."""
    solid = np.zeros(FRAME.shape, dtype=bool)
    solid[40] = solid[70] = True
    solid[40:71, ::20] = True
    solid[52:58, ::20] = False
    rows, cols = np.indices(FRAME.shape)
    within = (rows >= 40) & (rows <= 70)
    team = floor_of(solid, within & (cols <= 42), HERE)
    own = floor_of(solid, within & (cols >= 38), HERE)
    assert isinstance(placed(own, team, FRAME), NotFound)
    assert isinstance(placed(team, team, FRAME), NotFound)


def test_maps_that_show_nothing_are_not_matched() -> None:
    nothing = floor_of(rooms(), disc((12.0, 12.0), 0.5), HERE)
    found = placed(nothing, nothing, FRAME)
    assert isinstance(found, NotFound)
    assert "too few walls" in found.why
    little = ground_of(relief_m, disc((12.0, 12.0), 0.5), HERE, 1)
    found = placed(little, little, FRAME)
    assert isinstance(found, NotFound)
    assert "too small" in found.why


class Dots:
    """Cells speak by the product of what is in them."""

    @property
    def mix(self) -> Floats:
        return np.array(((0.0, 0.0), (0.0, 1.0)))

    def channels(self, planes: Floats, cell_m: float) -> Floats:
        return np.stack((planes[0] > 0, planes[1])).astype(np.float64)


@settings(max_examples=15, deadline=None)
@given(
    turn=st.floats(-math.pi, math.pi),
    x_m=st.floats(-9.0, 9.0),
    y_m=st.floats(-9.0, 9.0),
    seed=st.integers(0, 99),
)
def test_the_search_finds_any_turn_and_shift(
    turn: float, x_m: float, y_m: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    spots = rng.uniform(-6.0, 6.0, (60, 2))
    planes = np.ones((2, len(spots)))
    own = Strewn(spots, planes)
    team = own.turned(turn, x_m, y_m)
    best = search(own, team, around(team, 1.0), Dots(), 5.0)[0]
    assert np.hypot(*(best.middle_of(own) - team.middle_m)) < 1.5
    assert abs(wrap_angle(best.turn_rad - turn)) < 0.25


def test_a_field_is_read_between_its_cells_and_only_among_known_ones() -> None:
    frame = GridFrame(0.0, 0.0, 0.5, 4, 4)
    plane = (0.3 * cells_m(frame)[:, 0] - 0.2 * cells_m(frame)[:, 1]).reshape(4, 4)
    variance = np.full((4, 4), 0.04)
    variance[3, 3] = np.inf
    points = np.array(((0.6, 0.9), (1.6, 1.6), (1.0, 1.7), (-3.0, 0.5)))
    known, value, spread, slope = Field(frame, plane, variance).at(points)
    assert known.tolist() == [True, False, True, False]
    assert value == pytest.approx([0.3 * 0.6 - 0.2 * 0.9, 0.3 * 1.0 - 0.2 * 1.7])
    assert spread == pytest.approx([0.04, 0.04])
    assert slope == pytest.approx(np.array(((0.3, -0.2), (0.3, -0.2))))


def test_a_fit_takes_out_shift_turn_and_lift() -> None:
    spots = np.random.default_rng(1).uniform(6.0, 18.0, (4000, 2))
    field = Field(FRAME, relief_m(cells_m()).reshape(FRAME.shape), np.full(FRAME.shape, 1e-4))
    truth = (0.03, 0.25, -0.3)
    there = spots @ turning(truth[0]).T + truth[1:]
    moving = Moving(spots, relief_m(there) - 0.7, np.full(4000, 1e-4), (3.0, 0.01), lifts=True)
    found = fit(moving, field, (0.0, 0.0, 0.0), steps=20)
    assert found is not None
    assert found.carried(spots) == pytest.approx(there, abs=0.02 * CELL_M * 10)
    assert found.lift == pytest.approx(0.7, abs=0.003)


def test_the_information_of_a_fit_is_that_of_its_slopes() -> None:
    """On a field of slope 1 eastwards, n cells of variance v know x to v / n, and y not at all."""
    plane = cells_m()[:, 0].reshape(FRAME.shape)
    field = Field(FRAME, plane, np.full(FRAME.shape, 0.5e-2))
    spots = np.random.default_rng(2).uniform(8.0, 16.0, (500, 2))
    moving = Moving(spots, spots[:, 0], np.full(500, 0.5e-2), (3.0, 0.0), lifts=True)
    found = fit(moving, field, (0.0, 0.0, 0.0), steps=3)
    assert found is not None
    information = np.linalg.inv(found.covariance)
    assert information[0, 0] == pytest.approx(500 / 1e-2, rel=1e-3)
    assert found.covariance[1, 1] > 1e3


def test_a_shared_error_of_a_block_bounds_what_its_cells_tell_of_the_lift() -> None:
    """One block whose cells share an error of 0.1 m can't tell the lift better than to 0.1 m."""
    field = Field(FRAME, relief_m(cells_m()).reshape(FRAME.shape), np.full(FRAME.shape, 1e-4))
    spots = np.random.default_rng(2).uniform(10.1, 19.9, (2000, 2))
    moving = Moving(spots, relief_m(spots), np.full(2000, 1e-4), (10.0, 0.1), lifts=True)
    found = fit(moving, field, (0.0, 0.0, 0.0), steps=3)
    assert found is not None
    assert found.covariance[2, 2] == pytest.approx(0.01, rel=0.05)


def test_of_a_wall_the_distance_across_counts_and_beyond_its_end_the_whole() -> None:
    wall = np.column_stack((np.arange(0.0, 4.01, 0.4), np.full(11, 2.0)))
    points = np.array(((1.9, 2.3), (1.9, 1.7), (4.6, 2.0), (2.0, 9.0)))
    known, value, variance, slope = Lines(wall, 0.4).at(points)
    assert known.tolist() == [True, True, True, False]
    assert np.abs(value) == pytest.approx([0.3, 0.3, 0.6])
    assert value[0] * value[1] < 0, "on either side"
    assert slope[0] * value[0] == pytest.approx((0.0, 0.3))
    assert slope[2] * value[2] == pytest.approx((0.6, 0.0))
    assert variance == pytest.approx([0.16**2] * 3)


def test_neighbours_that_are_alike_tell_less() -> None:
    rng = np.random.default_rng(1)
    white = rng.normal(size=(1, 64, 64))
    known = np.ones((64, 64))
    blocks = np.repeat(np.repeat(rng.normal(size=(1, 16, 16)), 4, axis=1), 4, axis=2)
    # Of blocks of four, r is the triangle 1 - |lag| / 4, squared and summed over both axes:
    # (1 + 2 (9 + 4 + 1) / 16)^2 = 7.6; and a quarter for what chance adds.
    assert alike(white, known) == pytest.approx(1.25, abs=0.15)
    assert alike(blocks, known) == pytest.approx(9.5, rel=0.35)


def test_a_pose_of_the_own_frame_is_less_sure_the_farther_it_is_from_the_overlap() -> None:
    covariance = np.diag([1e-4, 1e-4, 1e-4, 1e-4])
    origin = Pose(10.0, 5.0, 1.0, math.pi / 2)
    found = Joined(origin, covariance, np.array((10.0, 5.0)), "", _judged(30.0, 0.0))
    near, tight = found.stand(Pose(0.0, 0.0, 0.5, 0.1))
    far, loose = found.stand(Pose(20.0, 0.0, 0.0, 0.0))
    assert (near.x_m, near.y_m, near.z_m) == pytest.approx((10.0, 5.0, 1.5))
    assert near.yaw_rad == pytest.approx(math.pi / 2 + 0.1)
    assert (far.x_m, far.y_m) == pytest.approx((10.0, 25.0))
    assert np.diag(tight) == pytest.approx([1e-4] * 4)
    assert np.diag(loose) == pytest.approx([1e-4 + 400 * 1e-4, 1e-4, 1e-4, 1e-4])


NEEDS = Needs(
    overlap_m2=20.0, evidence=5.0, agreement=0.8, rival=0.6, sigma_m=0.2, sigma_rad=0.05,
    apart_m=1.0, inflation=1.0, alike=0.8,
)  # fmt: skip


def _judged(evidence: float, x_m: float, **other: float) -> Judged:
    sigma_m, agreement = other.get("sigma_m", 0.05), other.get("agreement", 0.95)
    spread = np.diag([sigma_m**2, 0.01**2, 0.01**2, 0.01**2])
    found = Fit(0.0, x_m, 0.0, 0.0, 500, 0.3, spread, np.zeros(2))
    return Judged(found, other.get("overlap_m2", 50.0), evidence, agreement)


@pytest.mark.parametrize(
    ("places", "why"),
    [
        ([], "no place"),
        ([_judged(30.0, 0.0, overlap_m2=10.0)], "overlap"),
        ([_judged(30.0, 0.0, agreement=0.5)], "agrees"),
        ([_judged(2.0, 0.0)], "too little"),
        ([_judged(30.0, 0.0, sigma_m=1.0)], "moved by 1.00 m"),
        ([_judged(30.0, 0.0), _judged(25.0, 5.0)], "elsewhere"),
    ],
)
def test_what_is_not_sure_is_refused_in_words(places: list[Judged], why: str) -> None:
    own = Strewn(np.zeros((1, 2)), np.ones((1, 1)))
    found = verdict(places, own, NEEDS)
    assert isinstance(found, NotFound)
    assert why in found.why


def test_a_rival_next_to_the_place_or_far_weaker_does_not_count() -> None:
    own = Strewn(np.zeros((1, 2)), np.ones((1, 1)))
    places = [_judged(30.0, 0.0), _judged(29.0, 0.5), _judged(10.0, 9.0)]
    assert isinstance(verdict(places, own, NEEDS), Joined)


def test_it_is_tried_when_maps_have_grown_or_after_some_looks() -> None:
    joiner = Joiner()
    assert not joiner.is_due(1, 100, 0), "nothing was heard yet"
    assert joiner.is_due(1, 100, 50)
    assert not joiner.is_due(2, 105, 50)
    assert joiner.is_due(3, 100, 80), "the team's map has grown"
    assert not joiner.is_due(4, 100, 80)
    assert joiner.is_due(7, 100, 80), "four looks later"


def test_a_grid_around_a_map_holds_whole_cells_of_it() -> None:
    frame = GridFrame(3.13, -2.07, 0.2, 7, 11)
    map_ = Strewn(cells_m(frame), np.ones((1, 77)))
    assert around(map_, 0.2) == GridFrame(
        pytest.approx(3.13), pytest.approx(-2.07), pytest.approx(0.2), 7, 11
    )
    coarse = around(map_, 0.2, 3)
    assert coarse.shape == (3, 4)
    assert map_.binned(coarse)[0, 0, 0] == 9
    assert map_.binned(coarse).sum() == 77
