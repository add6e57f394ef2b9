"""Eqs. 17, 18: fiducials chosen in the ground, followed, and the motion that they tell."""

import math
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stereo_helpers import SENSOR, STEREO, stage

from agents.geometry import Pose
from agents.pose import rotations
from agents.pose.rigidmotion import Motion
from agents.stereo.calibration import pinhole
from agents.stereo.eyes import Look, calibration_of
from agents.stereo.fiducials import (
    BESIDE_PX,
    PENALTY,
    certainty,
    choose,
    depth_contrast,
    spread_out,
    visual_contrast,
)
from agents.stereo.interest import candidates, gradients, placing_variance
from agents.stereo.matching import FLOOR_PX, Matched
from agents.stereo.noise import noise_by_level
from agents.stereo.odometry import Odometer
from agents.stereo.spots import Frame
from agents.stereo.tracks import (
    agreeing,
    follow,
    homography,
    mapped,
    mean_plane,
    stretch,
)
from sim.stereo.camera import take

CAMERA = pinhole(320, 240, 60.0, 0.3)
CALM = np.full(256, 0.5)
SOUTH = Pose(6.0, 5.0, 0.0, 0.0)
"""On the part of the ground that has texture."""
DOWN = Look(0.0, 0.0, math.radians(-30))


# --- Foerstner --------------------------------------------------------------------------------


def test_a_ramp_has_the_gradients_of_a_ramp_and_no_corner():
    v, u = np.mgrid[0:40, 0:40]
    n = gradients((3 * u + v).astype(np.uint8)).at(np.array([[20.0, 20.0]]))[0]
    assert n == pytest.approx(81 * np.array([[9.0, 3.0], [3.0, 1.0]]))
    assert gradients((3 * u + v).astype(np.uint8)).strength[20, 20] == pytest.approx(0, abs=1e-3)


def test_strength_and_roundness_by_hand():
    bowl = np.zeros((40, 40))
    bowl[:, :20], bowl[:20, :] = 100.0, 100.0
    found = gradients(bowl.astype(np.uint8))
    xx, yy, xy = (float(m[20, 20]) for m in (found.xx, found.yy, found.xy))
    assert found.strength[20, 20] == pytest.approx((xx * yy - xy**2) / (xx + yy), rel=1e-4)
    assert found.roundness[20, 20] == pytest.approx(
        4 * (xx * yy - xy**2) / (xx + yy) ** 2, rel=1e-4
    )
    assert placing_variance(np.array([8.0]), np.array([2.0])) == pytest.approx(2 * 4 / 8)


def test_candidates_are_corners_and_not_edges_or_noise():
    rng = np.random.default_rng(1)
    image = np.full((120, 160), 90.0)
    image[40:70, 50:90] = 170.0  # four corners, four edges
    noisy = np.clip(image + rng.normal(0, 1.0, image.shape), 0, 255).astype(np.uint8)
    found = candidates(noisy, np.full(256, 1.0))
    corners = np.array([(49.5, 39.5), (89.5, 39.5), (49.5, 69.5), (89.5, 69.5)])
    assert len(found) >= 4
    apart = np.linalg.norm(found[:, None] - corners[None], axis=2)
    assert apart.min(axis=1).max() < 6  # every candidate is at a corner
    assert apart.min(axis=0).max() < 6  # and every corner has one


# --- the three terms of Eq. 17, by hand ---------------------------------------------------------


def test_certainty_is_p_over_the_radius_within_which_it_falls():
    sigma = np.full((60, 60), 2 * FLOOR_PX, dtype=np.float32)
    assert certainty(sigma, np.array([[30, 30]])) == pytest.approx([0.5])  # r = 1: falls nowhere
    row, col = np.mgrid[0:60, 0:60]
    ring = np.maximum(np.abs(row - 30), np.abs(col - 30))
    falling = (FLOOR_PX * (1.0 + np.minimum(ring, 8))).astype(np.float32)
    # Rings up to 8 fall; beyond 8 all are 1/9, which is still below the ring from 5 to 8.
    assert certainty(falling, np.array([[30, 30]])) == pytest.approx([1.0 / 16])
    falling[np.abs(ring - 3) <= 1] = FLOOR_PX  # the ring from 3 to 4 is sure again
    assert certainty(falling, np.array([[30, 30]])) == pytest.approx([1.0 / 2])


def test_visual_contrast_by_hand():
    image = np.full((80, 80), 100, dtype=np.uint8)
    image[40, 40] = 200
    mean = (100 * (33**2 - 1) + 200) / 33**2
    assert visual_contrast(image, np.array([[40, 40]])) == pytest.approx([(200 - mean) / mean * 33])
    image[36:45, 36:45] = 200  # bright as far as a window of 9; two dark rings, then bright again
    image[34:47, 34:47] = np.where(image[34:47, 34:47] == 200, 200, 20)
    image[:34], image[47:], image[:, :34], image[:, 47:] = 200, 200, 200, 200
    mean = (81 * 200 + (169 - 81) * 20 + (289 - 169) * 200) / 289  # of 17, the next falls
    assert visual_contrast(image, np.array([[40, 40]])) == pytest.approx([(200 - mean) / mean * 17])


def test_a_slope_has_no_depth_contrast_and_a_step_has():
    v, u = np.mgrid[0:80, 0:80].astype(np.float32)
    sigma = np.full((80, 80), 0.1, dtype=np.float32)
    spot = np.array([[40, 40]])
    assert depth_contrast(20 + 0.1 * u + 0.3 * v, sigma, spot) == pytest.approx([0.0])
    step = np.where(u < 40, 20, 26).astype(np.float32)
    assert depth_contrast(step, sigma, spot)[0] > 1.0
    assert depth_contrast(np.full((80, 80), np.nan, np.float32), sigma, spot) == [0.0]


def test_the_penalty_spreads_them_by_hand():
    spots = np.array([[0.0, 0.0], [10.0, 0.0], [40.0, 0.0], [2.0, 0.0]])
    score = np.array([2.0, 1.9, 1.2, 1.95])
    # Beside the first nothing is taken; the second loses PENALTY exp(-1) = 0.55, and leads still.
    assert spread_out(score, spots, 4, 10.0).tolist() == [0, 1, 2]
    assert 1.9 - PENALTY * math.exp(-1) > 1.2
    # At half the reach the third leads: the second loses 1.5 exp(-0.25).
    assert spread_out(score, spots, 2, 20.0).tolist() == [0, 2]
    # A fiducial that is there already counts like one that was taken.
    assert spread_out(score, spots, 1, 10.0, np.array([[0.0, BESIDE_PX - 1]])).tolist() == [1]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_no_two_are_beside_each_other(seed, count):
    rng = np.random.default_rng(seed)
    spots = rng.uniform(0, 100, (80, 2))
    picked = spots[spread_out(rng.uniform(0, 3, 80), spots, count, 15.0)]
    assert len(picked) <= count
    apart = np.linalg.norm(picked[:, None] - picked[None], axis=2)
    assert (apart[~np.eye(len(picked), dtype=bool)] >= BESIDE_PX).all()


# --- following ----------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_homography_takes_a_plane_where_the_motion_takes_it(seed):
    rng = np.random.default_rng(seed)
    plane = np.array([0.0, 0.3, 0.4]) + rng.normal(0, 0.05, 3)
    rays = np.column_stack((rng.uniform(-0.5, 0.5, (9, 2)), np.ones(9)))
    points = rays / (rays @ plane)[:, None]
    motion = Motion(
        rotations.from_vector(rng.normal(0, 0.1, 3)), rng.normal(0, 0.2, 3), np.zeros((6, 6))
    )
    h = homography(motion, plane, CAMERA)
    before = CAMERA.pixels(points)
    assert mapped(h, before) == pytest.approx(CAMERA.pixels(motion.moved(points)), abs=1e-6)
    step = 1e-4
    by_hand = (mapped(h, before + np.array([step, 0.0])) - mapped(h, before)) / step
    assert stretch(h, before)[:, :, 0] == pytest.approx(by_hand, rel=1e-3, abs=1e-4)


def test_the_mean_plane_is_the_plane_whatever_stands_on_it():
    plane = np.array([0.02, 0.45, 0.3])
    v, u = np.mgrid[0:240, 0:320].astype(np.float64)
    rays = np.stack(((u - CAMERA.cx_px), (v - CAMERA.cy_px), np.full(u.shape, CAMERA.focal_px)), -1)
    inverse = (rays / CAMERA.focal_px) @ plane
    disparity = CAMERA.focal_px * CAMERA.baseline_m * inverse
    disparity[inverse <= 0.05] = np.nan
    disparity[150:200, 100:180] += 9.0  # a rock
    found = mean_plane(Matched(disparity.astype(np.float32), disparity, {}), CAMERA)
    assert found == pytest.approx(plane, rel=0.02, abs=0.003)


def texture(seed=0, size=(200, 260)):
    rng = np.random.default_rng(seed)
    return cv2.GaussianBlur(rng.normal(0, 60, size), (0, 0), 2.0) * 3 + 120


def moved_by(image, u, v):
    shift = np.array([[1.0, 0.0, u], [0.0, 1.0, v]])
    size = (image.shape[1], image.shape[0])
    return cv2.warpAffine(image, shift, size, flags=cv2.INTER_CUBIC, borderValue=120)


def grey(image):
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def test_spots_are_followed_to_a_twentieth_of_a_pixel():
    before, after = grey(texture()), grey(moved_by(texture(), 3.4, -2.25))
    spots = candidates(before, CALM)[:40].astype(float)
    found = follow(before, after, spots, spots)
    assert found.found.mean() > 0.9
    off = (found.pixels - spots)[found.found] - [3.4, -2.25]
    assert np.abs(off).mean() < 0.05


def test_what_is_gone_is_not_followed():
    before, other = grey(texture(0)), grey(texture(1))
    spots = candidates(before, CALM)[:60].astype(float)
    assert follow(before, other, spots, spots).found.mean() < 0.1
    assert len(follow(before, other, spots[:0], spots[:0]).found) == 0


def test_false_tracks_leave_the_epipolar_lines():
    rng = np.random.default_rng(3)
    points = np.column_stack((rng.uniform(-1, 1, (60, 2)), rng.uniform(2, 6, 60)))
    turn = rotations.from_vector(np.array([0.02, 0.05, 0.01]))
    motion = Motion(turn, np.array([0.4, 0.05, -0.2]), np.zeros((6, 6)))
    before, after = CAMERA.pixels(points), CAMERA.pixels(motion.moved(points))
    after[:12] += rng.uniform(15, 30, (12, 2)) * rng.choice([-1, 1], (12, 2))
    kept = agreeing(before, after, CAMERA)
    assert kept[12:].mean() > 0.95
    assert kept[:12].sum() <= 3
    assert agreeing(before[:4], after[:4], CAMERA).all()  # too few to tell


# --- the whole way, on rendered pairs ------------------------------------------------------------


@cache
def frame(pose=SOUTH, look=DOWN, seed=0, sun=1.0, sky=0.25, longest=20.0):
    rng = np.random.default_rng(seed)
    shot = take(stage(sun, sky, longest), SENSOR, STEREO, pose, look, others={}, rng=rng)
    return Frame.of(shot.left, shot.right, 48)


def driven(pose, look=DOWN):
    """Return the true motion of the camera from SOUTH, DOWN to a pose and look; level ground."""

    def stands(at, seen):
        cp, sp, ct, st_ = (f(a) for a in (at.yaw_rad + seen.pan_rad, seen.tilt_rad)
                           for f in (math.cos, math.sin))  # fmt: skip
        turn = np.array([[sp, cp * st_, cp * ct], [-cp, sp * st_, sp * ct], [0.0, -ct, st_]])
        half = STEREO.baseline_m / 2
        return turn, np.array([at.x_m - half * sp, at.y_m + half * cp, at.z_m + SENSOR.height_m])

    (one, one_m), (other, other_m) = stands(SOUTH, DOWN), stands(pose, look)
    return Motion(other.T @ one, other.T @ (one_m - other_m), np.zeros((6, 6)))


def odometer(count=40, seed=0):
    found = Odometer(calibration_of(SENSOR, STEREO), count, np.random.default_rng(seed))
    found.begin(frame())
    return found


@pytest.mark.parametrize(
    ("pose", "guess"),
    [
        (SOUTH.moved(0.9, 0.05, 0.0, 0.03), SOUTH.moved(1.0, 0.0, 0.0, 0.0)),
        (SOUTH.moved(0.0, 0.0, 0.0, 0.3), SOUTH.moved(0.0, 0.0, 0.0, 0.25)),
        (SOUTH, SOUTH.moved(0.1, 0.0, 0.0, 0.0)),
    ],
    ids=["ahead", "a turn", "standing"],
)
def test_the_motion_is_told_as_exactly_as_it_says(pose, guess):
    step = odometer().step(frame(pose, seed=1), driven(guess))
    assert step.motion is not None, step.reason
    truth = driven(pose)
    turn = rotations.to_vector(truth.rotation @ step.motion.rotation.T)
    error = np.concatenate((truth.translation_m - step.motion.translation_m, turn))
    assert np.linalg.norm(error[:3]) < 0.012
    assert np.linalg.norm(error[3:]) < math.radians(0.2)
    assert error @ np.linalg.solve(step.motion.covariance, error) < 30  # chi2(6): 4e-5
    assert step.inliers.sum() >= 15


def test_the_same_images_tell_the_same_motion():
    one, same = (odometer().step(frame(SOUTH.moved(0.5, 0, 0, 0), seed=1), driven(SOUTH))
                 for _ in range(2))  # fmt: skip
    assert np.array_equal(one.motion.translation_m, same.motion.translation_m)
    assert np.array_equal(one.motion.covariance, same.motion.covariance)


def test_why_there_is_no_motion_is_told():
    away = SOUTH.moved(0.0, 0.0, 0.0, 2.0)
    assert "turned too far" in odometer().step(frame(away, seed=1), driven(away)).reason
    # Where the images show what nobody expected, no motion is made up.
    lost = odometer().step(frame(away, seed=1), driven(SOUTH))
    assert lost.motion is None
    assert lost.reason.startswith(("too few tracks", "the tracks agree"))
    dark = odometer().step(frame(SOUTH, sun=0.0, sky=0.0, seed=1), driven(SOUTH))
    assert dark.motion is None
    assert "too dark" in dark.reason


def test_poor_ground_has_too_few_fiducials_and_says_so():
    north = frame(Pose(6.0, 16.0, 0.0, 0.5), seed=1)
    walker = odometer()
    walker.begin(north)
    step = walker.step(frame(), driven(SOUTH))
    assert step.motion is None
    assert "little texture" in step.reason or "too few fiducials" in step.reason


def test_after_a_failure_it_goes_on_from_the_pair_after():
    walker = odometer()
    walker.step(frame(SOUTH, sun=0.0, sky=0.0, seed=1), driven(SOUTH))
    assert walker.step(frame(seed=2), driven(SOUTH)).motion is None  # nothing in the dark one
    step = walker.step(frame(SOUTH.moved(0.3, 0.0, 0.0, 0.0), seed=3), driven(SOUTH))
    assert step.motion is not None


def test_fiducials_are_spread_and_have_a_depth():
    seen = frame()
    found = choose(seen.left, seen.matched, 30, noise_by_level(seen.left, seen.right))
    assert len(found.pixels) == 30
    assert found.proposed > 60
    assert ((found.terms >= 0) & (found.terms <= 1)).all()
    col, row = found.pixels.astype(int).T
    assert np.isfinite(seen.matched.disparity_px[row, col]).all()
    quarters = {(u > 160, v > 120) for u, v in found.pixels}
    assert len(quarters) == 4
