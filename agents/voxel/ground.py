"""Where a robot can stand in a world of cubes, and its ways from there.

A cell can be stood in when it is free, the one below it solid (or unknown with solid ones about it:
a floor seen askew has gaps), and all above it free up to the robot's height; and when its disc has
room: in the columns that it touches, what is higher than the robot climbs is free as far up. From
cell to cell it goes in eight directions, up or down by no more than it climbs, and cuts no corners.
Several floors may lie over each other.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from agents.geometry import Bools, Floats, Ints
from agents.settings import DriveSettings, SensorSettings
from comms import kernels
from comms.kernels import kernel

UNKNOWN, FREE, SOLID = 0, 1, 2
"""States of a cell, as ground is worked out."""
AWAY = -1
"""The number of a cell in which nobody can stand."""
BESIDE = 3
"""An unknown cell is taken for floor beside so many that are, of eight."""
States = NDArray[np.int8]


@dataclass(frozen=True)
class Build:
    """A robot's size, in cells."""

    tall: int
    """It needs so many free cells, one over the other."""
    climb: int
    """It goes so many cells up or down at once."""
    reach: float
    """Radius of its disc."""

    @staticmethod
    def of(drive: DriveSettings, sensor: SensorSettings, cell_m: float) -> "Build":
        """Return the size of a robot that is as high as its camera."""
        return Build(
            math.ceil(sensor.height_m / cell_m - 1e-9) + 1,
            max(0, math.floor(drive.climb_m / cell_m + 1e-9)),
            0.5 * drive.footprint_m / cell_m,
        )


@kernel
def state_at(index: np.ndarray, states: np.ndarray, i: int, j: int, k: int) -> int:
    """Return the state of a cell; unknown where no block is kept."""
    if min(i, j, k) < 0:
        return 0
    a, b, c = i >> 4, j >> 4, k >> 4
    if a >= index.shape[0] or b >= index.shape[1] or c >= index.shape[2]:
        return 0
    block = index[a, b, c]
    if block < 0:
        return 0
    return states[block, i & 15, j & 15, k & 15]


@kernel
def _has_room(
    index: np.ndarray, states: np.ndarray, at: tuple[int, int, int], build: tuple[int, int, float]
) -> bool:
    i, j, k = at
    tall, climb, reach = build
    for up in range(1, tall):
        if state_at(index, states, i + up, j, k) != 1:
            return False
    near = math.ceil(reach - 0.5)
    for dj in range(-near, near + 1):
        for dk in range(-near, near + 1):
            gap_j, gap_k = max(abs(dj) - 0.5, 0.0), max(abs(dk) - 0.5, 0.0)
            if (dj == 0 and dk == 0) or gap_j * gap_j + gap_k * gap_k >= reach * reach:
                continue
            for up in range(climb, tall):
                if state_at(index, states, i + up, j + dj, k + dk) != 1:
                    return False
    return True


@kernel
def _has_floor(index: np.ndarray, states: np.ndarray, i: int, j: int, k: int) -> bool:
    """Say whether a cell is solid, or is not known and lies among cells that are."""
    state = state_at(index, states, i, j, k)
    if state != 0:
        return state == 2
    beside = 0
    for dj in range(-1, 2):
        for dk in range(-1, 2):
            beside += 1 if state_at(index, states, i, j + dj, k + dk) == 2 else 0
    return beside >= BESIDE


@kernel
def _stands(
    index: np.ndarray,
    states: np.ndarray,
    corners: np.ndarray,
    build: tuple[int, int, float],
    ids: np.ndarray,
) -> int:
    """Number the cells that can be stood in, block by block; return how many there are."""
    count = 0
    for block in range(len(states)):
        for z in range(16):
            for y in range(16):
                for x in range(16):
                    ids[block, z, y, x] = -1
                    if states[block, z, y, x] != 1:
                        continue
                    i, j, k = corners[block, 0] + z, corners[block, 1] + y, corners[block, 2] + x
                    if not _has_floor(index, states, i - 1, j, k):
                        continue
                    if _has_room(index, states, (i, j, k), build):
                        ids[block, z, y, x] = count
                        count += 1
    return count


@kernel
def _id_at(index: np.ndarray, ids: np.ndarray, i: int, j: int, k: int) -> int:
    if min(i, j, k) < 0:
        return -1
    a, b, c = i >> 4, j >> 4, k >> 4
    if a >= index.shape[0] or b >= index.shape[1] or c >= index.shape[2]:
        return -1
    block = index[a, b, c]
    return -1 if block < 0 else ids[block, i & 15, j & 15, k & 15]


@kernel
def _onto(index: np.ndarray, ids: np.ndarray, i: int, j: int, k: int, climb: int) -> int:
    """Return the place in a column that is nearest in height to layer i; the lower of two."""
    for off in range(climb + 1):
        low = _id_at(index, ids, i - off, j, k)
        if low >= 0:
            return low
        high = _id_at(index, ids, i + off, j, k)
        if high >= 0:
            return high
    return -1


@kernel
def _steps(
    index: np.ndarray, ids: np.ndarray, cells: np.ndarray, climb: int, out: np.ndarray
) -> int:
    """Fill (from, to, straight or not) of all steps; return how many there are."""
    count = 0
    for n in range(len(cells)):
        i, j, k = cells[n, 0], cells[n, 1], cells[n, 2]
        for dj in range(-1, 2):
            for dk in range(-1, 2):
                if dj == 0 and dk == 0:
                    continue
                to = _onto(index, ids, i, j + dj, k + dk, climb)
                if to < 0:
                    continue
                if dj != 0 and dk != 0:
                    one = _onto(index, ids, i, j + dj, k, climb)
                    other = _onto(index, ids, i, j, k + dk, climb)
                    if one < 0 or other < 0:
                        continue
                out[count, 0], out[count, 1] = n, to
                out[count, 2] = 1 if dj != 0 and dk != 0 else 0
                count += 1
    return count


@kernel
def _fill_cells(ids: np.ndarray, corners: np.ndarray, cells: np.ndarray) -> None:
    for block in range(len(ids)):
        for z in range(16):
            for y in range(16):
                for x in range(16):
                    n = ids[block, z, y, x]
                    if n >= 0:
                        cells[n, 0] = corners[block, 0] + z
                        cells[n, 1] = corners[block, 1] + y
                        cells[n, 2] = corners[block, 2] + x


class Ground:
    """All places where a robot of one build can stand, and the steps between them."""

    def __init__(
        self, index: NDArray[np.int32], states: States, corners: Ints, build: Build
    ) -> None:
        """Work it out.

        Args:
            index: (layers, rows, cols) of blocks, -1 where there is none.
            states: (blocks, 16, 16, 16) `UNKNOWN`, `FREE` or `SOLID`.
            corners: (blocks, 3) the first cell of each block.
            build: the robot's.
        """
        self.build = build
        self._index = index
        self._ids = np.empty(states.shape, dtype=np.int32)
        size = (build.tall, build.climb, build.reach)
        count = _stands(index, states, corners, size, self._ids)
        self.cells: Ints = np.empty((count, 3), dtype=np.int64)
        """(K, 3) the cells that can be stood in."""
        _fill_cells(self._ids, corners, self.cells)

    @cached_property
    def _graph(self) -> csr_matrix:
        """Steps by their length in cells, along the ground plan."""
        out = np.empty((8 * len(self.cells), 3), dtype=np.int64)
        steps = out[: _steps(self._index, self._ids, self.cells, self.build.climb, out)]
        length = np.where(steps[:, 2] > 0, math.sqrt(2.0), 1.0)
        count = len(self.cells)
        return csr_matrix((length, (steps[:, 0], steps[:, 1])), shape=(count, count))

    def place_at(self, layer: int, row: int, col: int, slack: int) -> int:
        """Return the number of the place in a column nearest to a layer, or `AWAY`."""
        return int(_onto(self._index, self._ids, layer, row, col, slack))

    def field(self, place: int) -> tuple[Floats, Ints]:
        """Return the way (K,) from a place to each, in cells, inf where none leads, and parents."""
        way, parent = dijkstra(self._graph, indices=place, return_predecessors=True)
        return np.asarray(way, dtype=np.float64), np.asarray(parent, dtype=np.int64)

    def reachable(self, place: int) -> Bools:
        """Return which places (K,) can be reached from one."""
        return np.isfinite(self.field(place)[0])


def way_back(parent: Ints, place: int) -> Ints:
    """Return the places (N,) on the way from the field's start to a place, both included."""
    way = [place]
    while parent[way[-1]] >= 0:
        way.append(int(parent[way[-1]]))
    return np.array(way[::-1], dtype=np.int64)


def corners_of(cells: Ints) -> Ints:
    """Return the cells (M, 3) at which a way (N, 3) turns, ends kept."""
    if len(cells) < 3:
        return cells
    steps = np.diff(cells[:, 1:], axis=0)
    turns = np.any(steps[1:] != steps[:-1], axis=1)
    return cells[np.concatenate(([True], turns, [True]))]


@kernels.warmer
def _warm() -> None:
    states = np.full((1, 16, 16, 16), FREE, dtype=np.int8)
    states[0, 0] = SOLID
    index = np.zeros((1, 1, 1), dtype=np.int32)
    corners = np.zeros((1, 3), dtype=np.int64)
    ground = Ground(index, states, corners, Build(3, 1, 1.0))
    ground.field(ground.place_at(1, 8, 8, 1))
