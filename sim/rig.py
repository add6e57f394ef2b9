"""What a simulated robot of each role is made of: body, camera, winch, on true ground."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from agents.geometry import Floats, Pose
from agents.ports import Hardware
from agents.settings import DriveSettings, SensorSettings, TetherSettings
from agents.stereo.eyes import Seen
from agents.voxel.ground import Build
from sim import planar_world
from sim.motion import Motions, Segment
from sim.occupancy import OccupancyBody, RangeCamera, Tread
from sim.planar import PlanarTread
from sim.planar_world import PlanarWorld
from sim.recorded import Led, RecordedGuide
from sim.rover import RoverBody
from sim.sensors import SENSORS, Mount
from sim.stereo.camera import StereoCamera
from sim.stereo.settings import LightSettings
from sim.stereo.shoot import Shot
from sim.tethered import TetheredBody
from sim.voxel import world as voxel_world
from sim.voxel.robot import VoxelTread
from sim.voxel.world import VoxelWorld
from sim.winch import SimWinch
from sim.worlds import World

START_SLACK_M = 0.05
"""Tethers are this much longer than the way to the Cliff-bot when the mission starts."""


@dataclass(frozen=True)
class Rig:
    """A robot's hardware, and what only the world knows of it."""

    hardware: Hardware
    delay_ns: int
    """The world plane shows team-mates as they were this long ago."""
    hazards_hit: Callable[[], int]
    """How often it came onto a rock or a step."""


def make_rig(
    name: str,
    roles: dict[str, str],
    *,
    terrain: World,
    landmarks: Mapping[str, Pose],
    motions: Motions,
    publish: Callable[[Segment], None],
    delay_ns: int,
    start: Pose,
    start_ns: int,
    tether_m: float | None,
    sensor: SensorSettings,
    drive: DriveSettings,
    tether: TetherSettings,
    body_rng: np.random.Generator,
    camera_rng: np.random.Generator,
    light: LightSettings,
    ground_salt: int,
    kept: Callable[[Shot, Seen], None] = lambda _shot, _seen: None,
    led: Led | None = None,
    meshes: Mapping[str, str] | None = None,
) -> Rig:
    """Build the hardware that a robot's role has.

    `motions` is this process's knowledge of everybody, own motion included; `publish` adds to it
    and tells the others. `landmarks` stand in the world and are seen like team-mates. `tether_m`
    is what is out of an Anchor-bot's drum, None at the start. `light` and `ground_salt`, which
    names the ground's pattern, are for cameras that see images; `kept` is given what these saw,
    and `meshes` are the models of landmarks that they know by their shape.
    Who is `led` has a guide instead of body and camera.
    """
    role = roles[name]

    def others(t_ns: int) -> dict[str, Pose]:
        seen = {mate: motions.pose_at(mate, t_ns - delay_ns) for mate in roles if mate != name}
        return {**landmarks, **{mate: pose for mate, pose in seen.items() if pose is not None}}

    def tethers(t_ns: int) -> list[tuple[Pose, float]]:
        seen_ns = t_ns - delay_ns
        anchors = [mate for mate, their in roles.items() if their == "anchor"]
        held = [(motions.pose_at(a, seen_ns), motions.tether_at(a, seen_ns)) for a in anchors]
        return [(pose, length_m) for pose, length_m in held if pose is not None and length_m > 0]

    if isinstance(terrain, PlanarWorld | VoxelWorld):
        tread, ranges_m = _among_cells(terrain, sensor, drive, camera_rng)
        among = OccupancyBody(name, tread, drive, start, publish, body_rng, start_ns=start_ns)
        eyes = RangeCamera(ranges_m, sensor, among.pose_now)
        return Rig(Hardware(body=among, camera=eyes), delay_ns, lambda: among.hazards_hit)
    if role == "cliffbot":
        body = TetheredBody(
            name, terrain, drive, start, publish, body_rng, tethers=tethers, start_ns=start_ns
        )
        return Rig(Hardware(body=body), delay_ns, lambda: body.hazards_hit)
    if role == "anchor":
        if tether_m is None:
            tether_m = _first_length_m(roles, motions, start)
        winch = SimWinch(
            name, tether, lambda _: start, publish, length_m=tether_m, start_ns=start_ns
        )
        return Rig(Hardware(winch=winch), delay_ns, lambda: 0)
    if led is not None:
        guide = RecordedGuide(name, led, sensor, drive, publish, start=start, start_ns=start_ns)
        return Rig(Hardware(guide=guide), delay_ns, lambda: 0)
    rover = RoverBody(name, terrain, drive, start, publish, body_rng, start_ns=start_ns)
    mount = Mount(
        name=name,
        roles=roles,
        landmarks=tuple(landmarks),
        meshes=meshes or {},
        terrain=terrain,
        sensor=sensor,
        pose_now=rover.pose_now,
        others=others,
        rng=camera_rng,
        radius_m=drive.footprint_m / 2,
        light=light,
        ground_salt=ground_salt,
        kept=kept,
    )
    camera = SENSORS.find(sensor.kind)(mount)
    eyes = camera if isinstance(camera, StereoCamera) else None
    hardware = Hardware(body=rover, camera=camera, eyes=eyes)
    return Rig(hardware, delay_ns, lambda: rover.hazards_hit)


def _among_cells(
    world: PlanarWorld | VoxelWorld,
    sensor: SensorSettings,
    drive: DriveSettings,
    rng: np.random.Generator,
) -> tuple[Tread, Callable[[Pose, float], Floats]]:
    """Return where wheels can go in a world, and how a camera ranges in it, erring by `rng`."""
    if isinstance(world, PlanarWorld):
        on_floor = partial(planar_world.look, world, sensor=sensor, rng=rng)
        return PlanarTread(world, drive), lambda pose, _: on_floor(pose)[0]
    ground = world.ground(Build.of(drive, sensor, world.frame.cell_m))
    return VoxelTread(world, ground), partial(voxel_world.look, world, sensor=sensor, rng=rng)


def _first_length_m(roles: dict[str, str], motions: Motions, anchor: Pose) -> float:
    """Return the length of tether from an Anchor-bot to where the Cliff-bot starts."""
    for mate, role in roles.items():
        pose = motions.pose_at(mate, 0) if role == "cliffbot" else None
        if pose is not None:
            way = (pose.x_m - anchor.x_m, pose.y_m - anchor.y_m, pose.z_m - anchor.z_m)
            return math.hypot(*way) + START_SLACK_M
    return 0.0
