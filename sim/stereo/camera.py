"""A stereo camera over simulated ground: the world renders a pair, the robot's code reads it."""

import asyncio
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, Pose
from agents.ports import Exposure, Glance
from agents.settings import SensorSettings
from agents.stereo.eyes import Look, Seen, calibration_of, left_eye_m, level_from_camera, see
from agents.stereo.finding import Finder
from agents.stereo.settings import StereoSettings
from agents.stereo.shape import Shape, shape_of
from comms.timebase import now_ns, to_s
from sim.ground import Terrain
from sim.stereo.mesh import Mesh, lander_mesh, placed, robot_mesh, shape_mesh
from sim.stereo.scene import World, origin_of
from sim.stereo.settings import LensSettings, LightSettings
from sim.stereo.shoot import Aim, Shot, shoot


@dataclass(frozen=True)
class Stage:
    """What a pair of cameras is put before."""

    world: World
    salt: int
    """Names the pattern on the ground: the same for all robots of a run."""
    light: LightSettings
    lens: LensSettings
    bodies: Mapping[str, Mesh]
    """Robots and landmarks in their own frames, by name."""
    shapes: Mapping[str, Shape]
    """Those among them that bear no tags, but are known by their shape."""


def make_stage(
    terrain: Terrain,
    masts_m: Mapping[str, float],
    *,
    salt: int,
    light: LightSettings | None = None,
    lens: LensSettings | None = None,
    landmark: Pose | None = None,
    meshes: Mapping[str, str] | None = None,
) -> Stage:
    """Return the stage of a run; robots are numbered by name, and 0 in `masts_m` is no mast.

    `meshes` are the models (`agents.stereo.shape.shape_of`) of those who look like no robot.
    """
    still = [] if landmark is None else [placed(lander_mesh(), landmark, origin_of(terrain))]
    numbers = {name: number for number, name in enumerate(sorted(masts_m))}
    bodies = {name: robot_mesh(numbers[name], masts_m[name]) for name in sorted(masts_m)}
    shapes = {name: shape_of(model) for name, model in sorted((meshes or {}).items())}
    bodies |= {name: shape_mesh(shape) for name, shape in shapes.items()}
    return Stage(
        World(terrain, still),
        salt,
        light or LightSettings(),
        lens or LensSettings(),
        bodies,
        shapes,
    )


def take(
    stage: Stage,
    sensor: SensorSettings,
    stereo: StereoSettings,
    pose: Pose,
    look: Look,
    *,
    others: Mapping[str, Pose],
    rng: np.random.Generator,
    vergence_px: tuple[float, float] = (0.0, 0.0),
) -> Shot:
    """Return the pair that a camera takes from a true pose; its levelling error is drawn anew."""
    roll_rad, pitch_rad = rng.normal(0.0, math.radians(sensor.attitude_sigma_deg), 2)
    world_from_level = _about_z(pose.yaw_rad)
    tilted = world_from_level @ _about_y(pitch_rad) @ _about_x(roll_rad)
    camera = tilted @ level_from_camera(look.pan_rad, look.tilt_rad)
    mast_m = np.array([pose.x_m, pose.y_m, pose.z_m + sensor.height_m])
    half = left_eye_m(sensor, stereo, look.pan_rad) - np.array([0.0, 0.0, sensor.height_m])
    eye_m = mast_m + tilted @ half - stage.world.origin_m
    moving = [
        placed(stage.bodies[name], others[name], stage.world.origin_m) for name in sorted(others)
    ]
    return shoot(
        stage.world.with_moving(moving),
        Aim(eye_m, camera[:, 0], camera[:, 1], camera[:, 2]),
        calibration_of(sensor, stereo),
        light=stage.light,
        lens=stage.lens,
        salt=stage.salt,
        rng=rng,
        vergence_px=vergence_px,
    )


def _about_x(angle_rad: float) -> Floats:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _about_y(angle_rad: float) -> Floats:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _about_z(angle_rad: float) -> Floats:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _unheard(_shot: Shot, _seen: Seen) -> None:
    """Keep nothing of a look."""


class StereoCamera:
    """`agents.ports.Camera` whose every look is a pair of images, and what is read out of them."""

    def __init__(
        self,
        name: str,
        stage: Stage,
        sensor: SensorSettings,
        pose_now: Callable[[], Pose],
        others: Callable[[int], Mapping[str, Pose]],
        rng: np.random.Generator,
        *,
        kept: Callable[[Shot, Seen], None] = _unheard,
    ) -> None:
        """Look from `pose_now()`, the robot's own true pose; see `sim.camera.RangeCamera`.

        `kept` is given every look's images and what was made of them, for the record.
        """
        self._stage = stage
        self._sensor = sensor
        self._pose_now = pose_now
        self._others = others
        self._rng = rng
        self.kept = kept
        self._mates = {
            number: mate
            for number, mate in enumerate(sorted(stage.bodies))
            if mate != name and mate not in stage.shapes
        }
        self._finders = {mark: Finder(shape) for mark, shape in stage.shapes.items()}
        u_px, v_px = rng.normal(0.0, stage.lens.vergence_sigma_px, 2)
        self._vergence_px = (float(u_px), float(v_px))

    async def look(self, pan_rad: float, tilt_rad: float) -> Exposure:
        """Take `sensor.look_s` to point and see; the exposure is of the moment when it ends."""
        await asyncio.sleep(self._sensor.look_s)
        look = Look(to_s(now_ns()), pan_rad, tilt_rad)
        shot = await self._taken(look, self._sensor.stereo, self._vergence_px)
        seen = await asyncio.to_thread(
            see,
            shot.left,
            shot.right,
            look,
            sensor=self._sensor,
            stereo=self._sensor.stereo,
            mates=self._mates,
            shapes=self._finders,
        )
        self.kept(shot, seen)
        return seen.exposure

    async def glance(self, pan_rad: float, tilt_rad: float) -> Glance:
        """`agents.ports.Eyes`: take `sensor.stereo.glance_s` to point and take a smaller pair."""
        stereo = self._sensor.stereo
        await asyncio.sleep(stereo.glance_s)
        look = Look(to_s(now_ns()), pan_rad, tilt_rad)
        u_px, v_px = self._vergence_px
        vergence_px = (u_px / stereo.glance_binning, v_px / stereo.glance_binning)
        shot = await self._taken(look, stereo.glanced(), vergence_px)
        return Glance(pan_rad, tilt_rad, shot.left, shot.right)

    async def _taken(
        self, look: Look, stereo: StereoSettings, vergence_px: tuple[float, float]
    ) -> Shot:
        """Render a pair; it takes a good part of a second, for which the radio must not wait."""
        return await asyncio.to_thread(
            take,
            self._stage,
            self._sensor,
            stereo,
            self._pose_now(),
            look,
            others=self._others(now_ns()),
            rng=self._rng,
            vergence_px=vergence_px,
        )
