"""Dense stereo: a rectified pair of grey images to disparity with a sigma per pixel.

Semi-global matching (OpenCV) in both directions; what the two do not agree on, what stands alone
and what has no texture to be matched by is left out, and counted by its reason.
"""

import math
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.errors import AgentError
from agents.geometry import Bools, Floats, Singles
from agents.stereo.noise import Grey, noise_at, noise_by_level, noise_power, texture_power

__all__ = ["Grey", "MatchSettings", "Matched", "PairError", "agreeing", "match"]

Pixel = TypeVar("Pixel", bound=np.generic)

STEP_PX = 16
"""Semi-global matching searches multiples of this many disparities."""
PARTS = 16
"""It answers in sixteenths of a pixel."""
SMALL_PENALTY, LARGE_PENALTY = 8, 32
"""For a change of disparity by one and by more, per pixel of the block."""
WHOLE_VOLUME = 64_000_000
"""Costs (pixels times disparities) up to which all eight ways through the image are taken; they
need the whole volume in memory, five need a few rows of it."""
MOST_DISPARITIES = 1000
"""More are refused; 16 bits hold twice as many in sixteenths."""
FLOOR_PX = 0.25
"""Sigma of a disparity whatever the texture: semi-global matching leans towards whole pixels, and
towards its neighbours. Measured on rendered and on real pairs (docs/vision.md)."""


class PairError(AgentError):
    """Two images that are no rectified pair, or a search that does not fit them."""


@dataclass(frozen=True, kw_only=True)
class MatchSettings:
    """How to match; the defaults are those of robots and of the command line."""

    max_disparity_px: int
    """Largest disparity searched; rounded up so that a multiple of 16 is searched."""
    min_disparity_px: int = 0
    block_px: int = 3
    uniqueness: int = 5
    """The best cost must be lower than all but its neighbours' by this many hundredths."""
    left_right_px: float = 1.0
    """Both directions must agree to within this."""
    speckle_px: int = 100
    """Patches of fewer pixels that stand alone are left out."""
    speckle_step_px: int = 2
    """A patch ends where disparity changes by more than this from one pixel to the next."""
    least_texture: float = 1.5
    """Pixels round which gradients have less power than this many times what the images' noise
    alone would give them are left out."""


@dataclass(frozen=True)
class Matched:
    """Disparity, its error, and why there is none where there is none."""

    disparity_px: Singles
    """(H, W) of the left image, NaN where unmatched."""
    sigma_px: Singles
    """(H, W) standard deviation, NaN where unmatched."""
    lost: dict[str, float]
    """Share of all pixels that was left out, by reason, in the order of the checks."""

    @property
    def density(self) -> float:
        """Share of pixels with a disparity."""
        return float(np.isfinite(self.disparity_px).mean())


def match(
    left: Grey, right: Grey, settings: MatchSettings, noise_dn: Floats | None = None
) -> Matched:
    """Return the disparity of a rectified pair of grey images (H, W).

    `noise_dn` (256,) is the standard deviation of the images' noise by grey level; it is estimated
    if left out.
    Raises PairError where the images differ in size or the search does not fit them.
    """
    _check(left, right, settings)
    low, count = _search(settings)
    mode = _mode(left, count)
    found = _matched(left, right, settings, low, count, mode)
    mirrored = _matched(_mirror(right), _mirror(left), settings, low, count, mode)
    noise = noise_at(left, noise_by_level(left, right) if noise_dn is None else noise_dn)
    texture = texture_power(left)
    of_noise = noise_power(noise)

    lost: dict[str, float] = {}

    def drop(reason: str, kept: Bools) -> None:
        before = np.isfinite(found)
        found[before & ~kept] = np.nan
        lost[reason] = float((before & ~kept).mean())

    textured = texture >= settings.least_texture * of_noise
    lost["little texture"] = float((~textured).mean())
    found[~textured] = np.nan
    lost["no match"] = float((np.isnan(found) & textured).mean())
    drop("left and right differ", agreeing(found, _mirror(mirrored), settings.left_right_px))
    drop("stands alone", _not_speckle(found, settings))
    sigma = disparity_sigma(np.maximum(texture - of_noise, 1e-6), noise)
    return Matched(found, np.where(np.isfinite(found), sigma, np.nan).astype(np.float32), lost)


def _check(left: Grey, right: Grey, settings: MatchSettings) -> None:
    if left.shape != right.shape or left.ndim != 2:
        raise PairError(
            f"the left image is {_size(left)}, the right one {_size(right)}: both must be grey"
            " and of one size"
        )
    if not (left.dtype == np.uint8 and right.dtype == np.uint8):
        raise PairError(f"images of {left.dtype} and {right.dtype}: both must have 8 bits")
    low, high, width = settings.min_disparity_px, settings.max_disparity_px, left.shape[1]
    if not -width < low < high < width or high - low > MOST_DISPARITIES:
        raise PairError(
            f"disparities {low} to {high} px: must rise, within the width of {width} px, and be at"
            f" most {MOST_DISPARITIES}"
        )
    if min(left.shape) < 2 * STEP_PX:
        raise PairError(f"images of {_size(left)}: need at least {2 * STEP_PX} x {2 * STEP_PX} px")


def _size(image: Grey) -> str:
    return " x ".join(str(side) for side in (image.shape[1], image.shape[0], *image.shape[2:]))


def _search(settings: MatchSettings) -> tuple[int, int]:
    """Return the lowest disparity and how many are searched; one more than asked for, so that the
    largest has a neighbour to be interpolated with."""
    span = settings.max_disparity_px - settings.min_disparity_px + 1
    return settings.min_disparity_px, STEP_PX * math.ceil(span / STEP_PX)


def _mode(image: Grey, count: int) -> int:
    if (image.size + image.shape[0] * count) * count <= WHOLE_VOLUME:
        return cv2.StereoSGBM_MODE_HH
    return cv2.StereoSGBM_MODE_SGBM


def _mirror(image: NDArray[Pixel]) -> NDArray[Pixel]:
    return np.ascontiguousarray(image[:, ::-1])


def _matched(
    left: Grey, right: Grey, settings: MatchSettings, low: int, count: int, mode: int
) -> Singles:
    """Return (H, W) disparity, NaN where none is found.

    OpenCV gives nothing for the outermost columns, as many as are searched: margins are added
    (they repeat the border) and cut off again, and what was matched with a margin is dropped.
    """
    area = settings.block_px**2
    matcher = cv2.StereoSGBM.create(
        minDisparity=low,
        numDisparities=count,
        blockSize=settings.block_px,
        P1=SMALL_PENALTY * area,
        P2=LARGE_PENALTY * area,
        disp12MaxDiff=-1,
        preFilterCap=63,
        uniquenessRatio=settings.uniqueness,
        speckleWindowSize=0,
        speckleRange=0,
        mode=mode,
    )
    before, after = max(0, low + count), max(0, -low)
    wide = [
        cv2.copyMakeBorder(image, 0, 0, before, after, cv2.BORDER_REPLICATE)
        for image in (left, right)
    ]
    raw = np.asarray(matcher.compute(wide[0], wide[1]))[:, before : before + left.shape[1]]
    found = (raw.astype(np.float32) / PARTS).astype(np.float32)
    across = np.arange(left.shape[1], dtype=np.float32) - found
    found[(raw < low * PARTS) | (across < 0) | (across > left.shape[1] - 1)] = np.nan
    return found


def agreeing(left_px: Singles, right_px: Singles, within_px: float) -> Bools:
    """Say where a disparity of the left image comes back from the right one, (H, W)."""
    width = left_px.shape[1]
    there = np.arange(width, dtype=np.float32) - left_px
    near = np.clip(np.rint(np.nan_to_num(there)), 0, width - 1).astype(np.int64)
    back = np.take_along_axis(right_px, near, axis=1)
    return np.abs(back - left_px) <= within_px


def _not_speckle(found: Singles, settings: MatchSettings) -> Bools:
    known = np.isfinite(found)
    empty = np.iinfo(np.int16).min
    whole = np.where(known, np.rint(np.nan_to_num(found) * PARTS), empty).astype(np.int16)
    cv2.filterSpeckles(whole, empty, settings.speckle_px, settings.speckle_step_px * PARTS)
    return np.asarray(whole != empty, dtype=np.bool_)


def disparity_sigma(texture: Singles, noise_dn: Singles) -> Singles:
    """Return how well disparity can be known (H, W), in px, by the power of true texture (H, W).

    The Cramer-Rao bound of a shift along the row, both images noisy: 2 noise^2 over the sum of
    squared gradients; and the matcher's own floor.
    """
    return np.sqrt(2 * noise_dn**2 / texture + FLOOR_PX**2).astype(np.float32)
