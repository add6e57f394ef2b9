"""How far to search: the largest disparity of a pair, from a small copy of it."""

import cv2
import numpy as np

from agents.stereo.matching import Grey, MatchSettings, PairError, match

SMALL_PX = 320
"""Width of the small copy."""
WIDEST = 0.4
"""Disparities up to this share of the width are thought possible."""
ROOM = 1.15
"""The search goes this much beyond what was found in the small copy."""
OUTLIERS = 0.002
"""Share of the small copy's disparities that is taken to be wrong."""


def largest_disparity(left: Grey, right: Grey) -> int:
    """Return a bound on the disparities of a rectified pair (H, W), in px.

    Raises PairError where the images are no pair, or show nothing that can be matched.
    """
    if left.shape != right.shape or left.ndim != 2:
        raise PairError("the two images differ in size: they are no rectified pair")
    scale = min(1.0, SMALL_PX / left.shape[1])
    small = [_shrunk(image, scale) for image in (left, right)]
    widest = round(small[0].shape[1] * WIDEST)
    found = match(small[0], small[1], MatchSettings(max_disparity_px=widest)).disparity_px
    known = found[np.isfinite(found)]
    if known.size == 0:
        raise PairError(
            "nothing in the two images can be matched: too dark, without texture, or no"
            " rectified pair"
        )
    largest = float(np.quantile(known, 1 - OUTLIERS)) / scale
    return min(max(16, round(ROOM * largest) + 2), left.shape[1] - 1)


def _shrunk(image: Grey, scale: float) -> Grey:
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8)
