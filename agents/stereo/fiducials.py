"""Which spots of the ground to find one's way by: Sujan & Meggiolaro, Eqs. 17 and 18.

Foerstner's operator proposes, the fiducial evaluation function chooses. Its three terms are
brought to one scale, each as a share of the largest among the candidates:

- certainty P/r: P = floor / sigma of the disparity; r, how far certainty falls about the spot;
- visual contrast C w: |I - mean| / mean of the window w beyond which that falls (Eq. 18);
- depth contrast H w: the highest spatial frequency of the disparity in a window that stands
  above its noise, w the largest window before the spectrum's centre moves up. (The paper takes a
  Fourier transform in space and says that heuristics may stand for it; this is one in the image.)

A spot near to one that is taken loses by how near it is, so that fiducials spread.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from agents.geometry import Bools, Floats, Ints, Singles
from agents.stereo.interest import candidates
from agents.stereo.matching import FLOOR_PX, Matched
from agents.stereo.noise import Grey

RADII_PX = (1, 2, 4, 8, 16)
"""Radii at which certainty is looked at about a spot."""
WINDOWS_PX = (3, 5, 9, 17, 33)
"""Sides of the windows of Eq. 18."""
DEPTH_WINDOWS_PX = (8, 16, 32)
"""Sides of the windows of the depth's spectrum."""
MOST = 600
"""So many of the strongest candidates are weighed."""
SPREAD = 0.7
"""Fiducials keep apart by about this share of the spacing that would fill the image."""
PENALTY = 1.5
"""What a spot loses right beside a fiducial; all three terms together come to 3 at most."""
BESIDE_PX = 4.0
"""Nearer than this to a fiducial is none: their windows would be all but one."""


@dataclass(frozen=True)
class Fiducials:
    """Spots chosen, the best first."""

    pixels: Floats
    """(n, 2) of (u, v)."""
    terms: Floats
    """(n, 3) of Eq. 17's terms, each in [0, 1]."""
    proposed: int
    """How many spots there were to choose from."""


def choose(
    image: Grey,
    matched: Matched,
    count: int,
    noise_by_level: Floats,
    *,
    taken: Floats | None = None,
    allowed: Bools | None = None,
) -> Fiducials:
    """Return at most `count` fiducials of a left image with its disparity, away from those taken.

    `taken` (m, 2) are pixels (u, v) of fiducials that are followed already; `allowed` (H, W) says
    where fiducials may be: left out, everywhere.
    """
    may_be = np.isfinite(matched.disparity_px)
    if allowed is not None:
        may_be &= allowed
    spots = candidates(image, noise_by_level)
    spots = spots[may_be[spots[:, 1], spots[:, 0]]][:MOST]
    terms = np.column_stack(
        [
            _to_scale(certainty(matched.sigma_px, spots)),
            _to_scale(visual_contrast(image, spots)),
            _to_scale(depth_contrast(matched.disparity_px, matched.sigma_px, spots)),
        ]
    ).reshape(-1, 3)
    room = image.size if allowed is None else int(allowed.sum())
    reach_px = SPREAD * math.sqrt(room / max(count, 1))
    picked = spread_out(terms.sum(axis=1), spots.astype(np.float64), count, reach_px, taken)
    return Fiducials(spots[picked].astype(np.float64), terms[picked], len(spots))


def spread_out(
    score: Floats, spots: Floats, count: int, reach_px: float, taken: Floats | None = None
) -> Ints:
    """Return the indices of the spots (n, 2) that are best one after the other.

    Each one that is taken costs its neighbours `PENALTY exp(-(distance / reach)^2)`, and those
    beside it everything.
    """
    left = score.copy()
    for spot in np.zeros((0, 2)) if taken is None else taken:
        left -= _penalty(spots, spot, reach_px)
    picked: list[int] = []
    while len(picked) < count and np.isfinite(left).any():
        best = int(np.argmax(left))
        picked.append(best)
        left -= _penalty(spots, spots[best], reach_px)
    return np.array(picked, dtype=np.int64)


def _penalty(spots: Floats, spot: Floats, reach_px: float) -> Floats:
    apart2 = ((spots - spot) ** 2).sum(axis=1)
    return np.where(apart2 < BESIDE_PX**2, np.inf, PENALTY * np.exp(-apart2 / reach_px**2))


def _to_scale(term: Floats) -> Floats:
    """Return a term as a share of its largest value."""
    return term / max(float(term.max(initial=0.0)), 1e-12)


def certainty(sigma_px: Singles, spots: Ints) -> Floats:
    """Return P/r (n,) at spots (n, 2) of (u, v): f1 of Eq. 17.

    r is the first of `RADII_PX` about which certainty, in the mean of the ring, no longer falls.
    """
    known = np.nan_to_num(FLOOR_PX / sigma_px, nan=0.0).astype(np.float32)
    col, row = spots[:, 0], spots[:, 1]
    inner = known[row, col].astype(np.float64)
    p, radius = inner.copy(), np.full(len(spots), float(RADII_PX[-1]))
    falling = np.ones(len(spots), dtype=np.bool_)
    for nearer, r in zip((0, *RADII_PX), RADII_PX, strict=False):
        ring = _ring_mean(known, nearer, r)[row, col]
        stops = falling & (ring >= inner)
        radius[stops] = r
        falling &= ~stops
        inner = ring
    return p / radius


def _ring_mean(values: Singles, nearer: int, r: int) -> Floats:
    """Return the mean (H, W) over the square ring between two radii about each pixel."""
    sums = [
        cv2.boxFilter(values, cv2.CV_64F, (2 * k + 1, 2 * k + 1), normalize=False)
        for k in (nearer, r)
    ]
    cells = (2 * r + 1) ** 2 - (2 * nearer + 1) ** 2
    return np.asarray((sums[1] - sums[0]) / cells, dtype=np.float64)


def visual_contrast(image: Grey, spots: Ints) -> Floats:
    """Return C w (n,) at spots (n, 2) of (u, v): f2 of Eq. 17, with Eq. 18's C without its sign.

    w is the side of the window, in pixels, after which the contrast begins to fall.
    """
    col, row = spots[:, 0], spots[:, 1]
    level = image[row, col].astype(np.float64)
    best, best_w = np.zeros(len(spots)), np.full(len(spots), float(WINDOWS_PX[0]))
    growing = np.ones(len(spots), dtype=np.bool_)
    for w in WINDOWS_PX:
        mean = np.asarray(cv2.boxFilter(image, cv2.CV_64F, (w, w)))[row, col]
        contrast = np.abs(level - mean) / np.maximum(mean, 1.0)
        growing &= contrast >= best
        best[growing], best_w[growing] = contrast[growing], w
    return best * best_w


def depth_contrast(disparity_px: Singles, sigma_px: Singles, spots: Ints) -> Floats:
    """Return H w (n,) at spots (n, 2) of (u, v): f3 of Eq. 17."""
    best = np.zeros(len(spots))
    centre = np.full(len(spots), np.inf)
    growing = np.ones(len(spots), dtype=np.bool_)
    for w in DEPTH_WINDOWS_PX:
        patches, noise = _patches(disparity_px, spots, w), _patches(sigma_px, spots, w)
        whole = np.isfinite(patches).mean(axis=(1, 2)) > 0.5
        highest, middle = _spectrum(patches, noise)
        growing &= whole & (middle <= centre)
        best[growing], centre[growing] = (highest * w)[growing], middle[growing]
    return best


def _patches(values: Singles, spots: Ints, w: int) -> Floats:
    """Return the windows (n, w, w) about spots; what is beyond the border repeats it."""
    steps = np.arange(w) - w // 2
    rows = np.clip(spots[:, 1, None] + steps, 0, values.shape[0] - 1)
    cols = np.clip(spots[:, 0, None] + steps, 0, values.shape[1] - 1)
    return values[rows[:, :, None], cols[:, None, :]].astype(np.float64)


def _spectrum(patches: Floats, sigma_px: Floats) -> tuple[Floats, Floats]:
    """Return the highest frequency above the noise (n,) and the spectrum's centre (n,), 1/px."""
    w = patches.shape[-1]
    filled = _flattened(patches)
    power = np.abs(np.fft.fft2(filled)) ** 2
    noise = _mean(sigma_px**2)[:, None, None] * w * w
    above = np.maximum(power - noise, 0.0)
    steps = np.fft.fftfreq(w)
    frequency = np.hypot(steps[:, None], steps[None, :])
    total = above.sum(axis=(1, 2))
    middle = (above * frequency).sum(axis=(1, 2)) / np.maximum(total, 1e-12)
    highest = np.where(above > noise, frequency, 0.0).max(axis=(1, 2))
    return highest, np.where(total > 0, middle, np.inf)


def _mean(values: Floats) -> Floats:
    """Return the mean (n,) over each window's known pixels; 0 where none is."""
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axis=(1, 2))
    return total / np.maximum(known.sum(axis=(1, 2)), 1)


def _flattened(patches: Floats) -> Floats:
    """Return windows less their mean plane's level and slopes, 0 where unknown.

    A slope is no contrast, and its jump from one border to the other would look like one.
    """
    w = patches.shape[-1]
    steps = np.arange(w) - (w - 1) / 2
    out = np.where(np.isfinite(patches), patches - _mean(patches)[:, None, None], 0.0)
    along: Sequence[Floats] = (steps[None, None, :], steps[None, :, None])
    for axis in along:
        slope = (out * axis).sum(axis=(1, 2)) / (w * (steps**2).sum())
        out = out - slope[:, None, None] * axis
    return np.where(np.isfinite(patches), out, 0.0)
