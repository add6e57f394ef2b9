"""How a grid of voxels is cut into the cubes that are versioned and sent."""

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from agents.tiles import Shape, TileGrid
from agents.voxel.frame import VoxelFrame, VoxelSet
from agents.voxelcast import SIDE


@dataclass(frozen=True)
class VoxelTiles(TileGrid):
    """Cubes of whole blocks, layer by layer from below, each row by row from the south-west.

    All are alike: those at the upper, north and east edge reach beyond the grid.
    """

    @cached_property
    def cells(self) -> Shape:
        """How many cells all cubes together have along each axis (layers, rows, cols)."""
        side = self.tile_cells
        return tuple(-(-n // side) * side for n in cast("VoxelFrame", self.frame).voxels)

    def touched(self, mask: VoxelSet) -> list[int]:
        """Return the tiles in which a set has a cell."""
        blocks = [block for block, cells in mask.masks.items() if cells.any()]
        return self._of(np.array(blocks, dtype=np.int64).reshape(-1, 3) * SIDE)
