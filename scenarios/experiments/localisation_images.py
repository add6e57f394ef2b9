"""The camera of Fig. 19 with real eyes: it goes over rendered ground and tracks what it sees.

A pair of cameras looks down at rough ground from the side and goes along it, trembling. Its
pictures are rendered; all that comes after is what robots do with them: dense stereo, fiducials
(Eqs. 17, 18), pyramidal Lucas-Kanade, RANSAC, and the motion (Eqs. 10 to 13). Where no motion is
found the one that was meant stands in.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from agents.geometry import Floats, GridFrame
from agents.pose import rotations
from agents.pose.egomotion import Found
from agents.pose.rigidmotion import Motion
from agents.stereo.calibration import Calibration, pinhole
from agents.stereo.odometry import Odometer, Step
from agents.stereo.spots import Frame
from scenarios.experiments.localisation_walk import (
    RUNNING_EVERY,
    TREMBLE_RAD,
    TREMBLE_SHARE,
    WAYS,
    Camera,
    errors_of,
    motions_of,
    running_of,
)
from scenarios.experiments.tables import Row
from sim.ground import Terrain
from sim.relief import make_relief
from sim.settings import TerrainSettings
from sim.stereo.scene import World
from sim.stereo.settings import LensSettings, LightSettings
from sim.stereo.shoot import Aim, Shot, shoot

WIDTH_PX, HEIGHT_PX, FOV_DEG, BASELINE_M = 320, 240, 60.0, 0.08
TILT_RAD = math.radians(-45.0)
CELL_M = 0.02
ROOM_M = (1.5, 4.5)
"""Ground to either side of the way, and across it."""
ALONG_M = 1.0
"""The way's distance from the ground's near border."""
GROUND = TerrainSettings(
    kind="plain",
    roughness_m=0.02,
    swell_m=0.03,
    rock_fraction=0.08,
    rock_max_m=0.15,
    texture_poor=0.0,
)
HEIGHT_OF_MEAN = 0.63
"""Height over the ground, as a share of the mean distance of what is in view (measured)."""
SMOOTHED_M = 0.4
"""The camera's wheels follow the ground in the mean over this."""
NEAREST_SHARE = 0.3
"""Disparities are searched up to that of this share of the mean distance."""


@dataclass(frozen=True)
class Walk:
    """A seed's way at one distance, by so many numbers of fiducials."""

    seed: int
    distance_m: float
    counts: Sequence[int]
    motions: int
    step_m: float


@dataclass(frozen=True)
class Taken:
    """What the walk's camera took."""

    cameras: Sequence[Camera]
    frames: Sequence[Frame]
    mean_m: float
    """Mean distance of the ground in view."""


def measure(walk: Walk, every: int) -> Sequence[Row]:
    """Return rows of a walk for each number of fiducials, one for every so many motions.

    They hold what those of `localisation.measure` hold, and `seen_m`, the true mean distance of
    the ground in view. Images are taken once, and looked at for each number anew.
    """
    rng = np.random.default_rng((walk.seed, round(1000 * walk.distance_m)))
    camera = pinhole(WIDTH_PX, HEIGHT_PX, FOV_DEG, BASELINE_M)
    taken = take(walk, camera, rng)
    rows: list[Row] = []
    for count in walk.counts:
        base: Row = {"seed": walk.seed, "distance_m": walk.distance_m, "fiducials": count}
        steps = list(_steps(walk, taken, camera, count))
        for k in range(every - 1, walk.motions, every):
            told = {key: value for key, value in steps[k].items() if not key.startswith("step ")}
            row: Row = {**base, "kind": "path", "travelled_m": (k + 1) * walk.step_m}
            rows.append({**row, **told, "seen_m": taken.mean_m})
        rows.append({**base, "kind": "step", **_single(steps)})
    return rows


def _single(steps: Sequence[Row]) -> Row:
    """Return what all motions of a walk say together."""
    row: Row = {"lost": sum(bool(step["lost"]) for step in steps)}
    for name in sorted({key for step in steps for key in step if key.startswith("step ")}):
        values = [float(step[name]) for step in steps if name in step]
        row[name] = math.sqrt(float(np.mean(np.square(values))))
    return row


def take(walk: Walk, camera: Calibration, rng: np.random.Generator) -> Taken:
    """Render a walk's pairs, and match them."""
    ground = terrain(walk, rng)
    world, lens, light = World(ground), LensSettings(), LightSettings()
    cameras = path(walk, ground, world.origin_m, rng)
    vergence = rng.normal(0.0, lens.vergence_sigma_px, 2)
    moment = world.with_moving([])
    most = math.ceil(camera.disparity_px(NEAREST_SHARE * walk.distance_m))
    frames: list[Frame] = []
    means: list[float] = []
    for place in cameras:
        right, down, ahead = place.attitude.T
        shot = shoot(
            moment,
            Aim(place.place_m, right, down, ahead),
            camera,
            light=light,
            lens=lens,
            salt=walk.seed,
            rng=rng,
            vergence_px=(float(vergence[0]), float(vergence[1])),
        )
        frames.append(Frame.of(shot.left, shot.right, most))
        means.append(_mean_distance_m(shot, camera))
    return Taken(cameras, frames, float(np.mean(means)))


def _mean_distance_m(shot: Shot, camera: Calibration) -> float:
    row, col = np.nonzero(np.isfinite(shot.depth_m))
    x, y = (col - camera.cx_px) / camera.focal_px, (row - camera.cy_px) / camera.focal_px
    return float((shot.depth_m[row, col] * np.sqrt(1 + x**2 + y**2)).mean())


def terrain(walk: Walk, rng: np.random.Generator) -> Terrain:
    """Return the ground of a walk: stony, gently uneven."""
    long_m = walk.motions * walk.step_m + 2 * ROOM_M[0]
    cols, rows = (math.ceil(side / CELL_M) for side in (long_m, ROOM_M[1]))
    return make_relief(GROUND, GridFrame(0.0, 0.0, CELL_M, rows, cols), rng)


def path(
    walk: Walk, ground: Terrain, origin_m: Floats, rng: np.random.Generator
) -> Sequence[Camera]:
    """Return the places of a camera that goes along +x and looks down and aside, along +y."""
    smooth = np.asarray(ndimage.gaussian_filter(ground.elevation_m, SMOOTHED_M / CELL_M))
    level = Terrain(ground.frame, smooth.astype(np.float32), ground.texture)
    cp, sp = math.cos(TILT_RAD), math.sin(TILT_RAD)
    aside = np.array([[1.0, 0.0, 0.0], [0.0, sp, cp], [0.0, -cp, sp]])
    places: list[Camera] = []
    for k in range(walk.motions + 1):
        x_m = ROOM_M[0] + k * walk.step_m
        z_m = level.height_m(x_m, ALONG_M) + HEIGHT_OF_MEAN * walk.distance_m
        trembling_m = rng.normal(0.0, TREMBLE_SHARE * walk.step_m, 3)
        place_m = np.array([x_m, ALONG_M, z_m]) + trembling_m - origin_m
        turn = rotations.from_vector(rng.normal(0.0, TREMBLE_RAD, 3))
        places.append(Camera(place_m, aside @ turn))
    return places


def _steps(walk: Walk, taken: Taken, camera: Calibration, count: int) -> Sequence[Row]:
    """Return a row for each motion of a walk by a number of fiducials."""
    odometer = Odometer(camera, count, np.random.default_rng((walk.seed, count)))
    odometer.begin(taken.frames[0])
    meant = _meant(walk)
    first = taken.cameras[0]
    chains = dict.fromkeys(WAYS, Motion(first.attitude, first.place_m, np.zeros((6, 6))))
    rows: list[Row] = []
    for k, after in enumerate(taken.cameras[1:], start=1):
        step = odometer.step(taken.frames[k], meant)
        told = _told(step, meant)
        chains = {way: told[way].inverse().then(chains[way]) for way in WAYS}
        tracked = int(np.isfinite(step.after_px[:, 0]).sum())
        row: Row = {"motion": k, "tracked": tracked, "lost": step.motion is None}
        row |= errors_of(chains, after)
        if step.motion is not None and step.tracks is not None and k % RUNNING_EVERY == 0:
            everyone = np.ones(len(step.tracks.before_m), dtype=np.bool_)
            found = Found(step.motion, everyone)
            row |= running_of(step.tracks, found, taken.cameras[k - 1], after)
        rows.append(row)
    return rows


def _told(step: Step, meant: Motion) -> Mapping[str, Motion]:
    """Return the motion by each way from the same fiducials; the one that was meant for want."""
    if step.motion is None or step.tracks is None:
        return dict.fromkeys(WAYS, meant)
    everyone = np.ones(len(step.tracks.before_m), dtype=np.bool_)
    return motions_of(step.tracks, Found(step.motion, everyone))


def _meant(walk: Walk) -> Motion:
    """Return the motion that was meant; it knows nothing of the trembling."""
    place, turn = 2 * (TREMBLE_SHARE * walk.step_m) ** 2, 2 * TREMBLE_RAD**2
    covariance = np.diag([place] * 3 + [turn] * 3)
    return Motion(np.eye(3), np.array([-walk.step_m, 0.0, 0.0]), covariance)
