"""Team-mates by their tags: corners in both images to a pose with covariance.

All tags of one robot that both images show are taken together. A first pose comes from the best
single tag (IPPE), then Gauss-Newton over the corners in both images; its normal matrix is the
covariance. A square alone has two poses that look alike from afar: both are tried.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.geometry import Floats
from agents.stereo.calibration import Calibration
from agents.stereo.edges import refined
from agents.stereo.matching import Grey
from agents.stereo.points import calibration_covariances
from agents.stereo.tagmodel import TAG_M, panels, robot_of

CORNER_SIGMA_PX = 0.15
"""Standard deviation of a corner's place; raised to what is left over where that is more."""
WORST_PX = 1.0
"""A pose that leaves more than this (root mean square) is none."""
TWICE = 1.5
"""Two poses whose leftovers differ by less than this factor can't be told apart."""
LEAST_LEVEL = math.cos(math.radians(20.0))
"""A robot that leans by more is not level; nor is it told so well from afar that it is."""
ROUNDS = 12
STEEPEST_DEG = 75.0
"""A tag seen from farther to its side is not measured."""


@dataclass(frozen=True)
class TagSighting:
    """A robot found by its tags."""

    robot: int
    """Its number in the team."""
    rotation: Floats
    """(3, 3) from the robot's frame to the camera's."""
    position_m: Floats
    """(3,) of the robot's ground contact, camera frame."""
    covariance: Floats
    """(6, 6) of (rotation vector in the camera frame, position), rad and m."""
    leftover_px: float
    tags: int


@dataclass(frozen=True)
class Refusal:
    """A robot whose tags show, but not its pose."""

    robot: int
    reason: str
    about_m: tuple[Floats, ...] = ()
    """Where it may be, (3,) each, camera frame."""


@dataclass(frozen=True)
class TagSearch:
    """What tags gave: robots found, and why others were not."""

    found: tuple[TagSighting, ...]
    refused: tuple[Refusal, ...]


@dataclass(frozen=True)
class _Seen:
    """Corners of one robot's tags: where they are on the robot, and in both images."""

    corners_m: Floats
    """(K, 3) in the robot's frame."""
    left_px: Floats
    """(K, 2)."""
    right_px: Floats


_SCALES = (1, 2)
"""Tags are looked for in the image, and what is not found then in one twice as large."""
_STRETCHED = np.rint(255 * np.log1p(np.arange(256) / 4) / np.log1p(255 / 4)).astype(np.uint8)
"""Grey levels to their logarithm: a tag in the shade has the contrast of one in the sun."""


@cache
def _detector(scale: int) -> cv2.aruco.ArucoDetector:
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    settings.minMarkerPerimeterRate = 0.02
    settings.adaptiveThreshConstant = 2
    settings.polygonalApproxAccuracyRate = 0.06
    if scale > 1:
        settings.adaptiveThreshWinSizeMin = 5
        settings.adaptiveThreshWinSizeMax = 45
        settings.adaptiveThreshWinSizeStep = 8
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    return cv2.aruco.ArucoDetector(family, settings)


def corners(image: Grey) -> dict[int, Floats]:
    """Return the corners (4, 2) of the tags in an image, by tag, clockwise from the upper left."""
    found: dict[int, Floats] = {}
    for scale in _SCALES:
        found = _detected(image, scale) | found
    return {tag: refined(image, quad) for tag, quad in sorted(found.items())}


def _detected(image: Grey, scale: int) -> dict[int, Floats]:
    """Return the rough corners (4, 2) of tags, looked for in an enlarged image."""
    large = np.asarray(_STRETCHED[image], dtype=np.uint8)
    if scale > 1:
        large = cv2.resize(large, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    found, names, _ = _detector(scale).detectMarkers(large)
    by_tag: dict[int, list[Floats]] = {}
    listed: list[int] = [] if len(found) == 0 else [int(name) for name in np.ravel(names)]
    for tag, quad in zip(listed, found, strict=True):
        large_px = np.asarray(quad, dtype=np.float64).reshape(4, 2)
        by_tag.setdefault(tag, []).append((large_px + 0.5) / scale - 0.5)
    # A tag that shows twice is a reflection or a forgery: neither is taken.
    return {tag: quads[0] for tag, quads in by_tag.items() if len(quads) == 1}


def find_robots(
    left: Grey,
    right: Grey,
    calibration: Calibration,
    robots: Sequence[int],
    *,
    up: Floats | None = None,
) -> TagSearch:
    """Return the robots (numbers out of `robots`) whose tags both images show.

    `up` (3,), camera frame, is away from the ground, where that is known: robots keep level, so
    that of the two poses that a tag may have from afar one mostly is none.
    """
    here, there = corners(left), corners(right)
    found: list[TagSighting] = []
    refused: list[Refusal] = []
    for robot in robots:
        mine = [tag for tag in sorted({*here, *there}) if robot_of(tag) == robot]
        both = [tag for tag in mine if tag in here and tag in there]
        if not mine:
            continue
        if not both:
            refused.append(Refusal(robot, "its tag is in one image only"))
            continue
        answer = _pose(robot, both, (here, there), calibration, up)
        if isinstance(answer, TagSighting):
            found.append(answer)
        else:
            refused.append(answer)
    return TagSearch(tuple(found), tuple(refused))


def _gathered(
    robot: int, tags: Sequence[int], left: dict[int, Floats], right: dict[int, Floats]
) -> _Seen:
    on_robot = {panel.tag: panel.corners_m(TAG_M) for panel in panels(robot)}
    return _Seen(
        np.concatenate([on_robot[tag] for tag in tags]),
        np.concatenate([left[tag] for tag in tags]),
        np.concatenate([right[tag] for tag in tags]),
    )


def _pose(
    robot: int,
    tags: Sequence[int],
    corners_px: tuple[dict[int, Floats], dict[int, Floats]],
    c: Calibration,
    up: Floats | None,
) -> TagSighting | Refusal:
    """Return the best pose, or why there is none.

    A tag that is half hidden may still be read, and spoils all: where they do not agree, that one
    counts which fits best.
    """
    seen = _gathered(robot, tags, *corners_px)
    tried = _fits(seen, c, up)
    if not tried or tried[0].leftover_px > WORST_PX:
        alone = [_gathered(robot, [tag], *corners_px) for tag in tags]
        fits = [(_fits(one, c, up), one) for one in alone]
        tried, seen = min(
            ((fit, one) for fit, one in fits if fit),
            key=lambda pair: pair[0][0].leftover_px,
            default=(tried, seen),
        )
    if not tried or tried[0].leftover_px > WORST_PX:
        return Refusal(robot, "its corners fit no pose")
    best = tried[0]
    if _aside_deg(seen, best) > STEEPEST_DEG:
        return Refusal(robot, "its tag is edge-on", (best.position_m,))
    for other in tried[1:]:
        apart = float(np.linalg.norm(cv2.Rodrigues(best.rotation.T @ other.rotation)[0]))
        if other.leftover_px < TWICE * best.leftover_px and apart > math.radians(5):
            reason = "its tag is too small to tell which way it faces"
            return Refusal(robot, reason, (best.position_m, other.position_m))
    sigma = max(CORNER_SIGMA_PX, best.leftover_px)
    covariance = np.asarray(sigma**2 * np.linalg.inv(best.normal), dtype=np.float64)
    covariance[3:, 3:] += calibration_covariances(best.position_m[None, :], c)[0]
    count = len(seen.corners_m) // 4
    return TagSighting(robot, best.rotation, best.position_m, covariance, best.leftover_px, count)


def _fits(seen: _Seen, c: Calibration, up: Floats | None) -> list["_Fit"]:
    """Return the poses that corners may have, the best first; level ones only if there are any."""
    tried = sorted(
        (_refined(seen, c, r, t) for r, t in _starts(seen, c)), key=lambda fit: fit.leftover_px
    )
    if up is None:
        return tried
    return [fit for fit in tried if fit.rotation[:, 2] @ up > LEAST_LEVEL] or tried


@dataclass(frozen=True)
class _Fit:
    rotation: Floats
    position_m: Floats
    normal: Floats
    leftover_px: float


def _starts(seen: _Seen, c: Calibration) -> list[tuple[Floats, Floats]]:
    """Return first poses: both that each tag alone allows."""
    starts: list[tuple[Floats, Floats]] = []
    for k in range(0, seen.corners_m.shape[0], 4):
        quad = seen.corners_m[k : k + 4]
        middle = quad.mean(axis=0)  # OpenCV's IPPE errs on a level square above its origin
        count, turns, shifts, _ = cv2.solvePnPGeneric(
            (quad - middle).reshape(-1, 1, 3),
            seen.left_px[k : k + 4].reshape(-1, 1, 2),
            c.matrix,
            None,
            flags=cv2.SOLVEPNP_IPPE,
        )
        for turn, shift in zip(turns[:count], shifts[:count], strict=True):
            rotation = _rotation(np.asarray(turn))
            place_m = np.asarray(shift, dtype=np.float64).ravel()
            starts.append((rotation, place_m - rotation @ middle))
    return starts


def _rotation(turn: NDArray[Any]) -> Floats:
    """Return the (3, 3) rotation of a rotation vector."""
    return np.asarray(cv2.Rodrigues(turn.astype(np.float64))[0], dtype=np.float64)


def _refined(seen: _Seen, c: Calibration, rotation: Floats, position_m: Floats) -> _Fit:
    """Return the least squares pose near a first one (Gauss-Newton, damped)."""
    damping, normal = 1e-3, np.eye(6)
    rest, slope = _leftovers(seen, c, rotation, position_m)
    for _ in range(ROUNDS):
        normal = slope.T @ slope
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -slope.T @ rest)
        turned = _rotation(step[:3]) @ rotation
        moved = position_m + step[3:]
        new_rest, new_slope = _leftovers(seen, c, turned, moved)
        if new_rest @ new_rest < rest @ rest:
            rotation, position_m, rest, slope = turned, moved, new_rest, new_slope
            damping /= 10
        else:
            damping *= 10
        if float(np.linalg.norm(step)) < 1e-9:
            break
    return _Fit(rotation, position_m, slope.T @ slope, float(np.sqrt(np.mean(rest**2))))


def _leftovers(
    seen: _Seen, c: Calibration, rotation: Floats, position_m: Floats
) -> tuple[Floats, Floats]:
    """Return predicted less found pixels (4K,), and their slopes (4K, 6)."""
    turned = seen.corners_m @ rotation.T
    points = turned + position_m
    points[:, 2] = np.maximum(points[:, 2], 1e-3)
    rest: list[Floats] = []
    slopes: list[Floats] = []
    for right, found in ((False, seen.left_px), (True, seen.right_px)):
        rest.append((c.pixels(points, right) - found).ravel())
        slopes.append(_slopes(points, turned, c, c.baseline_m if right else 0.0))
    return np.concatenate(rest), np.concatenate(slopes)


def _slopes(points: Floats, turned: Floats, c: Calibration, shift_m: float) -> Floats:
    """Return (2K, 6): change of pixels with a small turn about the robot's origin and a shift."""
    x, y, z = points[:, 0] - shift_m, points[:, 1], points[:, 2]
    zero = np.zeros_like(z)
    by_point = np.empty((z.size, 2, 3))
    by_point[:, 0] = c.focal_px * np.column_stack((1 / z, zero, -x / z**2))
    by_point[:, 1] = c.focal_px * np.column_stack((zero, 1 / z, -y / z**2))
    tx, ty, tz = turned[:, 0], turned[:, 1], turned[:, 2]
    by_turn = np.zeros((z.size, 3, 3))  # minus the cross product with the turned corner
    by_turn[:, 0, 1], by_turn[:, 0, 2] = tz, -ty
    by_turn[:, 1, 0], by_turn[:, 1, 2] = -tz, tx
    by_turn[:, 2, 0], by_turn[:, 2, 1] = ty, -tx
    return np.concatenate((by_point @ by_turn, by_point), axis=2).reshape(-1, 6)


def _aside_deg(seen: _Seen, fit: _Fit) -> float:
    """Return from how far to its side the squarest tag is seen."""
    least = 180.0
    for k in range(0, seen.corners_m.shape[0], 4):
        quad = seen.corners_m[k : k + 4] @ fit.rotation.T + fit.position_m
        out = np.cross(quad[3] - quad[0], quad[1] - quad[0])
        way = -quad.mean(axis=0)
        cosine = float(out @ way / np.linalg.norm(out) / np.linalg.norm(way))
        least = min(least, math.degrees(math.acos(min(max(cosine, -1.0), 1.0))))
    return least
