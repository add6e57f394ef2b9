"""How a team's grid is cut into the tiles that are versioned and sent."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.geometry import GridFrame

Window = tuple[slice, ...]
"""The cells of a tile, along each axis of the map."""
Shape = tuple[int, ...]
"""How many cells a tile, or a map, has along each axis."""


@dataclass(frozen=True)
class TileGrid:
    """How the team grid is cut into square tiles, row by row from the south-west."""

    frame: GridFrame
    tile_cells: int

    @property
    def across(self) -> int:
        """Tiles in one row."""
        return -(-self.frame.cols // self.tile_cells)

    @property
    def count(self) -> int:
        """Tiles in all."""
        return self.across * -(-self.frame.rows // self.tile_cells)

    def window(self, tile: int) -> Window:
        """Return the cells of a tile; tiles at the north and east edge may be smaller."""
        row, col = divmod(tile, self.across)
        side = self.tile_cells
        return (
            slice(row * side, min((row + 1) * side, self.frame.rows)),
            slice(col * side, min((col + 1) * side, self.frame.cols)),
        )

    def shape(self, tile: int) -> Shape:
        """Return how many cells a tile has along each axis."""
        return tuple(part.stop - part.start for part in self.window(tile))

    def centre_m(self, tile: int) -> tuple[float, float]:
        """Return (x, y) of a tile's middle."""
        rows, cols = self.window(tile)[-2:]
        return self.frame.centre_of((rows.start + rows.stop) // 2, (cols.start + cols.stop) // 2)

    def touched(self, mask: Any) -> list[int]:
        """Return the tiles in which a mask (rows, cols) has a cell."""
        rows, cols = np.nonzero(mask)
        tiles = (rows // self.tile_cells) * self.across + cols // self.tile_cells
        return [int(t) for t in np.unique(tiles)]
