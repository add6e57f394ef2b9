"""Made-up floors of buildings: rooms, corridors, doors, closed rooms and furniture, from a seed.

A floor is drawn at 0.1 m a pixel and then taken at 0.4 m a cell by the rule for real maps
(`sim.planar_world`), so that its walls become as thick and as ragged as theirs.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.geometry import GridFrame
from sim.planar_world import FREE, PlanarWorld, start_of

PIXEL_M, CELL_M = 0.1, 0.4
MARGIN_M = 4.0
"""Solid ground about a building."""
FOOTPRINT_M = 0.3
LEAST_WALL_M = 1.4
"""A wall between two rooms needs that much for a door."""
OPEN = 254
"""What a free pixel counts."""
Rng = np.random.Generator
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Room:
    """A rectangle, metres."""

    low: tuple[float, float]
    """x, y of its corner."""
    side: tuple[float, float]
    corridor: bool
    closed: bool = False

    @property
    def high(self) -> tuple[float, float]:
        """x, y of the other corner."""
        return self.low[0] + self.side[0], self.low[1] + self.side[1]


def floor_plan(rng: Rng) -> PlanarWorld:
    """Return a building's floor of 18 to 70 m, a third of them askew."""
    side_m = (float(rng.uniform(18, 70)), float(rng.uniform(18, 70)))
    least_m, wall_m, closed = rng.uniform(2.4, 5.0), rng.uniform(0.1, 0.35), rng.uniform(0.03, 0.45)
    rooms: list[Room] = []
    _split(rng, (MARGIN_M, MARGIN_M), side_m, float(least_m), 0, rooms)
    rooms = [
        Room(room.low, room.side, room.corridor, not room.corridor and rng.random() < closed)
        for room in rooms
    ]
    shape = tuple(round((side + 2 * MARGIN_M) / PIXEL_M) for side in side_m[::-1])
    image: Image = np.zeros(shape, dtype=np.uint8)
    for room in rooms:
        if not room.closed:
            low, high = np.array(room.low) + wall_m / 2, np.array(room.high) - wall_m / 2
            _fill(image, low, high, OPEN)
    _put_doors(rng, image, rooms, float(wall_m))
    for room in rooms:
        _furnish(rng, image, room)
    if rng.random() < 0.35:
        image = _turned(image, float(rng.uniform(0, 90)))
    block = round(CELL_M / PIXEL_M)
    rows, cols = image.shape[0] // block, image.shape[1] // block
    blocks = image[: rows * block, : cols * block].reshape(rows, block, cols, block)
    solid = blocks.mean((1, 3)) < FREE
    frame = GridFrame(0.0, 0.0, CELL_M, rows, cols)
    return PlanarWorld(frame, solid, start_of(solid, frame, FOOTPRINT_M))


def _split(
    rng: Rng,
    low: tuple[float, float],
    side: tuple[float, float],
    least_m: float,
    depth: int,
    rooms: list[Room],
) -> None:
    """Cut a rectangle in two, now and then with a corridor between, until rooms are left."""
    long = int(side[1] > side[0]) if rng.random() < 0.85 else int(side[1] <= side[0])
    small = min(side) < 2 * least_m and rng.random() < 0.25
    if side[long] < 2 * least_m or small or (depth > 2 and rng.random() < 0.12):
        rooms.append(Room(low, side, corridor=False))
        return
    wide_m = 0.0
    if min(side) > 6 and side[long] > 2 * least_m + 4 and rng.random() < 0.55:
        wide_m = float(rng.uniform(1.4, 3.2))
    cut_m = float(rng.uniform(least_m, max(side[long] - least_m - wide_m, least_m + 1e-9)))
    widths = (cut_m, wide_m, side[long] - cut_m - wide_m)
    at = low[long]
    for n, width in enumerate(widths):
        part_low = (at, low[1]) if long == 0 else (low[0], at)
        part_side = (width, side[1]) if long == 0 else (side[0], width)
        at += width
        if n == 1 and width > 0:
            rooms.append(Room(part_low, part_side, corridor=True))
        elif n != 1:
            _split(rng, part_low, part_side, least_m, depth + 1, rooms)


def _put_doors(rng: Rng, image: Image, rooms: list[Room], wall_m: float) -> None:
    """Open doors between neighbours: most rooms have one to a corridor, some one to a room."""
    for room in rooms:
        doors = 0
        for n in rng.permutation(len(rooms)):
            other = rooms[n]
            if room is other or room.closed or other.closed:
                continue
            for axis, at in _walls_between(room, other):
                along = 1 - axis
                from_m = max(room.low[along], other.low[along])
                to_m = min(room.high[along], other.high[along])
                if to_m - from_m >= LEAST_WALL_M and rng.random() < _chance(room, other, doors):
                    doors += 1
                    _open(rng, image, (axis, at, wall_m), (from_m, to_m), room, other)


def _walls_between(room: Room, other: Room) -> list[tuple[int, float]]:
    """Return the axes across which two rooms are neighbours, and where the wall stands."""
    found: list[tuple[int, float]] = []
    for axis in (0, 1):
        for at, there in ((room.high, other.low), (room.low, other.high)):
            if abs(at[axis] - there[axis]) < 1e-6:
                found.append((axis, at[axis]))
    return found


def _chance(room: Room, other: Room, doors: int) -> float:
    if room.corridor and other.corridor:
        return 1.0
    return 0.75 if (room.corridor or other.corridor) and doors == 0 else 0.12


def _open(
    rng: Rng,
    image: Image,
    wall: tuple[int, float, float],
    span_m: tuple[float, float],
    room: Room,
    other: Room,
) -> None:
    """Put a door in a wall (axis, place, thickness), or take it away all along."""
    (axis, at, wall_m), (from_m, to_m) = wall, span_m
    wide_m = float(rng.uniform(0.9, 1.9))
    if (room.corridor and other.corridor) or rng.random() < 0.08:
        wide_m = to_m - from_m
    wide_m = min(wide_m, to_m - from_m - 0.3)
    low, high = np.zeros(2), np.zeros(2)
    low[axis], high[axis] = at - wall_m, at + wall_m
    low[1 - axis] = float(rng.uniform(from_m + 0.1, to_m - 0.1 - wide_m))
    high[1 - axis] = low[1 - axis] + wide_m
    _fill(image, low, high, OPEN)


def _furnish(rng: Rng, image: Image, room: Room) -> None:
    share = 0.01 if room.corridor else 0.05
    for _ in range(rng.poisson(share * room.side[0] * room.side[1])):
        side = rng.uniform(0.3, 2.0, 2)
        room_for = np.maximum(np.array(room.side) - side, 0.1)
        low = np.array(room.low) + rng.uniform(0.0, 1.0, 2) * room_for
        _fill(image, low, low + side, 0)


def _fill(image: Image, low: NDArray[np.float64], high: NDArray[np.float64], value: int) -> None:
    (x0, y0), (x1, y1) = (np.maximum(np.rint(at / PIXEL_M).astype(int), 0) for at in (low, high))
    image[y0:y1, x0:x1] = value


def _turned(image: Image, angle_deg: float) -> Image:
    rows, cols = image.shape
    turn = cv2.getRotationMatrix2D((cols / 2, rows / 2), angle_deg, 1.0)
    c, s = abs(turn[0, 0]), abs(turn[0, 1])
    wide, high = int(rows * s + cols * c), int(rows * c + cols * s)
    turn[:, 2] += (wide / 2 - cols / 2, high / 2 - rows / 2)
    return cv2.warpAffine(image, turn, (wide, high), flags=cv2.INTER_NEAREST, borderValue=0).astype(
        np.uint8
    )
