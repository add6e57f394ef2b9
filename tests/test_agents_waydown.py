"""Ways down and what is still to be asked of them, on ground made by hand."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.geometry import Floats, GridFrame, Pose
from agents.ground.descent import barred, descent_cost
from agents.ground.surface import CLEARANCE_M
from agents.planning.waydown import (
    CALM_RISK,
    GOAL_M,
    STAND_M,
    Descent,
    hopeful,
    least_risky,
    open_questions,
    relief_of,
    safe_path,
    with_stand,
    within,
)
from agents.settings import DriveSettings

CELL_M = 0.2
SHAPE = (60, 40)
FRAME = GridFrame(0.0, 0.0, CELL_M, *SHAPE)
DRIVE = DriveSettings()
STAND = Pose(4.0, 10.0, 0.0, 0.0)
GOAL = (4.0, 2.0)
SHARP = np.full(SHAPE, 0.02)


def down(asked: Floats | None = None) -> Descent:
    return Descent(STAND, GOAL, np.zeros(SHAPE) if asked is None else asked)


def strip(elevation: Floats, south_m: float, north_m: float, value: float) -> Floats:
    out = elevation.copy()
    out[round(south_m / CELL_M) : round(north_m / CELL_M)] = value
    return out


def test_level_ground_that_was_seen_is_a_way_and_leaves_nothing_to_ask() -> None:
    level = np.zeros(SHAPE)
    path_m = safe_path(FRAME, DRIVE, level, SHARP, STAND, GOAL)
    assert path_m is not None
    assert np.hypot(*(path_m[-1] - GOAL)) <= GOAL_M
    assert not open_questions(FRAME, DRIVE, level, SHARP, down()).any()


def test_what_nobody_saw_is_asked_where_the_way_crosses_it() -> None:
    unseen = strip(np.zeros(SHAPE), 5.0, 7.0, np.nan)
    assert safe_path(FRAME, DRIVE, unseen, SHARP, STAND, GOAL) is None
    asked = open_questions(FRAME, DRIVE, unseen, SHARP, down())
    rows, cols = np.nonzero(asked)
    y_m, x_m = (rows + 0.5) * CELL_M, (cols + 0.5) * CELL_M
    assert asked.any()
    assert (y_m.min() > 5.0) & (y_m.max() < 7.0)
    assert np.abs(x_m - 4.0).max() < DRIVE.footprint_m  # the straight way is the shortest


def test_what_was_seen_badly_is_asked_too() -> None:
    blurred = strip(SHARP, 5.0, 7.0, 0.25)
    level = np.zeros(SHAPE)
    assert safe_path(FRAME, DRIVE, level, blurred, STAND, GOAL) is None
    hope = hopeful(FRAME, DRIVE, level, blurred, down())
    assert hope is not None
    assert hope.blurred.any()
    assert not (hope.unseen | hope.rock).any()
    assert "0.0 m2 unseen" in hope.told()


def test_a_hopeful_way_rather_asks_than_climbs_a_wall() -> None:
    wall = strip(np.zeros(SHAPE), 5.0, 7.0, 1.0)
    wall[:, 25:37] = np.where(wall[:, 25:37] > 0, np.nan, 0.0)  # nobody saw whether it goes on
    hope = hopeful(FRAME, DRIVE, wall, SHARP, down())
    assert hope is not None
    assert 25 * CELL_M < hope.path_m[:, 0].max() < 37 * CELL_M
    assert hope.unseen.sum() > hope.rock.sum()


def test_what_was_asked_often_in_vain_is_gone_round() -> None:
    unseen = strip(np.zeros(SHAPE), 5.0, 7.0, np.nan)
    first = open_questions(FRAME, DRIVE, unseen, SHARP, down())
    then = open_questions(FRAME, DRIVE, unseen, SHARP, down(np.where(first, 60.0, 0.0)))
    assert (first & then).sum() < 0.2 * first.sum()


def test_a_rock_that_was_seen_sharply_is_not_asked_again() -> None:
    wall = strip(np.zeros(SHAPE), 5.8, 6.2, 1.0)
    assert not open_questions(FRAME, DRIVE, wall, SHARP, down()).any()
    hope = hopeful(FRAME, DRIVE, wall, SHARP, down())
    assert hope is not None
    assert hope.rock.any()


def test_fine_cells_are_joined_to_half_a_wheel_before_rocks_are_looked_for() -> None:
    fine = GridFrame(0.0, 0.0, 0.05, 241, 160)
    rng = np.random.default_rng(5)
    noisy = rng.normal(scale=0.03, size=fine.shape)
    sigma = np.full(fine.shape, 0.03)
    stand = Pose(4.0, 10.0, 0.0, 0.0)
    relief = relief_of(fine, DRIVE, noisy, sigma, stand)
    assert relief.frame.cell_m == pytest.approx(0.1)
    assert relief.frame.shape == (121, 80)
    assert np.std(relief.elevation_m[:120]) == pytest.approx(0.015, rel=0.1)
    assert relief.sigma_m[0, 0] == pytest.approx(0.015)
    assert safe_path(fine, DRIVE, noisy, sigma, stand, GOAL) is not None
    hidden = noisy.copy()
    hidden[100:140] = np.nan
    asked = open_questions(fine, DRIVE, hidden, sigma, Descent(stand, GOAL, np.zeros(fine.shape)))
    assert asked.shape == fine.shape
    assert asked[100:140].sum() > 0.9 * asked.sum() > 0


def test_ground_under_the_wheels_goes_on_as_that_about_them() -> None:
    heights_m = 0.5 * CELL_M * np.arange(SHAPE[0], dtype=np.float64)
    slope: Floats = np.tile(heights_m[:, None], (1, SHAPE[1]))
    hole: Floats = slope.copy()
    hole[47:53, 17:23] = np.nan
    elevation_m, sigma_m = with_stand(FRAME, DRIVE, hole, np.full(SHAPE, np.inf), STAND)
    filled = np.isnan(hole) & ~np.isnan(elevation_m)
    assert filled.sum() > 20
    assert np.abs(elevation_m - slope)[filled].max() < 0.01
    assert sigma_m[FRAME.cell_of(4.0, 10.0)] == pytest.approx(0.25 * DRIVE.wheel_m)
    assert np.isnan(hole[50, 20])  # what was given is left as it was


def test_what_the_map_shows_where_a_robot_stands_is_the_robot_itself() -> None:
    fine = GridFrame(0.0, 0.0, 0.1, 120, 80)
    seen = np.zeros(fine.shape)
    seen[within(fine, (4.0, 10.0), 0.35)] = 0.9  # its body, in somebody's look
    sharp = np.full(fine.shape, 0.02)
    assert safe_path(fine, DRIVE, seen, sharp, STAND, GOAL) is not None
    assert safe_path(fine, DRIVE, seen, sharp, replace(STAND, y_m=11.3), GOAL) is not None
    seen[97:104] = 0.9  # a wall is one, whoever stands in it
    assert safe_path(fine, DRIVE, seen, sharp, STAND, GOAL) is None


def test_where_nothing_is_known_wheels_tell_their_own_height() -> None:
    nothing = np.full(SHAPE, np.nan)
    stand = replace(STAND, z_m=0.3)
    elevation_m, _ = with_stand(FRAME, DRIVE, nothing, np.full(SHAPE, np.inf), stand)
    assert np.nanmax(elevation_m) == np.nanmin(elevation_m) == pytest.approx(0.3)


def bumps(height_m: float) -> tuple[GridFrame, Floats, Floats]:
    """Return fine level ground with a belt of bumps across, open only in the far east."""
    fine = GridFrame(0.0, 0.0, 0.1, 120, 120)
    ground = np.zeros(fine.shape)
    for row in range(52, 69, 8):
        for col in range(row % 3, 100, 6):
            ground[row : row + 2, col : col + 2] = height_m
    return fine, ground, np.full(fine.shape, 0.04)


def test_a_way_goes_round_what_may_be_rocks_and_knows_its_risk() -> None:
    fine, ground, sigma = bumps(0.07)
    place = (fine, DRIVE, ground, sigma, STAND, GOAL)
    way = least_risky(*place)
    assert way is not None
    assert way.path_m[:, 0].max() > 10.0, "through the gap in the east"
    straight = ground.copy()
    straight[:, 100:] = np.nan  # nobody saw the gap
    through = least_risky(fine, DRIVE, straight, sigma, STAND, GOAL)
    assert through is not None
    assert through.risk > 3 * way.risk
    limit = 0.5 * (way.risk + through.risk)
    assert safe_path(*place, most_risk=limit) is not None
    assert safe_path(fine, DRIVE, straight, sigma, STAND, GOAL, most_risk=limit) is None


def test_what_may_be_rocks_is_asked_about_where_the_best_way_is_too_risky() -> None:
    fine, ground, sigma = bumps(0.07)
    ground[:, 100:] = np.nan
    ground[52:76, 100:] = 3.0  # a wall in the gap
    descent = Descent(STAND, GOAL, np.zeros(fine.shape))
    hope = hopeful(fine, DRIVE, ground, sigma, descent)
    assert hope is not None
    assert hope.vague.any()
    assert "m2 that may be rock" in hope.told()
    way = least_risky(fine, DRIVE, ground, sigma, STAND, GOAL)
    assert way is not None
    asked = open_questions(fine, DRIVE, ground, sigma, descent)
    assert asked.any() == (way.risk > CALM_RISK)


def test_who_is_on_a_way_keeps_to_it_until_another_is_clearly_better() -> None:
    """A wall of which the east end is a little nearer than the west end."""
    fine = GridFrame(0.0, 0.0, 0.1, 120, 120)
    ground, sigma = np.zeros(fine.shape), np.full(fine.shape, 0.02)
    stand, goal = Pose(6.2, 10.0, 0.0, 0.0), (6.2, 2.0)
    ground[60, 30:93] = 1.0
    place = (fine, DRIVE, ground, sigma, stand, goal)
    best = least_risky(*place)
    assert best is not None
    assert best.path_m[:, 0].max() > 9.3, "round the east"
    west_m = np.array([[6.2, 10.0], [1.2, 6.85], [1.3, 5.05], [6.15, 1.95]])
    kept = least_risky(*place, former_m=west_m)
    assert kept is not None
    assert kept.path_m == pytest.approx(west_m)
    beside = Pose(3.7, 8.5, 0.0, 0.0)
    halfway = least_risky(fine, DRIVE, ground, sigma, beside, goal, former_m=west_m)
    assert halfway is not None
    assert halfway.path_m == pytest.approx(np.vstack(([[3.7, 8.5]], west_m[1:])))
    far_west_m = np.array([[6.2, 10.0], [0.7, 10.0], [0.7, 2.0], [6.2, 2.0]])
    other = least_risky(*place, former_m=far_west_m)
    assert other is not None
    assert other.path_m == pytest.approx(best.path_m), "it costs a third more"
    ground[50, 0:60] = 1.0  # a second wall, before the west end
    barred = least_risky(fine, DRIVE, ground, sigma, stand, goal, former_m=west_m)
    assert barred is not None
    assert barred.path_m[:, 0].max() > 9.3


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.02, 0.6))
def test_the_quick_look_at_what_was_seen_hides_no_way(seed: int, share: float) -> None:
    """`safe_path` leaves off early: it may only do so where the whole rule shows no way either."""
    rng = np.random.default_rng(seed)
    elevation_m = np.zeros(SHAPE)
    blocks = rng.random((SHAPE[0] // 4, SHAPE[1] // 4)) < share
    elevation_m[np.kron(blocks, np.ones((4, 4))) > 0] = np.nan
    if safe_path(FRAME, DRIVE, elevation_m, SHARP, STAND, GOAL) is not None:
        return
    filled, sigma_m = with_stand(FRAME, DRIVE, elevation_m, SHARP, STAND)
    footprint_m = DRIVE.footprint_m + 2 * CLEARANCE_M
    bars = barred(
        filled,
        sigma_m,
        cell_m=CELL_M,
        footprint_m=footprint_m,
        wheel_m=DRIVE.wheel_m,
        climb_m=DRIVE.climb_m,
    )
    cost = descent_cost(bars, cell_m=CELL_M, footprint_m=footprint_m)
    row, col = FRAME.cell_of(STAND.x_m, STAND.y_m)
    may = np.isfinite(cost) | within(FRAME, (STAND.x_m, STAND.y_m), STAND_M)
    reached = np.zeros(SHAPE, dtype=bool)
    reached[row, col] = True
    while True:  # flood it, by sides only: a robot may cut corners nowhere
        grown = reached.copy()
        grown[1:] |= reached[:-1]
        grown[:-1] |= reached[1:]
        grown[:, 1:] |= reached[:, :-1]
        grown[:, :-1] |= reached[:, 1:]
        grown &= may
        if (grown == reached).all():
            break
        reached = grown
    rows, cols = np.nonzero(reached)
    away_m = np.hypot((cols + 0.5) * CELL_M - GOAL[0], (rows + 0.5) * CELL_M - GOAL[1])
    assert away_m.min() > GOAL_M
