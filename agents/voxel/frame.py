"""A grid of cubic cells, and sets of its cells of which only blocks are kept.

Axes are (layer, row, column): up, north and east. Cells are kept in blocks of 16 x 16 x 16, and a
block only where something is in it: no array is as large as the world.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Bools, Floats, GridFrame, Ints
from agents.voxelcast import SIDE

Block = tuple[int, int, int]
"""Which block: (layer, row, column) in blocks."""
CUBE = (SIDE, SIDE, SIDE)


@dataclass(frozen=True)
class VoxelFrame(GridFrame):
    """A grid of cubes: its floor plan as a `GridFrame`, its lowest face and its layers."""

    z_m: float = 0.0
    layers: int = SIDE

    @property
    def voxels(self) -> tuple[int, int, int]:
        """(layers, rows, cols)."""
        return (self.layers, self.rows, self.cols)

    @property
    def blocks(self) -> tuple[int, int, int]:
        """How many blocks there may be along each axis."""
        return (-(-self.layers // SIDE), -(-self.rows // SIDE), -(-self.cols // SIDE))

    @property
    def corner_m(self) -> tuple[float, float, float]:
        """(x, y, z) of the lowest south-west corner."""
        return (self.x_m, self.y_m, self.z_m)

    def at(self, x_m: float, y_m: float, z_m: float) -> Floats:
        """Return where a point lies (layer, row, col), in cells from the corner."""
        point = (z_m - self.z_m, y_m - self.y_m, x_m - self.x_m)
        return np.array([v / self.cell_m for v in point], dtype=np.float64)

    def voxel_of(self, x_m: float, y_m: float, z_m: float) -> Block:
        """Return the (layer, row, col) that holds a point; it may lie outside the grid."""
        layer, row, col = (math.floor(v) for v in self.at(x_m, y_m, z_m))
        return (layer, row, col)

    def voxels_of(self, points_m: Floats) -> Ints:
        """Return the cells (N, 3) that hold points (N, 3) as (x, y, z)."""
        cells: Floats = (points_m - np.array(self.corner_m))[:, ::-1] / self.cell_m
        return np.floor(cells).astype(np.int64)

    def centres_m(self, cells: Ints) -> Floats:
        """Return the centres (N, 3) as (x, y, z) of cells (N, 3)."""
        corner: Floats = np.array(self.corner_m, dtype=np.float64)
        return (cells[:, ::-1] + 0.5).astype(np.float64) * self.cell_m + corner

    def holds_voxel(self, layer: int, row: int, col: int) -> bool:
        """Say whether a cell lies inside the grid."""
        return 0 <= layer < self.layers and self.holds(row, col)


def block_of(cells: Ints) -> Ints:
    """Return the blocks (N, 3) that hold cells (N, 3)."""
    return cells // SIDE


def by_block(cells: Ints) -> list[tuple[Block, Ints, Ints]]:
    """Return, per block in order, which of the cells (N, 3) it holds and their flat places in it.

    Several cells may be the same one.
    """
    if len(cells) == 0:
        return []
    blocks = block_of(cells)
    local = cells - blocks * SIDE
    flat = (local[:, 0] * SIDE + local[:, 1]) * SIDE + local[:, 2]
    order = np.lexsort((blocks[:, 2], blocks[:, 1], blocks[:, 0]))
    cuts = np.flatnonzero(np.any(np.diff(blocks[order], axis=0) != 0, axis=1)) + 1
    parts: list[tuple[Block, Ints, Ints]] = []
    for which in np.split(order, cuts):
        layer, row, col = (int(v) for v in blocks[which[0]])
        parts.append(((layer, row, col), which, flat[which]))
    return parts


class VoxelSet:
    """A set of cells: masks (16, 16, 16) by block, and whether all cells elsewhere are in it."""

    def __init__(self, masks: dict[Block, Bools], *, elsewhere: bool = False) -> None:
        """Take the masks; blocks that are not among them hold no cell, or all."""
        self.masks = masks
        self.elsewhere = elsewhere

    @staticmethod
    def of(cells: Ints) -> "VoxelSet":
        """Return the set of some cells (N, 3)."""
        masks: dict[Block, Bools] = {}
        for block, _, places in by_block(cells):
            mask = np.zeros(CUBE, dtype=np.bool_)
            mask.ravel()[places] = True
            masks[block] = mask
        return VoxelSet(masks)

    def mask(self, block: Block) -> Bools:
        """Return the mask (16, 16, 16) of a block."""
        found = self.masks.get(block)
        return np.full(CUBE, self.elsewhere) if found is None else found

    def __and__(self, other: "VoxelSet") -> "VoxelSet":
        """Return the cells that are in both."""
        blocks = {*self.masks, *other.masks}
        both = {block: self.mask(block) & other.mask(block) for block in sorted(blocks)}
        return VoxelSet(both, elsewhere=self.elsewhere and other.elsewhere)

    def __invert__(self) -> "VoxelSet":
        """Return the cells that are not in it."""
        masks = {block: ~mask for block, mask in self.masks.items()}
        return VoxelSet(masks, elsewhere=not self.elsewhere)

    def any(self) -> bool:
        """Say whether there is a cell in it."""
        return self.elsewhere or any(bool(mask.any()) for mask in self.masks.values())

    def sum(self) -> int:
        """Return how many cells it has; those of kept blocks where it goes on elsewhere."""
        return sum(int(np.count_nonzero(mask)) for mask in self.masks.values())

    def cells(self) -> Ints:
        """Return the cells (N, 3) of the kept blocks, block by block."""
        found = [
            np.argwhere(self.masks[block]) + np.array(block) * SIDE for block in sorted(self.masks)
        ]
        return np.concatenate(found) if found else np.zeros((0, 3), dtype=np.int64)


class Packed:
    """Blocks laid one after another with an index, as kernels take them."""

    def __init__(self, frame: VoxelFrame, blocks: list[Block]) -> None:
        """Take the blocks in their order; those outside the frame are left out."""
        self.frame = frame
        shape = frame.blocks
        self.blocks = [b for b in blocks if all(0 <= v < n for v, n in zip(b, shape, strict=True))]
        self.index = np.full(shape, -1, dtype=np.int32)
        for number, block in enumerate(self.blocks):
            self.index[block] = number

    @cached_property
    def corners(self) -> Ints:
        """(N, 3) the first cell of each block."""
        return np.array(self.blocks, dtype=np.int64).reshape(-1, 3) * SIDE

    def stacked(self, arrays: dict[Block, Any], dtype: Any, absent: float = 0.0) -> NDArray[Any]:
        """Return the arrays (N, 16, 16, 16) of the blocks; `absent` fills one that is not there."""
        out = np.full((len(self.blocks), *CUBE), absent, dtype=dtype)
        for number, block in enumerate(self.blocks):
            found = arrays.get(block)
            if found is not None:
                out[number] = found
        return out
