"""Submaps hang on the robot's way: drawn against their anchors, which are corrected."""

import math

import numpy as np
import pytest
from robot_helpers import hear, log_of, measure, robot_on, say
from team_helpers import FRAME, SURE

from agents.fusion import Gaussian
from agents.geometry import Pose
from agents.layers import Anchor, OwnLayer
from agents.maps.elevation import Submap
from agents.maps.elevationlook import LookCells
from agents.messages import Fix, Status, pack_fix, pack_status, unpack_anchor
from agents.ports import Odometry
from agents.pose.anchoring import Tolerance, corrected, needs_submap, placing, submap_name
from agents.pose.localising import origin_of, reference
from agents.pose.posefilter import PoseFilter
from comms.frames import Kind

WISHES = Tolerance(shift_m=0.05, lift_m=0.02, reach_m=5.0)
ANCHOR = Anchor.at(Pose(1.0, 2.0, 0.0, 0.5), (0.04, 0.04, 0.01, 1e-4))


def layer_at(pose, covariance):
    layer, way = OwnLayer(FRAME, Submap), PoseFilter(pose, covariance)
    layer.begin_submap(pose, covariance)
    way.remember(submap_name(0))
    return layer, way


def test_a_submap_is_begun_when_the_pose_has_grown_unsure_against_its_anchor():
    pose = Pose(0, 0, 0, 0)
    assert needs_submap(OwnLayer(FRAME, Submap), PoseFilter(pose, SURE), 0.1), "the first one"
    for axis, limit in ((0, 0.1), (1, 0.1), (2, 0.1), (3, 0.02)):
        layer, way = layer_at(pose, np.eye(4))
        assert not needs_submap(layer, way, 0.1), "how unsure both are together does not matter"
        noise = np.zeros((4, 4))
        noise[axis, axis] = 0.98 * limit**2
        way.predict(Odometry(0.0, 0.0, 0.0, 0.0, noise))
        assert not needs_submap(layer, way, 0.1)
        noise[axis, axis] = 0.04 * limit**2
        way.predict(Odometry(0.0, 0.0, 0.0, 0.0, noise))
        assert needs_submap(layer, way, 0.1)


def test_a_look_is_drawn_where_it_lies_against_the_anchor_whatever_was_corrected_since():
    layer, way = layer_at(Pose(5, 5, 0, 0), np.diag([0.04, 0.04, 0.01, 1e-4]))
    way.predict(Odometry(1.0, 0.0, 0.0, 0.2, np.eye(4) * 1e-8))
    drawn, beyond = placing(layer, 0, way)
    way.fix(Pose(6.3, 5.1, 0.1, 0.2), np.eye(4) * 1e-6)
    layer.submaps[0].anchor = corrected(layer, way, WISHES)[0]
    again, _ = placing(layer, 0, way)
    assert again.distance_m(drawn) < 0.002
    assert beyond == pytest.approx((1e-8,) * 4, rel=0.01)
    moved = layer.submaps[0].anchor.corrected
    assert (moved.x_m, moved.y_m, moved.z_m) == pytest.approx((5.3, 5.1, 0.1), abs=0.01)


@pytest.mark.parametrize(
    ("pose", "variance", "told"),
    [
        (Pose(1.0, 2.0, 0.0, 0.5), (0.04, 0.04, 0.01, 1e-4), False),
        (Pose(1.04, 2.0, 0.0, 0.5), (0.04, 0.04, 0.01, 1e-4), False),
        (Pose(1.06, 2.0, 0.0, 0.5), (0.04, 0.04, 0.01, 1e-4), True),
        (Pose(1.0, 2.0, 0.03, 0.5), (0.04, 0.04, 0.01, 1e-4), True),
        (Pose(1.0, 2.0, 0.0, 0.512), (0.04, 0.04, 0.01, 1e-4), True),
        (Pose(1.0, 2.0, 0.0, 0.5), (0.01, 0.01, 0.01, 1e-5), True),
        (Pose(1.0, 2.0, 0.0, 0.5), (0.03, 0.03, 0.01, 1e-4), False),
        (Pose(1.0, 2.0, 0.0, 0.5), (0.04, 0.04, 0.001, 1e-4), True),
    ],
)
def test_an_anchor_is_told_again_when_it_moves_a_cell_or_is_much_surer(pose, variance, told):
    mean = np.array((pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad))
    better = WISHES.better(ANCHOR, Gaussian(mean, np.diag(variance)))
    assert (better is not None) == told
    if better is not None:
        assert better.version == 1
        assert WISHES.better(better, Gaussian(mean, np.diag(variance))) is None, "once is enough"


# --- a robot --------------------------------------------------------------------------------


def look_at_floor():
    cells = np.arange(40)
    return LookCells(cells % 8 + 4, cells // 8 + 4, np.full(40, 1.0), np.full(40, 1e-3))


def lost_robot(folder):
    """Return a RECON-bot that has mapped a floor and does not know where it is."""
    robot = robot_on(folder, index=0)
    robot.located = False
    robot.begin_submap()
    measure(robot, look_at_floor())
    return robot


def test_nobody_takes_in_the_map_of_a_lost_robot_until_an_anchor_comes(tmp_path):
    robot, mate = lost_robot(tmp_path / "a"), robot_on(tmp_path / "b", index=1)
    anchors, maps, seq = [], [], 0

    def speak(frames):
        nonlocal seq
        for n in range(frames):
            out = robot.choose_frame(round((100 + seq + n) * 1e9), 200)
            if out is not None and out.kind in (Kind.MAP, Kind.ANCHOR):
                hear(mate, out.kind, out.payload, sender=0, t_s=100.0 + seq, seq=seq)
                (maps if out.kind == Kind.MAP else anchors).append(out.payload)
            seq += 1

    hear(robot, Kind.STATUS, pack_status(Status(Pose(0, 0, 0, 0), (1e-4,) * 4, 0)), sender=1)
    speak(20)
    assert maps
    assert [unpack_anchor(a)[1].is_located for a in anchors] == [False]
    assert not mate.team.fused().known.any()
    assert not robot.team.fused().known.any(), "nor itself, in the team's frame"

    before = len(maps)
    there = Pose(14.0, 3.0, 2.0, 0.0)
    hear(robot, Kind.FIX, pack_fix(Fix(0, 1.0, there, (1e-4, 1e-4, 1e-4, 1e-6))), sender=1)
    assert robot.located
    assert log_of(robot).told("located") == ["seen by cliffbot"]
    speak(20)
    assert len(maps) == before, "the map is not sent again"
    assert [unpack_anchor(a)[1].is_located for a in anchors] == [False, True]
    assert len(anchors[-1]) < 40
    assert mate.store.digest() == robot.store.digest()
    found = mate.team.fused()
    assert np.count_nonzero(found.known) == pytest.approx(40, abs=10)
    assert found.elevation_m[found.known] == pytest.approx(3.0, abs=0.1)


def test_a_lost_robot_is_not_told_where_it_was_before_it_moved_on(tmp_path):
    robot = lost_robot(tmp_path)
    robot.stands_since_s = 50.0

    def told(t_s):
        fix = Fix(0, t_s, Pose(14.0, 3.0, 2.0, 0.0), (1e-4, 1e-4, 1e-4, 1e-6))
        hear(robot, Kind.FIX, pack_fix(fix), sender=1, t_s=60.0, seq=round(t_s))

    told(49.0)
    assert not robot.located
    told(51.0)
    assert robot.located


def test_what_was_mapped_while_lost_lies_by_the_filter_in_a_frame_of_its_own(tmp_path):
    robot = lost_robot(tmp_path)
    before = robot.charted()
    assert np.count_nonzero(before.known) == 40
    assert robot.charted(relative=True).elevation_m[before.known] == pytest.approx(1.0)
    robot.filter.fix(Pose(17.0, 1.0, 0.5, 0.0), np.diag([1e-6] * 4))
    assert robot.charted().known.sum() == 40
    assert not robot.team.fused().known.any()


def test_how_unsure_a_place_of_the_teams_map_is_by_the_anchors_round_it(tmp_path):
    robot, mate = robot_on(tmp_path / "a", index=1), robot_on(tmp_path / "b", index=0)
    mate.filter = type(mate.filter)(mate.pose, np.diag([0.04, 0.01, 0.0025, 1e-4]))
    mate.begin_submap()
    measure(mate, look_at_floor())
    chunks = say(mate, 30)
    assert chunks
    for chunk in chunks:
        robot.store.offer(chunk)
        robot.team.tile_changed(chunk.key)
    for key, anchor in mate.store.anchors.items():
        robot.store.offer_anchor(key, anchor)
    robot.team.relative()
    here = mate.own.submaps[0].anchor.corrected
    x, y, z, yaw = robot.team.placing((here.x_m, here.y_m), 100.0)
    assert (x, y, z, yaw) == pytest.approx((0.04, 0.01, 0.0025, 1e-4), rel=0.2)
    farther = robot.team.placing((here.x_m, here.y_m + 10.0), 100.0)
    assert farther[0] == pytest.approx(0.04 + 100 * 1e-4, rel=0.2)
    assert robot.team.placing((here.x_m, here.y_m), 0.0).tolist() == [0.0] * 4


def test_a_robot_that_restarts_lost_is_still_lost(tmp_path):
    robot = lost_robot(tmp_path)
    robot.disk.save_layer(robot._layer_content())
    again = robot_on(tmp_path)
    assert not again.located
    assert min(again.said_variance[:2]) > 1e6


def test_a_sighting_moves_the_anchors_that_were_published_and_no_byte_of_the_map(tmp_path):
    robot = robot_on(tmp_path)
    robot.begin_submap()
    measure(robot, look_at_floor())
    assert say(robot, 10)
    digest = robot.store.digest()
    robot.filter.predict(Odometry(2.0, 0.0, 0.0, 0.0, np.eye(4) * 0.04))
    robot.filter.fix(Pose(robot.pose.x_m + 0.3, 1.0, 0.1, 0.0), np.eye(4) * 1e-6)
    robot.correct_anchors()
    assert robot.store.digest() == digest, "the start was known: only what was driven since was not"
    robot.filter.fix(Pose(robot.pose.x_m, 1.0, 0.1, 0.0), np.eye(4) * 1e-12)
    assert not say(robot, 10, t_s=200.0)


def test_the_next_robot_is_the_origin_when_the_first_falls_silent(tmp_path):
    settings = robot_on(tmp_path, index=1).settings
    roles = ("explorer", "explorer", "anchor", "explorer")
    settings = type(settings)(**{**vars(settings), "roles": roles})
    mates = {}

    def origin(now_s, *, located=True):
        return origin_of(settings, mates, heard_since_s=now_s - 240.0, located=located)

    assert origin(0.0) == 0, "not heard yet"
    assert origin(300.0) == 1
    robot = robot_on(tmp_path / "b", index=1)
    hear(robot, Kind.STATUS, pack_status(Status(Pose(0, 0, 0, 0), (1e-4,) * 4, 1)), 0, 200.0)
    mates.update(robot.mates)
    assert origin(300.0) == 0
    assert origin(500.0) == 1
    assert origin(500.0, located=False) is None, "nobody of whom it knows"
    standing = Status(Pose(0, 0, 0, 0), (1e-4,) * 4, 2)
    hear(robot, Kind.STATUS, pack_status(standing), 0, 210.0)
    assert reference(settings, robot.mates, "recon", origin=0) is not None
    assert reference(settings, robot.mates, "recon", origin=1) is None, "an origin follows nobody"
    moving = Status(Pose(0, 0, 0, 0), (1e-4,) * 4, 1)
    hear(robot, Kind.STATUS, pack_status(moving), 0, 220.0)
    assert reference(settings, robot.mates, "recon", origin=0) is None, "where is it by now?"
    assert math.isfinite(robot.filter.sigma_m)
