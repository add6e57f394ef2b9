"""How a robot's team map grew: each time it is weighed, the cells that changed, in a few bytes.

It is a picture of the map and no map: of each cell a level tells roughly what it holds. Robots make
it where a run keeps a playback; nothing that they do depends on it.
"""

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Bools, Floats, GridFrame
from agents.layers import Mask
from agents.maps.elevation import Estimate
from agents.maps.occupancy import probability
from agents.maps.planar import Occupancy
from agents.maps.voxel import VoxelOccupancy
from agents.voxel.frame import VoxelFrame, VoxelSet
from agents.voxelcast import SIDE
from scenarios.scores.occupancy import floor_heights
from sim.planar_world import PlanarWorld
from sim.voxel.world import VoxelWorld
from sim.worlds import World

Levels = NDArray[np.uint16]
UNKNOWN = 0
MOST_LEVELS = 65_000
STEP = 0.1
"""Of an elevation, in cell sizes; light would show coarser steps."""
STEP_P = 0.01
"""Of a probability."""
SLACK = 2
"""A cell that moved by no more levels than this is not told again: noise would fill the file."""
MARGIN = 0.1
"""A map may be so much lower or higher than its world."""
MOST_CELLS = 250_000
"""A larger grid is shown by every second (third ...) cell of every second (third ...) row."""


@dataclass(frozen=True)
class Scale:
    """What the levels of a picture stand for: level n for low + (n - 1) * step, 0 for unknown."""

    low: float
    """Elevation in metres, or probability of being solid."""
    step: float
    most: int
    """The highest level."""
    stride: int
    """Every how many cells one is shown."""

    def levels(self, values: Floats) -> Levels:
        """Return the picture of values (rows, cols), NaN unknown."""
        small = values[self.stride // 2 :: self.stride, self.stride // 2 :: self.stride]
        known = np.isfinite(small)
        steps = np.rint((np.where(known, small, self.low) - self.low) / self.step)
        return np.where(known, np.clip(1 + steps, 1, self.most), UNKNOWN).astype(np.uint16)

    def mask(self, cells: Bools) -> Bools:
        """Return a mask (rows, cols) as small as a picture."""
        return cells[self.stride // 2 :: self.stride, self.stride // 2 :: self.stride]


def scale_of(world: World) -> Scale:
    """Return the scale of pictures of a world, and of all maps that are made of it."""
    rows, cols = world.frame.shape
    stride = max(1, math.ceil(math.sqrt(rows * cols / MOST_CELLS)))
    if isinstance(world, PlanarWorld):
        return Scale(0.0, STEP_P, 1 + round(1 / STEP_P), stride)
    truth_m = truth_of(world)
    heights = truth_m[np.isfinite(truth_m)]
    low, high = (float(heights.min()), float(heights.max())) if heights.size else (0.0, 1.0)
    step = max(STEP * world.frame.cell_m, (high - low) / (0.8 * MOST_LEVELS))
    low -= MARGIN * (high - low) + step
    return Scale(low, step, math.ceil((high + MARGIN * (high - low) - low) / step), stride)


def truth_of(world: World) -> Floats:
    """Return the world (rows, cols) as its maps tell of it: elevation, or 1 where it is solid.

    Of a world of cubes the height of the lowest floor in each column, NaN where all is rock.
    """
    if isinstance(world, VoxelWorld):
        return floor_heights(~world.solid, world.frame)
    if isinstance(world, PlanarWorld):
        return world.solid.astype(np.float64)
    return world.elevation_m.astype(np.float64)


def values_of(estimate: Estimate | Occupancy | VoxelOccupancy, frame: GridFrame) -> Floats:
    """Return what a map of a frame's grid says of each cell (rows, cols), NaN unknown.

    Of a voxel map how low each column is known to be free.
    """
    if isinstance(estimate, VoxelOccupancy):
        space = cast("VoxelFrame", frame)
        return floor_heights(np.nan_to_num(estimate.dense(space)) < 0, space)
    if isinstance(estimate, Occupancy):
        return np.where(estimate.known, probability(estimate.log_odds), np.nan)
    return estimate.elevation_m


def from_above(cells: Mask, frame: GridFrame) -> Bools:
    """Return in which columns (rows, cols) of a frame's grid a mask of a map has a cell."""
    if not isinstance(cells, VoxelSet):
        return cells
    above = np.zeros(frame.shape, dtype=bool)
    for (_, row, col), mask in cells.masks.items():
        room = above[row * SIDE : (row + 1) * SIDE, col * SIDE : (col + 1) * SIDE]
        seen: Bools = np.any(mask, axis=0)
        room |= seen[: room.shape[0], : room.shape[1]]
    return above


class Growth:
    """Watches one robot's map in one of its lives."""

    def __init__(self, world: World) -> None:
        """Begin with a map of which nothing is known."""
        self._scale, self._frame = scale_of(world), world.frame
        shape = self._scale.mask(np.zeros(world.frame.shape, dtype=bool)).shape
        self._shown: Levels = np.zeros(shape, np.uint16)
        self._own: Bools = np.zeros(shape, dtype=bool)
        self._begun = False

    def step(self, estimate: Any, own: Bools) -> tuple[bool, bytes] | None:
        """Return whether this is the life's first step, and what changed; None where nothing did.

        Args:
            estimate: the robot's team map.
            own: (rows, cols) the cells that its own sensors measured.

        """
        levels = self._scale.levels(values_of(estimate, self._frame))
        apart = np.abs(levels.astype(np.int32) - self._shown) > SLACK
        known_anew = (levels == UNKNOWN) != (self._shown == UNKNOWN)
        changed = np.flatnonzero(apart | known_anew)
        own = self._scale.mask(own).copy()
        measured = np.flatnonzero(own & ~self._own)
        first, self._begun = not self._begun, True
        if not first and changed.size == 0 and measured.size == 0:
            return None
        values = levels.ravel()[changed]
        self._shown.ravel()[changed] = values
        self._own = own
        return first, _packed(changed, measured, values)


def _packed(changed: NDArray[np.intp], measured: NDArray[np.intp], values: Levels) -> bytes:
    """Return two lists of cells as runs of neighbours, and the first list's levels.

    Little-endian: number of runs and of values (uint32 each) of the first list, number of runs of
    the second; gap and length (uint32 each) of each run; the levels (uint16).
    """
    first, second = _runs(changed), _runs(measured)
    head = np.array([len(first), len(values), len(second)], np.uint32)
    return b"".join(part.astype(part.dtype.newbyteorder("<")).tobytes() for part in
                    (head, first, second, values))  # fmt: skip


def _runs(cells: NDArray[np.intp]) -> NDArray[np.uint32]:
    """Return sorted cells as (N, 2): cells left out since the last run, and cells in a row."""
    if cells.size == 0:
        return np.zeros((0, 2), np.uint32)
    breaks = np.flatnonzero(np.diff(cells) > 1)
    starts = cells[np.concatenate(([0], breaks + 1))]
    ends = cells[np.concatenate((breaks, [cells.size - 1]))] + 1
    gaps = starts - np.concatenate(([0], ends[:-1]))
    return np.column_stack((gaps, ends - starts)).astype(np.uint32)


def grown(shown: Levels, own: Bools, data: bytes) -> None:
    """Lay what changed over a picture (rows, cols) and its mask of own cells, in place."""
    first, count, second = (int(n) for n in np.frombuffer(data, "<u4", 3))
    runs = np.frombuffer(data, "<u4", 2 * (first + second), 12).reshape(-1, 2)
    values = np.frombuffer(data, "<u2", count, 12 + runs.nbytes)
    shown.ravel()[_cells(runs[:first])] = values
    own.ravel()[_cells(runs[first:])] = True


def _cells(runs: NDArray[np.uint32]) -> NDArray[np.intp]:
    ends = np.cumsum(runs.astype(np.int64).sum(axis=1))
    spans = [np.arange(e - n, e) for e, (_, n) in zip(ends, runs.astype(np.int64), strict=True)]
    return np.concatenate(spans) if spans else np.zeros(0, np.intp)
