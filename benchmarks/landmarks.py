"""How well a landmark of known shape is found in rendered pairs, and how sure that claims to be.

A robot stands on made-up ground, the landmark somewhere before it, the sun anywhere; its arm is not
quite level and its cameras not quite as calibrated, drawn anew for each view. Every fourth view has
no landmark: what is found there is none.

    python benchmarks/landmarks.py [--views 32] [--model lander|solar-panel|FILE] [--first 1]
"""

import argparse
import math
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import stats

from agents.geometry import Floats, Pose, wrap_angle
from agents.settings import SensorSettings
from agents.stereo.eyes import Look, see
from agents.stereo.finding import Finder
from agents.stereo.settings import StereoSettings
from agents.stereo.shape import shape_of
from sim.ground import Footing
from sim.settings import TerrainSettings, WorldSettings
from sim.stereo.camera import make_stage, take
from sim.stereo.settings import LensSettings, LightSettings
from sim.terrain import make_terrain

SIDE_M, CELL_M = 24.0, 0.1
NEAREST_M, FARTHEST_M = 3.5, 9.0
ASIDE_RAD = math.radians(25.0)
LOOK = Look(0.0, 0.0, math.radians(-15.0))
NAME = "post"
ABSENT_EVERY = 4


@dataclass(frozen=True)
class View:
    """What became of one view."""

    seed: int
    away_m: float
    there: bool
    error: Floats | None
    """(4,) of (x, y, z, yaw) in the levelled robot frame; None: not found."""
    covariance: Floats | None
    """(4, 4) that it claims."""
    told: str
    """What the eyes say where they did not find it."""

    @property
    def nees(self) -> float:
        """Squared error in units of the covariance; 4 on average if that is right."""
        assert self.error is not None
        assert self.covariance is not None
        return float(self.error @ np.linalg.solve(self.covariance, self.error))


def view(seed: int, finder: Finder, model: str) -> View:
    """Return what becomes of one view."""
    rng = np.random.default_rng(seed)
    world = WorldSettings(terrain=TerrainSettings(kind="plain"), window_m=(SIDE_M, SIDE_M))
    terrain = make_terrain(world, CELL_M, rng)
    light = LightSettings(
        sun_azimuth_deg=float(rng.uniform(0, 360)), sun_elevation_deg=float(rng.uniform(20, 65))
    )
    stage = make_stage(terrain, {"a": 1.6, NAME: 0.0}, salt=seed, light=light, meshes={NAME: model})
    away_m, aside = rng.uniform(NEAREST_M, FARTHEST_M), rng.uniform(-ASIDE_RAD, ASIDE_RAD)
    facing = rng.uniform(-math.pi, math.pi)
    robot, post = Footing(terrain, 0.8, 0.8), Footing(terrain, 1.0, 1.0)
    x_m, y_m = SIDE_M / 2, SIDE_M / 2
    pose = Pose(x_m, y_m, robot.ground_m(x_m, y_m), float(rng.uniform(-math.pi, math.pi)))
    x_m += away_m * math.cos(pose.yaw_rad + aside)
    y_m += away_m * math.sin(pose.yaw_rad + aside)
    mark = Pose(x_m, y_m, post.ground_m(x_m, y_m), wrap_angle(pose.yaw_rad + facing))
    there = seed % ABSENT_EVERY != 0
    sensor, stereo = SensorSettings(), StereoSettings()
    u_px, v_px = rng.normal(0.0, LensSettings().vergence_sigma_px, 2)
    shot = take(
        stage, sensor, stereo, pose, LOOK, others={NAME: mark} if there else {}, rng=rng,
        vergence_px=(float(u_px), float(v_px)),
    )  # fmt: skip
    seen = see(
        shot.left, shot.right, LOOK, sensor=sensor, stereo=stereo, mates={}, shapes={NAME: finder}
    ).exposure
    if not seen.sightings:
        told = "; ".join(reason for reason in seen.ill if reason.startswith(NAME))
        return View(seed, float(away_m), there, None, None, told or "nothing stands out")
    (found,) = seen.sightings
    true_m = Pose(0.0, 0.0, 0.0, -pose.yaw_rad).team_from_robot(
        np.array([[mark.x_m - pose.x_m, mark.y_m - pose.y_m, mark.z_m - pose.z_m]])
    )[0]
    turned = wrap_angle(found.bearing_rad - (mark.yaw_rad - pose.yaw_rad))
    error = np.array([*(np.array(found.offset_m) - true_m), turned])
    return View(seed, float(away_m), there, error, found.covariance, "")


def told(views: list[View]) -> None:
    """Print the views' errors, and whether they were as large as claimed."""
    there = [v for v in views if v.there]
    found = [v for v in there if v.error is not None]
    false = [v for v in views if not v.there and v.error is not None]
    print(f"\nfound in {len(found)} of {len(there)} views with it, ", end="")
    print(f"in {len(false)} of {len(views) - len(there)} without")
    if not found:
        return
    errors = np.array([v.error for v in found])
    place_mm = 1000 * np.linalg.norm(errors[:, :3], axis=1)
    yaw_deg = np.degrees(np.abs(errors[:, 3]))
    print(f"place: median {np.median(place_mm):.0f} mm, largest {place_mm.max():.0f} mm;", end=" ")
    print(f"heading: median {np.median(yaw_deg):.2f}, largest {yaw_deg.max():.2f} degrees")
    nees = np.array([v.nees for v in found])
    low, high = (stats.chi2.ppf(q, 4 * len(nees)) / len(nees) for q in (0.025, 0.975))
    print(f"NEES {nees.mean():.2f} (4 is right, {low:.2f} to {high:.2f} in 95 % of cases);", end="")
    print(f" the median {np.median(nees):.2f} (3.36 is right), the largest {nees.max():.1f}")
    sigma = np.sqrt([np.diag(v.covariance) for v in found if v.covariance is not None])
    ratios = np.sqrt(np.mean((errors / sigma) ** 2, axis=0))
    each = zip(("x", "y", "z", "heading"), ratios, strict=True)
    print("r.m.s. error in sigmas:", ", ".join(f"{name} {ratio:.2f}" for name, ratio in each))


def main() -> int:
    """Look at the landmark as often as asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, default=32)
    parser.add_argument("--model", default="lander")
    parser.add_argument("--first", type=int, default=1, help="seed of the first view")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    finder = Finder(shape_of(args.model))
    views: list[View] = []
    print("seed  away m   x mm   y mm   z mm  heading deg    NEES")
    for seed in range(args.first, args.first + args.views):
        one = view(seed, finder, args.model)
        views.append(one)
        if one.error is None:
            what = "not found" if one.there else "none"
            print(f"{seed:4d} {one.away_m:7.1f}  {what}: {one.told}", flush=True)
        else:
            x, y, z, yaw = one.error
            what = "" if one.there else "  IS NOT THERE"
            print(
                f"{seed:4d} {one.away_m:7.1f} {1000 * x:6.0f} {1000 * y:6.0f} {1000 * z:6.0f}"
                f" {math.degrees(yaw):12.2f} {one.nees:7.1f}{what}",
                flush=True,
            )
    told(views)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
