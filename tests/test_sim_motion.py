import math

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.geometry import Pose
from sim.motion import MAX_SEGMENTS, Motions, Segment

metres = st.floats(-1e6, 1e6)
poses = st.builds(Pose, metres, metres, metres, st.floats(-math.pi, math.pi))
times = st.integers(0, 2**62)


@st.composite
def segments(draw: st.DrawFn) -> Segment:
    start, end = sorted(draw(st.tuples(times, times)))
    return Segment(
        draw(st.text(max_size=8)),
        start,
        end,
        draw(poses),
        draw(poses),
        draw(st.floats(0, 100)),
        draw(st.floats(0, 100)),
        draw(st.text(max_size=8)),
    )


@given(segment=segments())
@settings(max_examples=50, deadline=None)
def test_a_segment_survives_the_wire_exactly(segment: Segment) -> None:
    assert Segment.from_wire(segment.to_wire()) == segment
    assert Segment.from_wire(msgpack.unpackb(msgpack.packb(segment.to_wire()))) == segment


@given(segment=segments(), t_ns=times)
@settings(max_examples=50, deadline=None)
def test_a_segment_stays_between_its_ends_and_rests_at_the_last(
    segment: Segment, t_ns: int
) -> None:
    assert segment.pose_at(segment.end_ns) == segment.end
    assert segment.pose_at(segment.end_ns + t_ns) == segment.end
    assert segment.tether_at(segment.end_ns) == segment.tether_end_m
    pose = segment.pose_at(t_ns)
    low, high = sorted((segment.start.x_m, segment.end.x_m))
    assert low - 1e-6 <= pose.x_m <= high + 1e-6


def test_half_way_is_half_way_and_yaw_takes_the_shorter_way() -> None:
    a, b = Pose(0.0, 0.0, 0.0, 3.0), Pose(2.0, 4.0, 6.0, -3.0)
    segment = Segment("a", 100, 300, a, b, 1.0, 2.0)
    half = segment.pose_at(200)
    assert (half.x_m, half.y_m, half.z_m) == (1.0, 2.0, 3.0)
    assert abs(half.yaw_rad) == pytest.approx(math.pi)
    assert segment.tether_at(200) == 1.5
    assert segment.pose_at(0) == a


def test_the_newest_published_that_has_begun_holds() -> None:
    def at(x: float) -> Pose:
        return Pose(x, 0.0, 0.0, 0.0)

    motions = Motions()
    assert motions.pose_at("a", 5) is None
    motions.add(Segment("a", 0, 0, at(0), at(0)))
    motions.add(Segment("a", 10, 20, at(0), at(10)))
    motions.add(Segment("a", 20, 30, at(10), at(20)))
    motions.add(Segment("a", 15, 15, at(5), at(5), note="halt"))  # published last
    assert [motions.pose_at("a", t) for t in (0, 9, 12, 14)] == [at(0), at(0), at(2), at(4)]
    assert {motions.pose_at("a", t) for t in (15, 19, 25, 99)} == {at(5)}
    assert motions.pose_at("a", -1) is None
    assert motions.pose_at("b", 15) is None
    assert motions.tether_at("b", 15) == 0.0
    assert motions.robots == ("a",)


def test_a_frozen_robot_neither_drives_on_nor_pays_out() -> None:
    motions = Motions()
    motions.add(Segment("a", 0, 100, Pose(0.0, 0.0, 0.0, 0.0), Pose(10.0, 0.0, 0.0, 0.0), 1.0, 2.0))
    motions.freeze("a", 50)
    motions.freeze("nobody", 50)
    for t_ns in (50, 100, 10**12):
        assert motions.pose_at("a", t_ns) == Pose(5.0, 0.0, 0.0, 0.0)
        assert motions.tether_at("a", t_ns) == 1.5
    assert motions.pose_at("a", 25) == Pose(2.5, 0.0, 0.0, 0.0)


def test_old_motion_is_forgotten_and_memory_is_bounded() -> None:
    motions = Motions()
    for t in range(MAX_SEGMENTS + 5):
        pose = Pose(float(t), 0.0, 0.0, 0.0)
        motions.add(Segment("a", t, t, pose, pose))
    assert motions.pose_at("a", 4) is None
    assert motions.pose_at("a", 5) == Pose(5.0, 0.0, 0.0, 0.0)
