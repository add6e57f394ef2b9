"""The noise of images, by grey level, out of the images themselves; and what it leaves of texture.

A sensor's noise grows with light: its variance rises with the level, and no faster than the level
itself (shot noise). So the calmest squares of one level bound the noise of all others: of darker
ones from above, of brighter ones in proportion. What is calm by chance is textureless; what is
busy at every level may be either, and is not taken for noise as long as another level is calm.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.geometry import Floats, Singles

Grey = NDArray[np.uint8]

SQUARE_PX = 16
BIN_DN = 16
"""Squares are sorted by their mean level in bins this wide."""
CALM = 0.1
"""Share of the squares of a bin that is taken to have no texture."""
FEWEST = 8
"""Bins of fewer squares say nothing."""
ROUNDING_DN = 0.3
"""Least noise: whole grey levels."""
SUPPORT_PX = 9
"""Side of the window whose gradients say how well a pixel can be placed."""


def noise_by_level(*images: Grey) -> Floats:
    """Return the standard deviation (256,) of the images' noise at each grey level.

    What a mask blind to constant slope and curvature leaves (Immerkaer, 1996), over squares.
    """
    levels, powers = (np.concatenate(v) for v in zip(*map(_squares, images), strict=True))
    bins = (levels / BIN_DN).astype(np.int64)
    centres: list[float] = []
    calmest: list[float] = []
    for k in range(256 // BIN_DN):
        mine = powers[bins == k]
        if mine.size >= FEWEST:
            centres.append((k + 0.5) * BIN_DN)
            calmest.append(float(np.quantile(mine, CALM)))
    if not centres:
        centres, calmest = [128.0], [float(np.quantile(powers, CALM))]
    at, bound = np.array(centres), np.array(calmest)
    level = np.arange(256.0)[:, None]
    variance = (bound * np.maximum(level / at, 1.0)).min(axis=1)
    return np.sqrt(np.maximum(variance, ROUNDING_DN**2))


def _squares(image: Grey) -> tuple[Floats, Floats]:
    """Return the mean level and the power of what the mask leaves, by square (K,)."""
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32) / 6
    rest = np.asarray(cv2.filter2D(image.astype(np.float32), cv2.CV_32F, mask))
    rows, cols = (side // SQUARE_PX for side in image.shape)
    # White pixels are cut off: they show no noise.
    whole = np.where(image < 255, rest, np.nan)[: rows * SQUARE_PX, : cols * SQUARE_PX]
    shape = (rows, SQUARE_PX, cols, SQUARE_PX)
    power = (whole**2).reshape(shape).mean(axis=(1, 3)).ravel()
    level = image[: rows * SQUARE_PX, : cols * SQUARE_PX].reshape(shape).mean(axis=(1, 3)).ravel()
    seen = np.isfinite(power)
    return level[seen].astype(np.float64), power[seen].astype(np.float64)


def texture_power(image: Grey) -> Singles:
    """Return the sum of squared gradients along the row over each pixel's window, (H, W)."""
    slope = cv2.Scharr(image.astype(np.float32), cv2.CV_32F, 1, 0, scale=1 / 32)
    window = (SUPPORT_PX, SUPPORT_PX)
    total = cv2.boxFilter(slope * slope, cv2.CV_32F, window, normalize=False)
    return np.asarray(total, dtype=np.float32)


def noise_at(image: Grey, by_level: Floats) -> Singles:
    """Return the standard deviation (H, W) of the noise, by the mean level of each window."""
    mean = cv2.blur(image, (SUPPORT_PX, SUPPORT_PX))
    return by_level[np.asarray(mean, dtype=np.int64)].astype(np.float32)


def noise_power(noise_dn: Singles | float) -> Singles:
    """Return what noise alone, of a standard deviation in grey levels, makes of `texture_power`."""
    gain = 2 * (3**2 + 10**2 + 3**2) / 32**2  # of the gradient's mask
    return np.asarray(SUPPORT_PX**2 * gain * np.asarray(noise_dn) ** 2, dtype=np.float32)
