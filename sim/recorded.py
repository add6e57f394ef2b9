"""A recording of a real robot, or of a run, that stands in for a robot's body and sensor.

The robot can't be driven: it is led along the recorded poses at the recorded times, and takes in
each recorded look when its time has come. Where the recording says that it was is taken for true.
"""

import asyncio
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from agents.geometry import Floats, Ints, Pose, Singles, wrap_angle
from agents.ports import Exposure, Odometry, Step
from agents.settings import DriveSettings, SensorSettings
from agents.stereo.calibration import Calibration
from agents.stereo.conditions import ill_conditions
from agents.stereo.matching import Grey, MatchSettings, match
from agents.stereo.points import cloud
from comms.timebase import now_ns, sleep_until_ns, to_s
from sim.drift import UP_SIGMA_M, UP_SIGMA_PER_ROOT_M, covariance
from sim.motion import Segment, blend

MOST_PIECES = 64
"""Of the way between two looks, so many segments are published at most."""
LEG_M = 2.0
"""Of a way without looks, a robot is told after so many metres how far it has come."""
STOOD_M, STOOD_RAD = 1e-3, 1e-4
"""Who moved less between two looks stood."""
LEAST_SEARCH_PX = 16


@dataclass(frozen=True)
class Pair:
    """A rectified pair of images that a robot took."""

    left: Grey
    right: Grey
    calibration: Calibration
    level_from_camera: Floats
    """(3, 3): from the left camera (x right, y down, z ahead) to the levelled robot frame."""


@dataclass(frozen=True)
class Take:
    """One recorded look."""

    t_ns: int
    """From the recording's start."""
    pose: Pose
    """Where the robot stood, levelled."""
    eye_m: Floats
    """(3,) where the sensor (of a pair, the left camera) was, levelled robot frame."""
    points_m: Singles
    """(N, 3) levelled robot frame; none of a pair, whose points its robot finds itself."""
    pair: Pair | None = None


@dataclass(frozen=True)
class Recording:
    """Where a robot was, and what it saw there."""

    times_ns: Ints
    """(K,) of the poses, from the recording's start, rising; the first is 0."""
    poses: Floats
    """(K, 4) of x, y, z in m and yaw in radians."""
    takes: tuple[Take, ...]
    """By time."""

    def pose_at(self, t_ns: int) -> Pose:
        """Return where the robot was; before the first pose and after the last, those."""
        after = int(np.searchsorted(self.times_ns, t_ns, side="right"))
        if after == 0 or after == len(self.times_ns):
            return self._pose(min(after, len(self.times_ns) - 1))
        began, ends = int(self.times_ns[after - 1]), int(self.times_ns[after])
        share = (t_ns - began) / (ends - began)
        return blend(self._pose(after - 1), self._pose(after), share)

    def _pose(self, index: int) -> Pose:
        x_m, y_m, z_m, yaw_rad = (float(value) for value in self.poses[index])
        return Pose(x_m, y_m, z_m, yaw_rad)

    def begun_at(self, start: Pose) -> "Recording":
        """Return the recording moved and turned so that its first pose is another one."""
        first = self._pose(0)
        if start == first:
            return self
        turn_rad = wrap_angle(start.yaw_rad - first.yaw_rad)

        def moved(pose: Pose) -> Pose:
            way = np.array([[pose.x_m - first.x_m, pose.y_m - first.y_m, pose.z_m - first.z_m]])
            x_m, y_m, z_m = (
                float(v) for v in replace(start, yaw_rad=turn_rad).team_from_robot(way)[0]
            )
            return Pose(x_m, y_m, z_m, wrap_angle(pose.yaw_rad + turn_rad))

        poses = [moved(self._pose(index)) for index in range(len(self.poses))]
        rows = np.array([[p.x_m, p.y_m, p.z_m, p.yaw_rad] for p in poses])
        takes = tuple(replace(take, pose=moved(take.pose)) for take in self.takes)
        return Recording(self.times_ns, rows, takes)

    def places_m(self, lattice_m: float) -> Floats:
        """Return where looks were taken (N, 2), no two of them in one cell of a lattice."""
        cells: dict[tuple[int, int], tuple[float, float]] = {}
        for take in self.takes:
            at = (take.pose.x_m, take.pose.y_m)
            cells.setdefault((int(at[0] // lattice_m), int(at[1] // lattice_m)), at)
        return np.array(list(cells.values()))

    def breaks_ns(self, from_ns: int, until_ns: int) -> list[int]:
        """Return instants from one to another between which the way was about straight."""
        inside = self.times_ns[(self.times_ns > from_ns) & (self.times_ns < until_ns)]
        stride = -(-len(inside) // (MOST_PIECES - 1)) if len(inside) else 1
        return [from_ns, *(int(t_ns) for t_ns in inside[::stride]), until_ns]


@dataclass(frozen=True)
class Led:
    """A recording in the time of a run."""

    recording: Recording
    begin_ns: int
    """When it began."""
    drift: float = 1.0
    """Sigma of its way, as a share of that of the robot's own wheels."""


class RecordedGuide:
    """`agents.ports.Guide` along a recording; it publishes the way as a body does."""

    def __init__(
        self,
        name: str,
        led: Led,
        sensor: SensorSettings,
        drive: DriveSettings,
        publish: Callable[[Segment], None],
        *,
        start: Pose,
        start_ns: int,
    ) -> None:
        """Stand at a start pose, where the robot is at `start_ns`; it may come in the middle.

        How unsure a robot is of the way between two looks, `drive` says as it does for others.
        """
        self._name = name
        self._recording, self._begin_ns = led.recording, led.begin_ns
        self._sensor, self._drive = sensor, drive
        self._publish = publish
        self._stands = start
        self._takes, self._next = led.recording.takes, 0
        self._drift = led.drift
        self._emit(start_ns, start_ns, start, start, "start")

    async def step(self) -> Step | None:
        """Follow the recording to its next look, or some way there; what is over by now is missed.

        A leg ends where the robot stands, and after `LEG_M`: so it knows on the way where it is.
        """
        left_ns = now_ns() - self._begin_ns
        while self._next < len(self._takes) and self._takes[self._next].t_ns < left_ns:
            self._next += 1
        if self._next == len(self._takes):
            return None
        take = self._takes[self._next]
        times, poses = self._leg(left_ns, take)
        for (a_ns, a), (b_ns, b) in itertools.pairwise(zip(times, poses, strict=True)):
            self._emit(self._begin_ns + a_ns, self._begin_ns + b_ns, a, b, "led")
        await sleep_until_ns(self._begin_ns + times[-1])
        self._stands = poses[-1]
        odometry = measured(poses, self._drive, self._drift)
        if times[-1] < take.t_ns:
            return Step(odometry)
        self._next += 1
        return Step(odometry, await asyncio.to_thread(seen, take, self._sensor, to_s(now_ns())))

    def _leg(self, left_ns: int, take: Take) -> tuple[list[int], list[Pose]]:
        """Return the instants and poses of the way to a look, or of its first leg."""
        times = self._recording.breaks_ns(left_ns, take.t_ns)
        inner = [self._recording.pose_at(t_ns) for t_ns in times[1:-1]]
        poses = [self._stands, *inner, take.pose]
        way_m = 0.0
        for last, (a, b) in enumerate(itertools.pairwise(poses)):
            if way_m >= LEG_M or (last and is_stand(a, b) != is_stand(*poses[:2])):
                return times[: last + 1], poses[: last + 1]
            way_m += a.distance_m(b)
        return times, poses

    def _emit(self, start_ns: int, end_ns: int, start: Pose, end: Pose, note: str) -> None:
        self._publish(Segment(self._name, start_ns, end_ns, start, end, note=note))


def is_stand(before: Pose, after: Pose) -> bool:
    """Say whether a robot stood between two poses."""
    turn_rad = abs(wrap_angle(after.yaw_rad - before.yaw_rad))
    return before.distance_m(after) < STOOD_M and turn_rad < STOOD_RAD


def measured(poses: list[Pose], drive: DriveSettings, drift: float) -> Odometry | None:
    """Return the odometry of a way through poses, None of a robot that stood.

    Its error is none: that is already in the recording. Its sigmas are `drift` times those of a
    drive as far, after turning as far, on the robot's own wheels (`drive`).
    """
    first, last = poses[0], poses[-1]
    legs = list(itertools.pairwise(poses))
    if all(is_stand(a, b) for a, b in legs):
        return None
    way_m = sum(a.distance_m(b) for a, b in legs)
    turned_rad = sum(abs(wrap_angle(b.yaw_rad - a.yaw_rad)) for a, b in legs)
    east_m, north_m = last.x_m - first.x_m, last.y_m - first.y_m
    c, s = math.cos(first.yaw_rad), math.sin(first.yaw_rad)
    up_sigma_m = math.hypot(UP_SIGMA_M, UP_SIGMA_PER_ROOT_M * math.sqrt(way_m))
    return Odometry(
        c * east_m + s * north_m,
        c * north_m - s * east_m,
        last.z_m - first.z_m,
        wrap_angle(last.yaw_rad - first.yaw_rad),
        drift**2 * covariance(drive, turned_rad, way_m, way_m, up_sigma_m=up_sigma_m),
    )


def seen(take: Take, sensor: SensorSettings, t_s: float) -> Exposure:
    """Return a recorded look as the robot takes it in; of a pair, what the images say.

    Points farther from the sensor than its depth of field are left out; the noise of a cloud is
    Eq. 4's.
    """
    if take.pair is not None:
        return _matched(take, take.pair, sensor, t_s)
    points_m = take.points_m.astype(np.float64)
    range_m = np.linalg.norm(points_m - take.eye_m, axis=1)
    kept = (range_m >= sensor.near_m) & (range_m <= sensor.range_m)
    sigma_m = sensor.noise_s * range_m[kept] ** sensor.noise_n
    pan_rad, tilt_rad = _aim(points_m[kept] - take.eye_m)
    return Exposure(t_s, pan_rad, tilt_rad, points_m[kept], sigma_m)


def _aim(rays: Floats) -> tuple[float, float]:
    """Return pan and tilt of the middle of rays (N, 3); straight ahead where they have none."""
    length = np.linalg.norm(rays, axis=1, keepdims=True)
    x, y, z = (rays / np.maximum(length, 1e-9)).sum(axis=0) / max(len(rays), 1)
    flat = math.hypot(x, y)
    return (math.atan2(y, x), math.atan2(z, flat)) if flat > 0.1 else (0.0, 0.0)


def _matched(take: Take, pair: Pair, sensor: SensorSettings, t_s: float) -> Exposure:
    width_px = pair.left.shape[1]
    most = math.ceil(pair.calibration.disparity_px(max(sensor.near_m, 1e-3)))
    search = MatchSettings(max_disparity_px=min(max(most, LEAST_SEARCH_PX), width_px // 2))
    matched = match(pair.left, pair.right, search)
    found = cloud(
        matched,
        pair.calibration,
        stride_px=sensor.stereo.stride_px,
        near_m=sensor.near_m,
        far_m=sensor.range_m,
    )
    points_m = found.points_m @ pair.level_from_camera.T + take.eye_m
    pan_rad, tilt_rad = _aim(pair.level_from_camera[:, 2][None, :])
    ill = tuple(ill_conditions(pair.left, pair.right, matched))
    return Exposure(t_s, pan_rad, tilt_rad, points_m, found.sigma_along_m(), ill=ill)
