"""Legs whose motion the eyes tell: what goes into the pose filter, and what is told where not."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim_helpers import run
from stereo_helpers import flat, stage

from agents.geometry import Pose, wrap_angle
from agents.ports import Glance, Odometry
from agents.pose import rotations
from agents.pose.posefilter import PoseFilter
from agents.pose.rigidmotion import Motion
from agents.pose.waywatch import LEG, WayWatch, camera_motion, robot_motion
from agents.settings import DriveSettings, SensorSettings
from agents.stereo.eyes import left_eye_m, level_from_camera
from agents.stereo.settings import StereoSettings, glance_calibration
from sim.rover import RoverBody
from sim.stereo.camera import StereoCamera

SENSOR = SensorSettings(kind="stereo")
NOWHERE = np.zeros((2, 2), dtype=np.uint8)
START = Pose(5.0, 5.0, 0.0, 0.0)
SURE = np.diag([1e-6, 1e-6, 1e-6, 1e-8])
angles = st.floats(-3.0, 3.0)
lengths = st.floats(-1.5, 1.5)


def glance(pan_rad, tilt_rad=-0.4):
    return Glance(pan_rad, tilt_rad, NOWHERE, NOWHERE)


def ordered(forward_m, left_m, up_m, turn_rad):
    return Odometry(forward_m, left_m, up_m, turn_rad, np.eye(4))


@settings(max_examples=50, deadline=None)
@given(angles, angles, st.floats(-1.2, 0.2), lengths, lengths, lengths, angles)
def test_a_camera_goes_as_its_robot_goes_and_back(pan, after_pan, tilt, forward, left, up, turn):
    before, after = glance(pan, tilt), glance(after_pan, tilt)
    moved = camera_motion(ordered(forward, left, up, turn), before, after, SENSOR)
    offset, _, doubt = robot_motion(moved, before, after, SENSOR)
    assert doubt == ""
    assert offset[:3] == pytest.approx([forward, left, up], abs=1e-9)
    assert wrap_angle(offset[3] - turn) == pytest.approx(0.0, abs=1e-9)


def test_a_camera_sees_a_standing_point_where_the_motion_says():
    before, after = glance(0.5), glance(0.1)
    pose = Pose(0.0, 0.0, 0.0, 0.0).moved(0.8, 0.1, 0.05, 0.3)
    moved = camera_motion(ordered(0.8, 0.1, 0.05, 0.3), before, after, SENSOR)
    point = np.array([[4.0, 1.0, -0.2]])

    def seen(at, look):
        back = np.array([[math.cos(at.yaw_rad), math.sin(at.yaw_rad), 0.0],
                         [-math.sin(at.yaw_rad), math.cos(at.yaw_rad), 0.0],
                         [0.0, 0.0, 1.0]])  # fmt: skip
        level = (point - [at.x_m, at.y_m, at.z_m]) @ back.T
        eye = left_eye_m(SENSOR, SENSOR.stereo, look.pan_rad)
        return (level - eye) @ level_from_camera(look.pan_rad, look.tilt_rad)

    there = moved.moved(seen(Pose(0.0, 0.0, 0.0, 0.0), before))
    assert there == pytest.approx(seen(pose, after), abs=1e-9)


def test_the_covariance_is_that_of_the_errors():
    rng = np.random.default_rng(1)
    before, after = glance(0.4), glance(0.0)
    truth = camera_motion(ordered(1.0, 0.05, 0.1, 0.4), before, after, SENSOR)
    root = np.diag([0.004, 0.003, 0.006, 0.001, 0.002, 0.0015])
    noise = root @ root
    level_rad = math.radians(SENSOR.attitude_sigma_deg)
    offsets = []
    for _ in range(3000):
        error = root @ rng.standard_normal(6)
        turn = rotations.from_vector(error[3:]) @ truth.rotation
        # The arm is off level before and after: the camera is turned about x and y of its robot.
        lean = [rotations.from_vector(np.append(rng.normal(0, level_rad, 2), 0.0)) for _ in "ab"]
        one, other = (level_from_camera(g.pan_rad, g.tilt_rad) for g in (before, after))
        into, out = one.T @ lean[0].T @ one, other.T @ lean[1].T @ other
        measured = Motion(out @ turn @ into.T, out @ (truth.translation_m + error[:3]), noise)
        offsets.append(robot_motion(measured, before, after, SENSOR)[0])
    _, said, _ = robot_motion(Motion(truth.rotation, truth.translation_m, noise), before, after,
                              SENSOR)  # fmt: skip
    assert np.mean(offsets, axis=0) == pytest.approx([1.0, 0.05, 0.1, 0.4], abs=2e-3)
    made = np.cov(np.array(offsets).T)
    assert np.sqrt(np.diag(said)) == pytest.approx(np.sqrt(np.diag(made)), rel=0.25)


def test_a_motion_that_leans_is_doubted():
    before = after = glance(0.0)
    lean = rotations.from_vector(np.array([0.1, 0.0, 0.0]))
    sure = Motion(lean, np.zeros(3), np.eye(6) * 1e-6)
    assert "level arm" in robot_motion(sure, before, after, SENSOR)[2]


def watched(legs, *, drive=None, on=None, start=START, seed=0, sensor=SENSOR):
    """Drive legs (turn, forward) over level ground; return filters, truth, and what was told."""
    told = []
    rng = np.random.default_rng(seed)
    here = on or stage()
    body = RoverBody("alfa", flat(), drive or DriveSettings(), start, lambda _: None, rng)
    eyes = StereoCamera("alfa", here, sensor, body.pose_now, lambda _: {}, rng)
    watch = WayWatch(eyes, sensor, np.random.default_rng(1), lambda *what: told.append(what))
    ways = [PoseFilter(start, SURE) for _ in range(2)]
    for way in ways:
        way.doubt_slip(0.01)

    async def go():
        for turn_rad, forward_m in legs:
            await watch.begin(turn_rad, ways[1])
            odometry = await body.drive(turn_rad, forward_m)
            for way in ways:
                way.predict(odometry)
            await watch.end(odometry, ways[1])
        watch.tell_way()
        return body.pose_now()

    return ways, run(go()), told, watch


def off_m(way, truth):
    return math.hypot(way.pose.x_m - truth.x_m, way.pose.y_m - truth.y_m)


SLIPPERY = DriveSettings(slip_sigma=0.1)


def test_images_know_what_wheels_don_t():
    (wheels, eyes), truth, told, watch = watched(
        [(-0.4, 1.0), (0.1, 1.0), (0.9, 0.7)], drive=SLIPPERY
    )
    assert told == [("motion from images", "3 of 3 legs")]
    assert off_m(wheels, truth) > 3 * off_m(eyes, truth)
    assert off_m(eyes, truth) < 0.02
    assert eyes.sigma_m < 0.2 * wheels.sigma_m
    assert not eyes.holds(LEG)
    assert watch.seen is not None
    assert watch.seen.step.inliers.sum() > 20


def test_the_same_seed_gives_the_same_way():
    (one, same) = (watched([(-0.3, 1.0)])[0][1] for _ in range(2))
    assert one.pose == same.pose
    assert np.array_equal(one.covariance, same.covariance)


def test_where_images_tell_nothing_wheels_do_and_it_is_said():
    dark = stage(sun=0.0, sky=0.0)
    (wheels, eyes), _, told, _ = watched([(-0.3, 1.0)], on=dark)
    assert eyes.pose == wheels.pose
    assert np.array_equal(eyes.covariance, wheels.covariance)
    (what, why), summary = told
    assert what == "no motion from images"
    assert "too dark" in why
    assert summary == ("motion from images", "0 of 1 legs")


def test_poor_ground_is_no_way_to_tell():
    (wheels, eyes), _, told, _ = watched([(0.0, 1.0)], start=Pose(6.0, 15.0, 0.0, 1.57))
    assert eyes.pose == wheels.pose
    assert told[0][0] == "no motion from images"
    assert "texture" in told[0][1] or "fiducials" in told[0][1]


def test_a_glance_is_the_pair_read_smaller():
    small = glance_calibration(60.0, StereoSettings())
    assert (small.width_px, small.height_px) == (320, 240)
    whole = StereoSettings(glance_binning=1)
    assert whole.glanced().width_px == whole.width_px
