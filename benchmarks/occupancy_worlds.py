"""Worlds and looks to compress: floor plans, voxel scenes, and what a scanner makes of them.

Everything is made up from a seed. A scanner's rays leave log odds as a simple inverse sensor model
has them: every cell that a ray crosses is a little freer, the cell where it ends more occupied.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from comms.kernels import kernel

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Rng = np.random.Generator

HIT, MISS = 0.85, -0.4
CLAMPS = ((-2.0, 3.5), (-6.0, 6.0), (-6.0, 6.0))


@kernel
def _scan(
    solid: NDArray[np.uint8],
    log_odds: Floats,
    known: NDArray[np.uint8],
    origin: Floats,
    directions: Floats,
    offsets: Floats,
    reach: float,
    shift: Floats,
) -> None:
    """Add the rays of one look (layers, rows, cols); a ray ends `offsets` cells off the surface.

    `shift` is how far the robot is wrong about where it stands, in cells.
    """
    depth, height, width = solid.shape
    for k in range(directions.shape[0]):
        length, met = 0.0, 0
        while length < reach:
            z = math.floor(origin[0] + directions[k, 0] * length)
            y = math.floor(origin[1] + directions[k, 1] * length)
            x = math.floor(origin[2] + directions[k, 2] * length)
            if z < 0 or y < 0 or x < 0 or z >= depth or y >= height or x >= width:
                break
            if solid[z, y, x]:
                met = 1
                break
            length += 0.3
        end = length + (offsets[k] if met else 0.0)
        last = -1
        along = 0.0
        while along <= end:
            z = math.floor(origin[0] + shift[0] + directions[k, 0] * along)
            y = math.floor(origin[1] + shift[1] + directions[k, 1] * along)
            x = math.floor(origin[2] + shift[2] + directions[k, 2] * along)
            along += 0.3
            if z < 0 or y < 0 or x < 0 or z >= depth or y >= height or x >= width:
                break
            cell = (z * height + y) * width + x
            if cell == last:
                continue
            last = cell
            known[z, y, x] = 1
            log_odds[z, y, x] += 0.85 if met and along > end - 0.3 else -0.4


def look(
    solid: Bools,
    looks: int,
    rng: Rng,
    *,
    reach: float = 120.0,
    clamp: tuple[float, float] = (-6, 6),
) -> tuple[Floats, Bools]:
    """Return log odds and mask (layers, rows, cols) after looks from free cells."""
    log_odds, known = np.zeros(solid.shape), np.zeros(solid.shape, np.uint8)
    free = np.argwhere(~solid)
    for _ in range(looks):
        origin = free[rng.integers(len(free))] + 0.5
        if solid.shape[0] == 1:
            bearings = np.arange(0, 2 * math.pi, 0.5 / reach)
            directions = np.stack([0 * bearings, np.sin(bearings), np.cos(bearings)], 1)
        else:
            directions = _cone(rng, reach)
        offsets = rng.normal(0.3, 0.5, len(directions))
        shift = rng.normal(0, 0.3, 3) * (np.array(solid.shape) > 1)
        _scan(solid.astype(np.uint8), log_odds, known, origin, directions, offsets, reach, shift)
        np.clip(log_odds, *clamp, out=log_odds)
    return log_odds, known.astype(np.bool_)


def _cone(rng: Rng, reach: float) -> Floats:
    """Return the rays of a depth camera of 90 x 70 degrees that looks about level."""
    step = 0.7 / reach
    u, v = np.meshgrid(np.arange(-1.0, 1.0, step), np.arange(-0.7, 0.7, step))
    turn, tilt = rng.uniform(0, 2 * math.pi), rng.uniform(-0.5, 0.2)
    rays = np.stack([v.ravel(), u.ravel(), np.ones(u.size)], 1)
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    z, y, x = rays.T
    x, z = x * math.cos(tilt) - z * math.sin(tilt), x * math.sin(tilt) + z * math.cos(tilt)
    x, y = x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn)
    return np.stack([z, y, x], 1)


def floor_plan(rng: Rng, side: int) -> Bools:
    """Return the solid cells (1, side, side) of a floor: rooms, doors, columns, furniture."""
    solid = np.zeros((side, side), np.bool_)
    wall = int(rng.integers(1, 4))
    solid[:wall], solid[-wall:], solid[:, :wall], solid[:, -wall:] = True, True, True, True
    _split(solid, (0, 0, side, side), wall, rng, int(rng.integers(2, 6)))
    for _ in range(rng.poisson(side * side / 900)):
        i, j = rng.integers(0, side, 2)
        if rng.random() < 0.5:
            h, w = rng.integers(1, 12, 2)
            solid[i : i + h, j : j + w] = True
        else:
            y, x = np.ogrid[:side, :side]
            solid |= (y - i) ** 2 + (x - j) ** 2 < rng.uniform(0.7, 5) ** 2
    if rng.random() < 0.5:
        solid = _turned(solid, rng.uniform(-0.6, 0.6))
    return solid[None]


def _split(solid: Bools, room: tuple[int, int, int, int], wall: int, rng: Rng, depth: int) -> None:
    top, left, height, width = room
    if depth == 0 or max(height, width) < 30 or (depth < 3 and rng.random() < 0.15):
        return
    if height > width:
        at = top + int(height * rng.uniform(0.3, 0.7))
        door = left + int(rng.integers(wall, max(width - 12, wall + 1)))
        solid[at : at + wall, left : left + width] = True
        solid[at : at + wall, door : door + int(rng.integers(6, 20))] = False
        _split(solid, (top, left, at - top, width), wall, rng, depth - 1)
        _split(solid, (at, left, top + height - at, width), wall, rng, depth - 1)
    else:
        turned = solid.T
        _split_across(turned, (left, top, width, height), wall, rng, depth)


def _split_across(
    solid: Bools, room: tuple[int, int, int, int], wall: int, rng: Rng, depth: int
) -> None:
    top, left, height, width = room
    at = top + int(height * rng.uniform(0.3, 0.7))
    door = left + int(rng.integers(wall, max(width - 12, wall + 1)))
    solid[at : at + wall, left : left + width] = True
    solid[at : at + wall, door : door + int(rng.integers(6, 20))] = False
    _split(solid.T, (left, top, width, at - top), wall, rng, depth - 1)
    _split(solid.T, (left, at, width, top + height - at), wall, rng, depth - 1)


def _turned(solid: Bools, angle: float) -> Bools:
    side = solid.shape[0]
    y, x = np.mgrid[:side, :side] - side / 2
    i = np.rint(y * math.cos(angle) + x * math.sin(angle) + side / 2).astype(int)
    j = np.rint(x * math.cos(angle) - y * math.sin(angle) + side / 2).astype(int)
    inside = (i >= 0) & (j >= 0) & (i < side) & (j < side)
    return np.where(inside, solid[i.clip(0, side - 1), j.clip(0, side - 1)], True)


def scene(rng: Rng, shape: tuple[int, int, int]) -> Bools:
    """Return the solid cells (layers, rows, cols) of rough ground with boxes, balls and walls."""
    layers, rows, cols = shape
    f = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(cols)[None])
    f[0, 0] = np.inf
    noise = rng.normal(size=f.shape) + 1j * rng.normal(size=f.shape)
    ground = np.fft.irfft2(noise * f**-1.8, (rows, cols))
    ground = 3 + (ground - ground.min()) / np.ptp(ground) * rng.uniform(0, layers / 3)
    z, y, x = np.ogrid[:layers, :rows, :cols]
    solid = z < ground[None]
    for _ in range(rng.poisson(rows * cols / 400)):
        i, j = int(rng.integers(0, rows)), int(rng.integers(0, cols))
        base = int(ground[i, j])
        if rng.random() < 0.5:
            d, h, w = rng.integers(2, max(layers // 2, 3)), *rng.integers(1, 14, 2)
            solid[max(base - 2, 0) : base + d, i : i + h, j : j + w] = True
        else:
            ball = (z - base - rng.uniform(0, layers / 3)) ** 2 + (y - i) ** 2 + (x - j) ** 2
            solid |= ball < rng.uniform(1, 6) ** 2
    return solid


def three_states(
    log_odds: Floats, known: Bools, occupied_from: float = 0.6
) -> tuple[Floats, Bools]:
    """Return a map as it is published: certainly free, certainly occupied, or not known.

    With a threshold above -0.3, cells between that and the threshold are not known.
    """
    told = known & ((log_odds > occupied_from) | (log_odds < max(-0.3, occupied_from)))
    return np.where(log_odds > occupied_from, 6.0, -6.0), told


def turned_map(log_odds: Floats, known: Bools, angle: float) -> tuple[Floats, Bools]:
    """Return a published map (1, rows, cols) turned as a picture and read in again.

    Grey between black and white reads as not known, as in many maps that people publish.
    """
    grey = np.where(known[0], np.where(log_odds[0] > 0, 0, 254), 205).astype(np.uint8)
    middle = (grey.shape[1] / 2, grey.shape[0] / 2)
    matrix = cv2.getRotationMatrix2D(middle, math.degrees(angle), 1.0)
    size = (grey.shape[1], grey.shape[0])
    grey = cv2.warpAffine(grey, matrix, size, flags=cv2.INTER_LINEAR, borderValue=205)
    occupancy = (255 - grey[None].astype(np.float64)) / 255
    free, occupied = occupancy < 0.196, occupancy > 0.65
    return np.where(occupied, 6.0, -6.0), free | occupied
