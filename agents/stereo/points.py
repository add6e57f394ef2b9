"""Disparity to points, each with its covariance; and the noise law that this is (Eq. 4)."""

from dataclasses import dataclass

import cv2
import numpy as np

from agents.geometry import Floats, Ints, Singles
from agents.stereo.calibration import Calibration
from agents.stereo.matching import Matched

PIXEL_SIGMA_PX = 0.29
"""Standard deviation of where within its pixel a point lies: uniform over one pixel."""


ABOUT_PX = 9
"""Side of the square of pixels about a point."""


@dataclass(frozen=True)
class Cloud:
    """Points of one pair, camera frame (x right, y down, z ahead, left camera the origin)."""

    points_m: Floats
    """(N, 3)."""
    covariance: Floats
    """(N, 3, 3), m^2."""
    pixels: Ints
    """(N, 2) of (row, column) in the left image."""

    def sigma_along_m(self) -> Floats:
        """Return the standard deviation (N,) along the ray from the camera."""
        ray = self.points_m / np.linalg.norm(self.points_m, axis=1, keepdims=True)
        return _sigma_along(self, ray)


def cloud(
    matched: Matched,
    calibration: Calibration,
    *,
    stride_px: int = 1,
    near_m: float = 0.0,
    far_m: float = np.inf,
    least_about: float = 0.0,
) -> Cloud:
    """Return the points of a matched pair whose depth is within [near_m, far_m].

    Every `stride_px`-th pixel of every such row is taken: neighbours come out of one another's
    windows, and to count each as a measurement of its own would make a map too sure. Left out is
    where less than `least_about` of the pixels about it (9 x 9) were matched: at the border of what
    two images have in common, one side is drawn towards the other.
    """
    start = stride_px // 2
    thinned = matched.disparity_px[start::stride_px, start::stride_px].astype(np.float64)
    depth_m = calibration.depth_m(thinned)
    near = np.isfinite(depth_m) & (depth_m >= near_m) & (depth_m <= far_m)
    near &= matched_about(matched.disparity_px)[start::stride_px, start::stride_px] >= least_about
    pixels = start + stride_px * np.argwhere(near)
    sigma_px = matched.sigma_px[pixels[:, 0], pixels[:, 1]].astype(np.float64)
    points_m = back_projected(pixels, depth_m[near], calibration)
    return Cloud(points_m, covariances(points_m, sigma_px, calibration), pixels)


def matched_about(disparity_px: Singles) -> Singles:
    """Return the share (H, W) of the pixels about each that were matched."""
    known = np.isfinite(disparity_px).astype(np.float32)
    share = cv2.blur(known, (ABOUT_PX, ABOUT_PX), borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(share, dtype=np.float32)


def back_projected(pixels: Ints, depth_m: Floats, calibration: Calibration) -> Floats:
    """Return points (N, 3) at depths (N,) under pixels (N, 2) of (row, column)."""
    c = calibration
    x = (pixels[:, 1] - c.cx_px) * depth_m / c.focal_px
    y = (pixels[:, 0] - c.cy_px) * depth_m / c.focal_px
    return np.column_stack((x, y, depth_m))


def covariances(points_m: Floats, sigma_px: Floats, calibration: Calibration) -> Floats:
    """Return the covariance (N, 3, 3) of points (N, 3) whose disparities have a sigma (N,).

    First order: a point is z (x/z, y/z, 1) with z = f b / (d + doffs). Disparity and the pixel's
    width belong to the point alone; to them comes what the calibration may have wrong.
    """
    c = calibration
    out = calibration_covariances(points_m, c)
    z = points_m[:, 2]
    out += _along_rays(points_m, (z**2 / (c.focal_px * c.baseline_m) * sigma_px) ** 2)
    across = (z * PIXEL_SIGMA_PX / c.focal_px) ** 2
    out[:, 0, 0] += across
    out[:, 1, 1] += across
    return out


def calibration_covariances(points_m: Floats, calibration: Calibration) -> Floats:
    """Return the covariance (N, 3, 3) of points (N, 3) that the calibration's own errors make.

    These are one error for all points of a look, which a covariance per point can't say: averages
    over many points get surer than they are, by at most this much.
    """
    c = calibration
    z = points_m[:, 2]
    offset = (z**2 / (c.focal_px * c.baseline_m) * c.offset_sigma_px) ** 2
    out = _along_rays(points_m, offset + (z * c.baseline_sigma) ** 2)
    # A longer focal length puts a point farther away along z, and leaves x and y as they are.
    out[:, 2, 2] += (z * c.focal_sigma) ** 2
    return out


def _along_rays(points_m: Floats, depth_variance: Floats) -> Floats:
    """Return the covariance (N, 3, 3) of points that a variance (N,) of their depth makes."""
    ray = points_m / points_m[:, 2:]
    return depth_variance[:, None, None] * ray[:, :, None] * ray[:, None, :]


@dataclass(frozen=True)
class RangeLaw:
    """sigma_i = S T_i L^n (Sujan & Meggiolaro, Eq. 4), fitted; T = 1 along the ray."""

    s: float
    """Sigma along the ray at 1 m."""
    t_right: float
    t_down: float
    """Sigma across the ray, to the right and downwards, over that along it (medians)."""
    n: float
    residual: float
    """Root mean square of log(sigma / law): 0.1 is ten per cent."""


def fit_range_law(found: Cloud) -> RangeLaw:
    """Fit Eq. 4 to the covariances of points: a line through log sigma over log range.

    At least two points at different ranges are needed.
    """
    assert found.points_m.shape[0] >= 2, "a law through fewer than two points"
    range_m = np.linalg.norm(found.points_m, axis=1)
    sigma_m = found.sigma_along_m()
    n, log_s = (float(v) for v in np.polyfit(np.log(range_m), np.log(sigma_m), 1))
    rest = np.log(sigma_m) - (log_s + n * np.log(range_m))
    right, down = _across(found, range_m)
    return RangeLaw(
        float(np.exp(log_s)),
        float(np.median(right / sigma_m)),
        float(np.median(down / sigma_m)),
        n,
        float(np.sqrt(np.mean(rest**2))),
    )


def _across(found: Cloud, range_m: Floats) -> tuple[Floats, Floats]:
    """Return sigma (N,) across the ray, along image rows and downwards."""
    ray = found.points_m / range_m[:, None]
    right = np.column_stack((ray[:, 2], np.zeros_like(range_m), -ray[:, 0]))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    down = np.asarray(np.cross(ray, right), dtype=np.float64)
    return _sigma_along(found, right), _sigma_along(found, down)


def _sigma_along(found: Cloud, axis: Floats) -> Floats:
    return np.sqrt(np.einsum("ni,nij,nj->n", axis, found.covariance, axis))
