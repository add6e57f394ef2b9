"""How far off a robot is after a way, by its wheels and by its eyes.

A rover drives leg by leg over made-up ground and watches its way (`agents.pose.waywatch`); two pose
filters take in the same drives, one of them the images too. Nothing else tells it where it is.

    python benchmarks/watched_way.py [--ways 10] [--legs 20] [--kind plain|field]
"""

import argparse
import asyncio
import math
from dataclasses import dataclass

import numpy as np

from agents.fusion import pose_numbers
from agents.geometry import Floats, GridFrame, Pose, wrap_angle
from agents.ports import Odometry
from agents.pose.posefilter import PoseFilter
from agents.pose.waywatch import WayWatch
from agents.settings import DriveSettings, SensorSettings
from sim.clock import VirtualLoop
from sim.ground import Terrain
from sim.rover import RoverBody
from sim.settings import TerrainSettings
from sim.stereo.camera import StereoCamera, make_stage
from sim.terrain import TERRAINS

SIDE_M, CELL_M = 28.0, 0.1
START = Pose(SIDE_M / 2, 0.75 * SIDE_M, 0.0, 0.0)
TURN_RAD = math.radians(25.0)
"""The rover turns by up to this before a leg."""


@dataclass(frozen=True)
class Way:
    """What became of one way."""

    driven_m: float
    wheels: Floats
    """(4,) error of (x, y, z, yaw) by the wheels alone."""
    eyes: Floats
    """(4,) with the images."""
    nees: float
    """Squared error by the eyes in units of its covariance; 4 on average if that is right."""
    told: int
    legs: int
    reasons: tuple[str, ...]


def drive_way(seed: int, legs: int, kind: str) -> Way:
    """Return what becomes of a way of so many legs."""
    frame = GridFrame(0.0, 0.0, CELL_M, round(SIDE_M / CELL_M), round(SIDE_M / CELL_M))
    rng = np.random.default_rng(seed)
    ground = TERRAINS.find(kind)(TerrainSettings(kind=kind), frame, rng)
    loop = VirtualLoop(0)
    try:
        task = loop.create_task(_drive(ground, legs, rng, seed))
        loop.run_window(10**15)
        return task.result()
    finally:
        loop.close()


async def _drive(ground: Terrain, legs: int, rng: np.random.Generator, seed: int) -> Way:
    drive, sensor = DriveSettings(), SensorSettings(kind="stereo")
    body = RoverBody("rover", ground, drive, START, lambda _: None, rng)
    stage = make_stage(ground, {"rover": sensor.height_m}, salt=seed)
    eyes = StereoCamera("rover", stage, sensor, body.pose_now, lambda _: {}, rng)
    reasons: list[str] = []
    watch = WayWatch(
        eyes,
        sensor,
        np.random.default_rng(seed),
        lambda what, why: reasons.append(f"{what}: {why}"),
    )
    ways = [PoseFilter(body.pose_now(), np.diag([1e-6, 1e-6, 1e-6, 1e-8])) for _ in range(2)]
    for way in ways:
        way.doubt_slip(drive.slip_bias_sigma)
    told, driven_m = 0, 0.0
    watched = ways[1]
    for _ in range(legs):
        turn_rad = float(rng.uniform(-TURN_RAD, TURN_RAD))
        if _leaves(body.pose_now(), turn_rad):
            turn_rad = math.pi / 2
        was = body.pose_now()
        await watch.begin(turn_rad, watched)
        odometry: Odometry = await body.drive(turn_rad, 1.0)
        for way in ways:
            way.predict(odometry)
        await watch.end(odometry, watched)
        told += watch.seen is not None and watch.seen.offset is not None
        driven_m += was.distance_m(body.pose_now())
        await asyncio.sleep(0)
    errors = [_error(way, body.pose_now()) for way in ways]
    nees = float(errors[1] @ np.linalg.solve(watched.covariance, errors[1]))
    return Way(driven_m, errors[0], errors[1], nees, told, legs, tuple(reasons))


def _leaves(pose: Pose, turn_rad: float) -> bool:
    ahead = pose.moved(0.0, 0.0, 0.0, turn_rad).moved(4.0, 0.0, 0.0, 0.0)
    return not (3.0 < ahead.x_m < SIDE_M - 3.0 and SIDE_M / 2 < ahead.y_m < SIDE_M - 3.0)


def _error(way: PoseFilter, truth: Pose) -> Floats:
    off = pose_numbers(way.pose) - pose_numbers(truth)
    off[3] = wrap_angle(float(off[3]))
    return off


def _rms(values: Floats) -> float:
    return math.sqrt(float(np.mean(np.square(values))))


def main() -> None:
    """Drive the ways and print what became of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ways", type=int, default=10)
    parser.add_argument("--legs", type=int, default=20)
    parser.add_argument("--kind", default="plain", help="of ground: plain, cliff, field, sandpit")
    args = parser.parse_args()
    ways: list[Way] = []
    for seed in range(1, args.ways + 1):
        ways.append(drive_way(seed, args.legs, args.kind))
        way = ways[-1]
        flat = [1000 * math.hypot(off[0], off[1]) for off in (way.wheels, way.eyes)]
        print(
            f"way {seed}: {way.driven_m:.1f} m, off by {flat[0]:.0f} mm by wheels,"
            f" {flat[1]:.0f} mm with eyes; {way.told} of {way.legs} legs from images",
            *way.reasons,
            sep="\n  ",
            flush=True,
        )
    driven_m = sum(way.driven_m for way in ways)
    print(f"{len(ways)} ways, {driven_m:.0f} m; r.m.s. error at the end:")
    for name, errors in (
        ("wheels", np.array([way.wheels for way in ways])),
        ("eyes", np.array([way.eyes for way in ways])),
    ):
        flat_m = _rms(np.hypot(errors[:, 0], errors[:, 1]))
        share = 100 * flat_m / (driven_m / len(ways))
        print(
            f"  {name}: {1000 * flat_m:.0f} mm ({share:.2f} % of the way),"
            f" {1000 * _rms(errors[:, 2]):.0f} mm of height,"
            f" {math.degrees(_rms(errors[:, 3])):.2f} deg"
        )
    legs, told = sum(way.legs for way in ways), sum(way.told for way in ways)
    print(f"  {told} of {legs} legs from images; NEES {np.mean([w.nees for w in ways]):.2f} (4)")


if __name__ == "__main__":
    main()
