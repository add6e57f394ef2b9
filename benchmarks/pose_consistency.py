"""Are robots as wrong as they say? NEES of poses over many short drives; errors of maps in sigmas.

    python benchmarks/pose_consistency.py [RUNS]

Drives are the simulator's (slip, drift, odometry), sightings too, on flat ground: 40 legs of about
1 m at random, an object in sight at the end, or now and then all along. NEES is the squared error
in units of the covariance; its mean over N runs is 4 where the covariance is right, and lies in the
band in 95 % of the cases.
"""

import math
import sys
from collections.abc import Callable

import numpy as np
from scipy.stats import chi2

from agents.fusion import pose_numbers
from agents.geometry import Floats, GridFrame, Pose, wrap_angle
from agents.pose.posefilter import PoseFilter, Remembered
from agents.settings import DriveSettings, SensorSettings
from sim.drift import draw_leg, measure
from sim.ground import Terrain
from sim.scene import Scene
from sim.sighting import View, sightings

LEGS = 40
MARK = Pose(20.0, 20.0, 0.0, 0.5)
START = Pose(18.0, 18.0, 0.0, 0.0)
SENSOR, DRIVE = SensorSettings(), DriveSettings()
MATE_SIGMAS = (0.02, 0.02, 0.02, 0.004)
MATE = Remembered("mate", 0)
HALF = Remembered("submap", 1)


def flat() -> Scene:
    """Return flat ground, 40 m square."""
    frame = GridFrame(0.0, 0.0, 0.5, 80, 80)
    level = np.zeros(frame.shape, dtype=np.float32)
    return Scene(Terrain(frame, level, np.ones_like(level)))


def drive(filt: PoseFilter, truth: Pose, bias: float, rng: np.random.Generator) -> Pose:
    """Drive one leg, back towards the middle where it has gone far."""
    home = math.atan2(MARK.y_m - truth.y_m, MARK.x_m - truth.x_m)
    far = truth.distance_m(MARK) > 7.0
    turn = wrap_angle(home - truth.yaw_rad) if far else float(rng.uniform(-0.8, 0.8))
    leg = draw_leg(DRIVE, bias, turn, 1.0, rng)
    filt.predict(measure(DRIVE, leg, 1.0, 0.0, rng))
    return leg.pose_after(truth, 1.0)


def look(
    scene: Scene, filt: PoseFilter, truth: Pose, kind: str, said: Pose, rng: np.random.Generator
) -> None:
    """Look at the mark, and take in what is seen of it."""
    pan = wrap_angle(math.atan2(MARK.y_m - truth.y_m, MARK.x_m - truth.x_m) - truth.yaw_rad)
    view = View(SENSOR, truth, pan, -0.25, {"mark": MARK}, 0.4)
    for seen in sightings(scene, view, rng):
        if kind == "landmark":
            filt.saw(MARK, np.zeros((4, 4)), seen)
        elif kind == "standing mate":
            if not filt.holds(MATE):
                filt.introduce(MATE, said, np.diag(MATE_SIGMAS) ** 2)
            filt.saw_again(MATE, seen)


def nees(mean: Floats, covariance: Floats, truth: Pose) -> float:
    """Return the squared error of (x, y, z, yaw) in units of its covariance."""
    error = mean - pose_numbers(truth)
    error[3] = wrap_angle(float(error[3]))
    return float(error @ np.linalg.solve(covariance, error))


def run(scene: Scene, kind: str, seed: int) -> tuple[float, float, float]:
    """Return NEES of the pose at the end and of a submap's anchor half way, and the error in m."""
    rng = np.random.default_rng(seed)
    bias = float(rng.normal(0.0, DRIVE.slip_bias_sigma))
    said = Pose(*(pose_numbers(MARK) + rng.normal(size=4) * MATE_SIGMAS))
    filt, truth, half = PoseFilter(START, np.diag([1e-6, 1e-6, 1e-6, 1e-8])), START, START
    filt.doubt_slip(DRIVE.slip_bias_sigma)
    for number in range(LEGS):
        if number == LEGS // 2:
            filt.remember(HALF)
            half = truth
        truth = drive(filt, truth, bias, rng)
        if number % 5 == 4:
            look(scene, filt, truth, kind, said, rng)
    anchor = filt.remembered(HALF)
    return (
        nees(pose_numbers(filt.pose), filt.covariance, truth),
        nees(anchor.mean, anchor.covariance, half),
        filt.pose.distance_m(truth),
    )


def main(runs: int, say: Callable[[str], None] = print) -> None:
    """Print the table."""
    scene = flat()
    low, high = (float(chi2.ppf(share, 4 * runs)) / runs for share in (0.025, 0.975))
    say(f"{runs} drives of {LEGS} m; mean NEES should lie in {low:.2f} to {high:.2f}")
    say(f"{'seen':<20}{'pose':>8}{'anchor':>8}{'error, m':>10}")
    for kind in ("nothing", "landmark", "standing mate"):
        rows = np.array([run(scene, kind, seed) for seed in range(runs)])
        pose, anchor = rows[:, :2].mean(axis=0)
        error = math.sqrt(float(np.mean(rows[:, 2] ** 2)))
        say(f"{kind:<20}{pose:8.2f}{anchor:8.2f}{error:10.3f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50)
