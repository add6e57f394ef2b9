"""Fiducials measured in space: in each pair of images for itself, with what that is worth.

A spot is where its window is in the left image, so that there it has no error; its depth has one.
In a later image it has the error of having been followed, too.
"""

from dataclasses import dataclass

import numpy as np

from agents.geometry import Bools, Floats
from agents.stereo import tracks
from agents.stereo.calibration import Calibration
from agents.stereo.interest import gradients, nearest_pixels
from agents.stereo.matching import Grey, Matched, MatchSettings, match
from agents.stereo.noise import noise_at, noise_by_level

PLACE_FLOOR_PX = 0.06
"""Standard deviation of a followed spot's place along each axis, whatever the texture."""
DISPARITY_FLOOR_PX = 0.06
"""The same of its disparity."""


@dataclass(frozen=True)
class Frame:
    """A pair of images made ready to be followed."""

    left: Grey
    right: Grey
    matched: Matched
    noise_by_level: Floats
    """(256,) standard deviation."""

    @classmethod
    def of(cls, left: Grey, right: Grey, max_disparity_px: int) -> "Frame":
        """Match a rectified pair of grey images (H, W)."""
        noise = noise_by_level(left, right)
        found = match(left, right, MatchSettings(max_disparity_px=max_disparity_px), noise)
        return cls(left, right, found, noise)


@dataclass(frozen=True)
class Spots:
    """Fiducials measured in one pair, camera frame."""

    pixels: Floats
    """(n, 2) of (u, v) in the left image."""
    points_m: Floats
    """(n, 3)."""
    noise: Floats
    """(n, 3, 3) covariance by the disparity's error alone, m^2: where it is in the image is what
    makes it this spot."""

    def only(self, chosen: Bools) -> "Spots":
        """Return the spots that are marked (n,)."""
        return Spots(self.pixels[chosen], self.points_m[chosen], self.noise[chosen])


def none() -> Spots:
    """Return no spots."""
    return Spots(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 3, 3)))


def joined(one: Spots, other: Spots) -> Spots:
    """Return the spots of both."""
    return Spots(
        np.concatenate((one.pixels, other.pixels)),
        np.concatenate((one.points_m, other.points_m)),
        np.concatenate((one.noise, other.noise)),
    )


def measured(frame: Frame, pixels: Floats, calibration: Calibration) -> tuple[Spots, Bools]:
    """Return spots at pixels (n, 2) of a pair's left image, and which of them have a depth."""
    c = calibration
    disparity_px, seen = tracks.across(frame.left, frame.right, frame.matched, pixels, c)
    depth_m = np.where(seen, c.depth_m(np.where(seen, disparity_px, 1.0)), 1.0)
    seen &= np.isfinite(depth_m)
    depth_m = np.where(seen, depth_m, 1.0)
    ray = rays(pixels, c)
    sigma_m = depth_m**2 / (c.focal_px * c.baseline_m) * _disparity_sigma(frame, pixels)
    noise = sigma_m[:, None, None] ** 2 * ray[:, :, None] * ray[:, None, :]
    return Spots(pixels, ray * depth_m[:, None], noise), seen


def rays(pixels: Floats, c: Calibration) -> Floats:
    """Return the points (n, 3) at depth 1 under pixels (n, 2) of (u, v)."""
    x, y = (pixels[:, 0] - c.cx_px) / c.focal_px, (pixels[:, 1] - c.cy_px) / c.focal_px
    return np.column_stack((x, y, np.ones(len(pixels))))


def _disparity_sigma(frame: Frame, pixels: Floats) -> Floats:
    """Return the standard deviation (n,) of followed disparities: noise over texture, a floor."""
    n = gradients(frame.left).at(pixels)
    along = np.maximum(n[:, 0, 0], 1e-6)
    return np.sqrt(2 * _noise(frame, pixels) ** 2 / along + DISPARITY_FLOOR_PX**2)


def _noise(frame: Frame, pixels: Floats) -> Floats:
    col, row = nearest_pixels(pixels, frame.left.shape)
    return noise_at(frame.left, frame.noise_by_level)[row, col].astype(np.float64)


def placing_noise(
    before: Frame, pixels: Floats, stretch: Floats, after_m: Floats, c: Calibration
) -> Floats:
    """Return the covariance (n, 3, 3) of points after a motion by how well they were followed.

    `stretch` (n, 2, 2) takes an error in the redrawn image to one in the later image.
    """
    n = gradients(before.left).at(pixels)
    n += 1e-6 * np.eye(2)
    place = 2 * _noise(before, pixels)[:, None, None] ** 2 * np.linalg.inv(n)
    place = place + PLACE_FLOOR_PX**2 * np.eye(2)
    place = stretch @ place @ np.swapaxes(stretch, 1, 2)
    out = np.zeros((len(pixels), 3, 3))
    out[:, :2, :2] = place * (after_m[:, 2, None, None] / c.focal_px) ** 2
    return out
