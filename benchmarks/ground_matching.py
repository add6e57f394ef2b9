"""How far off a robot is on made-up ground after a way, with its looks held against its own map.

    python benchmarks/ground_matching.py [DRIVES] [--kind plain|cliff|field]

A rover drives leg by leg, looks about every other leg and maps what it sees; two filters take in
the same drives, one of them what looks tell of the map (`agents.ground.stands`). Nothing else tells
where it is. NEES is the squared error in units of the covariance: 4 on average where that is right.
"""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from agents.fusion import pose_numbers
from agents.geometry import Floats, GridFrame, Pose, wrap_angle
from agents.ground.stands import Stands
from agents.layers import Anchor, variances
from agents.maps.elevation import Submap
from agents.maps.elevationlook import bin_look
from agents.pose.anchoring import submap_name
from agents.pose.posefilter import PoseFilter
from agents.settings import DriveSettings, SensorSettings
from sim.camera import expose
from sim.drift import draw_leg, measure
from sim.ground import Terrain
from sim.scene import Scene, scene_of
from sim.settings import TerrainSettings
from sim.terrain import TERRAINS

SIDE_M, CELL_M = 28.0, 0.1
LEGS, LOOK_EVERY = 30, 2
MIDDLE = (SIDE_M / 2, 0.75 * SIDE_M)
FAR_M = 4.0
SENSOR, DRIVE = SensorSettings(), DriveSettings()


@dataclass(frozen=True)
class Drive:
    """What became of one drive."""

    wheels: Floats
    """(4,) error of (x, y, z, yaw) by the wheels alone."""
    matched: Floats
    """(4,) with looks held against the map."""
    nees: float
    nees_wheels: float
    doubts: int
    map_error_m: float
    """Median of the map's absolute errors."""


def drive(seed: int, kind: str) -> Drive:
    """Return what becomes of one drive."""
    frame = GridFrame(0.0, 0.0, CELL_M, round(SIDE_M / CELL_M), round(SIDE_M / CELL_M))
    rng = np.random.default_rng(seed)
    terrain = TERRAINS.find(kind)(TerrainSettings(kind=kind), frame, rng)
    scene = scene_of(terrain)
    start = grounded(terrain, Pose(*MIDDLE, 0.0, float(rng.uniform(-math.pi, math.pi))))
    sure = np.diag([1e-8, 1e-8, 1e-8, 1e-10])
    wheels, way = PoseFilter(start, sure), PoseFilter(start, sure)
    bias = float(rng.normal(0.0, DRIVE.slip_bias_sigma))
    for each in (wheels, way):
        each.doubt_slip(DRIVE.slip_bias_sigma)
    submap = Submap(frame, Anchor.at(start, (1e-8, 1e-8, 1e-8, 1e-10)))
    way.remember(submap_name(0))
    stands, truth, doubts = Stands(frame, SENSOR), start, 0
    for number in range(LEGS + 1):
        if number % LOOK_EVERY == 0:
            doubts += look(scene, stands, submap, way, truth, rng)
        if number < LEGS:
            truth = step(terrain, truth, bias, (wheels, way), rng)
    both = submap.known & np.isfinite(terrain.elevation_m)
    elevation_m, _ = submap.estimate((slice(None), slice(None)))
    return Drive(
        error_of(wheels, truth),
        error_of(way, truth),
        nees(way, truth),
        nees(wheels, truth),
        doubts,
        float(np.median(np.abs(elevation_m - terrain.elevation_m)[both])),
    )


def grounded(terrain: Terrain, pose: Pose) -> Pose:
    """Put a pose on the ground."""
    row, col = terrain.frame.cell_of(pose.x_m, pose.y_m)
    return Pose(pose.x_m, pose.y_m, float(terrain.elevation_m[row, col]), pose.yaw_rad)


def step(
    terrain: Terrain,
    truth: Pose,
    bias: float,
    filters: tuple[PoseFilter, ...],
    rng: np.random.Generator,
) -> Pose:
    """Drive one leg, back towards the middle where it has gone far."""
    home = math.atan2(MIDDLE[1] - truth.y_m, MIDDLE[0] - truth.x_m)
    far = math.dist((truth.x_m, truth.y_m), MIDDLE) > FAR_M
    turn = wrap_angle(home - truth.yaw_rad) if far else float(rng.uniform(-0.8, 0.8))
    leg = draw_leg(DRIVE, bias, turn, 1.0, rng)
    there = grounded(terrain, leg.pose_after(truth, 1.0))
    odometry = measure(DRIVE, leg, 1.0, there.z_m - truth.z_m, rng)
    for each in filters:
        each.predict(odometry)
    return there


def look(
    scene: Scene,
    stands: Stands,
    submap: Submap,
    way: PoseFilter,
    truth: Pose,
    rng: np.random.Generator,
) -> int:
    """Look ahead and to both sides; return how many looks were not believed."""
    doubts = 0
    for pan_rad in (0.0, 1.6, -1.6):
        seen = expose(scene, SENSOR, truth, pan_rad, -0.35, others={}, rng=rng)
        doubts += len(stands.locate(submap, 0, seen, way))
        offset = way.from_remembered(submap_name(0))
        drawn = submap.anchor.pose.moved(*(float(v) for v in offset.mean))
        cells = bin_look(
            seen,
            drawn,
            submap.frame,
            attitude_sigma_rad=math.radians(SENSOR.attitude_sigma_deg),
            extra_variance=variances(offset.covariance),
        )
        submap.observe(cells)
        stands.drew(submap, 0, drawn, seen, cells, way)
    return doubts


def error_of(way: PoseFilter, truth: Pose) -> Floats:
    """Return (4,) what a filter is wrong by."""
    error = pose_numbers(way.pose) - pose_numbers(truth)
    error[3] = wrap_angle(float(error[3]))
    return error


def nees(way: PoseFilter, truth: Pose) -> float:
    """Return the squared error of (x, y, z, yaw) in units of its covariance."""
    error = error_of(way, truth)
    return float(error @ np.linalg.solve(way.covariance, error))


def main(drives: int, kind: str, say: Callable[[str], None] = print) -> None:
    """Print the table."""
    low, high = (float(chi2.ppf(share, 4 * drives)) / drives for share in (0.025, 0.975))
    say(f"{drives} drives of {LEGS} m on {kind} ground; NEES should lie in {low:.2f} to {high:.2f}")
    done = [drive(seed, kind) for seed in range(1, drives + 1)]
    say(f"{'':<10}{'place, m':>10}{'height, m':>11}{'heading, deg':>14}{'NEES':>8}")
    for name in ("wheels", "matched"):
        errors = np.array([getattr(each, name) for each in done])
        rms = np.sqrt(np.mean(errors**2, axis=0))
        squared = [each.nees if name == "matched" else each.nees_wheels for each in done]
        say(
            f"{name:<10}{math.hypot(rms[0], rms[1]):10.3f}{rms[2]:11.3f}"
            f"{math.degrees(rms[3]):14.2f}{np.mean(squared):8.2f}"
        )
    doubts = sum(each.doubts for each in done)
    error_m = np.median([each.map_error_m for each in done])
    say(f"{doubts} looks were not believed; the map's median error is {error_m:.3f} m")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("drives", nargs="?", type=int, default=20)
    parser.add_argument("--kind", default="plain")
    options = parser.parse_args()
    main(options.drives, options.kind)
