"""Whether cells are measured as often as predicted, and with which law of visibility.

    python benchmarks/visibility_calibration.py [--looks N] [--seed N] [--figure FILE.png]

A robot explores with the simulated camera, on made-up ground and on the elevation files that are
named (--file FILE, and --scale for metres per cell other than theirs). Before each look it predicts
for every cell in the field of view the chance of being measured (Eq. 5 by either law, times the
chance that a ray falls on the cell); after it the cell was measured or not. Brier score: mean
squared difference; ECE: mean difference between chance and share in 20 bins of chance.
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from agents.geometry import Bools, Floats, Pose
from agents.ground import surface
from agents.layers import Anchor
from agents.maps.elevation import Submap
from agents.maps.elevationlook import bin_look
from agents.planning import looks, strategies
from agents.planning.information import Interest
from agents.planning.scene import Scene, View
from agents.settings import DriveSettings, PlannerSettings, SensorSettings
from agents.sight import gaze, visibility
from agents.sight.gaze import Ground, Lens
from sim.camera import Scene as Stage
from sim.camera import expose
from sim.terrain import Terrain, TerrainSettings, WorldSettings, make_terrain

SENSOR = SensorSettings()
BINS = 20
FIRST_PANS = 6
LAWS: tuple[visibility.Law, ...] = ("product", "crest")


@dataclass(frozen=True)
class Sample:
    """Cells of the fields of view of one robot's looks, all (N,)."""

    chance: dict[visibility.Law, Floats]
    measured: Bools
    known: Bools


def chances(scene: Scene, pose: Pose, heading: float, tilt: float) -> Iterator[Floats]:
    """Yield the chance (H, W) of each cell of being measured, by each law; NaN out of view."""
    view, lens = scene.view, Lens.of(SENSOR)
    frame = view.frame
    north, east = surface.gradient(surface.smoothed(scene.ground_m), frame.cell_m)
    ground = Ground(scene.ground_m, north, east, scene.worth, frame.cell_m, frame.cell_m)
    eye = (pose.x_m, pose.y_m, pose.z_m + SENSOR.height_m)
    for law in LAWS:
        patch = visibility.predict(
            scene.ground_m,
            scene.sigma_m,
            frame,
            eye,
            range_m=SENSOR.range_m,
            near_m=SENSOR.near_m,
            law=law,
        )
        chance = gaze.measured_chance(patch, ground, lens).astype(np.float64)
        inside = gaze.in_view(patch, heading, tilt, lens)
        inside &= (patch.range_m <= SENSOR.range_m) & (patch.range_m >= SENSOR.near_m)
        whole = np.full(frame.shape, np.nan)
        h, w = chance.shape
        cut = (slice(patch.row0, patch.row0 + h), slice(patch.col0, patch.col0 + w))
        whole[cut] = np.where(inside, chance, np.nan)
        yield whole


def explore(terrain: Terrain, start: Pose, count: int, rng: np.random.Generator) -> Sample:
    """Return what one robot predicted and measured in its looks."""
    frame, stage, pose = terrain.frame, Stage(terrain), start
    submap = Submap(frame, Anchor.at(pose, (1e-6, 1e-6, 1e-6, 1e-8)))
    planner = PlannerSettings()
    method, interest = strategies.strategy("information-interest"), Interest(frame.shape, 1.0)
    predicted: dict[visibility.Law, list[Floats]] = {law: [] for law in LAWS}
    measured: list[Bools] = []
    known: list[Bools] = []
    for n in range(count):
        elevation, variance = submap.estimate((slice(None), slice(None)))
        view = View(
            frame=frame,
            elevation_m=elevation,
            sigma_m=np.sqrt(variance),
            looks=submap.looks.astype(np.int64),
            interest=interest.share,
            pose=pose,
            pose_sigma_m=0.02,
            others=[],
            sensor=SENSOR,
            drive=DriveSettings(),
            planner=planner,
            claims=[],
        )
        heading, tilt = 2 * math.pi * n / FIRST_PANS, math.radians(-25.0)
        if n >= FIRST_PANS:
            plan = method.choose(view, rng)
            if plan is None:
                break
            x_m, y_m = plan.target_m
            pose = Pose(x_m, y_m, terrain.height_m(x_m, y_m), 0.0)
            heading, tilt = plan.heading_rad, plan.tilt_rad
        view = replace(view, pose=pose)
        by_law = dict(zip(LAWS, chances(Scene(view), pose, heading, tilt), strict=True))
        exposure = expose(stage, SENSOR, pose, heading, tilt, others={}, rng=rng)
        cells = bin_look(
            exposure,
            pose,
            frame,
            attitude_sigma_rad=math.radians(SENSOR.attitude_sigma_deg),
            extra_variance=(0.0, 0.0, 0.0, 0.0),
        )
        got = np.zeros(frame.shape, dtype=np.bool_)
        got[cells.rows, cells.cols] = True
        seen = np.isfinite(by_law["crest"])
        for law in LAWS:
            predicted[law].append(by_law[law][seen])
        measured.append(got[seen])
        known.append(~np.isnan(elevation[seen]))
        interest.update(looks.expected_visibility(view, pose, heading, tilt), got)
        submap.observe(cells)
    chance: dict[visibility.Law, Floats] = {law: np.concatenate(predicted[law]) for law in LAWS}
    return Sample(chance, np.concatenate(measured), np.concatenate(known))


def calm_start(terrain: Terrain) -> Pose:
    """Return the calmest place in the middle of the ground."""
    frame, reach = terrain.frame, 6
    best: tuple[float, int, int] | None = None
    for row in range(frame.rows // 3, frame.rows * 3 // 4, 4):
        for col in range(frame.cols // 3, frame.cols * 2 // 3, 4):
            around = terrain.elevation_m[
                row - reach : row + reach + 1, col - reach : col + reach + 1
            ]
            spread = float(around.std())
            if math.isfinite(spread) and (best is None or spread < best[0]):
                best = (spread, row, col)
    assert best is not None
    x_m, y_m = frame.centre_of(best[1], best[2])
    return Pose(x_m, y_m, terrain.height_m(x_m, y_m), 0.0)


def worlds(files: list[str], scale_m: float | None) -> Iterator[tuple[str, WorldSettings]]:
    made = {
        "cliff": TerrainSettings(kind="cliff"),
        "plain": TerrainSettings(kind="plain"),
        "rocky plain": TerrainSettings(kind="plain", rock_fraction=0.15, roughness_m=0.3),
    }
    made |= {Path(f).stem: TerrainSettings(kind="file", file=f, cell_m=scale_m) for f in files}
    for name, terrain in made.items():
        yield name, WorldSettings(window_m=(28.0, 24.0), terrain=terrain)


def binned(chance: Floats, measured: Bools) -> tuple[Floats, Floats, Floats]:
    """Return mean chance, share measured and count of each bin that is not empty."""
    which = np.minimum((chance * BINS).astype(np.int64), BINS - 1)
    count = np.bincount(which, minlength=BINS)
    sums = np.bincount(which, chance, BINS), np.bincount(which, measured, BINS)
    kept = count > 0
    return sums[0][kept] / count[kept], sums[1][kept] / count[kept], count[kept].astype(np.float64)


def row(what: str, law: visibility.Law, chance: Floats, measured: Bools) -> str:
    foretold, share, count = binned(chance, measured)
    ece = float((np.abs(foretold - share) * count).sum() / count.sum())
    brier = float(((chance - measured) ** 2).mean())
    return (
        f"| {what} | {law} | {len(chance)} | {chance.mean():.3f} | {measured.mean():.3f} "
        f"| {brier:.4f} | {ece:.4f} |"
    )


def draw(samples: list[Sample], path: str) -> None:
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    for axes, known in zip(figure.subplots(1, 2, sharey=True), (True, False), strict=True):
        axes.plot((0, 1), (0, 1), color="0.6", lw=1)
        for law, colour in zip(LAWS, ("#b3552b", "#22638c"), strict=True):
            chance = np.concatenate([s.chance[law][s.known == known] for s in samples])
            measured = np.concatenate([s.measured[s.known == known] for s in samples])
            foretold, share, count = binned(chance, measured)
            name = "Eq. 5, product" if law == "product" else "Eq. 5, worst obstruction (ours)"
            axes.plot(foretold, share, color=colour, lw=1.6, label=name)
            axes.scatter(foretold, share, s=300 * count / count.sum() + 4, color=colour)
        axes.set_title("cells measured before" if known else "cells estimated only")
        axes.set_xlabel("predicted chance of being measured in a look")
        axes.set_aspect("equal")
        axes.grid(alpha=0.25)
    figure.axes[0].set_ylabel("share of cells measured")
    figure.axes[0].legend(loc="upper left")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--looks", type=int, default=24)
    parser.add_argument("--seed", type=int, default=101)
    parser.add_argument("--file", action="append", default=[], help="an elevation file")
    parser.add_argument("--scale", type=float, help="metres per cell of the files")
    parser.add_argument("--figure", help="where to write the calibration plot (.png)")
    args = parser.parse_args()
    samples: list[Sample] = []
    print("| ground | law | cells | predicted | measured | Brier | ECE |")
    print("|---|---|---:|---:|---:|---:|---:|")
    for n, (name, world) in enumerate(worlds(args.file, args.scale)):
        rng = np.random.default_rng(args.seed + n)
        terrain = make_terrain(world, 0.1, rng)
        samples.append(explore(terrain, calm_start(terrain), args.looks, rng))
        for law in LAWS:
            print(row(name, law, samples[-1].chance[law], samples[-1].measured), flush=True)
    for known, what in (
        (True, "all, measured before"),
        (False, "all, estimated only"),
        (None, "all"),
    ):
        for law in LAWS:
            kept = [
                np.ones(len(s.known), bool) if known is None else s.known == known for s in samples
            ]
            chance = np.concatenate([s.chance[law][k] for s, k in zip(samples, kept, strict=True)])
            measured = np.concatenate([s.measured[k] for s, k in zip(samples, kept, strict=True)])
            print(row(what, law, chance, measured))
    if args.figure:
        draw(samples, args.figure)


if __name__ == "__main__":
    main()
