"""How a grid of voxels is cut into the cubes that are versioned and sent."""

from dataclasses import dataclass
from typing import cast

import numpy as np

from agents.tiles import Shape, TileGrid, Window
from agents.voxel.frame import VoxelFrame, VoxelSet
from agents.voxelcast import SIDE


@dataclass(frozen=True)
class VoxelTiles(TileGrid):
    """Cubes of whole blocks, layer by layer from below, each row by row from the south-west.

    All are alike: those at the upper, north and east edge reach beyond the grid.
    """

    @property
    def _rows(self) -> int:
        return -(-self.frame.rows // self.tile_cells)

    @property
    def count(self) -> int:
        """Tiles in all."""
        layers = -(-cast("VoxelFrame", self.frame).layers // self.tile_cells)
        return layers * self._rows * self.across

    def window(self, tile: int) -> Window:
        """Return the cells (layers, rows, cols) of a tile."""
        rest, col = divmod(tile, self.across)
        layer, row = divmod(rest, self._rows)
        side = self.tile_cells
        return tuple(slice(n * side, (n + 1) * side) for n in (layer, row, col))

    def shape(self, tile: int) -> Shape:
        """Return how many cells a tile has along each axis."""
        del tile
        return (self.tile_cells,) * 3

    def touched(self, mask: VoxelSet) -> list[int]:
        """Return the tiles in which a set has a cell."""
        blocks = [block for block, cells in mask.masks.items() if cells.any()]
        at = np.array(blocks, dtype=np.int64).reshape(-1, 3) * SIDE // self.tile_cells
        tiles = (at[:, 0] * self._rows + at[:, 1]) * self.across + at[:, 2]
        return [int(t) for t in np.unique(tiles)]
