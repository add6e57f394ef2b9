"""One look of a stereo camera: a pair of images to what the robot's cycle takes, an `Exposure`.

The mast stands at the robot's ground contact; both cameras are at its top, half a baseline to
either side, and the arm keeps their rows level.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agents.geometry import Bools, Floats, Pose, wrap_angle
from agents.ports import Exposure, Sighting
from agents.settings import SensorSettings
from agents.stereo.calibration import Calibration, pinhole
from agents.stereo.conditions import ill_conditions
from agents.stereo.finding import Finder, Found, NotFound
from agents.stereo.matching import Grey, Matched, MatchSettings, match
from agents.stereo.points import calibration_covariances, cloud
from agents.stereo.settings import StereoSettings
from agents.stereo.subpixel import refined
from agents.stereo.tags import TagSearch, TagSighting, find_robots

ROCKS = 0.3
LEAST_ABOUT = 0.8
"""Points are left out about which less than this share of the pixels was matched. Of the points of
a mission that lay more than four sigmas off, two in three were such."""
MATE_RADIUS_M, MATE_TOP_M = 0.55, 2.2
"""Points this near to a sighted team-mate's axis, and up to this high, are its own: no ground."""

ROOM_M = 0.3
"""So far about a landmark's shape points are taken for its own."""


@dataclass(frozen=True)
class Look:
    """Which way a look went."""

    t_s: float
    pan_rad: float
    tilt_rad: float


@dataclass(frozen=True)
class Seen:
    """A look, and what was found on the way, for the log and for whoever wants to see it."""

    exposure: Exposure
    matched: Matched
    tags: TagSearch


def calibration_of(sensor: SensorSettings, stereo: StereoSettings) -> Calibration:
    """Return the calibration of a robot's pair."""
    return pinhole(stereo.width_px, stereo.height_px, sensor.fov_deg, stereo.baseline_m)


def level_from_camera(pan_rad: float, tilt_rad: float) -> Floats:
    """Return the (3, 3) rotation from the camera's frame to the levelled robot frame."""
    cp, sp, ct, st = math.cos(pan_rad), math.sin(pan_rad), math.cos(tilt_rad), math.sin(tilt_rad)
    return np.array([[sp, cp * st, cp * ct], [-cp, sp * st, sp * ct], [0.0, -ct, st]])


def left_eye_m(sensor: SensorSettings, stereo: StereoSettings, pan_rad: float) -> Floats:
    """Return where the left camera is, (3,), levelled robot frame."""
    half = stereo.baseline_m / 2
    return np.array([-half * math.sin(pan_rad), half * math.cos(pan_rad), sensor.height_m])


def see(
    left: Grey,
    right: Grey,
    look: Look,
    *,
    sensor: SensorSettings,
    stereo: StereoSettings,
    mates: Mapping[int, str],
    shapes: Mapping[str, Finder] | None = None,
) -> Seen:
    """Return what a pair of images says; `mates` are the other robots' names by their numbers.

    `shapes` are landmarks of known geometry, by name.
    """
    calibration = calibration_of(sensor, stereo)
    most = largest_disparity_px(sensor, calibration, look.tilt_rad)
    matched = match(left, right, MatchSettings(max_disparity_px=most))
    matched = refined(left, right, matched, stereo.stride_px)
    found = cloud(
        matched,
        calibration,
        stride_px=stereo.stride_px,
        near_m=sensor.near_m,
        far_m=sensor.range_m,
        least_about=LEAST_ABOUT,
    )
    turn = level_from_camera(look.pan_rad, look.tilt_rad)
    eye_m = left_eye_m(sensor, stereo, look.pan_rad)
    points_m = found.points_m @ turn.T + eye_m
    tags = find_robots(left, right, calibration, sorted(mates), up=turn[2])
    sightings = tuple(_sighting(s, mates[s.robot], turn, eye_m, sensor) for s in tags.found)
    feet_m = [np.array(s.offset_m) for s in sightings]
    kept = _ground(
        points_m, [*feet_m, *(turn @ about + eye_m for r in tags.refused for about in r.about_m)]
    )
    kept &= np.linalg.norm(found.points_m, axis=1) <= sensor.range_m
    sigma_m = found.sigma_along_m()
    marks: list[Sighting] = []
    told: list[str] = []
    for name, finder in sorted((shapes or {}).items()):
        answer = finder.find(points_m[kept], sigma_m[kept], eye_m)
        if isinstance(answer, NotFound):
            told += [f"{name}: {answer.reason}"] if answer.reason else []
            continue
        marks.append(_mark(name, answer, turn, eye_m, sensor, calibration))
        size_m = (finder.shape.radius_m + ROOM_M, finder.shape.height_m + ROOM_M)
        kept &= _off(points_m, answer.foot_m, *size_m)
    exposure = Exposure(
        look.t_s,
        look.pan_rad,
        look.tilt_rad,
        points_m[kept],
        sigma_m[kept],
        tuple(sorted((*sightings, *marks), key=lambda s: s.name)),
        ill=(*ill_conditions(left, right, matched), *_refused(tags, mates), *told),
    )
    return Seen(exposure, matched, tags)


def largest_disparity_px(sensor: SensorSettings, calibration: Calibration, tilt_rad: float) -> int:
    """Return the disparity of the nearest that a look at this tilt can show.

    That is ground (or rocks of `ROCKS` of the mast's height) at the image's lower edge; to search
    closer would cost time and find chance matches.
    """
    half = math.atan((calibration.height_px - 1 - calibration.cy_px) / calibration.focal_px)
    below = max(math.sin(min(half - tilt_rad, math.pi / 2)), 0.05)
    nearest_m = max(sensor.near_m, (1 - ROCKS) * sensor.height_m * math.cos(half) / below)
    most = math.ceil(calibration.disparity_px(nearest_m))
    return min(max(most, 16), calibration.width_px // 2)


def _refused(tags: TagSearch, mates: Mapping[int, str]) -> list[str]:
    return [f"{mates[refusal.robot]}: {refusal.reason}" for refusal in tags.refused]


def _ground(points_m: Floats, feet_m: Sequence[Floats]) -> Bools:
    """Say which points (N, 3) are not on a robot that stands at one of the feet (3,)."""
    kept = np.ones(points_m.shape[0], dtype=np.bool_)
    for foot_m in feet_m:
        kept &= _off(points_m, foot_m, MATE_RADIUS_M, MATE_TOP_M)
    return kept


def off_mates(exposure: Exposure, pose: Pose, stands: Sequence[tuple[Pose, float]]) -> Exposure:
    """Leave out the points that may be on a team-mate.

    Args:
        exposure: one look.
        pose: from where it was taken.
        stands: where team-mates say that they are, each with how far off, in metres, it may have
            been when the look was taken: so much farther out points are left out.
    """
    at_m = pose.team_from_robot(exposure.points_m)
    kept = np.ones(len(at_m), dtype=np.bool_)
    for stand, off_m in stands:
        foot_m = np.array((stand.x_m, stand.y_m, stand.z_m))
        kept &= _off(at_m, foot_m, MATE_RADIUS_M + off_m, MATE_TOP_M)
    return replace(exposure, points_m=exposure.points_m[kept], sigma_m=exposure.sigma_m[kept])


def _off(points_m: Floats, foot_m: Floats, radius_m: float, top_m: float) -> Bools:
    """Say which points (N, 3) are not within an upright cylinder on a foot (3,)."""
    aside = np.hypot(points_m[:, 0] - foot_m[0], points_m[:, 1] - foot_m[1])
    return (aside > radius_m) | (points_m[:, 2] - foot_m[2] > top_m)


def _mark(
    name: str,
    found: Found,
    turn: Floats,
    eye_m: Floats,
    sensor: SensorSettings,
    calibration: Calibration,
) -> Sighting:
    """Turn a landmark that was found into a sighting.

    To its covariance come the arm's levelling error, and what the calibration may have wrong, which
    all its points share.
    """
    covariance = found.covariance.copy()
    from_eye_m = found.foot_m - eye_m
    lens = calibration_covariances((turn.T @ from_eye_m)[None], calibration)[0]
    covariance[:3, :3] += _level_covariance(from_eye_m, sensor) + turn @ lens @ turn.T
    x, y, z = (float(v) for v in found.foot_m)
    return Sighting(name, (x, y, z), wrap_angle(found.yaw_rad), covariance)


def _level_covariance(from_eye_m: Floats, sensor: SensorSettings) -> Floats:
    """Return the covariance (3, 3) of a place by the levelling error, a turn about the eye."""
    x, y, z = from_eye_m
    lever = np.array([[0.0, z], [-z, 0.0], [y, -x]])
    return math.radians(sensor.attitude_sigma_deg) ** 2 * lever @ lever.T


def _sighting(
    found: TagSighting, name: str, turn: Floats, eye_m: Floats, sensor: SensorSettings
) -> Sighting:
    """Turn a pose in the camera's frame into a sighting in the levelled robot frame.

    To the tag's own covariance comes the arm's levelling error, which turns all about the camera.
    """
    offset_m = turn @ found.position_m + eye_m
    ahead = turn @ found.rotation[:, 0]
    lean = turn @ found.covariance[:3, :3] @ turn.T
    mixed = np.zeros((4, 6))
    mixed[:3, 3:] = turn
    mixed[3, :3] = turn[2]  # a turn about the vertical is what changes the yaw
    covariance = mixed @ found.covariance @ mixed.T
    covariance[3, 3] = lean[2, 2]
    covariance[:3, :3] += _level_covariance(offset_m - eye_m, sensor)
    covariance += np.diag([1e-6, 1e-6, 1e-6, _YAW_FLOOR_RAD**2])
    return Sighting(
        name,
        (float(offset_m[0]), float(offset_m[1]), float(offset_m[2])),
        wrap_angle(math.atan2(float(ahead[1]), float(ahead[0]))),
        covariance,
    )


_YAW_FLOOR_RAD = math.radians(0.2)
"""How square the panels are mounted."""
