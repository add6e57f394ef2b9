"""Pairs of maps that are to be joined, by the simulator's worlds and cameras: the truth is known.

Each case has the map of a team, as it is once it was sent whole, and that of a late-comer in a
frame of its own. Both looked all round from a few places; between those the late-comer's odometry
erred a little.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from floor_plans import floor_plan

from agents.geometry import Floats, GridFrame, Pose, wrap_angle
from agents.joining.searching import turning
from agents.layers import Anchor
from agents.maps.elevation import ElevationKind
from agents.maps.elevationlook import bin_look
from agents.maps.kind import EVERYWHERE
from agents.maps.planar import PlanarKind
from agents.maps.planarlook import look_odds
from agents.settings import SensorSettings
from sim.camera import expose
from sim.ground import Footing, Terrain
from sim.planar_world import PlanarWorld, load_map, look, made_up, reachable, start_of
from sim.scene import Scene
from sim.settings import TerrainSettings, WorldSettings
from sim.terrain import make_terrain

EXACT = (1e-6, 1e-6, 1e-6, 1e-8)
NO_MORE = (0.0, 0.0, 0.0, 0.0)
TILE = 32
STRAY_M, STRAY_RAD = 0.02, 0.002
"""By how much a late-comer's odometry is off from one place to the next."""
GROUND_SENSOR = SensorSettings(columns=96, rows=72, range_m=10.0)
FLOOR_SENSOR = SensorSettings(fov_deg=90.0, range_m=15.0, near_m=0.0)
FOOTPRINT_M = 0.3
FILES = {
    "marsyard": ("marsyard_erc2021_0p09m", None),
    "ames yard": ("ames_yard_0p5m", None),
    "gale crater": ("mars_gale_hirise_1m", 0.25),
    "hinwil": ("hinwil_2m", 0.25),
}
"""Real ground of the shared data; the last two at a quarter and an eighth of their scale."""
Rng = np.random.Generator


@dataclass(frozen=True)
class Case:
    """A team's map and a late-comer's, on the team's grid and on one of the late-comer's own."""

    frame: GridFrame
    team: Any
    own: Any
    truth: Pose
    """Of the origin of the late-comer's frame."""
    overlap: float
    """Share of the late-comer's cells that the team knows."""
    overlap_m2: float


def ground(name: str, seed: int, shared: Path) -> Terrain:
    """Return some ground: made up, flat, rippled, or a real one of the shared data."""
    rng = np.random.default_rng((seed, 1))
    if name in ("flat", "ripples"):
        frame = GridFrame(0.0, 0.0, 0.2, 220, 220)
        x, y = np.meshgrid(*[(np.arange(220) + 0.5) * 0.2] * 2)
        waves = 0.15 * np.sin(2 * math.pi * x / 3.0) + 0.15 * np.sin(2 * math.pi * y / 4.0)
        level = waves if name == "ripples" else 0.0 * waves
        return Terrain(frame, level.astype(np.float32), np.ones(frame.shape, np.float32))
    if name in FILES:
        file, cell_m = FILES[name]
        path = str(shared / "data" / "dem" / f"{file}.npz")
        settings = TerrainSettings(file=path, cell_m=cell_m)
    else:
        settings = TerrainSettings(kind=name)
    world = WorldSettings(terrain=settings, window_m=(44.0, 44.0))
    return make_terrain(world, 0.2, rng)


def floor(name: str, seed: int, shared: Path) -> PlanarWorld:
    """Return a floor: made up, repetitive, empty, or a real building's of the shared data."""
    rng = np.random.default_rng((seed, 1))
    match name:
        case "hall":
            return made_up(rng, side_m=80.0)
        case "building":
            return floor_plan(rng)
        case "offices" | "empty":
            return _plain_floor(name)
    path = shared / "data" / "occupancy" / f"{name}.yaml"
    return load_map(path, footprint_m=FOOTPRINT_M)


def _plain_floor(name: str) -> PlanarWorld:
    """Return equal rooms on both sides of a corridor, or a hall with nothing in it."""
    solid = np.zeros((60, 250) if name == "offices" else (250, 250), dtype=np.bool_)
    solid[[0, -1]] = solid[:, [0, -1]] = True
    if name == "offices":
        solid[[26, 33]] = True
        for room in range(0, 250, 10):
            solid[:26, room] = solid[34:, room] = True
            solid[[26, 33], room + 4 : room + 7] = False
    frame = GridFrame(0.0, 0.0, 0.4, *solid.shape)
    return PlanarWorld(frame, solid, start_of(solid, frame, FOOTPRINT_M))


def _stray(truth: Pose, stand: Pose, rng: Rng, *, first: bool) -> Pose:
    """Return where a late-comer believes a place to be, in its own frame."""
    off = np.zeros(4) if first else rng.normal(size=4)
    x, y = turning(-truth.yaw_rad) @ (stand.x_m - truth.x_m, stand.y_m - truth.y_m)
    return Pose(
        float(x + STRAY_M * off[0]), float(y + STRAY_M * off[1]),
        stand.z_m - truth.z_m + 0.5 * STRAY_M * float(off[2]),
        wrap_angle(stand.yaw_rad - truth.yaw_rad + STRAY_RAD * float(off[3])),
    )  # fmt: skip


def _own_frame(frame: GridFrame, start: Pose) -> Pose:
    """Return the true pose of the frame of a robot that takes its start for the grid's middle."""
    west, east, south, north = frame.extent_m
    x, y = turning(start.yaw_rad) @ ((west + east) / 2, (south + north) / 2)
    return Pose(start.x_m - float(x), start.y_m - float(y), start.z_m, start.yaw_rad)


def _as_heard(kind: Any, submap: Any, frame: GridFrame) -> Any:
    """Return a submap as it is once it was sent whole, tile by tile."""
    grid, heard = kind.tiles(frame, TILE), kind.blank(frame.shape)
    for tile in grid.tiles:
        window = grid.window(tile)
        if kind.drawn(submap, window).known.any():
            told = kind.decode(kind.encode(submap, window).data, grid.shape(tile))
            kind.paste(heard, window, told)
    return heard


def _overlap(own: Any, team: Any, frame: GridFrame, truth: Pose) -> tuple[float, float]:
    """Return which share of the late-comer's cells the team knows, and how many m2."""
    rows, cols = np.nonzero(own.known)
    x_m, y_m = frame.x_m + (cols + 0.5) * frame.cell_m, frame.y_m + (rows + 0.5) * frame.cell_m
    there = np.column_stack((x_m, y_m)) @ turning(truth.yaw_rad).T + (truth.x_m, truth.y_m)
    cells = frame.cells_of(there)
    inside = cells[((cells >= 0) & (cells < frame.shape)).all(axis=1)]
    both = int(team.known[inside[:, 0], inside[:, 1]].sum())
    return both / max(len(rows), 1), both * frame.cell_m**2


def _places(open_m: Floats, rng: Rng, apart_m: float, reach_m: float) -> Iterator[list[Floats]]:
    """Return where the team looks from, then where the late-comer does, so far apart."""
    first = open_m[rng.integers(len(open_m))]
    away = np.abs(np.hypot(*(open_m - first).T) - apart_m)
    other = open_m[rng.choice(np.flatnonzero(away <= max(1.0, float(away.min()) + 0.5)))]
    for middle, count in ((first, int(rng.integers(3, 8))), (other, int(rng.integers(1, 6)))):
        near = open_m[np.hypot(*(open_m - middle).T) < reach_m]
        yield [middle, *(near[rng.integers(len(near))] for _ in range(count - 1))]


def ground_case(terrain: Terrain, seed: int, apart_m: float) -> Case:
    """Return a case on some ground, with so much between the middles of both."""
    rng, kind, scene = np.random.default_rng((seed, 2)), ElevationKind(0.05, 1.0), Scene(terrain)
    footing = Footing(terrain, 0.8, 0.2)
    open_m = np.argwhere(footing.standable(25.0))[::7, ::-1] * terrain.frame.cell_m
    open_m = open_m + (terrain.frame.x_m, terrain.frame.y_m) + 0.5 * terrain.frame.cell_m
    sides = list(_places(open_m, rng, apart_m, 4.0))

    def drawn(places: list[Floats], truth: Pose | None, yaw_rad: float) -> Any:
        submap = kind.submap(terrain.frame, Anchor.at(Pose(0.0, 0.0, 0.0, 0.0), EXACT))
        for number, (x, y) in enumerate(places):
            stand = Pose(float(x), float(y), footing.ground_m(float(x), float(y)), yaw_rad)
            at = stand if truth is None else _stray(truth, stand, rng, first=number == 0)
            for pan in np.linspace(0.0, 2 * math.pi, 6, endpoint=False):
                shot = expose(
                    scene, GROUND_SENSOR, stand, float(pan), -0.44, others={}, rng=rng
                )  # fmt: skip
                cells = bin_look(
                    shot, at, terrain.frame, extra_variance=NO_MORE,
                    attitude_sigma_rad=math.radians(GROUND_SENSOR.attitude_sigma_deg),
                )  # fmt: skip
                submap.observe(cells)
        return submap

    team = _as_heard(kind, drawn(sides[0], None, 0.0), terrain.frame)
    x, y = (float(v) for v in sides[1][0])
    start = Pose(x, y, footing.ground_m(x, y), float(rng.uniform(-math.pi, math.pi)))
    truth = _own_frame(terrain.frame, start)
    own = kind.drawn(drawn(sides[1], truth, start.yaw_rad), EVERYWHERE)
    return Case(terrain.frame, team, own, truth, *_overlap(own, team, terrain.frame, truth))


def floor_case(world: PlanarWorld, seed: int, apart_m: float) -> Case:
    """Return a case on a floor, with so much between the middles of both."""
    rng, kind, frame = np.random.default_rng((seed, 2)), PlanarKind(), world.frame
    cells = np.argwhere(reachable(world, FOOTPRINT_M))[:, ::-1]
    open_m = (cells + 0.5) * frame.cell_m + (frame.x_m, frame.y_m)
    sides = list(_places(open_m, rng, apart_m, 8.0))

    def drawn(places: list[Floats], truth: Pose | None, yaw_rad: float) -> Any:
        submap = kind.submap(frame, Anchor.at(Pose(0.0, 0.0, 0.0, 0.0), EXACT))
        for number, (x, y) in enumerate(places):
            stand = Pose(float(x), float(y), 0.0, yaw_rad)
            at = stand if truth is None else _stray(truth, stand, rng, first=number == 0)
            for pan in np.arange(4) * math.pi / 2:
                eye, there = (
                    replace(p, yaw_rad=wrap_angle(p.yaw_rad + float(pan))) for p in (stand, at)
                )
                ranges_m, _ = look(world, eye, FLOOR_SENSOR, rng)
                submap.observe(
                    look_odds(ranges_m, there, frame, FLOOR_SENSOR, extra_variance=NO_MORE)
                )
        return submap

    team = _as_heard(kind, drawn(sides[0], None, 0.3), frame)
    off = rng.uniform(-0.4, 0.4, 2) * frame.cell_m
    x, y = (float(v) for v in sides[1][0] + off)
    start = Pose(x, y, 0.0, float(rng.uniform(-math.pi, math.pi)))
    truth = replace(_own_frame(frame, start), z_m=0.0)
    own = kind.drawn(drawn([np.array((x, y)), *sides[1][1:]], truth, start.yaw_rad), EVERYWHERE)
    return Case(frame, team, own, truth, *_overlap(own, team, frame, truth))
