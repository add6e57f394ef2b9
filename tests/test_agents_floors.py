"""Finding one's place on a floor, and a way over it."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_sim_planar import HOUSE, floor

from agents.floorways import gap_m, way_to
from agents.geometry import Pose, wrap_angle
from agents.planar.matching import FLOOR_M, match
from agents.settings import SensorSettings
from sim.planar_world import look

SENSOR = SensorSettings(fov_deg=90.0, range_m=8.0, columns=120)
HALL = floor(
    """
    ####################
    #..................#
    #......##..........#
    #......##......#...#
    #..............#...#
    #..................#
    #...#..............#
    #..................#
    ####################
    """
)
CORRIDOR = floor("\n".join(("#" * 60, "." * 60, "." * 60, "." * 60, "#" * 60)))
LOG_ODDS = np.where(HALL.solid, 4.0, -4.0)
UNSURE = np.diag([0.1**2, 0.1**2, 0.01, 0.03**2])
FREE = ~HOUSE.solid
NOWHERE = np.zeros(FREE.shape, dtype=bool)


# --- where it is ----------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_a_look_at_a_known_floor_tells_where_it_was_taken(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = Pose(2.0, 1.6, 0.0, float(rng.uniform(-0.5, 0.5)))
    ranges_m, _ = look(HALL, true, SENSOR, rng)
    e = np.clip(rng.normal(size=3), -2, 2) * (0.1, 0.1, 0.03)
    believed = Pose(true.x_m + e[0], true.y_m + e[1], 0.0, true.yaw_rad + e[2])
    found = match(LOG_ODDS, HALL.frame, believed, UNSURE, ranges_m, SENSOR)
    assert found is not None
    assert found.pose.distance_m(true) < 0.06
    assert abs(wrap_angle(found.pose.yaw_rad - true.yaw_rad)) < 0.02
    assert np.linalg.eigvalsh(found.covariance)[0] > 0
    assert found.covariance[0, 0] >= FLOOR_M**2


def test_a_corridor_tells_what_is_across_it_and_nothing_along_it() -> None:
    pose = Pose(12.0, 1.0, 0.0, 0.0)
    ranges_m, _ = look(CORRIDOR, pose, SENSOR, np.random.default_rng(1))
    log_odds = np.where(CORRIDOR.solid, 4.0, -4.0)
    found = match(log_odds, CORRIDOR.frame, pose, UNSURE, ranges_m, SENSOR)
    assert found is not None
    assert found.covariance[1, 1] < 0.06**2
    assert found.covariance[0, 0] > 20 * found.covariance[1, 1]


def test_where_the_map_is_blank_or_another_place_a_look_tells_nothing() -> None:
    pose = Pose(2.0, 1.6, 0.0, 0.0)
    ranges_m, _ = look(HALL, pose, SENSOR, np.random.default_rng(2))
    blank = np.zeros(HALL.frame.shape)
    assert match(blank, HALL.frame, pose, UNSURE, ranges_m, SENSOR) is None
    wrong = np.full(ranges_m.shape, 0.7)
    assert match(LOG_ODDS, HALL.frame, pose, UNSURE, wrong, SENSOR) is None


# --- ways -----------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.2, 0.3, 0.4, 0.8]))
@settings(max_examples=40, deadline=None)
def test_a_circle_fits_through_every_way(seed: int, footprint_m: float) -> None:
    rng = np.random.default_rng(seed)
    solid = rng.random((14, 17)) < 0.15
    frame = HALL.frame.__class__(-1.0, 2.0, 0.4, 14, 17)
    free = np.argwhere(~solid)
    here, there = (frame.centre_of(*free[rng.integers(len(free))]) for _ in range(2))
    if gap_m(solid, frame, *here, footprint_m) < footprint_m / 2:
        return
    none = np.zeros(solid.shape, dtype=bool)
    way = way_to(~solid, frame, Pose(*here, 0.0, 0.0), there, footprint_m, none)
    if way is None:
        return
    assert way[0] == pytest.approx(here)
    assert frame.cell_of(*way[-1]) == frame.cell_of(*there)
    for a, b in itertools.pairwise(way):
        for share in np.linspace(0, 1, 40):
            x, y = a + share * (b - a)
            assert gap_m(solid, frame, x, y, footprint_m) >= footprint_m / 2 - 0.012


def test_a_way_leads_through_the_door_and_not_into_the_closed_cell() -> None:
    pose = Pose(0.6, 1.8, 0.0, 0.0)
    way = way_to(FREE, HOUSE.frame, pose, (3.4, 2.6), 0.3, NOWHERE)
    assert way is not None
    length = float(np.hypot(*np.diff(way, axis=0).T).sum())
    assert math.dist((0.6, 1.8), (3.4, 2.6)) <= length < 3.6
    assert way_to(FREE, HOUSE.frame, pose, (0.6, 0.6), 0.3, NOWHERE) is None
    assert way_to(FREE, HOUSE.frame, pose, (3.4, 2.6), 0.9, NOWHERE) is None
    assert way_to(FREE, HOUSE.frame, pose, (99.0, 2.6), 0.3, NOWHERE) is None


def test_where_a_robot_was_stopped_it_goes_round_if_it_can() -> None:
    pose, goal = Pose(1.0, 1.8, 0.0, 0.0), (5.0, 1.8)
    frame = HALL.frame
    none = np.zeros(frame.shape, dtype=bool)
    straight = way_to(~HALL.solid, frame, pose, goal, 0.3, none)
    assert straight is not None
    barred = none.copy()
    barred[frame.cell_of(3.0, 1.8)] = True
    round_it = way_to(~HALL.solid, frame, pose, goal, 0.3, barred)
    assert round_it is not None
    assert len(round_it) > len(straight)
    wall = none.copy()
    wall[:, frame.cell_of(3.0, 1.8)[1]] = True
    assert way_to(~HALL.solid, frame, pose, goal, 0.3, wall) is not None, "if need be, through"
