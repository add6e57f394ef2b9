"""Planar worlds: a grid of free and solid cells, from a seed or a building's map, and who sees it.

Definitions, so that others can check: a cell of a map file is free where the mean of its block of
the image is at least 192, on a scale where a free pixel (by the file's thresholds) is 254 and any
other, unknown ones included, is 0. Observable are the cells, the first obstacle along a ray
included, that a noise-free look sees from any position on a 2 m lattice through the start that can
be reached from it, at 12 headings.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from agents.geometry import Bools, Floats, GridFrame, Ints, Pose
from agents.ground.markov import distance_to_known_m
from agents.planar.rays import crossings, fan_rad
from agents.settings import SensorSettings
from comms import kernels
from comms.kernels import kernel
from sim.errors import WorldError
from sim.occupancy import measured_m

FREE = 192.0
"""A block whose mean is less is solid; a free pixel counts 254."""
LATTICE_M = 2.0
HEADINGS = 12
CLEAR_M = 3.0
"""Nothing is put up this near to the middle of a made-up world."""


@dataclass(frozen=True)
class PlanarWorld:
    """What is solid, and where robots start."""

    frame: GridFrame
    solid: Bools
    """(rows, cols), row 0 south."""
    start: tuple[int, int]
    """The free cell nearest to the middle of the largest region that a robot can move in."""


def start_of(solid: Bools, frame: GridFrame, footprint_m: float) -> tuple[int, int]:
    """Return the free cell nearest to the middle of the largest region that a robot can move in.

    Raises:
        WorldError: it has no room anywhere.
    """
    clear = standable(solid, frame.cell_m, footprint_m)
    if not clear.any():
        raise WorldError(f"the world has no room for a robot of {footprint_m} m footprint")
    _, label, stats, _ = cv2.connectedComponentsWithStats(clear.astype(np.uint8), connectivity=4)
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    cells = np.argwhere(label == largest)
    middle = 0.5 * (np.array(frame.shape) - 1)
    row, col = cells[np.argmin(((cells - middle) ** 2).sum(axis=1))]
    return int(row), int(col)


def standable(solid: Bools, cell_m: float, footprint_m: float) -> Bools:
    """Return the cells (rows, cols) at whose centre a robot's disc touches no solid cell."""
    gap_m = distance_to_known_m(np.pad(solid, 1, constant_values=True), cell_m)[1:-1, 1:-1]
    return gap_m > 0.5 * footprint_m + 0.5 * cell_m - 1e-3


def made_up(
    rng: np.random.Generator,
    *,
    side_m: float = 100.0,
    cell_m: float = 0.4,
    solid_share: float = 0.15,
    footprint_m: float = 0.4,
) -> PlanarWorld:
    """Return a walled square with buildings, walls and pillars, strewn until they fill a share."""
    if not (0.0 <= solid_share <= 0.5 and side_m >= 10.0 * cell_m > 0.0):
        raise WorldError(
            f"a made-up world of {side_m} m, cells of {cell_m} m and {solid_share} solid: the side "
            "must be at least 10 cells, the share between 0 and 0.5"
        )
    cells = round(side_m / cell_m)
    solid = np.zeros((cells, cells), dtype=np.uint8)
    solid[[0, -1]] = solid[:, [0, -1]] = 1
    rows, cols = np.indices(solid.shape) + 0.5
    middle = np.hypot(rows - 0.5 * cells, cols - 0.5 * cells) * cell_m < CLEAR_M
    while solid.mean() < solid_share:
        block = cv2.boxPoints(_block(rng, side_m)) / cell_m
        cv2.fillPoly(solid, [np.rint(block).astype(np.int32)], (1,))
        solid[middle] = 0
    frame = GridFrame(0.0, 0.0, cell_m, cells, cells)
    walls = solid.astype(np.bool_)
    return PlanarWorld(frame, walls, start_of(walls, frame, footprint_m))


def _block(
    rng: np.random.Generator, side_m: float
) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Return middle, sides and turn of a building, a wall or a pillar; half of them stand askew."""
    kind = rng.random()
    if kind < 0.4:
        sides = (float(rng.uniform(3.0, 9.0)), float(rng.uniform(3.0, 9.0)))
    elif kind < 0.7:
        sides = (float(rng.uniform(4.0, 16.0)), 0.8)
    else:
        side = float(rng.uniform(0.8, 2.0))
        sides = (side, side)
    x, y = (float(at) for at in rng.uniform(0.0, side_m, 2))
    turn = float(rng.choice((0.0, 90.0))) if rng.random() < 0.5 else float(rng.uniform(0.0, 90.0))
    return (x, y), sides, turn


def load_map(path: Path, *, cell_m: float = 0.4, footprint_m: float = 0.4) -> PlanarWorld:
    """Read a building's map as `map_server` does: a yaml file that names an image.

    Raises:
        WorldError: a file is absent or says what can't be read; one sentence says what.
    """
    told = _yaml(path)
    image = _image(path, told["image"])
    resolution_m = _number(path, told, "resolution")
    if not 0.0 < resolution_m < math.inf:
        raise WorldError(f"{path}: resolution is {resolution_m:g}: it must be a number above 0")
    block = round(cell_m / resolution_m)
    if block < 1 or abs(block * resolution_m - cell_m) > 1e-6:
        raise WorldError(
            f"{path}: cells of {cell_m} m are no multiple of its pixels of {resolution_m} m"
        )
    dark = image / 255.0 if _negated(path, told["negate"]) else 1.0 - image / 255.0
    free = np.where(dark < _number(path, told, "free_thresh"), 254.0, 0.0)[::-1]
    rows, cols = free.shape[0] // block, free.shape[1] // block
    means = free[: rows * block, : cols * block].reshape(rows, block, cols, block).mean((1, 3))
    if min(rows, cols) < 1:
        raise WorldError(f"{path}: its image is smaller than one cell of {cell_m} m")
    frame = GridFrame(*_origin(path, told["origin"]), cell_m, rows, cols)
    solid = means < FREE
    return PlanarWorld(frame, solid, start_of(solid, frame, footprint_m))


def _yaml(path: Path) -> dict[str, str]:
    """Return the flat `key: value` lines of a map_server file."""
    if not path.is_file():
        raise WorldError(f"the map {str(path)!r} does not exist; allowed is a map_server yaml file")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise WorldError(f"{path}: is no map_server yaml file ({error})") from None
    lines = [line.split("#")[0].partition(":") for line in text.splitlines()]
    told = {key.strip(): value.strip().strip("\"'") for key, colon, value in lines if colon}
    for key in ("image", "resolution", "origin", "negate", "free_thresh"):
        if key not in told:
            raise WorldError(f"{path}: it has no {key!r}, which every map_server file holds")
    return told


def _image(path: Path, name: str) -> NDArray[np.uint8]:
    image_path = path.parent / name
    try:
        image = cv2.imread(str(image_path), cv2.IMREAD_GRAYSCALE) if image_path.is_file() else None
    except cv2.error:  # larger than OpenCV reads
        image = None
    if image is None:
        raise WorldError(f"{path}: its image {name!r} is absent or can't be read")
    return image.astype(np.uint8)


def _negated(path: Path, text: str) -> bool:
    known = {"0": False, "1": True, "false": False, "true": True}
    if text.lower() not in known:
        raise WorldError(f"{path}: negate is {text!r}: it must be 0 or 1")
    return known[text.lower()]


def _origin(path: Path, text: str) -> tuple[float, float]:
    try:
        x_m, y_m, yaw_rad = (float(part) for part in text.strip("[]").split(","))
    except ValueError:
        x_m = y_m = yaw_rad = math.nan
    if not math.isfinite(x_m + y_m) or yaw_rad != 0.0:
        raise WorldError(f"{path}: origin is {text!r}: it must be [x, y, 0], in m, not turned")
    return x_m, y_m


def _number(path: Path, told: dict[str, str], key: str) -> float:
    try:
        return float(told[key])
    except ValueError:
        raise WorldError(f"{path}: {key} is {told[key]!r}: it must be a number") from None


@kernel
def _hits(
    solid: np.ndarray, x: float, y: float, angles: np.ndarray, reach: float, seen: np.ndarray
) -> np.ndarray:
    """Return how far each ray goes to a solid cell's face, in cells, inf if none; mark the seen."""
    rows, cols = solid.shape
    cells = np.empty((2 * int(reach) + 8, 2), dtype=np.int64)
    entry = np.empty(len(cells))
    found = np.full(len(angles), np.inf)
    for k in range(len(angles)):
        count = crossings(x, y, angles[k], reach, cells, entry)
        for n in range(count):
            i, j = cells[n, 0], cells[n, 1]
            if i < 0 or j < 0 or i >= rows or j >= cols:
                break
            seen[i, j] = True
            if solid[i, j] and n > 0:
                found[k] = entry[n]
                break
    return found


def look(
    world: PlanarWorld, pose: Pose, sensor: SensorSettings, rng: np.random.Generator | None
) -> tuple[Floats, Bools]:
    """Return what a planar camera measures, and the cells that its rays truly reach.

    Args:
        world: what is solid.
        pose: of the camera; its yaw is the middle of the fan.
        sensor: field of view, range, rays and noise (Eq. 4).
        rng: draws the noise; None: none.

    Returns:
        ranges_m (columns,) along `rays.fan_rad(sensor)`, inf where nothing came back; seen
        (rows, cols), first obstacles included.
    """
    frame = world.frame
    seen = np.zeros(frame.shape, dtype=np.bool_)
    x, y = (pose.x_m - frame.x_m) / frame.cell_m, (pose.y_m - frame.y_m) / frame.cell_m
    angles = pose.yaw_rad + fan_rad(sensor)
    ranges_m = _hits(world.solid, x, y, angles, sensor.range_m / frame.cell_m, seen) * frame.cell_m
    return measured_m(ranges_m, sensor, rng), seen


def reachable(world: PlanarWorld, footprint_m: float) -> Bools:
    """Return the cells (rows, cols) at whose centre a robot can stand that began at the start."""
    clear = standable(world.solid, world.frame.cell_m, footprint_m)
    _, label = cv2.connectedComponents(clear.astype(np.uint8), connectivity=4)
    return label == label[world.start]


def lattice(world: PlanarWorld, footprint_m: float, step_m: float = LATTICE_M) -> Ints:
    """Return the reachable cells (N, 2) on a lattice through the start."""
    step = max(1, round(step_m / world.frame.cell_m))
    cells = np.argwhere(reachable(world, footprint_m))
    return cells[((cells - np.array(world.start)) % step == 0).all(axis=1)]


def views(
    world: PlanarWorld, sensor: SensorSettings, cells: Ints, headings: int = HEADINGS
) -> list[Ints]:
    """Return what noise-free looks see: for each cell and heading in turn, flat cell indices."""
    found: list[Ints] = []
    for row, col in cells:
        x_m, y_m = world.frame.centre_of(int(row), int(col))
        for k in range(headings):
            pose = Pose(x_m, y_m, 0.0, 2.0 * math.pi * k / headings)
            found.append(np.flatnonzero(look(world, pose, sensor, None)[1]))
    return found


def observable(world: PlanarWorld, sensor: SensorSettings, footprint_m: float) -> Bools:
    """Return the cells (rows, cols) that count when coverage is told; see above."""
    seen = np.zeros(world.frame.shape, dtype=np.bool_)
    for row, col in lattice(world, footprint_m):
        x_m, y_m = world.frame.centre_of(int(row), int(col))
        for k in range(HEADINGS):
            seen |= look(world, Pose(x_m, y_m, 0.0, 2 * math.pi * k / HEADINGS), sensor, None)[1]
    return seen


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    solid = np.zeros((8, 8), dtype=np.bool_)
    solid[0] = True
    world = PlanarWorld(GridFrame(0.0, 0.0, 1.0, 8, 8), solid, (4, 4))
    look(world, Pose(4.5, 4.5, 0.0, 0.0), SensorSettings(columns=4, range_m=3.0), None)
