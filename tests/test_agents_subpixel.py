"""Disparity between pixels, on pairs of which it is known; and where no points are made."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.geometry import Pose, Singles
from agents.ports import Exposure
from agents.stereo.calibration import pinhole
from agents.stereo.eyes import MATE_RADIUS_M, off_mates
from agents.stereo.matching import Grey, Matched, MatchSettings, match
from agents.stereo.points import cloud, matched_about
from agents.stereo.subpixel import FARTHEST_PX, refined

ROWS, COLS = 96, 160
STRIDE = 4
LATTICE = (slice(STRIDE // 2, None, STRIDE),) * 2


def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return a smooth pattern of waves longer than four pixels, in grey levels."""
    rng = np.random.default_rng(7)
    total = np.full(np.broadcast(x, y).shape, 128.0)
    for _ in range(40):
        along, phase = rng.uniform(0, 2 * math.pi, 2)
        k = 2 * math.pi / rng.uniform(4.5, 20.0)
        total += 9.0 * np.sin(k * (x * math.cos(along) + y * math.sin(along)) + phase)
    return total


def pair(
    plane: tuple[float, float, float], noise_dn: float, seed: int
) -> tuple[Grey, Grey, Singles]:
    """Return two images of a plane of disparity (at the middle, per column, per row), and it."""
    y, x = (v.astype(np.float64) for v in np.indices((ROWS, COLS)))
    disparity = plane[0] + plane[1] * (x - COLS / 2) + plane[2] * (y - ROWS / 2)
    # A point at column u of the left image is at u - d(u) in the right one.
    u = (x + plane[0] - plane[1] * COLS / 2 + plane[2] * (y - ROWS / 2)) / (1.0 - plane[1])
    rng = np.random.default_rng(seed)
    left, right = (
        np.clip(np.rint(view + rng.normal(0.0, noise_dn, x.shape)), 0, 255).astype(np.uint8)
        for view in (texture(x, y), texture(u, y))
    )
    return left, right, disparity.astype(np.float32)


def known(disparity: Singles, off_px: float, sigma_px: float = 0.3) -> Matched:
    """Return what a matcher says that is wrong everywhere by as much."""
    found = (disparity + np.float32(off_px)).astype(np.float32)
    return Matched(found, np.full_like(found, sigma_px), {})


def inner(values: Singles) -> np.ndarray:
    return values[LATTICE][4:-4, 6:-4].astype(np.float64).ravel()


@settings(max_examples=12, deadline=None)
@given(st.floats(6.0, 9.0), st.floats(-0.08, 0.08), st.floats(-0.08, 0.08), st.floats(-0.45, 0.45))
def test_planes_are_found_to_a_hundredth_of_a_pixel(
    middle: float, per_col: float, per_row: float, off_px: float
) -> None:
    left, right, truth = pair((middle, per_col, per_row), 0.0, 1)
    better = refined(left, right, known(truth, off_px), STRIDE)
    error = np.abs(inner(better.disparity_px) - inner(truth))
    assert np.median(error) < 0.015
    assert np.quantile(error, 0.95) < 0.05


def test_after_semi_global_matching_errors_fall_and_sigma_says_by_how_much() -> None:
    left, right, truth = pair((7.3, 0.03, -0.05), 3.0, 2)
    noise_dn = np.full(256, 3.0)
    before = match(left, right, MatchSettings(max_disparity_px=24), noise_dn)
    after = refined(left, right, before, STRIDE)
    errors = [inner(one.disparity_px) - inner(truth) for one in (before, after)]
    assert np.nanmedian(np.abs(errors[1])) < 0.6 * np.nanmedian(np.abs(errors[0]))
    ratio = errors[1] / inner(after.sigma_px)
    assert np.nanmean(np.abs(ratio) > 3) < 0.02
    assert 0.2 < np.nanstd(ratio) < 1.3


def test_brightness_that_differs_from_eye_to_eye_does_not_matter() -> None:
    left, right, truth = pair((7.0, 0.02, 0.0), 0.0, 3)
    darker = (right.astype(np.int64) - 12).clip(0).astype(np.uint8)
    plain, dark = (refined(left, r, known(truth, 0.3), STRIDE) for r in (right, darker))
    assert np.median(np.abs(inner(plain.disparity_px) - inner(dark.disparity_px))) < 0.01


def test_what_no_fit_explains_stays_as_it_was() -> None:
    left, right, truth = pair((7.0, 0.0, 0.0), 0.0, 4)
    far_off = known(truth, FARTHEST_PX + 1.5)
    kept = refined(left, right, far_off, STRIDE)
    moved = np.abs(inner(kept.disparity_px) - inner(far_off.disparity_px))
    assert moved.max() < FARTHEST_PX
    blank = np.full_like(left, 90)
    flat = refined(blank, blank, known(truth, 0.0), STRIDE)
    assert np.isfinite(flat.sigma_px[LATTICE]).all()
    assert np.allclose(flat.disparity_px, truth, atol=1e-4), "no texture moves nothing"


def test_only_the_lattice_is_refined_and_holes_stay_holes() -> None:
    left, right, truth = pair((7.0, 0.0, 0.0), 0.0, 5)
    before = known(truth, 0.3)
    hole = before.disparity_px.copy()
    hole[40:60, 70:90] = np.nan
    after = refined(left, right, replace(before, disparity_px=hole), STRIDE)
    lattice = np.zeros(truth.shape, dtype=bool)
    lattice[LATTICE] = True
    assert np.array_equal(after.disparity_px[~lattice], hole[~lattice], equal_nan=True)
    assert np.isnan(after.disparity_px[40:60, 70:90]).all()


def test_points_need_matched_pixels_about_them() -> None:
    disparity = np.full((60, 80), np.nan, dtype=np.float32)
    disparity[:, :40] = 10.0
    matched = Matched(disparity, np.full_like(disparity, 0.25), {})
    share = matched_about(disparity)
    assert share[30, 20] == 1.0
    assert share[0, 0] == 1.0, "beyond the image's border it goes on"
    assert share[30, 39] == pytest.approx(5 / 9)
    calibration = pinhole(80, 60, 60.0, 0.3)
    every, most = (cloud(matched, calibration, least_about=least) for least in (0.0, 0.8))
    assert every.pixels[:, 1].max() == 39
    assert most.pixels[:, 1].max() == 36


@pytest.mark.parametrize(
    ("away_m", "off_m", "kept"),
    [
        (0.5 * MATE_RADIUS_M, 0.0, False),
        (1.1 * MATE_RADIUS_M, 0.0, True),
        (1.1 * MATE_RADIUS_M, 0.2 * MATE_RADIUS_M, False),
        (1.3 * MATE_RADIUS_M, 0.2 * MATE_RADIUS_M, True),
    ],
)
def test_where_a_team_mate_says_that_it_stands_is_no_ground(
    away_m: float, off_m: float, kept: bool
) -> None:
    """It stands 3 m north of a robot that looks north: straight ahead."""
    seen = np.array([[3.0 - away_m, 0.0, 0.1], [6.0, 0.0, 0.0], [3.0, 0.0, 2.9]])
    look = Exposure(1.0, 0.0, -0.3, seen, np.array([0.01, 0.02, 0.03]))
    mate = Pose(5.0, 8.0, 0.0, 0.0)
    left = off_mates(look, Pose(5.0, 5.0, 0.0, math.pi / 2), [(mate, off_m)])
    assert len(left.points_m) == len(left.sigma_m) == 2 + kept
    assert left.sigma_m[-1] == 0.03, "what hangs over it is not its own"
