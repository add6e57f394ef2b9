"""Caves made from a seed: chambers and tunnels in rock, with overhangs, and an open entrance.

A chamber is half an ellipsoid on a level floor, its wall and roof rough; tunnels lead from each to
the nearest one made before, down or up no steeper than a robot climbs. In chambers stand rocks with
a stem and a wider cap, under which a robot can look and go, and stones hang from the roof. At the
west a forecourt lies open to the sky.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import zoom

from agents.geometry import Bools, Floats
from agents.voxel.frame import VoxelFrame
from agents.voxel.ground import Build
from sim.errors import WorldError
from sim.voxel.settings import CaveSettings
from sim.voxel.world import VoxelWorld

GRADE = 0.25
"""Steepest tunnel: height by length."""
LOW_M, HIGH_M = 0.8, 3.8
"""Floors lie at least so high over the lowest layer, and so far below the highest."""
TRIES = 30
LEAST_WINDOW_M = (10.0, 9.0)
NOISE_M = 2.0
"""Size of the bumps of walls and roofs."""
COURT_M = (3.4, 3.0)
"""Depth of the forecourt, and half of its width."""


@dataclass(frozen=True)
class Chamber:
    """One chamber: middle of its floor and half axes, metres."""

    x_m: float
    y_m: float
    floor_m: float
    half_m: tuple[float, float, float]
    """Along x, y and up."""


class _Rock:
    """Rock that is being carved; heights and places of cells are of their middles, metres."""

    def __init__(self, frame: VoxelFrame, roughness: float, rng: np.random.Generator) -> None:
        self.frame = frame
        self.solid: Bools = np.ones(frame.voxels, dtype=np.bool_)
        layers, rows, cols = frame.voxels
        cell = frame.cell_m
        self.z = (np.arange(layers) + 0.5)[:, None, None] * cell
        self.y = (np.arange(rows) + 0.5)[None, :, None] * cell
        self.x = (np.arange(cols) + 0.5)[None, None, :] * cell
        self.rough = roughness * _noise(frame, rng)

    def carve(self, inside: Bools) -> None:
        """Take rock away, but for the outermost cells."""
        self.solid[1:-1, 1:-1, 1:-1] &= ~inside[1:-1, 1:-1, 1:-1]

    def chamber(self, one: Chamber) -> None:
        a, b, c = one.half_m
        out = ((self.x - one.x_m) / a) ** 2 + ((self.y - one.y_m) / b) ** 2
        out = out + ((self.z - one.floor_m) / c) ** 2
        self.carve((out < 1.0 + self.rough) & (self.z > one.floor_m))

    def tunnel(self, way_m: Floats, radius_m: float, tall_m: float) -> None:
        """Carve along points (N, 3) of the floor."""
        for x, y, floor in way_m:
            out = ((self.x - x) ** 2 + (self.y - y) ** 2) / radius_m**2
            up = ((self.z - floor) / tall_m) ** 2
            self.carve((out + up**2 < 1.0 + 0.5 * self.rough) & (self.z > floor))

    def fill(self, x_m: float, y_m: float, low_m: float, high_m: float, radius_m: float) -> None:
        """Put an upright disc of rock somewhere."""
        out = np.hypot(self.x - x_m, self.y - y_m) < radius_m
        self.solid |= out & (self.z > low_m) & (self.z < high_m)


def _noise(frame: VoxelFrame, rng: np.random.Generator) -> Floats:
    """Return smooth noise (layers, rows, cols) within -1 and 1."""
    shape = frame.voxels
    coarse = [max(2, math.ceil(n * frame.cell_m / NOISE_M) + 1) for n in shape]
    factors = [n / m for n, m in zip(shape, coarse, strict=True)]
    return np.asarray(zoom(rng.uniform(-1.0, 1.0, coarse), factors, order=1), dtype=np.float64)


def make_cave(
    rng: np.random.Generator,
    settings: CaveSettings,
    *,
    window_m: tuple[float, float],
    cell_m: float,
    build: Build,
) -> VoxelWorld:
    """Return a cave in which a robot gets from the entrance to every chamber.

    Raises:
        WorldError: the window has no room for such a cave.
    """
    cols, rows = (round(side / cell_m) for side in window_m)
    frame = VoxelFrame(0.0, 0.0, cell_m, rows, cols, 0.0, round(settings.height_m / cell_m))
    if window_m[0] < LEAST_WINDOW_M[0] or window_m[1] < LEAST_WINDOW_M[1]:
        raise WorldError(
            f"world.window_m = [{window_m[0]:g}, {window_m[1]:g}]: a cave needs at least"
            f" [{LEAST_WINDOW_M[0]:g}, {LEAST_WINDOW_M[1]:g}]"
        )
    if settings.height_m < LOW_M + HIGH_M:
        raise WorldError(
            f"world.cave.height_m = {settings.height_m:g}: must be at least {LOW_M + HIGH_M:g}"
        )
    for _ in range(TRIES):
        world, goals = _draw(rng, settings, frame)
        ground = world.ground(build)
        place = ground.place_at(*world.start, 1)
        if place < 0:
            continue
        reached = ground.reachable(place)
        layer, row, col = (int(v) for v in ground.cells[place])
        if all(_is_reached(frame, ground.cells[reached], one) for one in goals):
            return VoxelWorld(frame, world.solid, (layer, row, col))
    raise WorldError(
        f"world.cave.chambers = {settings.chambers}: no cave of so many chambers was found in a"
        f" window of {window_m[0]:g} x {window_m[1]:g} m in {TRIES} tries; must be fewer"
    )


def _is_reached(frame: VoxelFrame, cells: np.ndarray, one: Chamber) -> bool:
    """Say whether a robot gets near the middle of a chamber's floor."""
    away = frame.centres_m(cells) - np.array((one.x_m, one.y_m, one.floor_m))
    return bool((np.hypot(away[:, 0], away[:, 1]) + np.abs(away[:, 2]) < 1.5).any())


def _draw(
    rng: np.random.Generator, settings: CaveSettings, frame: VoxelFrame
) -> tuple[VoxelWorld, list[Chamber]]:
    rock = _Rock(frame, settings.roughness, rng)
    wide_m, deep_m = frame.cols * frame.cell_m, frame.rows * frame.cell_m
    top_m = frame.layers * frame.cell_m
    court_floor_m = float(rng.uniform(LOW_M, top_m - HIGH_M))
    court = Chamber(1.9, 0.5 * deep_m, court_floor_m, (1.5, 2.5, 2.4))
    made = [court]
    for _ in range(settings.chambers):
        half = (*rng.uniform(2.0, 4.0, 2), rng.uniform(2.0, HIGH_M - 1.0))
        spots = rng.uniform((4.0, 2.5), (wide_m - 2.5, deep_m - 2.5), (20, 2))
        gaps = [min(math.hypot(x - m.x_m, y - m.y_m) for m in made) for x, y in spots]
        x, y = spots[int(np.argmin(np.abs(np.array(gaps) - 7.0)))]
        near = min(made, key=lambda m: math.hypot(x - m.x_m, y - m.y_m))
        rise = GRADE * math.hypot(x - near.x_m, y - near.y_m)
        floor_m = near.floor_m + float(rng.uniform(-rise, rise))
        floor_m = min(max(floor_m, LOW_M), top_m - HIGH_M)
        one = Chamber(float(x), float(y), floor_m, (float(half[0]), float(half[1]), float(half[2])))
        rock.chamber(one)
        rock.tunnel(_way(rng, near, one), float(rng.uniform(0.9, 1.4)), float(rng.uniform(1.5, 2)))
        made.append(one)
    for one in made[1:]:
        _furnish(rng, rock, one, settings)
    depth, half_width = COURT_M
    sky = (rock.x < depth) & (np.abs(rock.y - court.y_m) < half_width) & (rock.z > court.floor_m)
    rock.carve(sky)
    rock.solid[-1] &= ~sky[-1]
    start = frame.voxel_of(court.x_m, court.y_m, court.floor_m + 0.6 * frame.cell_m)
    return VoxelWorld(frame, rock.solid, start), made


def _way(rng: np.random.Generator, one: Chamber, other: Chamber) -> Floats:
    """Return the floor (N, 3) of a bent tunnel from one chamber to another."""
    ends = np.array(((one.x_m, one.y_m, one.floor_m), (other.x_m, other.y_m, other.floor_m)))
    bend = ends.mean(axis=0)
    bend[:2] += rng.uniform(-1.5, 1.5, 2)
    t = np.linspace(0.0, 1.0, max(2, math.ceil(math.dist(*ends[:, :2]) / 0.25)))[:, None]
    return (1 - t) ** 2 * ends[0] + 2 * t * (1 - t) * bend + t**2 * ends[1]


def _furnish(rng: np.random.Generator, rock: _Rock, one: Chamber, settings: CaveSettings) -> None:
    """Put rocks with an overhanging cap on a chamber's floor, and hang stones from its roof."""
    for _ in range(int(rng.poisson(settings.overhangs))):
        turn, away = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.45, 0.8)
        x = one.x_m + away * one.half_m[0] * math.cos(turn)
        y = one.y_m + away * one.half_m[1] * math.sin(turn)
        stem_m, cap_m = float(rng.uniform(0.2, 0.4)), float(rng.uniform(0.8, 1.3))
        under_m = one.floor_m + float(rng.uniform(1.15, 1.45))
        rock.fill(x, y, one.floor_m, under_m, stem_m)
        rock.fill(x, y, under_m, under_m + 0.5, cap_m)
    for _ in range(int(rng.poisson(settings.overhangs))):
        turn, away = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.1, 0.8)
        x = one.x_m + away * one.half_m[0] * math.cos(turn)
        y = one.y_m + away * one.half_m[1] * math.sin(turn)
        tip_m = one.floor_m + float(rng.uniform(1.3, 1.8))
        rock.fill(x, y, tip_m, one.floor_m + one.half_m[2] + 0.5, float(rng.uniform(0.15, 0.35)))
