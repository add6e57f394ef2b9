"""A small stage, real pairs, and OpenCV's own sample, for the tests of stereo."""

import json
import math
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import pytest
from sim_helpers import SHARED

from agents.geometry import GridFrame, Pose
from agents.settings import SensorSettings
from agents.stereo.calibration import Calibration
from agents.stereo.eyes import Look
from agents.stereo.settings import StereoSettings
from sim.ground import Terrain
from sim.stereo.camera import Stage, make_stage, take
from sim.stereo.settings import LensSettings, LightSettings
from sim.stereo.shoot import Shot

PAIRS = SHARED / "data" / "stereo"
SENSOR = SensorSettings(attitude_sigma_deg=0.0)
STEREO = StereoSettings(width_px=320, height_px=240)
MASTS_M = {"alfa": 1.6, "bravo": 1.6}
HERE = Pose(6.0, 10.0, 0.0, 0.0)
AHEAD = Look(0.0, 0.0, math.radians(-20))

needs_motorcycle = pytest.mark.skipif(
    not (PAIRS / "motorcycle.json").is_file(), reason=f"the real pair in {PAIRS} is not here"
)


def flat(side_m: float = 20.0, cell_m: float = 0.2) -> Terrain:
    """Return level ground at height 0, its left (north) half without texture."""
    n = round(side_m / cell_m)
    texture = np.ones((n, n), dtype=np.float32)
    texture[n * 6 // 10 :] = 0.0
    return Terrain(GridFrame(0.0, 0.0, cell_m, n, n), np.zeros((n, n), np.float32), texture)


@cache
def stage(sun: float = 1.0, sky: float = 0.25, longest: float = 20.0) -> Stage:
    light = LightSettings(sun=sun, sky=sky)
    return make_stage(
        flat(), MASTS_M, salt=3, light=light, lens=LensSettings(longest_exposure=longest)
    )


def shot(
    mates: dict[str, Pose] | None = None,
    *,
    look: Look = AHEAD,
    seed: int = 0,
    on: Stage | None = None,
    stereo: StereoSettings = STEREO,
    pose: Pose = HERE,
) -> Shot:
    rng = np.random.default_rng(seed)
    return take(on or stage(), SENSOR, stereo, pose, look, others=mates or {}, rng=rng)


@dataclass(frozen=True)
class RealPair:
    left: np.ndarray
    right: np.ndarray
    truth_px: np.ndarray
    calibration: Calibration


@cache
def motorcycle() -> RealPair:
    left, right = (
        cv2.imread(str(PAIRS / f"motorcycle_{side}.png"), cv2.IMREAD_GRAYSCALE)
        for side in ("left", "right")
    )
    said = json.loads((PAIRS / "motorcycle.json").read_text())
    keys = ("focal_px", "cx_px", "cy_px", "doffs_px", "baseline_m")
    calibration = Calibration(
        width_px=left.shape[1], height_px=left.shape[0], **{key: said[key] for key in keys}
    )
    truth = np.load(PAIRS / "motorcycle_disparity.npz")["disparity"]
    return RealPair(left, right, truth, calibration)


def opencv_sample(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return disparity by the settings of OpenCV's sample program stereo_match.cpp (SGBM)."""
    area, count = 3 * 3, ((left.shape[1] // 8) + 15) & -16
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=count,
        blockSize=3,
        P1=8 * area,
        P2=32 * area,
        disp12MaxDiff=1,
        preFilterCap=63,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=32,
        mode=cv2.StereoSGBM_MODE_SGBM,
    )
    found = matcher.compute(left, right).astype(np.float32) / 16
    found[found < 0] = np.nan
    return found


def scored(found_px: np.ndarray, truth_px: np.ndarray) -> tuple[float, float]:
    """Return density, and the share of matched pixels more than 2 px off, where truth is known."""
    known = np.isfinite(truth_px)
    both = known & np.isfinite(found_px)
    return both.sum() / known.sum(), float((np.abs(found_px - truth_px)[both] > 2).mean())
