"""Spots followed from image to image: pyramidal Lucas-Kanade, there and back (OpenCV).

The later image is first drawn as it would look from the earlier place, were the ground its mean
plane and the motion as predicted: so a window looks alike in both, from however much nearer the
second one was taken, and little is left to be searched.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from agents.geometry import Bools, Floats
from agents.pose.rigidmotion import Motion
from agents.stereo.calibration import Calibration
from agents.stereo.interest import nearest_pixels
from agents.stereo.matching import Matched
from agents.stereo.noise import Grey

WINDOW_PX = 21
LEVELS = 3
"""Halvings of the image at most."""
RETURN_PX = 0.3
"""Who is followed there and back must come home within this."""
ROW_PX = 1.0
"""Left and right agree on a row within this."""
STEP_PX = 3.0
"""A disparity followed from the matched one strays by less than this."""
LINE_PX = 2.0
"""Tracks keep to epipolar lines, or to a homography, within this."""
FEWEST_CHECKED = 8
"""Fewer tracks can't be held against each other."""
SAMPLE_STEP = 4
"""Every so many pixels count for the mean plane."""
ROUNDS = 4
"""Times that the mean plane is fitted; what lies far off counts less each time."""
EDGE_PX = WINDOW_PX // 2 + 1
"""Nearer to the border a window is not whole."""


@dataclass(frozen=True)
class Followed:
    """Where n spots of one image are in another."""

    pixels: Floats
    """(n, 2) of (u, v); where it is not `found` it says nothing."""
    found: Bools
    """(n,)"""


def follow(
    before: Grey, after: Grey, pixels: Floats, guess: Floats, levels: int = LEVELS
) -> Followed:
    """Follow spots (n, 2) of (u, v) from one image to another, from a guess (n, 2), and back."""
    if len(pixels) == 0:
        return Followed(pixels, np.zeros(0, dtype=np.bool_))
    there, ok = _flow(before, after, pixels, guess, levels)
    back, back_ok = _flow(after, before, there, pixels, levels)
    home = np.linalg.norm(back - pixels, axis=1) <= RETURN_PX
    return Followed(there, ok & back_ok & home & inside(there, after.shape))


def _flow(
    one: Grey, other: Grey, pixels: Floats, guess: Floats, levels: int
) -> tuple[Floats, Bools]:
    settings: dict[str, Any] = {
        "winSize": (WINDOW_PX, WINDOW_PX),
        "maxLevel": levels,
        "criteria": (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 0.003),
        "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
    }
    starts, guesses = (np.ascontiguousarray(p, dtype=np.float32)[:, None] for p in (pixels, guess))
    there, status, _ = cv2.calcOpticalFlowPyrLK(one, other, starts, guesses.copy(), **settings)
    found = np.asarray(there, dtype=np.float64).reshape(-1, 2)
    ok = (np.ravel(status) == 1) & np.isfinite(found).all(axis=1)
    return np.where(ok[:, None], found, 0.0), ok


def inside(pixels: Floats, shape: tuple[int, ...]) -> Bools:
    """Say which pixels (n, 2) of (u, v) have a whole window in an image of a shape (H, W)."""
    u, v = pixels[:, 0], pixels[:, 1]
    wide = (u >= EDGE_PX) & (u <= shape[1] - 1 - EDGE_PX)
    return wide & (v >= EDGE_PX) & (v <= shape[0] - 1 - EDGE_PX)


def mean_plane(matched: Matched, calibration: Calibration) -> Floats:
    """Return n (3,) of the plane `n p = 1` nearest to what was matched, camera frame, 1/m.

    A plane's disparity is linear in the pixel. Zero (a plane that is nowhere near) where too
    little was matched to tell.
    """
    c = calibration
    thinned = matched.disparity_px[::SAMPLE_STEP, ::SAMPLE_STEP].astype(np.float64)
    row, col = np.nonzero(np.isfinite(thinned))
    if len(row) < FEWEST_CHECKED:
        return np.zeros(3)
    d = thinned[row, col] + c.doffs_px
    where = np.column_stack((SAMPLE_STEP * col, SAMPLE_STEP * row, np.ones(len(row))))
    weight = np.ones(len(row))
    fit = np.zeros(3)
    for _ in range(ROUNDS):
        root = np.sqrt(weight)
        fit = np.linalg.lstsq(where * root[:, None], d * root, rcond=None)[0]
        off = np.abs(d - where @ fit)
        weight = 1.0 / np.maximum(off, 0.5) ** 2
    a, b, level = fit
    n = np.array([a * c.focal_px, b * c.focal_px, a * c.cx_px + b * c.cy_px + level])
    return n / (c.focal_px * c.baseline_m)


def homography(motion: Motion, plane: Floats, calibration: Calibration) -> Floats:
    """Return what takes pixels of a plane's points (`n p = 1`) from before a motion to after it."""
    k = calibration.matrix
    h = k @ (motion.rotation + np.outer(motion.translation_m, plane)) @ np.linalg.inv(k)
    return np.asarray(h, dtype=np.float64)


def mapped(h: Floats, pixels: Floats) -> Floats:
    """Return pixels (n, 2) moved by a homography; those that it sends beyond infinity far off."""
    out = np.column_stack((pixels, np.ones(len(pixels)))) @ h.T
    scale = np.where(out[:, 2] > 1e-9, out[:, 2], np.nan)
    return np.nan_to_num(out[:, :2] / scale[:, None], nan=-1e6)


def stretch(h: Floats, pixels: Floats) -> Floats:
    """Return the Jacobians (n, 2, 2) of a homography at pixels (n, 2)."""
    out = np.column_stack((pixels, np.ones(len(pixels)))) @ h.T
    there = out[:, :2] / out[:, 2:]
    return (h[None, :2, :2] - there[:, :, None] * h[None, 2:, :2]) / out[:, 2, None, None]


def follow_through(
    before: Grey, after: Grey, pixels: Floats, guess: Floats, h: Floats, levels: int = LEVELS
) -> tuple[Followed, Floats]:
    """Follow spots into a later image that a homography nearly tells; as `follow`.

    Also returns the (n, 2, 2) by which an error of a place in the redrawn image is one in the
    later image itself.
    """
    drawn = redrawn(before, after, h)
    found = follow(before, drawn, pixels, _unmapped(h, guess), levels)
    landed = mapped(h, found.pixels)
    return Followed(landed, found.found & inside(landed, after.shape)), stretch(h, found.pixels)


def redrawn(before: Grey, after: Grey, h: Floats) -> Grey:
    """Return a later image as it would look from the earlier place, and at its exposure.

    What it doesn't show is filled in from the earlier image: a black border would draw all that
    is near it to itself, and at the coarsest level of the pyramid everything is near it.
    """
    size = (before.shape[1], before.shape[0])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    drawn = np.asarray(cv2.warpPerspective(after, h, size, flags=flags), dtype=np.uint8)
    nearest = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    shown = np.asarray(cv2.warpPerspective(np.ones_like(after), h, size, flags=nearest)) > 0
    if not shown.any():
        return before
    gain = max(float(np.median(before[shown])), 1.0) / max(float(np.median(drawn[shown])), 1.0)
    bright = np.clip(np.rint(drawn * gain), 0, 255).astype(np.uint8)
    return np.where(shown, bright, before)


def in_view(h: Floats, shape: tuple[int, ...]) -> Bools:
    """Say which pixels (H, W) a homography leaves in the image, away from its border."""
    wide = np.zeros(shape, dtype=np.uint8)
    wide[EDGE_PX:-EDGE_PX, EDGE_PX:-EDGE_PX] = 1
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(wide, h, (shape[1], shape[0]), flags=flags)) > 0


def _unmapped(h: Floats, pixels: Floats) -> Floats:
    return mapped(np.asarray(np.linalg.inv(h), dtype=np.float64), pixels)


def across(
    left: Grey, right: Grey, matched: Matched, pixels: Floats, calibration: Calibration
) -> tuple[Floats, Bools]:
    """Return disparities (n,) at pixels (n, 2) of the left image, to a tenth of a pixel, and where.

    Semi-global matching tells where to look; what it says of parts of a pixel is not taken. The
    right eye is a camera that moved by the baseline: its image too is redrawn by the mean plane,
    for level ground is sheared from eye to eye.
    """
    c = calibration
    col, row = nearest_pixels(pixels, matched.disparity_px.shape)
    near_px = matched.disparity_px[row, col].astype(np.float64)
    known = np.isfinite(near_px)
    guess = pixels - np.column_stack((np.nan_to_num(near_px), np.zeros(len(pixels))))
    to_right = Motion(np.eye(3), np.array([-c.baseline_m, 0.0, 0.0]), np.zeros((6, 6)))
    aside = np.array([[1.0, 0.0, c.doffs_px], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    h = aside @ homography(to_right, mean_plane(matched, c), c)
    found = follow_through(left, right, pixels, guess, h, levels=0)[0]
    disparity_px = pixels[:, 0] - found.pixels[:, 0]
    straight = np.abs(found.pixels[:, 1] - pixels[:, 1]) <= ROW_PX
    close = np.abs(disparity_px - np.nan_to_num(near_px)) <= STEP_PX
    return disparity_px, known & found.found & straight & close & (disparity_px > 0)


def agreeing(before: Floats, after: Floats, calibration: Calibration) -> Bools:
    """Say which tracks (n, 2) of (u, v) one motion of the camera can have made.

    They keep to epipolar lines, or, where more of them do (level ground, a turn on the spot), to
    a homography.
    """
    everyone = np.ones(len(before), dtype=np.bool_)
    if len(before) < FEWEST_CHECKED:
        return everyone
    one, other = before.astype(np.float64), after.astype(np.float64)
    on_line = cv2.findEssentialMat(
        one, other, calibration.matrix, method=cv2.RANSAC, prob=0.999, threshold=LINE_PX
    )[1]
    on_plane = cv2.findHomography(one, other, cv2.RANSAC, LINE_PX)[1]
    told = [np.ravel(np.asarray(mask)) for mask in (on_line, on_plane)]
    checks = [np.asarray(mask > 0) for mask in told if len(mask) == len(before)]
    return max(checks, key=lambda m: int(m.sum()), default=everyone)
