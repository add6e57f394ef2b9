"""A ranging camera that sees true ground with true occlusion, and measures it as badly as Eq. 4.

Rays are spread evenly over azimuth (pan +- fov/2) and elevation (tilt +- fov_vertical/2), as the
planner's box sums assume. Errors of a measured point: S L^n along the ray and T S L^n across it in
both directions (Sujan & Meggiolaro, Eq. 4), and one error of the arm's levelling per look, which
turns all its points about the camera.
"""

import asyncio
import math
from collections.abc import Callable, Mapping

import numpy as np

from agents.geometry import Floats, Pose
from agents.ports import Exposure
from agents.settings import SensorSettings
from agents.voxel.rays import ray_directions
from comms.timebase import now_ns, to_s
from sim.coverage import observable_cells, reachable_positions
from sim.ground import Terrain
from sim.scene import Scene, return_probability, scene_of
from sim.sighting import View, sightings

__all__ = [
    "RangeCamera",
    "Scene",
    "expose",
    "observable_cells",
    "ray_directions",
    "reachable_positions",
]


def _tilted(vectors: Floats, roll_rad: float, pitch_rad: float) -> Floats:
    """Turn vectors (N, 3) by a small roll about x and pitch about y (nose down positive)."""
    cr, sr, cp, sp = (
        math.cos(roll_rad),
        math.sin(roll_rad),
        math.cos(pitch_rad),
        math.sin(pitch_rad),
    )
    roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return vectors @ (pitch @ roll).T


def _turned(vectors: Floats, yaw_rad: float) -> Floats:
    """Turn vectors (N, 3) of the robot frame into the world's axes."""
    return Pose(0.0, 0.0, 0.0, yaw_rad).team_from_robot(vectors)


def expose(
    scene: Scene,
    sensor: SensorSettings,
    pose: Pose,
    pan_rad: float,
    tilt_rad: float,
    *,
    others: Mapping[str, Pose],
    rng: np.random.Generator,
    t_s: float = 0.0,
    body_radius_m: float = 0.4,
) -> Exposure:
    """Return what one look from a true pose measures, all in the levelled robot frame.

    `others` are the true poses of team-mates: they hide ground, give no points, and are sighted
    where a fiducial of theirs is in view. The same generator state gives the same exposure.
    """
    view = View(sensor, pose, pan_rad, tilt_rad, others, body_radius_m)
    roll_rad, pitch_rad = rng.normal(0.0, math.radians(sensor.attitude_sigma_deg), 2)
    nominal = ray_directions(sensor, pan_rad, tilt_rad)
    chance = rng.random(nominal.shape[0])
    noise = rng.standard_normal(nominal.shape)
    rays = _turned(_tilted(nominal, roll_rad, pitch_rad), pose.yaw_rad)
    found = scene.cast(view.eye_m, rays, view.blocked_m(rays, sensor.range_m))
    hit = np.flatnonzero(found[:, 0] >= sensor.near_m)
    likely = return_probability(found[hit, 1], scene.texture_at(found[hit, 2], found[hit, 3]))
    kept = hit[chance[hit] < likely]
    points_m, sigma_m = measured(sensor, nominal[kept], found[kept, 0], noise[kept])
    return Exposure(t_s, pan_rad, tilt_rad, points_m, sigma_m, sightings(scene, view, rng))


def measured(
    sensor: SensorSettings, rays: Floats, range_m: Floats, noise: Floats
) -> tuple[Floats, Floats]:
    """Return the points (N, 3) that noisy ranges along unit rays (N, 3) give, and their sigma (N,).

    Sujan & Meggiolaro, Eq. 4: sigma = S T L^n with T = 1 along the ray and `noise_t_lateral`
    across it; `noise` (N, 3) is standard normal. The sigma that is reported follows from the range
    as measured, the only one that the robot knows.
    """
    sigma = sensor.noise_s * range_m**sensor.noise_n
    along = np.maximum(range_m + sigma * noise[:, 0], 1e-3)
    flat = np.hypot(rays[:, 0], rays[:, 1])
    safe = np.maximum(flat, 1e-12)
    cosine = np.where(flat > 1e-9, rays[:, 0] / safe, 1.0)
    sine = np.where(flat > 1e-9, rays[:, 1] / safe, 0.0)
    left = np.column_stack((-sine, cosine, np.zeros_like(flat)))
    up = np.column_stack((-rays[:, 2] * cosine, -rays[:, 2] * sine, flat))
    lateral = sensor.noise_t_lateral * sigma
    points = along[:, None] * rays
    points += (lateral * noise[:, 1])[:, None] * left + (lateral * noise[:, 2])[:, None] * up
    points[:, 2] += sensor.height_m
    return points, sensor.noise_s * along**sensor.noise_n


class RangeCamera:
    """`agents.ports.Camera` over simulated ground."""

    def __init__(
        self,
        terrain: Terrain,
        sensor: SensorSettings,
        pose_now: Callable[[], Pose],
        others: Callable[[int], Mapping[str, Pose]],
        rng: np.random.Generator,
        body_radius_m: float = 0.4,
    ) -> None:
        """Look from `pose_now()`, the robot's own true pose.

        `others(t_ns)` gives the true poses of team-mates (not the robot itself) as the world plane
        knows them at that time, its delay already taken off.
        """
        self._scene = scene_of(terrain)
        self._sensor = sensor
        self._pose_now = pose_now
        self._others = others
        self._rng = rng
        self._body_radius_m = body_radius_m

    async def look(self, pan_rad: float, tilt_rad: float) -> Exposure:
        """Take `sensor.look_s` to point and range; the exposure is of the moment when it ends."""
        await asyncio.sleep(self._sensor.look_s)
        t_ns = now_ns()
        return expose(
            self._scene,
            self._sensor,
            self._pose_now(),
            pan_rad,
            tilt_rad,
            others=self._others(t_ns),
            rng=self._rng,
            t_s=to_s(t_ns),
            body_radius_m=self._body_radius_m,
        )
