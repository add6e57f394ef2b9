"""A camera that goes past fiducials, measures them by Eq. 4, and finds its own way by them.

The camera looks along x and goes sideways, along y, past points at a mean distance ahead of it;
its arm trembles. It tracks a number of fiducials from frame to frame, takes up new ones for those
that leave its view, and adds motion to motion. Some tracks are false.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from agents.geometry import Bools, Floats, Ints
from agents.pose import rotations
from agents.pose.egomotion import Found, Tracks, find_motion, point_covariance
from agents.pose.rigidmotion import EgomotionError, Motion, closed_form, least_squares
from agents.pose.runningmotion import running_motion
from agents.settings import SensorSettings
from scenarios.experiments.tables import Row

HALF_VIEW_RAD = math.radians(30.0)
"""Half the field of view, both ways."""
PICKED_RAD = math.radians(27.0)
"""New fiducials are chosen within this, and a step inside: they stay in view for a motion."""
DEPTHS = (0.6, 1.4)
"""Fiducials lie between these shares of the mean distance."""
TREMBLE_RAD = math.radians(1.0)
"""Standard deviation of the camera's attitude about each axis."""
TREMBLE_SHARE = 0.1
"""Standard deviation of its place, as a share of a step."""
CROWD = 4.0
"""Fiducials that there are in view, to one that is tracked."""
FALSE_SHARE = 0.2
"""How far off a false track is, as a share of the mean distance."""
WAYS = ("refined", "closed form", "Eq. 12")
"""Ways to tell a motion from the same points."""
RUNNING_EVERY = 8
"""Eq. 13 is looked at in every eighth motion: it fits the points over and over."""
STEP_NUMBERS = (
    "step running error_m",
    "step running said_m",
    "step refined error_m",
    "step refined said_m",
)
"""What a row says of its one motion: errors of Eq. 13's mean and ours, and their covariances'."""


@dataclass(frozen=True)
class Course:
    """What one walk is like."""

    distance_m: float
    """Mean distance of fiducials."""
    count: int
    """How many are tracked."""
    motions: int
    step_m: float
    false_share: float
    """Chance that a track is false."""
    noise_s: float
    """S of Eq. 4, 1/m for n = 2."""


@dataclass(frozen=True)
class Camera:
    """Where a camera is: world_from_camera."""

    place_m: Floats
    attitude: Floats

    def sees(self, points_m: Floats) -> Floats:
        """Return points (n, 3) of the world in the camera's frame."""
        return (points_m - self.place_m) @ self.attitude


@dataclass(frozen=True)
class _Frame:
    """What is measured at one place."""

    ids: Ints
    points_m: Floats
    noise: Floats
    onward: Ints
    """Those that will be looked for at the next place."""


def walk(course: Course, rng: np.random.Generator) -> Iterator[Row]:
    """Yield a row for each motion: the error so far by each way, and what its covariance says."""
    world = _fiducials(course, rng)
    cameras = _path(course, rng)
    start = Motion(cameras[0].attitude, cameras[0].place_m, np.zeros((6, 6)))
    chains = dict.fromkeys(WAYS, start)
    frame = _frame(world, course, cameras[0], np.zeros(0, dtype=np.int64), rng)
    for k, camera in enumerate(cameras[1:], start=1):
        following = _frame(world, course, camera, frame.onward, rng)
        tracks = _tracks(frame, following, course, rng)
        try:
            found = find_motion(tracks, rng)
            steps = motions_of(tracks, found)
        except EgomotionError:
            found = None
            steps = dict.fromkeys(WAYS, _commanded(course))
        chains = {way: steps[way].inverse().then(chains[way]) for way in WAYS}
        row: Row = {"motion": k, "tracked": len(tracks.before_m), "lost": found is None}
        row |= errors_of(chains, camera)
        if found is not None and k % RUNNING_EVERY == 0:
            row |= running_of(tracks, found, cameras[k - 1], camera)
        yield row
        frame = following


def errors_of(chains: Mapping[str, Motion], camera: Camera) -> Row:
    """Return how far each way's chain of motions is off a camera's true place, and what it says."""
    row: Row = {}
    for way in WAYS:
        off_m = chains[way].translation_m - camera.place_m
        row[f"{way} error_m"] = float(np.linalg.norm(off_m))
    row["said_m"] = math.sqrt(float(np.trace(chains["refined"].covariance[:3, :3])))
    return row


def _fiducials(course: Course, rng: np.random.Generator) -> Floats:
    """Return points (m, 3) all along the way."""
    wide_m = 2 * course.distance_m * math.tan(HALF_VIEW_RAD)
    long_m = course.motions * course.step_m + 2 * wide_m
    m = math.ceil(CROWD * course.count * long_m / wide_m)
    x = course.distance_m * rng.uniform(*DEPTHS, m)
    y = rng.uniform(-wide_m, long_m - wide_m, m)
    return np.column_stack((x, y, x * np.tan(rng.uniform(-HALF_VIEW_RAD, HALF_VIEW_RAD, m))))


def _path(course: Course, rng: np.random.Generator) -> list[Camera]:
    n = course.motions + 1
    places = rng.normal(0.0, TREMBLE_SHARE * course.step_m, (n, 3))
    places[:, 1] += course.step_m * np.arange(n)
    turns = rotations.from_vector(rng.normal(0.0, TREMBLE_RAD, (n, 3)))
    return [Camera(place, turn) for place, turn in zip(places, turns, strict=True)]


def _within(points_m: Floats, half_rad: float, inset_m: float = 0.0) -> Bools:
    """Say which points (n, 3) of the camera's frame lie within a view, and a length inside it."""
    reach_m = points_m[:, 0] * math.tan(half_rad) - inset_m
    return (np.abs(points_m[:, 1]) <= reach_m) & (np.abs(points_m[:, 2]) <= reach_m + inset_m)


def _frame(
    world_m: Floats, course: Course, camera: Camera, former: Ints, rng: np.random.Generator
) -> _Frame:
    """Measure the former fiducials that are in view, and new ones for those about to leave it."""
    true_m = camera.sees(world_m)
    kept = former[_within(true_m[former], HALF_VIEW_RAD)]
    lasting = _within(true_m, PICKED_RAD, course.step_m)
    staying = kept[lasting[kept]]
    fresh = rng.permutation(np.setdiff1d(np.flatnonzero(lasting), former))
    fresh = fresh[: course.count - len(staying)]
    ids = np.concatenate((kept, fresh))
    sensor = SensorSettings(noise_s=course.noise_s)
    noise = noise_of(sensor, true_m[ids])
    drawn = np.linalg.cholesky(noise) @ rng.standard_normal((len(ids), 3, 1))
    measured_m = true_m[ids] + drawn[:, :, 0]
    onward = np.concatenate((staying, fresh))
    return _Frame(ids, measured_m, noise_of(sensor, measured_m), onward)


def noise_of(sensor: SensorSettings, points_m: Floats) -> Floats:
    """Return the covariances (n, 3, 3) of points (n, 3) in the camera's frame (Eq. 4)."""
    sigma_m = sensor.noise_s * np.linalg.norm(points_m, axis=1) ** sensor.noise_n
    return point_covariance(points_m, sigma_m, sensor.noise_t_lateral)


def _tracks(before: _Frame, after: _Frame, course: Course, rng: np.random.Generator) -> Tracks:
    """Return what was followed from one frame to the next; some of it is false."""
    ids = np.intersect1d(before.onward, after.ids, assume_unique=True)
    was, now = (np.array([f.ids.tolist().index(i) for i in ids]) for f in (before, after))
    false = rng.random(len(now)) < course.false_share
    off_m = FALSE_SHARE * course.distance_m
    astray = false[:, None] * rng.uniform(-off_m, off_m, (len(now), 3))
    return Tracks(
        before.points_m[was], after.points_m[now] + astray, before.noise[was], after.noise[now]
    )


def motions_of(tracks: Tracks, found: Found) -> dict[str, Motion]:
    """Return the motion by each way, all from the points that RANSAC kept."""
    kept = tracks.only(found.inliers)
    uncertain = 3.0 / np.trace(kept.before_noise + kept.after_noise, axis1=1, axis2=2)
    plain = closed_form(kept.before_m, kept.after_m, uncertain)
    paper = least_squares(kept.before_m, kept.after_m)
    fits = (found.motion, Motion(*plain, np.zeros((6, 6))), Motion(*paper, np.zeros((6, 6))))
    return dict(zip(WAYS, fits, strict=True))


def _commanded(course: Course) -> Motion:
    """Return the motion that was meant, for want of a better: it knows nothing of the trembling."""
    place, turn = 2 * (TREMBLE_SHARE * course.step_m) ** 2, 2 * TREMBLE_RAD**2
    return Motion(
        np.eye(3), np.array([0.0, -course.step_m, 0.0]), np.diag([place] * 3 + [turn] * 3)
    )


def running_of(tracks: Tracks, found: Found, was: Camera, now: Camera) -> Row:
    """Return how far one motion by Eq. 13 is off, what its covariance says, and ours likewise."""
    kept = tracks.only(found.inliers)
    try:
        running = running_motion(kept.before_m, kept.after_m)
    except EgomotionError:  # the first three on a line
        return {}
    true_m = now.sees(was.place_m[None])[0]
    numbers = (
        float(np.linalg.norm(running.translation_m - true_m)),
        math.sqrt(float(np.trace(running.covariance[:3, :3]))),
        float(np.linalg.norm(found.motion.translation_m - true_m)),
        math.sqrt(float(np.trace(found.motion.covariance[:3, :3]))),
    )
    return dict(zip(STEP_NUMBERS, numbers, strict=True))
