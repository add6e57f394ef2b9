"""Stereo beside OpenCV's own sample settings, and rendering: `python benchmarks/stereo.py [PAIRS]`.

PAIRS is a folder with motorcycle_left.png, _right.png and _disparity.npz (Middlebury 2014); without
it only rendered pairs are judged. Ratios within one run; seconds are of this process's own core.
"""

import math
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from agents.geometry import Pose
from agents.settings import SensorSettings
from agents.stereo.eyes import Look, calibration_of
from agents.stereo.matching import MatchSettings, match
from agents.stereo.settings import StereoSettings
from agents.stereo.span import largest_disparity
from agents.stereo.subpixel import refined
from sim.settings import TerrainSettings, WorldSettings
from sim.stereo.camera import make_stage, take
from sim.terrain import make_terrain


def sample(left: np.ndarray, right: np.ndarray, block: int, area_px: int) -> np.ndarray:
    """Match by the settings of OpenCV's stereo_match.cpp (block 3) and stereo_match.py (16)."""
    count = ((left.shape[1] // 8) + 15) & -16
    matcher = cv2.StereoSGBM.create(
        minDisparity=0, numDisparities=count, blockSize=block, P1=8 * area_px, P2=32 * area_px,
        disp12MaxDiff=1, preFilterCap=63, uniquenessRatio=10, speckleWindowSize=100,
        speckleRange=32,
    )  # fmt: skip
    found = matcher.compute(left, right).astype(np.float32) / 16
    found[found < 0] = np.nan
    return found


def row(pair: str, way: str, found: np.ndarray, truth: np.ndarray, seconds: float) -> None:
    known = np.isfinite(truth)
    both = known & np.isfinite(found)
    error = np.abs(found - truth)[both]
    good = (error <= 2).sum() / known.sum()
    print(
        f"| {pair} | {way} | {both.sum() / known.sum():.1%} | {(error > 2).mean():.2%} |"
        f" {1 - good:.1%} | {np.median(error):.3f} | {seconds:.2f} |"
    )


def judged(pair: str, left: np.ndarray, right: np.ndarray, truth: np.ndarray) -> None:
    ways = {
        "ours": lambda: (
            match(
                left, right, MatchSettings(max_disparity_px=largest_disparity(left, right))
            ).disparity_px
        ),
        "stereo_match.cpp": lambda: sample(left, right, 3, 9),
        "stereo_match.py": lambda: sample(left, right, 16, 27),
    }
    points(pair, left, right, truth)
    for way, run in ways.items():
        start = time.process_time()
        found = run()
        row(pair, way, found, truth, time.process_time() - start)


STRIDE_PX = StereoSettings().stride_px
POINTS: list[str] = []
"""Lines of the second table: the pixels of which a robot makes points."""


def points(pair: str, left: np.ndarray, right: np.ndarray, truth: np.ndarray) -> None:
    """Tell how right disparity is where points are made, as matched and refined."""
    found = match(left, right, MatchSettings(max_disparity_px=largest_disparity(left, right)))
    start = time.process_time()
    better = refined(left, right, found, STRIDE_PX)
    seconds = time.process_time() - start
    lattice = (slice(STRIDE_PX // 2, None, STRIDE_PX),) * 2
    for way, one in (("matched", found), ("refined", better)):
        error = np.abs(one.disparity_px - truth)[lattice]
        both = np.isfinite(error)
        ratio = error[both] / one.sigma_px[lattice][both]
        POINTS.append(
            f"| {pair} | {way} | {np.median(error[both]):.3f} | {(error[both] > 0.5).mean():.1%}"
            f" | {1.48 * np.median(ratio):.2f} | {seconds if way == 'refined' else 0:.2f} |"
        )


def main() -> int:
    cv2.setNumThreads(1)
    print("| Pair | Way | Density | Bad 2 px of matched | Bad or unmatched | Median px | CPU s |")
    print("|---|---|---|---|---|---|---|")
    if len(sys.argv) > 1:
        folder = Path(sys.argv[1])
        left, right = (
            cv2.imread(str(folder / f"motorcycle_{side}.png"), cv2.IMREAD_GRAYSCALE)
            for side in ("left", "right")
        )
        truth = np.load(folder / "motorcycle_disparity.npz")["disparity"]
        judged("motorcycle", left, right, truth)
    sensor, stereo, spent = SensorSettings(), StereoSettings(), 0.0
    calibration = calibration_of(sensor, stereo)
    for seed in range(1, 4):
        world = WorldSettings(terrain=TerrainSettings(kind="plain"), window_m=(24.0, 24.0))
        terrain = make_terrain(world, 0.1, np.random.default_rng(seed))
        stage = make_stage(terrain, {"a": 1.6, "b": 1.6}, salt=seed)
        pose = Pose(8.0, 12.0, terrain.height_m(8.0, 12.0), 0.0)
        mate = Pose(13.0, 13.0, terrain.height_m(13.0, 13.0), 1.0)
        rng, look = np.random.default_rng(seed), Look(0.0, 0.0, math.radians(-25))
        take(stage, sensor, stereo, pose, look, others={"b": mate}, rng=rng)
        start = time.process_time()
        shot = take(stage, sensor, stereo, pose, look, others={"b": mate}, rng=rng)
        spent += time.process_time() - start
        truth = calibration.focal_px * calibration.baseline_m / shot.depth_m
        judged(f"rendered {seed}", shot.left, shot.right, np.where(truth > 1, truth, np.nan))
    print("\n| Pair | Points | Median px | Off by over 0.5 px | Error over sigma | CPU s |")
    print("|---|---|---|---|---|---|")
    print("\n".join(POINTS))
    print(f"\nRendering: {3 / spent:.1f} pairs of 640 x 480 per second of one core.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
