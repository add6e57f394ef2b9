import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.geometry import GridFrame, Pose
from sim.ground import Terrain
from sim.motion import Motions, Segment
from sim.propagation import Propagation

NS = 1_000_000_000
DELAY_NS = NS // 10
quick = settings(max_examples=60, deadline=None)


def ridge(height_m=3.0, side=40, cell_m=0.5):
    """Return level ground with a ridge from south to north through its middle."""
    elevation_m = np.zeros((side, side), np.float32)
    elevation_m[:, side // 2 - 1 : side // 2 + 1] = height_m
    return Terrain(GridFrame(0.0, 0.0, cell_m, side, side), elevation_m, np.ones_like(elevation_m))


def standing(**places_m):
    motions = Motions()
    for name, (x_m, y_m, z_m) in places_m.items():
        pose = Pose(x_m, y_m, z_m, 0.0)
        motions.add(Segment(name, 0, 0, pose, pose))
    return motions


def world(terrain=None, **places_m):
    return Propagation("me", standing(**places_m), terrain or ridge(), DELAY_NS)


WEST, EAST = (5.0, 10.0, 0.0), (15.0, 10.0, 0.0)


@pytest.mark.parametrize(
    ("antenna_m", "mate_antenna_m", "hidden"),
    [(1.0, 1.0, True), (2.9, 2.9, True), (3.1, 3.1, False), (1.0, 5.5, False), (1.0, 4.5, True)],
)
def test_a_ridge_hides_those_behind_it_unless_their_antennas_stand_out(
    antenna_m, mate_antenna_m, hidden
):
    """Midway, the line is at the mean of the antennas' heights: the ridge is 3 m high."""
    here = world(me=WEST, mate=EAST)
    assert here.hides("mate", NS, antenna_m, mate_antenna_m) is hidden


def test_who_is_on_the_same_side_is_in_sight():
    here = world(me=WEST, mate=(7.0, 14.0, 0.0))
    assert not here.hides("mate", NS, 0.5, 0.5)
    assert not world(me=WEST, mate=WEST).hides("mate", NS, 1.0, 1.0)


places = st.tuples(st.floats(0.5, 19.5), st.floats(0.5, 19.5), st.floats(0, 2))


@quick
@given(places, places, st.floats(0.2, 5), st.floats(0.2, 5), st.integers(0, 5))
def test_sight_is_mutual(one, other, one_m, other_m, seed):
    rough = np.random.default_rng(seed).normal(0, 0.7, (40, 40)).cumsum(0).astype(np.float32)
    terrain = Terrain(ridge().frame, rough, np.ones_like(rough))
    motions = standing(one=one, other=other)
    here, there = (Propagation(me, motions, terrain, DELAY_NS) for me in ("one", "other"))
    assert here.hides("other", NS, other_m, one_m) == there.hides("one", NS, one_m, other_m)
    assert here.distance_m("other", NS) == there.distance_m("one", NS)


@quick
@given(places, places)
def test_over_level_ground_everybody_sees_everybody(one, other):
    level = Terrain(ridge().frame, np.zeros((40, 40), np.float32), np.ones((40, 40), np.float32))
    assert not world(terrain=level, me=one, mate=other).hides("mate", NS, 0.5, 0.5)


def test_unknown_ground_and_the_world_beyond_the_window_hide_nothing():
    unknown = ridge()
    unknown.elevation_m[unknown.elevation_m > 0] = np.nan
    assert not world(terrain=unknown, me=WEST, mate=EAST).hides("mate", NS, 1.0, 1.0)
    assert not world(me=(-5.0, 10.0, 0.0), mate=(-5.0, 50.0, 0.0)).hides("mate", NS, 1.0, 1.0)


def test_who_is_not_known_of_is_taken_as_near_and_in_sight():
    here = world(me=WEST)
    assert here.distance_m("mate", NS) is None
    assert not here.hides("mate", NS, 1.0, 1.0)


def test_everybody_is_where_they_were_one_world_delay_before():
    """A drive along the ridge's east side and round its end, seen from the west."""
    motions = standing(me=WEST)
    start, end = Pose(*EAST, 0.0), Pose(5.0, 13.0, 0.0, 0.0)
    motions.add(Segment("mate", 0, NS, start, end))
    here = Propagation("me", motions, ridge(), DELAY_NS)
    assert here.distance_m("mate", NS) == pytest.approx(here_m(0.9, start, end))
    assert here.distance_m("mate", NS + DELAY_NS) == pytest.approx(3.0)
    assert here.hides("mate", DELAY_NS, 1.0, 1.0)
    assert not here.hides("mate", NS + DELAY_NS, 1.0, 1.0)
    assert here.hides("mate", DELAY_NS, 1.0, 1.0), "asked again, it answers again"
    assert here.distance_m("mate", DELAY_NS - 1) is None, "before the first that is known"


def here_m(share, start, end):
    x_m, y_m = (a + share * (b - a) for a, b in ((start.x_m, end.x_m), (start.y_m, end.y_m)))
    return np.hypot(x_m - WEST[0], y_m - WEST[1])
