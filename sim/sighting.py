"""Team-mates in a look: who is in view, and where they are measured to be."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, Pose, wrap_angle
from agents.ports import Sighting
from agents.settings import SensorSettings
from sim.raycast import cylinder_limits
from sim.scene import Scene

BODY_HEIGHT_M = 0.6
"""A team-mate hides what is behind an upright cylinder of this height."""
MARKS_M = (0.15, 0.35, 0.55)
"""Heights of a robot's fiducials; one in sight is enough."""
YAW_FLOOR_RAD = math.radians(0.5)
"""Error of a sighted robot's yaw at no distance."""


@dataclass(frozen=True)
class View:
    """Where a camera stands and looks, and who is about."""

    sensor: SensorSettings
    pose: Pose
    pan_rad: float
    tilt_rad: float
    others: Mapping[str, Pose]
    body_radius_m: float

    @property
    def eye_m(self) -> Floats:
        """(3,) where the camera is, in the world."""
        pose = self.pose
        return np.array([pose.x_m, pose.y_m, pose.z_m + self.sensor.height_m])

    def blocked_m(self, rays: Floats, limit_m: float, besides: str = "") -> Floats:
        """Return (N,) how far world rays (N, 3) go before a team-mate stops them."""
        feet_m = [[o.x_m, o.y_m, o.z_m] for name, o in self.others.items() if name != besides]
        return cylinder_limits(
            self.eye_m,
            rays,
            np.array(feet_m, dtype=np.float64).reshape(-1, 3),
            self.body_radius_m,
            BODY_HEIGHT_M,
            limit_m,
        )

    def frames(self, way_m: Floats) -> bool:
        """Say whether what lies `way_m` (3,) from the eye is in range and inside the frame."""
        distance = float(np.linalg.norm(way_m))
        if not self.sensor.near_m <= distance <= self.sensor.range_m:
            return False
        azimuth = math.atan2(way_m[1], way_m[0]) - self.pose.yaw_rad
        aside = abs(wrap_angle(azimuth - self.pan_rad))
        above = abs(math.asin(way_m[2] / distance) - self.tilt_rad)
        return (
            aside <= math.radians(self.sensor.fov_deg) / 2
            and above <= math.radians(self.sensor.fov_vertical_deg) / 2
        )


def sightings(scene: Scene, view: View, rng: np.random.Generator) -> tuple[Sighting, ...]:
    """Return the team-mates of whom a fiducial is in the frame and in plain sight, by name."""
    seen = [name for name in sorted(view.others) if _in_sight(scene, view, name)]
    return tuple(_sighted(view, name, rng) for name in seen)


def _in_sight(scene: Scene, view: View, name: str) -> bool:
    other, eye_m = view.others[name], view.eye_m
    for height_m in MARKS_M:
        way_m = np.array([other.x_m, other.y_m, other.z_m + height_m]) - eye_m
        if not view.frames(way_m):
            continue
        distance = float(np.linalg.norm(way_m))
        free_m = view.blocked_m((way_m / distance)[None, :], distance, besides=name)[0]
        if free_m >= distance and scene.clear(eye_m, eye_m + way_m):
            return True
    return False


def sighting_covariance(
    sensor: SensorSettings, from_camera_m: Floats, body_radius_m: float = 0.4
) -> Floats:
    """Return the (4, 4) covariance of a sighted robot's (x, y, z, yaw) in the levelled robot frame.

    `from_camera_m` (3,) is where its fiducials are, seen from the camera. Position: Eq. 4 along
    and across the ray, and the levelling error that turns it about the camera. Yaw: fiducials a
    body's width apart, each with Eq. 4's error.
    """
    distance = max(float(np.linalg.norm(from_camera_m)), 1e-6)
    ray = from_camera_m / distance
    sigma = sensor.noise_s * distance**sensor.noise_n
    across = sensor.noise_t_lateral * sigma
    x, y, z = from_camera_m
    lever = np.array([[0.0, z], [-z, 0.0], [y, -x]])
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = (
        (sigma**2 - across**2) * np.outer(ray, ray)
        + across**2 * np.eye(3)
        + math.radians(sensor.attitude_sigma_deg) ** 2 * lever @ lever.T
        + 1e-6 * np.eye(3)
    )
    covariance[3, 3] = YAW_FLOOR_RAD**2 + (sigma / (math.sqrt(2) * body_radius_m)) ** 2
    return covariance


def _sighted(view: View, name: str, rng: np.random.Generator) -> Sighting:
    """Draw a measured relative pose with the error that its covariance says."""
    pose, other, sensor = view.pose, view.others[name], view.sensor
    way_m = np.array([[other.x_m - pose.x_m, other.y_m - pose.y_m, other.z_m - pose.z_m]])
    offset = Pose(0.0, 0.0, 0.0, -pose.yaw_rad).team_from_robot(way_m)[0]
    marks = offset + np.array([0.0, 0.0, MARKS_M[1] - sensor.height_m])
    covariance = sighting_covariance(sensor, marks, view.body_radius_m)
    error = np.linalg.cholesky(covariance) @ rng.standard_normal(4)
    x, y, z = (float(v) for v in offset + error[:3])
    bearing = wrap_angle(other.yaw_rad - pose.yaw_rad + float(error[3]))
    return Sighting(name, (x, y, z), bearing, covariance)
