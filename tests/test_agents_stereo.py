import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stereo_helpers import (
    SENSOR,
    STEREO,
    motorcycle,
    needs_motorcycle,
    opencv_sample,
    scored,
)

from agents.stereo.calibration import Calibration, CalibrationError, pinhole
from agents.stereo.conditions import ill_conditions
from agents.stereo.edges import refined
from agents.stereo.eyes import left_eye_m, level_from_camera
from agents.stereo.matching import (
    FLOOR_PX,
    Matched,
    MatchSettings,
    PairError,
    agreeing,
    match,
)
from agents.stereo.noise import noise_by_level
from agents.stereo.points import Cloud, cloud, covariances, fit_range_law
from agents.stereo.span import largest_disparity
from agents.stereo.tagmodel import TAG_M, TagError, is_lid, panels, robot_of
from agents.stereo.tags import find_robots

PAIR = pinhole(320, 240, 60.0, 0.3)
NO_CALIBRATION_ERROR = Calibration(
    width_px=320,
    height_px=240,
    focal_px=300.0,
    cx_px=160.0,
    cy_px=120.0,
    baseline_m=0.25,
    focal_sigma=0.0,
    baseline_sigma=0.0,
    offset_sigma_px=0.0,
)


def shifted_pair(shift_px: int, noise: float = 1.0, width: int = 160) -> tuple[np.ndarray, ...]:
    """Return a random picture, and the same as the right camera sees it at one disparity."""
    rng = np.random.default_rng(5)
    wide = cv2.GaussianBlur(rng.random((96, width + shift_px)) * 255, (0, 0), 1.2)
    wide = np.clip((wide - 128) * 3 + 128, 0, 255)
    pair = (wide[:, :width], wide[:, shift_px:])
    return tuple(
        np.clip(np.rint(i + rng.normal(0, noise, i.shape)), 0, 255).astype(np.uint8) for i in pair
    )


@pytest.mark.parametrize("shift_px", [0, 7, 30])
def test_a_shifted_picture_is_matched_at_its_shift(shift_px: int) -> None:
    # What the left camera sees at u, the right one sees at u - d.
    left, right = shifted_pair(shift_px)
    found = match(left, right, MatchSettings(max_disparity_px=40))
    inner = found.disparity_px[:, shift_px:]
    assert np.isfinite(inner).mean() > 0.95
    assert np.nanmedian(np.abs(inner - shift_px)) < 0.1
    assert np.isnan(found.disparity_px[:, : max(shift_px - 2, 0)]).all()


def test_the_left_margin_is_matched_as_far_as_both_images_show_it() -> None:
    left, right = shifted_pair(7)
    found = match(left, right, MatchSettings(max_disparity_px=60)).disparity_px
    assert np.isfinite(found[:, 10:60]).mean() > 0.95


def test_losses_and_matches_make_up_the_image() -> None:
    left, right = shifted_pair(7)
    left[:40], right[:40] = 128, 128
    found = match(left, right, MatchSettings(max_disparity_px=31))
    assert found.density + sum(found.lost.values()) == pytest.approx(1.0, abs=1e-6)
    assert np.array_equal(np.isfinite(found.disparity_px), np.isfinite(found.sigma_px))
    assert np.isnan(found.disparity_px[:34]).all()


def test_noise_alone_is_not_matched() -> None:
    rng = np.random.default_rng(0)
    left, right = (
        np.clip(rng.normal(90, 2, (120, 160)), 0, 255).astype(np.uint8) for _ in range(2)
    )
    assert match(left, right, MatchSettings(max_disparity_px=31)).density < 0.05


def test_noise_is_measured() -> None:
    rng = np.random.default_rng(0)
    plain = np.clip(np.rint(rng.normal(90, 2.0, (240, 320))), 0, 255).astype(np.uint8)
    assert noise_by_level(plain)[90] == pytest.approx(2.0, rel=0.15)


def test_noise_that_grows_with_light_is_not_taken_for_texture() -> None:
    """Shot noise: a dark sky over bright, textureless ground."""
    rng = np.random.default_rng(0)
    level = np.full((160, 160), 40.0)
    level[60:] = 160.0
    shots = [rng.normal(level, np.sqrt(level / 20)) for _ in range(2)]
    left, right = (np.clip(np.rint(shot), 0, 255).astype(np.uint8) for shot in shots)
    noise = noise_by_level(left, right)
    assert noise[40] == pytest.approx(math.sqrt(2), rel=0.15)
    assert noise[160] == pytest.approx(math.sqrt(8), rel=0.15)
    assert (np.diff(noise) >= 0).all()
    assert match(left, right, MatchSettings(max_disparity_px=31)).density < 0.03


def test_agreement_is_by_the_pixel_that_the_disparity_leads_to() -> None:
    left = np.array([[np.nan, 1, 2, 2, 2]], dtype=np.float32)
    right = np.array([[1.4, 2.6, 9, np.nan, 0]], dtype=np.float32)
    assert agreeing(left, right, 1.0).tolist() == [[False, True, True, True, False]]


@pytest.mark.parametrize(
    ("left", "right", "most"),
    [
        (np.zeros((64, 64), np.uint8), np.zeros((64, 65), np.uint8), 16),
        (np.zeros((64, 64, 3), np.uint8), np.zeros((64, 64, 3), np.uint8), 16),
        (np.zeros((64, 64), np.uint16), np.zeros((64, 64), np.uint16), 16),
        (np.zeros((64, 64), np.uint8), np.zeros((64, 64), np.uint8), 64),
        (np.zeros((64, 64), np.uint8), np.zeros((64, 64), np.uint8), -1),
        (np.zeros((16, 64), np.uint8), np.zeros((16, 64), np.uint8), 16),
    ],
)
def test_what_is_no_pair_is_refused(left: np.ndarray, right: np.ndarray, most: int) -> None:
    with pytest.raises(PairError):
        match(left, right, MatchSettings(max_disparity_px=most))


def test_a_pair_without_anything_to_match_has_no_largest_disparity() -> None:
    empty = np.full((120, 160), 100, dtype=np.uint8)
    with pytest.raises(PairError, match="nothing in the two images"):
        largest_disparity(empty, empty)


@needs_motorcycle
def test_a_real_pair_is_matched_better_than_by_opencvs_sample() -> None:
    pair = motorcycle()
    most = largest_disparity(pair.left, pair.right)
    assert np.nanmax(pair.truth_px) <= most <= 1.5 * np.nanmax(pair.truth_px)
    found = match(pair.left, pair.right, MatchSettings(max_disparity_px=most))
    density, bad = scored(found.disparity_px, pair.truth_px)
    their_density, their_bad = scored(opencv_sample(pair.left, pair.right), pair.truth_px)
    assert density > their_density
    assert bad < their_bad
    assert density > 0.85
    assert bad < 0.055
    # Where it is right, it is as right as it says.
    error = np.abs(found.disparity_px - pair.truth_px)
    assert np.nanquantile(error / found.sigma_px, 0.68) < 1.2


@needs_motorcycle
def test_real_points_lie_where_the_truth_does() -> None:
    pair = motorcycle()
    found = match(pair.left, pair.right, MatchSettings(max_disparity_px=64))
    points = cloud(found, pair.calibration, stride_px=4)
    c = pair.calibration
    truth_m = c.focal_px * c.baseline_m / (pair.truth_px + c.doffs_px)
    error_m = points.points_m[:, 2] - truth_m[points.pixels[:, 0], points.pixels[:, 1]]
    assert np.nanmedian(np.abs(error_m)) < 0.012


def test_depth_by_hand() -> None:
    pair = Calibration(
        width_px=100,
        height_px=100,
        focal_px=500.0,
        cx_px=50,
        cy_px=50,
        baseline_m=0.2,
        doffs_px=5.0,
    )
    depth_m = pair.depth_m(np.array([20.0, -5.0, -7.0, np.nan]))
    assert depth_m[0] == pytest.approx(4.0)
    assert np.isinf(depth_m[1:3]).all()
    assert np.isnan(depth_m[3])


@given(x=st.floats(-2, 2), y=st.floats(-2, 2), z=st.floats(0.5, 30.0), doffs=st.floats(-40.0, 40.0))
@settings(max_examples=50, deadline=None)
def test_a_point_comes_back_from_its_pixels(x: float, y: float, z: float, doffs: float) -> None:
    pair = Calibration(
        width_px=640, height_px=480, focal_px=500.0, cx_px=310, cy_px=230, baseline_m=0.3,
        doffs_px=doffs,
    )  # fmt: skip
    point = np.array([[x, y, z]])
    left, right = pair.pixels(point), pair.pixels(point, right=True)
    assert left[0, 1] == right[0, 1]
    disparity = left[0, 0] - right[0, 0]
    assert float(pair.depth_m(np.array([disparity]))[0]) == pytest.approx(z, rel=1e-9)
    assert pair.disparity_px(z) == pytest.approx(disparity, abs=1e-9)


@pytest.mark.parametrize(
    "wrong",
    [{"focal_px": 0.0}, {"baseline_m": -0.1}, {"cx_px": math.nan}, {"focal_sigma": -1.0}],
)
def test_an_impossible_calibration_is_refused(wrong: dict[str, float]) -> None:
    good = {"width_px": 10, "height_px": 10, "focal_px": 9.0, "cx_px": 5, "cy_px": 5}
    with pytest.raises(CalibrationError, match=next(iter(wrong))):
        Calibration(**(good | {"baseline_m": 0.1} | wrong))


def test_covariance_is_what_noisy_disparities_do() -> None:
    c, rng = NO_CALIBRATION_ERROR, np.random.default_rng(1)
    point = np.array([[1.0, 0.5, 6.0]])
    sigma_px = np.array([0.2])
    said = covariances(point, sigma_px, c)[0]
    u = c.pixels(point)[0] + rng.uniform(-0.5, 0.5, (200_000, 2))
    disparity = c.disparity_px(6.0) + rng.normal(0, 0.2, 200_000)
    z = c.depth_m(disparity)
    drawn = np.column_stack(((u[:, 0] - c.cx_px) * z, (u[:, 1] - c.cy_px) * z, z * c.focal_px))
    measured = np.cov((drawn / c.focal_px).T)
    assert np.allclose(said, measured, rtol=0.06, atol=2e-6)


def test_covariance_counts_what_the_calibration_has_wrong() -> None:
    wrong = {"focal_sigma": 0.01, "baseline_sigma": 0.02, "offset_sigma_px": 0.4}
    base = {
        "width_px": 320, "height_px": 240, "focal_px": 300.0, "cx_px": 160.0, "cy_px": 120.0,
        "baseline_m": 0.25,
    }  # fmt: skip
    point = np.array([[0.0, 0.0, 5.0]])
    got = covariances(point, np.array([0.0]), Calibration(**base, **wrong))[0, 2, 2]
    per_px = 25 / (300 * 0.25)
    assert got == pytest.approx((5 * 0.01) ** 2 + (5 * 0.02) ** 2 + (per_px * 0.4) ** 2)


def test_the_law_of_range_is_equation_4() -> None:
    """With noise of disparity alone sigma is S L^2 along the optical axis: S = sigma_d / (f b)."""
    c = NO_CALIBRATION_ERROR
    z = np.linspace(2, 12, 50)
    points = np.column_stack((np.zeros(50), np.zeros(50), z))
    law = fit_range_law(
        Cloud(points, covariances(points, np.full(50, 0.25), c), np.zeros((50, 2), dtype=np.int64))
    )
    assert law.n == pytest.approx(2.0, abs=1e-6)
    assert law.s == pytest.approx(0.25 / (300 * 0.25), rel=1e-6)
    assert law.residual < 1e-9
    # Across: the pixel's width, z / f * 0.29; at the median range of 7 m.
    assert law.t_right == pytest.approx(0.29 / 300 * 7 / (law.s * 49), rel=0.05)
    assert law.t_down == pytest.approx(law.t_right)


def test_strides_take_pixels_from_the_middle_and_bounds_hold() -> None:
    disparity = np.full((12, 12), 10.0, dtype=np.float32)
    disparity[6:] = 1.0
    matched = Matched(disparity, np.full_like(disparity, 0.2), {})
    c = NO_CALIBRATION_ERROR
    found = cloud(matched, c, stride_px=4, far_m=10.0)
    assert found.pixels.tolist() == [[2, 2], [2, 6], [2, 10]]
    assert np.allclose(found.points_m[:, 2], 300 * 0.25 / 10)
    assert cloud(matched, c, near_m=10.0).points_m.shape[0] == 72


def test_ill_conditions_are_told() -> None:
    dark = np.full((60, 80), 3, dtype=np.uint8)
    nothing = Matched(
        np.full((60, 80), np.nan, dtype=np.float32),
        np.full((60, 80), np.nan, dtype=np.float32),
        {"little texture": 0.9},
    )
    told = " | ".join(ill_conditions(dark, dark, nothing))
    assert "too dark" in told
    assert "little texture: 90%" in told
    assert "few matches: 0%" in told
    white = np.full((60, 80), 255, dtype=np.uint8)
    assert "too bright: 100%" in " | ".join(ill_conditions(white, white, nothing))
    full = Matched(np.ones((60, 80), np.float32), np.ones((60, 80), np.float32), {})
    grey = np.full((60, 80), 120, dtype=np.uint8)
    assert ill_conditions(grey, grey, full) == ()


def test_panels_face_outwards_and_are_the_robots_own() -> None:
    tags = [panel.tag for robot in range(3) for panel in panels(robot)]
    assert len(set(tags)) == 15
    for robot in range(3):
        for panel in panels(robot):
            assert robot_of(panel.tag) == robot
            assert is_lid(panel.tag) == (panel.centre_m[0] == panel.centre_m[1])
            out = np.cross(panel.down, panel.right)
            assert out @ panel.centre_m > 0.2
            corners = panel.corners_m()
            assert np.linalg.norm(corners[1] - corners[0]) == pytest.approx(TAG_M)
            assert np.cross(corners[3] - corners[0], corners[1] - corners[0]) @ out > 0
    with pytest.raises(TagError, match="robot 117"):
        panels(117)


@given(
    shift=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    turn_deg=st.floats(-40, 40),
    blur=st.floats(0.3, 1.2),
)
@settings(max_examples=25, deadline=None)
def test_a_blurred_squares_corners_are_found_to_a_seventh_of_a_pixel(
    shift: tuple[float, float], turn_deg: float, blur: float
) -> None:
    turn = math.radians(turn_deg)
    axes = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    square = 24 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) @ axes.T + 50 + np.array(shift)
    fine_px = (np.arange(500) - 2) / 5
    grid = np.stack(np.meshgrid(fine_px, fine_px), axis=-1) - 50 - np.array(shift)
    inside = np.clip((24 - np.abs(grid @ axes).max(axis=-1)) / 0.2 + 0.5, 0, 1)
    fine = (200 - 180 * inside).astype(np.float32)
    image = cv2.resize(fine, (100, 100), interpolation=cv2.INTER_AREA)
    image = np.rint(cv2.GaussianBlur(image, (0, 0), blur)).astype(np.uint8)
    rough = square + np.array([(0.6, -0.4), (-0.3, 0.5), (0.5, 0.5), (-0.6, 0.2)])
    assert np.abs(refined(image, rough) - square).max() < 0.15


def test_the_levelled_frame_is_reached_by_turning_the_arm() -> None:
    ahead = level_from_camera(0.0, 0.0)
    assert np.allclose(ahead @ [0, 0, 1], [1, 0, 0])
    assert np.allclose(ahead @ [1, 0, 0], [0, -1, 0])
    assert np.allclose(ahead @ [0, 1, 0], [0, 0, -1])
    left_and_down = level_from_camera(math.pi / 2, math.radians(-30))
    assert np.allclose(left_and_down @ [0, 0, 1], [0, math.cos(math.pi / 6), -0.5])
    assert np.linalg.det(left_and_down) == pytest.approx(1.0)


def test_an_empty_pair_shows_no_robots() -> None:
    rng = np.random.default_rng(0)
    left, right = (rng.integers(0, 255, (240, 320)).astype(np.uint8) for _ in range(2))
    search = find_robots(left, right, PAIR, [0, 1, 2])
    assert search.found == ()


def test_sigma_never_claims_more_than_the_matcher_can() -> None:
    left, right = shifted_pair(7, noise=0.5)
    found = match(left, right, MatchSettings(max_disparity_px=31))
    assert np.nanmin(found.sigma_px) >= FLOOR_PX


def test_the_left_eye_is_half_a_baseline_to_the_left() -> None:
    assert np.allclose(left_eye_m(SENSOR, STEREO, 0.0), [0.0, 0.15, SENSOR.height_m])
    assert np.allclose(left_eye_m(SENSOR, STEREO, math.pi / 2), [-0.15, 0.0, SENSOR.height_m])
