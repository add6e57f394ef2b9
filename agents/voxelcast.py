"""Rays through voxels of which only blocks are kept where something was seen.

Each ray goes from face to face of the cells that it crosses (Amanatides & Woo, "A fast voxel
traversal algorithm for ray tracing", 1987); a block that is not there is crossed in one step. Axes
are (layer, row, column), up, north and east, as everywhere; a cell's own centre does not matter
here, its faces lie at whole multiples of `cell_m` from the corner.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agents.errors import AgentError
from agents.geometry import Bools, Floats, Ints, Singles
from comms import kernels
from comms.kernels import kernel

SIDE = 16
"""Cells along a block's side."""
SHIFT = 4
"""SIDE = 2 ** SHIFT."""
NO_BLOCK = -1


class VoxelError(AgentError):
    """Voxels or rays that can't be cast."""


@dataclass(frozen=True)
class VoxelBlocks:
    """Probabilities of occupancy, kept in blocks of 16 x 16 x 16 cells."""

    corner_m: tuple[float, float, float]
    """(x, y, z) of the lowest south-west corner, metres."""
    cell_m: float
    index: NDArray[np.int32]
    """(layers, rows, columns) of blocks: where a block lies in `cells`, or -1 where there is
    none."""
    cells: Singles
    """(blocks, 16, 16, 16) probabilities in [0, 1]."""

    def __post_init__(self) -> None:
        """Refuse an index that points outside `cells`, and blocks of another shape."""
        shape = (SIDE, SIDE, SIDE)
        if self.index.ndim != 3 or self.cells.ndim != 4 or self.cells.shape[1:] != shape:
            raise VoxelError(
                f"an index of shape {self.index.shape} and blocks of shape {self.cells.shape}: "
                f"allowed are (layers, rows, columns) and (blocks, {SIDE}, {SIDE}, {SIDE})"
            )
        if self.index.size and not (
            int(self.index.min()) >= NO_BLOCK and int(self.index.max()) < len(self.cells)
        ):
            raise VoxelError(
                f"the index runs from {self.index.min()} to {self.index.max()}: allowed is"
                f" {NO_BLOCK} to {len(self.cells) - 1}"
            )

    @staticmethod
    def from_dense(
        corner_m: tuple[float, float, float], cell_m: float, occupancy: Singles, known: Bools
    ) -> "VoxelBlocks":
        """Return the blocks of a dense array (layers, rows, columns) that hold a known cell.

        Cells that are not known have probability 0 in a block that is kept.
        """
        blocks = tuple(-(-n // SIDE) for n in occupancy.shape)
        room = tuple(n * SIDE for n in blocks)
        dense = np.zeros(room, dtype=np.float32)
        seen = np.zeros(room, dtype=np.bool_)
        inside = tuple(slice(0, n) for n in occupancy.shape)
        dense[inside], seen[inside] = np.where(known, occupancy, 0.0), known
        split = (blocks[0], SIDE, blocks[1], SIDE, blocks[2], SIDE)
        kept = seen.reshape(split).any(axis=(1, 3, 5))
        index = np.full(blocks, NO_BLOCK, dtype=np.int32)
        index[kept] = np.arange(int(kept.sum()), dtype=np.int32)
        cells = dense.reshape(split).transpose(0, 2, 4, 1, 3, 5)[kept]
        return VoxelBlocks(corner_m, cell_m, index, np.ascontiguousarray(cells))


@dataclass(frozen=True)
class Hits:
    """What N rays met."""

    cells: Ints
    """(N, 3) layer, row and column of the first occupied cell; -1 where there was none."""
    distance_m: Floats
    """(N,) where the ray enters that cell; NaN where there was none."""
    clear_p: Floats
    """(N,) product of 1 - p over the cells crossed before it, or before the limit: Eq. 5's
    visibility of what lies there."""


@kernel
def _to_face(at: int, start: float, speed: float, width: int) -> float:
    """Return the way to the next face of the stretch of `width` cells (a power of 2) about `at`."""
    if speed > 0.0:
        return ((at // width + 1) * width - start) / speed
    if speed < 0.0:
        return ((at // width) * width - start) / speed
    return np.inf


@kernel
def _bounded(at: float, low: int, width: int) -> int:
    """Return the cell that holds a point, no farther than the stretch that begins at `low`."""
    return min(max(math.floor(at), low), low + width - 1)


@kernel
def _past_absent(
    at: tuple[int, int, int], start: np.ndarray, ray: np.ndarray, limit: float, absent_p: float
) -> tuple[tuple[int, int, int], float, float]:
    """Cross the block that holds `at`, in which nothing is kept.

    Return the first cell beyond it, the way there, and the product of 1 - p of the cells crossed.
    """
    z, y, x = at
    fz = _to_face(z, start[0], ray[0], SIDE)
    fy = _to_face(y, start[1], ray[1], SIDE)
    fx = _to_face(x, start[2], ray[2], SIDE)
    leave = min(fz, fy, fx)
    end = min(leave, limit)
    lz, ly, lx = (z >> SHIFT) * SIDE, (y >> SHIFT) * SIDE, (x >> SHIFT) * SIDE
    ez = _bounded(start[0] + end * ray[0], lz, SIDE)
    ey = _bounded(start[1] + end * ray[1], ly, SIDE)
    ex = _bounded(start[2] + end * ray[2], lx, SIDE)
    clear = 1.0
    if absent_p > 0.0:
        clear = (1.0 - absent_p) ** (1 + abs(ez - z) + abs(ey - y) + abs(ex - x))
    if fz <= fy and fz <= fx:
        ez = lz + SIDE if ray[0] > 0.0 else lz - 1
    elif fy <= fx:
        ey = ly + SIDE if ray[1] > 0.0 else ly - 1
    else:
        ex = lx + SIDE if ray[2] > 0.0 else lx - 1
    return (ez, ey, ex), leave, clear


@kernel
def _through(
    cells: np.ndarray,
    block: int,
    at: tuple[int, int, int],
    start: np.ndarray,
    ray: np.ndarray,
    begun: float,
    limit: float,
    occupied_p: float,
) -> tuple[tuple[int, int, int], float, float, bool]:
    """Go from cell to cell of a block of `cells`, entered at `at` after the way `begun`.

    Return the cell met, or the first beyond the block, the way there, the product of 1 - p of the
    cells crossed, and whether the cell was met.
    """
    z, y, x = at
    way, clear = begun, 1.0
    tz, ty, tx = (
        _to_face(z, start[0], ray[0], 1),
        _to_face(y, start[1], ray[1], 1),
        _to_face(x, start[2], ray[2], 1),
    )
    gz, gy, gx = abs(1.0 / ray[0]), abs(1.0 / ray[1]), abs(1.0 / ray[2])
    dz, dy, dx = (1 if ray[0] > 0 else -1), (1 if ray[1] > 0 else -1), (1 if ray[2] > 0 else -1)
    bz, by, bx = z >> SHIFT, y >> SHIFT, x >> SHIFT
    while way <= limit and x >> SHIFT == bx and y >> SHIFT == by and z >> SHIFT == bz:
        p = cells[block, z & (SIDE - 1), y & (SIDE - 1), x & (SIDE - 1)]
        if p >= occupied_p:
            return (z, y, x), way, clear, True
        clear *= 1.0 - p
        if tx <= ty and tx <= tz:
            way, x, tx = tx, x + dx, tx + gx
        elif ty <= tz:
            way, y, ty = ty, y + dy, ty + gy
        else:
            way, z, tz = tz, z + dz, tz + gz
    return (z, y, x), way, clear, False


@kernel
def _cast_one(
    index: np.ndarray,
    cells: np.ndarray,
    start: np.ndarray,
    ray: np.ndarray,
    limit: float,
    odds: tuple[float, float],
    hit: np.ndarray,
) -> tuple[float, float]:
    """Cast one ray from inside the voxels; lengths in cells, axes (layer, row, column).

    `odds`: occupancy from which a cell stops the ray, and of a cell in no block. Fill `hit` (3,);
    return the way to the cell met (NaN: none) and the product of 1 - p before it.
    """
    at = (math.floor(start[0]), math.floor(start[1]), math.floor(start[2]))
    way, clear = 0.0, 1.0
    while way <= limit:
        z, y, x = at[0] >> SHIFT, at[1] >> SHIFT, at[2] >> SHIFT
        if min(z, y, x) < 0 or z >= index.shape[0] or y >= index.shape[1] or x >= index.shape[2]:
            break
        block = index[z, y, x]
        if block < 0:
            at, way, free = _past_absent(at, start, ray, limit, odds[1])
            clear *= free
            continue
        at, way, free, met = _through(cells, block, at, start, ray, way, limit, odds[0])
        clear *= free
        if met:
            hit[0], hit[1], hit[2] = at
            return way, clear
    return np.nan, clear


@kernel
def _cast(
    index: np.ndarray,
    cells: np.ndarray,
    start: np.ndarray,
    rays: np.ndarray,
    limit: float,
    odds: tuple[float, float],
    hits: np.ndarray,
    clear: np.ndarray,
) -> np.ndarray:
    """Cast rays (N, 3); return how far each goes, in cells."""
    ways = np.empty(len(rays))
    for n in range(len(rays)):
        ways[n], clear[n] = _cast_one(index, cells, start, rays[n], limit, odds, hits[n])
    return ways


def cast(
    voxels: VoxelBlocks,
    eye_m: tuple[float, float, float],
    rays: Floats,
    limit_m: float,
    *,
    occupied_p: float = 0.5,
    absent_p: float = 0.0,
) -> Hits:
    """Return what rays from one eye meet first.

    Args:
        voxels: where to look.
        eye_m: (x, y, z) of the eye, inside the voxels.
        rays: (N, 3) unit vectors (x, y, z).
        limit_m: length of the rays.
        occupied_p: occupancy from which a cell stops a ray.
        absent_p: occupancy of the cells in no block, less than `occupied_p`.

    Raises:
        VoxelError: the eye lies outside the voxels, or `absent_p` is not below `occupied_p`.
    """
    start = (np.array(eye_m[::-1]) - np.array(voxels.corner_m[::-1])) / voxels.cell_m
    room = np.array(voxels.index.shape) * SIDE
    if not ((start >= 0).all() and (start < room).all()):
        raise VoxelError(f"the eye at {eye_m} lies outside the voxels")
    if not 0.0 <= absent_p < occupied_p:
        raise VoxelError(f"absent_p is {absent_p}: allowed is 0 to less than {occupied_p}")
    hits = np.full((len(rays), 3), NO_BLOCK, dtype=np.int64)
    clear = np.empty(len(rays))
    ways = _cast(
        voxels.index,
        voxels.cells,
        start,
        np.ascontiguousarray(rays[:, ::-1], dtype=np.float64),
        limit_m / voxels.cell_m,
        (occupied_p, absent_p),
        hits,
        clear,
    )
    return Hits(hits, ways * voxels.cell_m, clear)


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    flat = np.zeros((16, 16, 16), dtype=np.float32)
    voxels = VoxelBlocks.from_dense((0.0, 0.0, 0.0), 1.0, flat, flat == 0.0)
    cast(voxels, (8.0, 8.0, 8.0), np.array(((0.0, 0.6, 0.8),)), 4.0)
