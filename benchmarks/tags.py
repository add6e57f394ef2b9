"""How many looks at a Cliff-bot in plain sight find it by its tags, and how right are they?

    python benchmarks/tags.py [--seeds N] [--first N] [--looks N] [--no-lids]

Puts the Cliff-bot of the scenario `cliff` anywhere between its start and its goal, and the
RECON-bot on the plateau where no lip hides it and it is no farther than 12 m off, renders the look
at it, and tells by which of its tags it was found: those on its sides, which the slope that it
hangs in hides from above, that on its lid, or both.
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats, Pose
from agents.planning.following import FAR_M, in_sight
from agents.planning.scene import BODY_M
from agents.stereo.calibration import Calibration
from agents.stereo.eyes import Look, calibration_of, left_eye_m, level_from_camera
from agents.stereo.tagmodel import CENTRE_M, is_lid, robot_of
from agents.stereo.tags import corners, find_robots
from scenarios.schema import load
from scenarios.stage import set_stage
from sim.camera import reachable_positions
from sim.ground import Terrain
from sim.stereo.camera import make_stage, take
from sim.stereo.shoot import Shot

NEAR_M = 2.0
NO_LID_M = 2 * CENTRE_M + 1e-3
"""A mast of a millimetre takes the place of the lid."""
KINDS = ("its lid", "its sides", "both", "not found")


@dataclass(frozen=True)
class Seen:
    """One look."""

    kind: str
    away_m: float
    error_m: float
    """Of the distance, along the ray; NaN where it was not found."""
    sigma_m: float
    reason: str


def looks(seed: int, count: int, lids: bool) -> Iterator[Seen]:
    """Render looks at the Cliff-bot of one seed."""
    scenario = load("cliff", ("sensor.kind=stereo",), seed=seed)
    world = set_stage(scenario)
    terrain, sensor = world.terrain, scenario.sensor
    assert isinstance(terrain, Terrain)
    assert world.goal_m is not None
    names = sorted(scenario.robots)
    number = names.index("cliffbot")
    masts_m = dict.fromkeys(names, 0.0 if lids else NO_LID_M) | {"recon": sensor.height_m}
    stage = make_stage(terrain, masts_m, salt=seed)
    rng, start = np.random.default_rng(seed), world.starts["cliffbot"]
    ground_m = np.asarray(terrain.elevation_m, dtype=np.float64)
    drive = scenario.drive
    begin = world.starts["recon"]
    stands_m = reachable_positions(
        terrain, (begin.x_m, begin.y_m), drive.max_slope_deg, drive.footprint_m, 0.5
    )
    others = {name: pose for name, pose in world.starts.items() if "anchor" in name}
    while count:
        x_m = float(rng.uniform(start.x_m - 4, start.x_m + 4))
        y_m = float(rng.uniform(world.goal_m[1], start.y_m))
        mate = Pose(x_m, y_m, terrain.height_m(x_m, y_m), float(rng.uniform(-math.pi, math.pi)))
        x_m, y_m = (float(v) for v in stands_m[rng.integers(len(stands_m))][:2])
        here = Pose(x_m, y_m, terrain.height_m(x_m, y_m), float(rng.uniform(-math.pi, math.pi)))
        east, north, up_m = mate.x_m - x_m, mate.y_m - y_m, mate.z_m - here.z_m
        eye_m = np.array([(x_m, y_m, here.z_m + sensor.height_m)])
        body_m = np.array((mate.x_m, mate.y_m, mate.z_m + BODY_M))
        near = NEAR_M < float(np.linalg.norm(body_m - eye_m[0])) < FAR_M
        if not (near and in_sight(ground_m, terrain.frame, eye_m, body_m)[0]):
            continue
        count -= 1
        pan_rad = math.atan2(north, east) - here.yaw_rad
        tilt_rad = math.atan2(up_m - sensor.height_m, math.hypot(east, north))
        at = {**others, "cliffbot": mate}
        look = Look(0.0, pan_rad, tilt_rad)
        shot = take(stage, sensor, sensor.stereo, here, look, others=at, rng=rng)
        c, s = math.cos(here.yaw_rad), math.sin(here.yaw_rad)
        offset = np.array([c * east + s * north, c * north - s * east, up_m])
        turn = level_from_camera(pan_rad, tilt_rad)
        true_m: Floats = (offset - left_eye_m(sensor, sensor.stereo, pan_rad)) @ turn
        yield judged(shot, calibration_of(sensor, sensor.stereo), number, turn, true_m)


def judged(shot: Shot, calibration: Calibration, number: int, turn: Floats, true_m: Floats) -> Seen:
    """Hold what is found in a pair against where the robot is, (3,), camera frame."""
    search = find_robots(shot.left, shot.right, calibration, [number], up=turn[2])
    away_m = float(np.linalg.norm(true_m))
    if not search.found:
        reason = search.refused[0].reason if search.refused else "no tag was read"
        return Seen(KINDS[3], away_m, math.nan, math.nan, reason)
    found, ray = search.found[0], true_m / away_m
    read = {*corners(shot.left)} & {*corners(shot.right)}
    lids = {is_lid(tag) for tag in read if robot_of(tag) == number}
    kind = KINDS[2] if len(lids) == 2 else KINDS[0] if True in lids else KINDS[1]
    sigma_m = math.sqrt(float(ray @ found.covariance[3:, 3:] @ ray))
    return Seen(kind, away_m, float((found.position_m - true_m) @ ray), sigma_m, "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--looks", type=int, default=40, help="of each seed")
    parser.add_argument("--no-lids", action="store_true", help="without tags on lids")
    args = parser.parse_args()
    all_seen = [
        seen
        for seed in range(args.first, args.first + args.seeds)
        for seen in looks(seed, args.looks, not args.no_lids)
    ]
    print("| found by | looks | mean distance, m | error along the ray, rms, m | over its sigma |")
    print("|---|---:|---:|---:|---:|")
    for kind in KINDS:
        mine = [seen for seen in all_seen if seen.kind == kind]
        if mine:
            error = np.array([seen.error_m for seen in mine])
            over = error / np.array([seen.sigma_m for seen in mine])
            away_m = np.mean([seen.away_m for seen in mine])
            told = [f"{np.sqrt(np.mean(v**2)):.3g}" for v in (error, over)]
            told = ["", ""] if kind == KINDS[3] else told
            print(f"| {kind} | {len(mine)} | {away_m:.1f} | {told[0]} | {told[1]} |")
    for reason in sorted({seen.reason for seen in all_seen if seen.reason}):
        print(f"{sum(seen.reason == reason for seen in all_seen)}: {reason}")


if __name__ == "__main__":
    main()
