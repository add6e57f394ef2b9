"""A team-mate is looked at from where it shows, which from most places it does not."""

import math

import numpy as np
from test_agents_strategies import cliff, view_of

from agents.geometry import GridFrame, Pose
from agents.planning.following import FAR_M, in_sight, way_to_see
from agents.planning.scene import BODY_M

FRAME = GridFrame(0.0, 0.0, 0.1, 60, 60)


def test_a_wall_hides_what_is_behind_it_and_a_low_one_does_not() -> None:
    ground_m = np.zeros(FRAME.shape)
    ground_m[30:32, :40] = 2.0
    eyes_m = np.array([(2.0, 5.0, 1.5), (5.9, 2.8, 1.5), (2.0, 1.0, 1.5)])
    target_m = np.array([2.0, 2.0, 0.6])
    assert in_sight(ground_m, FRAME, eyes_m, target_m).tolist() == [False, True, True]
    ground_m[30:32, :40] = 0.3
    assert in_sight(ground_m, FRAME, eyes_m, target_m).all()


def test_it_goes_no_farther_than_it_has_to_and_not_to_where_it_looked_in_vain() -> None:
    """Below the lip, out of sight from where it stands, a mate shows from places nearer to it."""
    z = cliff()
    view = view_of(z)
    x_m, y_m = view.pose.x_m, view.pose.y_m
    beside = Pose(x_m + 2.0, y_m, float(z[view.frame.cell_of(x_m + 2.0, y_m)]), 0.0)
    here = way_to_see(view, beside)
    assert here is not None
    assert len(here) == 1
    other = way_to_see(view, beside, [(x_m, y_m)])
    assert other is not None
    assert 0.7 < math.dist(other[-1], (x_m, y_m)) < 3.0
    below_y_m = next(y for y in np.arange(y_m, 0.0, -0.1) if z[view.frame.cell_of(x_m, y)] < -2.0)
    below = Pose(x_m, float(below_y_m), float(z[view.frame.cell_of(x_m, below_y_m)]), 0.0)
    way_m = way_to_see(view, below)
    assert way_m is not None
    assert len(way_m) > 1
    target_m = np.array((below.x_m, below.y_m, below.z_m + BODY_M))
    before_m, after_m = (
        np.array([(x, y, z[view.frame.cell_of(x, y)] + view.sensor.height_m)])
        for x, y in (way_m[0], way_m[-1])
    )
    assert not in_sight(z, view.frame, before_m, target_m).any()
    assert in_sight(z, view.frame, after_m, target_m).all()


def test_a_mate_off_the_map_is_seen_from_nowhere() -> None:
    assert way_to_see(view_of(cliff()), Pose(-50.0, 0.0, 0.0, 0.0)) is None


def test_it_comes_as_near_as_tags_are_found() -> None:
    view = view_of(np.zeros((120, 120)), pose=Pose(1.5, 1.5, 0.0, 0.0))
    mate = Pose(11.0, 11.0, 0.0, 0.0)
    way_m = way_to_see(view, mate)
    assert way_m is not None
    assert math.dist(way_m[0], (mate.x_m, mate.y_m)) > FAR_M
    assert math.dist(way_m[-1], (mate.x_m, mate.y_m)) < FAR_M
