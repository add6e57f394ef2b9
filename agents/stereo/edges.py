"""The corners of a tag to a tenth of a pixel: lines along its four edges, and where they cross.

OpenCV's own refinement looks for corners, and finds a blurred square's a third of a pixel inside
of where they are. An edge's steepest point stays in place when it is blurred.
"""

import cv2
import numpy as np

from agents.geometry import Floats
from agents.stereo.matching import Grey
from agents.stereo.tagmodel import TAG_CELLS

ALONG = 24
"""Profiles across each edge."""
MARGIN = 0.1
"""Share of an edge next to each corner that is left alone."""
STEP_PX = 0.25
WIDEST_PX = 1.5
REACHES = (0.5, 0.4, 0.35, 0.35)
"""Shares of a cell that profiles reach to both sides, round by round: farther, they would meet the
tag's own pattern, or what lies beyond its white border."""
LEAST_PX = 0.75
"""Profiles reach this far at least: less, and they would not hold a blurred edge."""


def refined(image: Grey, quad: Floats) -> Floats:
    """Return the corners (4, 2) of a black square on white, near those given, in the same order."""
    for share in REACHES:
        side_px = float(np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).min())
        reach_px = min(WIDEST_PX, max(LEAST_PX, share * side_px / TAG_CELLS))
        lines = [_edge(image, quad[k], quad[(k + 1) % 4], reach_px) for k in range(4)]
        crossed = [np.cross(lines[k - 1], lines[k]) for k in range(4)]
        if min(abs(float(point[2])) for point in crossed) < 1e-9:
            return quad
        quad = np.array([point[:2] / point[2] for point in crossed])
    return quad


def _edge(image: Grey, start: Floats, end: Floats, reach_px: float) -> Floats:
    """Return the line (3,), homogeneous, through the steepest points near an edge.

    Walking from `start` to `end` the dark square lies on the right (corners go clockwise as seen,
    and rows grow downwards).
    """
    way = end - start
    out = np.array([way[1], -way[0]]) / max(float(np.linalg.norm(way)), 1e-9)
    share = np.linspace(MARGIN, 1 - MARGIN, ALONG)
    offsets = np.arange(-reach_px - STEP_PX / 2, reach_px + STEP_PX, STEP_PX)
    offsets -= offsets.mean()
    at = start + share[:, None, None] * way + offsets[None, :, None] * out
    map_x, map_y = at[..., 0].astype(np.float32), at[..., 1].astype(np.float32)
    # Linear interpolation would draw an edge that lies along the rows to the pixels' middles.
    profile = cv2.remap(image.astype(np.float32), map_x, map_y, cv2.INTER_CUBIC).astype(np.float64)
    rise = np.maximum(np.diff(profile, axis=1), 0.0)
    middle = (offsets[1:] + offsets[:-1]) / 2
    weight = rise.sum(axis=1)
    place = rise @ middle / np.maximum(weight, 1e-9)
    points = start + share[:, None] * way + place[:, None] * out
    return _line(points, weight)


def _line(points: Floats, weight: Floats) -> Floats:
    """Return the line (3,) through points (N, 2) by weighted total least squares."""
    total = max(float(weight.sum()), 1e-9)
    middle = (points * weight[:, None]).sum(axis=0) / total
    spread = (points - middle) * np.sqrt(weight / total)[:, None]
    normal = np.linalg.svd(spread, full_matrices=False)[2][1]
    return np.array([normal[0], normal[1], -float(normal @ middle)])
