"""Where an image can be followed: Foerstner's interest operator (Foerstner & Guelch, 1987).

The sums N of squared gradients over a window tell how well the window can be placed in another
image: its covariance is the noise's variance times the inverse of N. `det N / tr N` is then the
inverse of what both axes have together, and `4 det N / tr^2 N` how round the error is: 0 along an
edge, 1 where all directions are alike.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from agents.geometry import Floats, Ints, Singles
from agents.stereo.noise import Grey, noise_at

WINDOW_PX = 9
"""Side of the window whose gradients are summed."""
GAIN = 1 / 32
"""Makes Scharr's mask a derivative per pixel."""
ROUND = 0.3
"""Least roundness: below, a window slides along an edge."""
PLACED_PX = 0.25
"""Standard deviation of a place in another image, both axes together, beyond which a window is
not followed: texture is held against the images' own noise, not against other texture."""
APART_PX = 3
"""Of candidates nearer than this to each other only the best is one."""
BORDER_PX = 12
"""Windows this near to the border are left alone."""


@dataclass(frozen=True)
class Gradients:
    """The sums N of squared gradients over each pixel's window, (H, W) each."""

    xx: Singles
    yy: Singles
    xy: Singles

    @property
    def strength(self) -> Singles:
        """det N / tr N."""
        return np.divide(self._determinant, self._trace).astype(np.float32)

    @property
    def roundness(self) -> Singles:
        """4 det N / tr^2 N, in [0, 1]."""
        return (4 * self._determinant / self._trace**2).astype(np.float32)

    @property
    def _determinant(self) -> Singles:
        return np.maximum(self.xx * self.yy - self.xy**2, np.float32(0)).astype(np.float32)

    @property
    def _trace(self) -> Singles:
        return np.maximum(self.xx + self.yy, np.float32(1e-6)).astype(np.float32)

    def at(self, pixels: Floats) -> Floats:
        """Return N (n, 2, 2) at the pixels nearest to (n, 2) of (u, v)."""
        col, row = nearest_pixels(pixels, self.xx.shape)
        out = np.empty((len(pixels), 2, 2))
        out[:, 0, 0], out[:, 1, 1] = self.xx[row, col], self.yy[row, col]
        out[:, 0, 1] = out[:, 1, 0] = self.xy[row, col]
        return out


def nearest_pixels(pixels: Floats, shape: tuple[int, ...]) -> tuple[Ints, Ints]:
    """Return columns and rows (n,) of the pixels nearest to (n, 2) of (u, v), kept inside."""
    whole = np.rint(pixels).astype(np.int64)
    return np.clip(whole[:, 0], 0, shape[1] - 1), np.clip(whole[:, 1], 0, shape[0] - 1)


def gradients(image: Grey) -> Gradients:
    """Return the sums of squared gradients of an image (H, W), grey levels squared."""
    smooth = image.astype(np.float32)
    x = cv2.Scharr(smooth, cv2.CV_32F, 1, 0, scale=GAIN)
    y = cv2.Scharr(smooth, cv2.CV_32F, 0, 1, scale=GAIN)
    return Gradients(*(_summed(p) for p in (x * x, y * y, x * y)))


def _summed(product: cv2.typing.MatLike) -> Singles:
    window = (WINDOW_PX, WINDOW_PX)
    return np.asarray(cv2.boxFilter(product, cv2.CV_32F, window, normalize=False), np.float32)


def placing_variance(strength: Floats | Singles, noise_dn: Floats | Singles) -> Singles:
    """Return the variance of a window's place in another image, both axes together, px^2.

    Both images are noisy, which doubles it: `2 noise^2 tr N^-1`.
    """
    floor = np.maximum(np.asarray(strength, dtype=np.float32), np.float32(1e-9))
    return (2 * np.asarray(noise_dn, dtype=np.float32) ** 2 / floor).astype(np.float32)


def candidates(image: Grey, noise_by_level: Floats, found: Gradients | None = None) -> Ints:
    """Return pixels (n, 2) of (u, v) that can be followed, the strongest first.

    `noise_by_level` (256,) is the images' noise (`agents.stereo.noise`).
    """
    n = gradients(image) if found is None else found
    strength = n.strength
    peaks = strength == cv2.dilate(strength, np.ones((2 * APART_PX + 1,) * 2, dtype=np.uint8))
    noise = noise_at(image, noise_by_level)
    peaks &= placing_variance(strength, noise) <= PLACED_PX**2
    peaks &= n.roundness >= ROUND
    inside = np.zeros(image.shape, dtype=np.bool_)
    inside[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    row, col = np.nonzero(peaks & inside)
    order = np.lexsort((col, row, -strength[row, col]))
    return np.column_stack((col, row))[order].astype(np.int64)
