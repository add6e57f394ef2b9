"""Disparity to a tenth of a pixel: least squares of the images themselves about single pixels.

Semi-global matching leans towards whole pixels and towards its neighbours. About each pixel that
is to become a point, disparity is taken for a plane, and the plane that makes the right image's
window the left one's is found by Gauss-Newton (Lucas & Kanade, 1981), brightness apart. What the
fit leaves over says how sure it is.
"""

import math
from dataclasses import replace

import numpy as np

from agents.stereo.matching import Grey, Matched
from comms import kernels
from comms.kernels import kernel

HALF_PX = 5
"""The window reaches so far to all sides."""
ROUNDS = 6
ENOUGH_PX = 0.005
"""Corrections smaller than this end the search."""
SAME_PX = 2.0
"""What differs from the plane by more is other ground: it has no part in the window."""
FEWEST = 0.5
"""Share of the window that must have a part in it."""
FARTHEST_PX = 1.0
"""A correction beyond this is not believed."""
SLOPE_SIGMA = 0.05
"""How well the slope of disparity is known beforehand, pixels per pixel."""
SHARED = 1.3
"""Errors of neighbouring pixels are not independent: sigma is larger by this than they say."""
FLOOR_PX = 0.1
"""Sigma whatever the fit leaves over. Both measured (docs/vision.md)."""


def refined(left: Grey, right: Grey, matched: Matched, stride_px: int) -> Matched:
    """Return a matched pair with every `stride_px`-th pixel of every such row refined.

    Where no fit is believed a pixel stays as it was, disparity and sigma.
    """
    start = stride_px // 2
    lattice = matched.disparity_px[start::stride_px, start::stride_px]
    pixels = start + stride_px * np.argwhere(np.isfinite(lattice))
    fitted = np.full((len(pixels), 2), np.nan)
    whole = matched.disparity_px.astype(np.float64)
    _refine(left.astype(np.float64), right.astype(np.float64), whole, pixels, fitted)
    good = np.isfinite(fitted[:, 1])
    rows, cols = pixels[good, 0], pixels[good, 1]
    disparity, sigma = matched.disparity_px.copy(), matched.sigma_px.copy()
    disparity[rows, cols] = fitted[good, 0]
    sigma[rows, cols] = np.hypot(SHARED * fitted[good, 1], FLOOR_PX)
    return replace(matched, disparity_px=disparity, sigma_px=sigma)


@kernel
def _between(line: np.ndarray, x: float) -> tuple[float, float]:
    """Return value and slope of a line of pixels at x, by a Catmull-Rom spline; NaN outside."""
    i = math.floor(x)
    if i < 1 or i > len(line) - 3:
        return math.nan, math.nan
    t = x - i
    a, b, c, d = line[i - 1], line[i], line[i + 1], line[i + 2]
    one, two, three = 0.5 * (c - a), a - 2.5 * b + 2.0 * c - 0.5 * d, 1.5 * (b - c) + 0.5 * (d - a)
    return b + t * (one + t * (two + t * three)), one + t * (2.0 * two + 3.0 * t * three)


@kernel
def _plane(disparity: np.ndarray, row: int, col: int) -> np.ndarray:
    """Return the plane (3,) of disparity about a pixel: there, per column, per row."""
    here = disparity[row, col]
    square = np.eye(3) * 1e-3
    side = np.zeros(3)
    terms = np.empty(3)
    for i in range(-HALF_PX, HALF_PX + 1):
        for j in range(-HALF_PX, HALF_PX + 1):
            apart = disparity[row + i, col + j] - here
            if abs(apart) < SAME_PX:
                weight = math.exp(-(i * i + j * j) / (HALF_PX * HALF_PX))
                terms[0], terms[1], terms[2] = 1.0, j, i
                for k in range(3):
                    side[k] += weight * terms[k] * apart
                    for m in range(3):
                        square[k, m] += weight * terms[k] * terms[m]
    plane = np.linalg.solve(square, side)
    plane[0] += here
    return plane


@kernel
def _step(
    left: np.ndarray,
    right: np.ndarray,
    disparity: np.ndarray,
    row: int,
    col: int,
    state: np.ndarray,
    square: np.ndarray,
    side: np.ndarray,
) -> tuple[float, int]:
    """Fill the normal equations about a state (4,): plane, and brightness; return what is left over
    per pixel, and how many there are."""
    square[:] = 0.0
    side[:] = 0.0
    terms = np.empty(4)
    total, weights, count = 0.0, 0.0, 0
    for i in range(-HALF_PX, HALF_PX + 1):
        for j in range(-HALF_PX, HALF_PX + 1):
            model = state[0] + state[1] * j + state[2] * i
            if not abs(disparity[row + i, col + j] - model) < SAME_PX:
                continue
            value, slope = _between(right[row + i], col + j - model)
            if math.isnan(value):
                continue
            weight = math.exp(-(i * i + j * j) / (HALF_PX * HALF_PX))
            error = left[row + i, col + j] - value - state[3]
            terms[0], terms[1], terms[2], terms[3] = -slope, -slope * j, -slope * i, 1.0
            total += weight * error * error
            weights += weight
            count += 1
            for k in range(4):
                side[k] += weight * terms[k] * error
                for m in range(4):
                    square[k, m] += weight * terms[k] * terms[m]
    return total / max(weights, 1e-9), count


@kernel
def _refine(
    left: np.ndarray,
    right: np.ndarray,
    disparity: np.ndarray,
    pixels: np.ndarray,
    fitted: np.ndarray,
) -> None:
    """Fill (N, 2): disparity and sigma of pixels (N, 2), NaN where no fit is believed."""
    height, width = left.shape
    square, side, state = np.zeros((4, 4)), np.zeros(4), np.zeros(4)
    for n in range(len(pixels)):
        row, col = pixels[n, 0], pixels[n, 1]
        if min(row, col, height - 1 - row, width - 1 - col) < HALF_PX:
            continue
        before = _plane(disparity, row, col)
        if max(abs(before[1]), abs(before[2])) > 1.0:
            continue
        state[:3] = before
        state[3] = 0.0
        sigma = math.nan
        for _ in range(ROUNDS):
            rest, count = _step(left, right, disparity, row, col, state, square, side)
            if count < FEWEST * (2 * HALF_PX + 1) ** 2:
                sigma = math.nan
                break
            power = max(rest, 0.25)
            held = power / (SLOPE_SIGMA * SLOPE_SIGMA)
            square[0, 0] += 1e-6
            for k in range(1, 3):
                square[k, k] += held
                side[k] -= held * (state[k] - before[k])
            inverse = np.linalg.inv(square)
            step = inverse @ side
            state += step
            sigma = math.sqrt(2.0 * power * inverse[0, 0])
            if abs(step[0]) < ENOUGH_PX:
                break
        if abs(state[0] - before[0]) < FARTHEST_PX and state[0] > 0.0:
            fitted[n, 0] = state[0]
            fitted[n, 1] = sigma


@kernels.warmer
def _warm() -> None:
    image = (np.indices((32, 32)).sum(axis=0) % 7 * 20).astype(np.uint8)
    disparity = np.full(image.shape, 2.0, dtype=np.float32)
    refined(image, image, Matched(disparity, disparity.copy(), {}), 4)
