"""A recording on disk to what leads a robot: where it was, and what it saw there."""

import math
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np

from agents.geometry import Floats, Ints, Pose
from agents.settings import DriveSettings
from agents.stereo.calibration import Calibration
from comms.timebase import NS, from_s
from scenarios.recordings import looks
from scenarios.recordings.bags import Bag, Message
from scenarios.recordings.transforms import Place, Track, Transforms
from scenarios.schema import Scenario
from sim.errors import WorldError
from sim.recorded import Led, Pair, Recording, Take
from sim.settings import RecordingSettings

ODOMETRY = "nav_msgs/msg/Odometry"
STAMPED = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")
TRANSFORMS = "tf2_msgs/msg/TFMessage"
TOGETHER_NS = 5_000_000
"""Images of a pair were taken at one time, if their stamps differ by no more."""
MOST_TAKES = 20_000


def recorded(scenario: Scenario, name: str, start: Pose | None) -> Led | None:
    """Return what leads a robot; None of one that drives itself.

    The recording is moved to begin at `start`; None: it is taken to tell places in the world.

    Raises:
        WorldError: the recording can't be used.

    """
    robot = scenario.robots[name]
    if robot.recording is None:
        return None
    recording = read(robot.recording, scenario.sensor.height_m)
    begun = recording if start is None else recording.begun_at(start)
    return Led(begun, from_s(scenario.joins_s(name)), robot.recording.drift)


def drive_of(scenario: Scenario, name: str) -> DriveSettings:
    """Return what a robot may believe of its wheels: one that is led slips no more than it drifts.

    A robot estimates by how much its wheels slip; the poses of a recording have that in them.
    """
    recording, drive = scenario.robots[name].recording, scenario.drive
    if recording is None:
        return drive
    slip_bias_sigma = recording.drift * drive.slip_bias_sigma
    return drive.model_copy(update={"slip_bias_sigma": slip_bias_sigma})


def read(settings: RecordingSettings, height_m: float) -> Recording:
    """Return a recording; where its looks stand in no sensor's frame, that is `height_m` up.

    Raises:
        WorldError: it can't be read, or poses and looks don't fit together.

    """
    try:
        changed_ns = Path(settings.file).stat().st_mtime_ns
    except OSError as error:
        raise WorldError(f"{settings.file}: can't be read: {error.strerror}") from error
    return _read(settings.model_dump_json(), height_m, changed_ns)


@lru_cache(maxsize=4)
def _read(settings: str, height_m: float, _changed_ns: int) -> Recording:
    return _Reading(RecordingSettings.model_validate_json(settings), height_m).read()


class _Reading:
    def __init__(self, settings: RecordingSettings, height_m: float) -> None:
        self.settings, self.height_m = settings, height_m
        self.file = Path(settings.file)
        self.bag = Bag(self.file)
        self.frames = Transforms()
        self.base, self.fixed = settings.base, ""

    def read(self) -> Recording:
        self._transforms()
        track = self._poses()
        begin_ns = int(track[0])
        sights = self._pairs() if self.settings.images else self._clouds()
        takes: list[Take] = []
        outside, seen = 0, 0
        for message, take in sights:
            seen += 1
            if take is None or message.t_ns < begin_ns:
                outside += 1
            elif len(takes) < MOST_TAKES:
                takes.append(take)
        if not takes:
            raise WorldError(
                f"{self.file}: has no look that can be used: of {seen} none was taken while its"
                f" poses tell where {self.base!r} was"
            )
        return self._settled(track, begin_ns, takes)

    def _settled(self, times_ns: Ints, begin_ns: int, takes: list[Take]) -> Recording:
        """Return all by time from the recording's start, with the poses at looks among poses."""
        at = {int(t_ns): self._stand(int(t_ns)) for t_ns in times_ns}
        at |= {take.t_ns: take.pose for take in takes}
        known = sorted((t_ns, pose) for t_ns, pose in at.items() if pose is not None)
        rows = np.array([[p.x_m, p.y_m, p.z_m, p.yaw_rad] for _, p in known])
        times = np.array([t_ns - begin_ns for t_ns, _ in known], dtype=np.int64)
        moved = tuple(
            Take(take.t_ns - begin_ns, take.pose, take.eye_m, take.points_m, take.pair)
            for take in sorted(takes, key=lambda take: take.t_ns)
        )
        return Recording(times, rows, moved)

    # --- poses --------------------------------------------------------------------------------

    def _transforms(self) -> None:
        topics = self.bag.of_kinds(TRANSFORMS)
        for message in self.bag.read(*topics) if topics else ():
            static = message.topic.endswith("tf_static")
            for one in message.told["transforms"]:
                stamp, moved = one["header"]["stamp"], one["transform"]
                self.frames.add(
                    _frame(one["header"]["frame_id"]),
                    _frame(one["child_frame_id"]),
                    (stamp["sec"] * NS + stamp["nanosec"]) or message.t_ns,
                    (moved["translation"], moved["rotation"]),
                    static,
                )

    def _poses(self) -> Ints:
        """Find out where the robot was; return when that was told (K,), ns, rising."""
        topic = self.settings.poses
        if topic is None:
            return self._by_transforms()
        self._expect(topic, ODOMETRY, *STAMPED)
        track: Track | None = None
        for message in self.bag.read(topic):
            told = message.told
            if track is None:
                self.fixed = _frame(told["header"]["frame_id"])
                named = told["child_frame_id"] if message.kind == ODOMETRY else ""
                self.base = _frame(named) or self.base
                track = self.frames.tracks[self.base] = Track(self.fixed)
            pose = told["pose"] if message.kind == STAMPED[0] else told["pose"]["pose"]
            track.add(message.t_ns, pose["position"], pose["orientation"])
        if track is None or not len(track.times_ns):
            raise WorldError(f"{self.file}: topic {topic} holds no pose")
        return track.times_ns

    def _by_transforms(self) -> Ints:
        line = self.frames.line(self.base)
        tracks = [self.frames.tracks[frame] for frame in line[:-1]]
        moving = [track.times_ns for track in tracks if not track.is_static]
        if not moving:
            found = self.bag.of_kinds(ODOMETRY, *STAMPED)
            known = sorted({*self.frames.tracks, *(t.parent for t in self.frames.tracks.values())})
            raise WorldError(
                f"{self.file}: its transforms don't tell where frame {self.base!r} goes; give"
                f" recording.base (one of {_some(known)}) or recording.poses (one of"
                f" {_some(found)})"
            )
        self.fixed = line[-1]
        return max(moving, key=len)

    def _stand(self, t_ns: int) -> Pose | None:
        """Return the robot's levelled pose at a time."""
        place = self.frames.between(self.fixed, self.base, t_ns)
        if place is None:
            return None
        x_m, y_m, z_m = (float(value) for value in place.shift_m)
        return Pose(x_m, y_m, z_m, math.atan2(place.rotation[1, 0], place.rotation[0, 0]))

    def _expect(self, topic: str, *kinds: str) -> None:
        found = self.bag.topics.get(topic)
        if found not in kinds:
            what = "has no topic" if found is None else f"has {found} on topic"
            there = _some(self.bag.of_kinds(*kinds))
            raise WorldError(
                f"{self.file}: {what} {topic}; needed is {' or '.join(kinds)} (there: {there})"
            )

    # --- looks --------------------------------------------------------------------------------

    def _clouds(self) -> Iterator[tuple[Message, Take | None]]:
        topic = self.settings.clouds
        if topic is None:
            there = self.bag.of_kinds(looks.CLOUD)
            if len(there) != 1:
                raise WorldError(
                    f"{self.file}: has {len(there)} topics of point clouds ({_some(there)}); say"
                    " which by recording.clouds, or name recording.images"
                )
            topic = there[0]
        self._expect(topic, looks.CLOUD)
        for message in self._spaced(self.bag.read(topic)):
            yield message, self._cloud(message)

    def _cloud(self, message: Message) -> Take | None:
        frame = _frame(message.told["header"]["frame_id"])
        stand = self._stand(message.t_ns)
        sensor = self._sensor(frame, message)
        if stand is None or sensor is None:
            return None
        world_m = sensor.points(looks.points(message.told, f"{self.file}: topic {message.topic}"))
        local_m = _levelled(stand, world_m).astype(np.float32)
        eye_m = np.array([0.0, 0.0, self.height_m])
        if frame != self.fixed:
            eye_m = _levelled(stand, sensor.shift_m[None, :])[0]
        return Take(message.t_ns, stand, eye_m, local_m)

    def _pairs(self) -> Iterator[tuple[Message, Take | None]]:
        assert self.settings.images is not None
        left, right = self.settings.images
        for topic in (left, right):
            self._expect(topic, *looks.IMAGES)
        calibration = self._calibration(left, right)
        others = {message.t_ns: message for message in self.bag.read(right)}
        times = np.array(sorted(others), dtype=np.int64)
        for message in self._spaced(self.bag.read(left)):
            near = times[np.abs(times - message.t_ns) <= TOGETHER_NS]
            other = others[int(near[0])] if len(near) else None
            take = None if other is None else self._pair(message, other, calibration)
            yield message, take

    def _pair(self, left: Message, right: Message, calibration: Calibration) -> Take | None:
        stand = self._stand(left.t_ns)
        camera = self._sensor(_frame(left.told["header"]["frame_id"]), left)
        if stand is None or camera is None:
            return None
        images = [looks.grey(m.told, f"{self.file}: topic {m.topic}") for m in (left, right)]
        size = (calibration.height_px, calibration.width_px)
        if any(image.shape != size for image in images):
            sizes = " and ".join(f"{image.shape[1]} x {image.shape[0]}" for image in images)
            raise WorldError(
                f"{self.file}: its images are {sizes} pixels, their camera_info says"
                f" {size[1]} x {size[0]}"
            )
        pair = Pair(images[0], images[1], calibration, _yawed(-stand.yaw_rad) @ camera.rotation)
        eye_m = _levelled(stand, camera.shift_m[None, :])[0]
        return Take(left.t_ns, stand, eye_m, np.zeros((0, 3), np.float32), pair)

    def _calibration(self, left: str, right: str) -> Calibration:
        told = []
        for topic in (left, right):
            self._expect(looks.sibling(topic), looks.CAMERA)
            first = next(self.bag.read(looks.sibling(topic)), None)
            if first is None:
                raise WorldError(f"{self.file}: topic {looks.sibling(topic)} holds nothing")
            told.append(first.told)
        return looks.calibration(told[0], told[1], self.file)

    def _spaced(self, messages: Iterator[Message]) -> Iterator[Message]:
        last_ns: int | None = None
        for message in messages:
            if last_ns is None or message.t_ns - last_ns >= from_s(self.settings.every_s):
                last_ns = message.t_ns
                yield message

    def _sensor(self, frame: str, message: Message) -> Place | None:
        """Return where a look's frame is in the fixed one."""
        if self.fixed not in self.frames.line(frame):
            raise WorldError(
                f"{self.file}: nothing tells where frame {frame!r} of topic {message.topic} is on"
                f" the robot: there is no transform to it from {self.base!r} or {self.fixed!r}"
                f" (there: {_some(sorted(self.frames.tracks))})"
            )
        return self.frames.between(self.fixed, frame, message.t_ns)


def _frame(name: str) -> str:
    return name.removeprefix("/")


def _some(names: list[str]) -> str:
    return ", ".join(names[:12]) + (" ..." if len(names) > 12 else "") if names else "none"


def _yawed(yaw_rad: float) -> Floats:
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _levelled(stand: Pose, world_m: Floats) -> Floats:
    """Turn points (N, 3) of the fixed frame into the levelled frame of a robot."""
    return (world_m - (stand.x_m, stand.y_m, stand.z_m)) @ _yawed(-stand.yaw_rad).T
