"""Cameras over simulated ground, by name; installed packages may bring more."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from agents.geometry import Pose
from agents.ports import Camera
from agents.settings import SensorSettings
from agents.stereo.eyes import Seen
from comms.plugins import Plugins
from sim.camera import RangeCamera
from sim.ground import Terrain
from sim.stereo.camera import StereoCamera, make_stage
from sim.stereo.settings import LightSettings
from sim.stereo.shoot import Shot

MAPPERS = ("recon", "explorer")
"""Roles that have a camera, on a mast."""


@dataclass(frozen=True)
class Mount:
    """What a camera is mounted on, and what it is put before."""

    name: str
    roles: Mapping[str, str]
    """Of the whole team, by name."""
    landmarks: tuple[str, ...]
    """Names of what stands there like a robot without a mast."""
    meshes: Mapping[str, str]
    """Models of those landmarks that are known by their shape instead, by name."""
    terrain: Terrain
    sensor: SensorSettings
    pose_now: Callable[[], Pose]
    """True pose of the robot that carries it, in the world frame."""
    others: Callable[[int], dict[str, Pose]]
    """True poses of the others at an instant (ns), as far as they are known here, and landmarks."""
    rng: np.random.Generator
    radius_m: float
    """Of a robot's body."""
    light: LightSettings
    ground_salt: int
    """Names the pattern on the ground: the same for all robots of a run."""
    kept: Callable[[Shot, Seen], None] = lambda _shot, _seen: None
    """Is given what a camera of images saw, for the record."""


def _range(mount: Mount) -> Camera:
    return RangeCamera(
        mount.terrain, mount.sensor, mount.pose_now, mount.others, mount.rng, mount.radius_m
    )


def _stereo(mount: Mount) -> Camera:
    mast_m = mount.sensor.height_m
    masts_m = {mate: mast_m if r in MAPPERS else 0.0 for mate, r in mount.roles.items()}
    masts_m |= dict.fromkeys(mount.landmarks, 0.0)
    stage = make_stage(
        mount.terrain, masts_m, salt=mount.ground_salt, light=mount.light, meshes=mount.meshes
    )
    return StereoCamera(
        mount.name, stage, mount.sensor, mount.pose_now, mount.others, mount.rng, kept=mount.kept
    )


SENSORS: Plugins[Callable[[Mount], Camera]] = Plugins(
    "ropeteam.sensors", {"range": _range, "stereo": _stereo}
)
"""By `sensor.kind`; each is called for every robot that maps."""
