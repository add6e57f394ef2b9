"""A robot that watches its way: each leg's motion, by what its eyes see before and after it.

Before a leg the eyes take in the ground where the leg will lead, and after it the same ground
again; what the fiducials in it tell corrects what the wheels said. Wheels slip, always to the same
side; images don't, and by them the pose filter learns by how much.
"""

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, wrap_angle
from agents.ports import Eyes, Glance, Odometry
from agents.pose.localising import GATE
from agents.pose.posefilter import PoseFilter, Remembered
from agents.pose.rigidmotion import Motion
from agents.settings import SensorSettings
from agents.stereo.eyes import largest_disparity_px, left_eye_m, level_from_camera
from agents.stereo.odometry import Odometer, Step
from agents.stereo.settings import glance_calibration
from agents.stereo.spots import Frame

LEG = Remembered("leg", 0)
"""Where the leg began."""
SAME_RAD = math.radians(8.0)
"""A pair taken no more than this aside of where a leg leads serves as the one before it."""
LEVEL_SIGMAS = 5.0
"""Two looks of a level arm that differ in tilt by more than this were of no level robot."""
PLACE_FLOOR_M, YAW_FLOOR_RAD = 0.001, math.radians(0.02)
"""Least sigmas: how well the head's place on its mast is known."""


@dataclass(frozen=True)
class Seen:
    """What the eyes made of one leg."""

    before: Frame
    after: Frame
    step: Step
    offset: Floats | None
    """(4,) of (forward, left, up, turn) in the frame of the pose before; None: `step.reason`."""


class WayWatch:
    """Watches leg by leg; what it tells goes into the pose filter."""

    def __init__(
        self,
        eyes: Eyes,
        sensor: SensorSettings,
        rng: np.random.Generator,
        tell: Callable[[str, str], None],
    ) -> None:
        """Watch through `eyes`; `tell(what, detail)` is given what does not work, and why."""
        self._eyes = eyes
        self._sensor = sensor
        self._tell = tell
        self._calibration = glance_calibration(sensor.fov_deg, sensor.stereo)
        self._odometer = Odometer(self._calibration, sensor.stereo.fiducials, rng)
        self._before: Glance | None = None
        """What was seen before the present leg."""
        self._last: Glance | None = None
        """What was seen after the last one, if the robot stands there still."""
        self._tried = 0
        self._told = 0
        self.seen: Seen | None = None
        """The last leg, for whoever wants to see it."""

    async def begin(self, turn_rad: float, way: PoseFilter) -> None:
        """Look where a leg will lead, unless that was just seen; remember where it begins."""
        last, self._last = self._last, None
        if last is None or abs(wrap_angle(turn_rad - last.pan_rad)) > SAME_RAD:
            last, frame = await self._glance(turn_rad)
            self._odometer.begin(frame)
        self._before = last
        if way.holds(LEG):
            way.forget(LEG)  # of a leg that was broken off
        way.remember(LEG)

    async def end(self, odometry: Odometry, way: PoseFilter) -> None:
        """Look again at what was seen before the leg, and correct the way by it."""
        before, frame = self._before, self._odometer.frame
        assert before is not None
        assert frame is not None
        after, after_frame = await self._glance(0.0)
        meant = camera_motion(odometry, before, after, self._sensor)
        step = await asyncio.to_thread(self._odometer.step, after_frame, meant)
        offset: Floats | None = None
        reason = step.reason
        if step.motion is not None:
            offset, covariance, reason = robot_motion(step.motion, before, after, self._sensor)
            if not reason:
                nis = way.fix_against(LEG, offset, covariance, gate=GATE)
                reason = _doubt(nis)
        way.forget(LEG)
        self._last = after
        self._tried += 1
        self._told += not reason
        self.seen = Seen(frame, after_frame, step, None if reason else offset)
        if reason:
            self._tell("no motion from images", reason)

    def tell_way(self) -> None:
        """Tell how many legs since the last time were told by images."""
        if self._tried:
            self._tell("motion from images", f"{self._told} of {self._tried} legs")
        self._tried = self._told = 0

    async def _glance(self, pan_rad: float) -> tuple[Glance, Frame]:
        tilt_rad = math.radians(self._sensor.stereo.glance_tilt_deg)
        glance = await self._eyes.glance(pan_rad, tilt_rad)
        most = largest_disparity_px(self._sensor, self._calibration, tilt_rad)
        frame = await asyncio.to_thread(Frame.of, glance.left, glance.right, most)
        return glance, frame


def _doubt(nis: float) -> str:
    """Say why a motion was not believed, or nothing."""
    return f"images and wheels disagree: {math.sqrt(nis):.1f} sigmas" if nis > GATE else ""


def camera_motion(
    odometry: Odometry, before: Glance, after: Glance, sensor: SensorSettings
) -> Motion:
    """Return the motion of the left camera, points before to points after, by what wheels say."""
    (one, one_m), (other, other_m) = (_stand(glance, sensor) for glance in (before, after))
    back = _about_up(-odometry.turn_rad)
    moved_m = np.array([odometry.forward_m, odometry.left_m, odometry.up_m])
    rotation = other.T @ back @ one
    return Motion(rotation, other.T @ (back @ (one_m - moved_m) - other_m), np.zeros((6, 6)))


def robot_motion(
    motion: Motion, before: Glance, after: Glance, sensor: SensorSettings
) -> tuple[Floats, Floats, str]:
    """Return a robot's (forward, left, up, turn) by its camera's motion, covariance, and doubts.

    The mast stands upright, so that the robot goes as its eye does; by how much the arm was off
    level before the leg turns the way that the eye went. Doubts are words, or nothing.
    """
    (one, one_m), (other, other_m) = (_stand(glance, sensor) for glance in (before, after))
    inverse = motion.inverse()
    turned = one @ inverse.rotation @ other.T
    turn_rad = math.atan2(float(turned[1, 0]), float(turned[0, 0]))
    went_m = one @ inverse.translation_m
    offset_m = went_m + one_m - _about_up(turn_rad) @ other_m
    mixed = np.zeros((4, 6))
    mixed[:3, :3] = one
    mixed[:3, 3:] = -np.outer(_about_up(turn_rad + math.pi / 2) @ _flat(other_m), one[2])
    mixed[3, 3:] = one[2]
    covariance = mixed @ inverse.covariance @ mixed.T
    x, y, z = went_m
    lever = np.array([[0.0, z], [-z, 0.0], [y, -x]])
    level_rad = math.radians(sensor.attitude_sigma_deg)
    covariance[:3, :3] += level_rad**2 * lever @ lever.T
    covariance += np.diag([PLACE_FLOOR_M**2] * 3 + [YAW_FLOOR_RAD**2])
    lean = math.hypot(float(turned[2, 0]), float(turned[2, 1]))
    spread = math.sqrt(2 * level_rad**2 + float(np.linalg.eigvalsh(inverse.covariance[3:, 3:])[2]))
    doubt = ""
    if lean > LEVEL_SIGMAS * spread:
        doubt = f"the tracks agree on no motion of a level arm: {math.degrees(lean):.1f} deg"
    return np.append(offset_m, turn_rad), 0.5 * (covariance + covariance.T), doubt


def _stand(glance: Glance, sensor: SensorSettings) -> tuple[Floats, Floats]:
    """Return a left camera's attitude (3, 3) and place (3,) in its levelled robot's frame."""
    turn = level_from_camera(glance.pan_rad, glance.tilt_rad)
    return turn, left_eye_m(sensor, sensor.stereo, glance.pan_rad)


def _about_up(angle_rad: float) -> Floats:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _flat(point_m: Floats) -> Floats:
    return np.array([point_m[0], point_m[1], 0.0])
