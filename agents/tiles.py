"""How a team's grid is cut into the tiles that are versioned and sent, along any number of axes."""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from agents.geometry import GridFrame

Window = tuple[slice, ...]
"""The cells of a tile, along each axis of the map."""
Shape = tuple[int, ...]
"""How many cells a tile, or a map, has along each axis."""


@dataclass(frozen=True)
class TileGrid:
    """How the team grid is cut into square tiles, row by row from the south-west.

    A robot of a team that covers much ground may keep a region of it: then tiles have the numbers
    of the whole grid, and windows count from the region's corner.
    """

    frame: GridFrame
    """What the robot keeps."""
    tile_cells: int
    whole: GridFrame | None = None
    """The team's grid, where `frame` is a region of it; its corner is a tile's."""

    @cached_property
    def cells(self) -> Shape:
        """How many cells the region has along each axis."""
        return self.frame.shape

    @cached_property
    def along(self) -> Shape:
        """Tiles of the team's grid along each axis."""
        cells = self.cells if self.whole is None else self.whole.shape
        return tuple(-(-n // self.tile_cells) for n in cells)

    @property
    def count(self) -> int:
        """Tiles of the team's grid in all."""
        return math.prod(self.along)

    @cached_property
    def _corner(self) -> Shape:
        """The place of the region's first tile."""
        if self.whole is None:
            return (0,) * len(self.cells)
        side_m = self.tile_cells * self.frame.cell_m
        return (
            round((self.frame.y_m - self.whole.y_m) / side_m),
            round((self.frame.x_m - self.whole.x_m) / side_m),
        )

    @cached_property
    def tiles(self) -> tuple[int, ...]:
        """The tiles of the region, ascending."""
        spans = (
            range(first, first - (-n // self.tile_cells))
            for first, n in zip(self._corner, self.cells, strict=True)
        )
        return tuple(self.number(place) for place in product(*spans))

    @cached_property
    def _held(self) -> frozenset[int]:
        return frozenset(self.tiles)

    def holds(self, tile: int) -> bool:
        """Say whether a tile lies in the region."""
        return tile in self._held

    def place(self, tile: int) -> Shape:
        """Return which tile it is along each axis."""
        at: list[int] = []
        for tiles in reversed(self.along):
            tile, n = divmod(tile, tiles)
            at.append(n)
        return tuple(reversed(at))

    def number(self, place: Shape) -> int:
        """Return the tile at a place: the last axis counts fastest."""
        tile = 0
        for n, tiles in zip(place, self.along, strict=True):
            tile = tile * tiles + n
        return tile

    def window(self, tile: int) -> Window:
        """Return the cells of a tile; tiles at the north and east edge may be smaller."""
        known = self._windows.get(tile)
        if known is None:
            side = self.tile_cells
            ahead = (n - first for n, first in zip(self.place(tile), self._corner, strict=True))
            known = self._windows[tile] = tuple(
                slice(n * side, min((n + 1) * side, cells))
                for n, cells in zip(ahead, self.cells, strict=True)
            )
        return known

    @cached_property
    def _windows(self) -> dict[int, Window]:
        """The windows that were asked for: maps are laid by them all the time."""
        return {}

    def shape(self, tile: int) -> Shape:
        """Return how many cells a tile has along each axis."""
        return shape_of(self.window(tile))

    def beside(self, tile: int) -> tuple[int, ...]:
        """Return the tiles of the region that share an edge, or in space a face, with a tile."""
        known = self._beside.get(tile)
        if known is None:
            near = (other for other in self.sides(tile) if other is not None)
            known = self._beside[tile] = tuple(near)
        return known

    @cached_property
    def _beside(self) -> dict[int, tuple[int, ...]]:
        return {}

    def sides(self, tile: int) -> tuple[int | None, ...]:
        """Return the tiles before and behind a tile along each axis; None: not in the region."""
        known = self._sides.get(tile)
        if known is None:
            place = self.place(tile)
            found: list[int | None] = []
            for axis, tiles in enumerate(self.along):
                for n in (place[axis] - 1, place[axis] + 1):
                    other = self.number((*place[:axis], n, *place[axis + 1 :]))
                    found.append(other if 0 <= n < tiles and other in self._held else None)
            known = self._sides[tile] = tuple(found)
        return known

    @cached_property
    def _sides(self) -> dict[int, tuple[int | None, ...]]:
        return {}

    def centre_m(self, tile: int) -> tuple[float, float]:
        """Return (x, y) of a tile's middle."""
        rows, cols = self.window(tile)[-2:]
        return self.frame.centre_of((rows.start + rows.stop) // 2, (cols.start + cols.stop) // 2)

    def touched(self, mask: Any) -> list[int]:
        """Return the tiles in which a mask, of the form that the map's kind has, has a cell."""
        return self._of(np.argwhere(mask))

    def _of(self, cells: Any) -> list[int]:
        """Return the tiles that hold some cells (N, axes) of the region."""
        spans = tuple(-(-n // self.tile_cells) for n in self.cells)
        flat = np.ravel_multi_index(tuple(np.transpose(cells // self.tile_cells)), spans)
        found = np.flatnonzero(np.bincount(flat, minlength=math.prod(spans)))
        at = np.transpose(np.unravel_index(found, spans)) + np.array(self._corner)
        return [self.number(tuple(int(n) for n in place)) for place in at]


def shape_of(window: Window) -> Shape:
    """Return how many cells a window has along each axis."""
    return tuple(part.stop - part.start for part in window)
