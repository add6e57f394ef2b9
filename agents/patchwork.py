"""Submaps laid over one another on the team's grid, tile by tile: only what changed is laid anew.

Within one origin the surest submap of each cell counts; over origins information adds up. What an
anchor's covariance adds to a cell depends on the slope there, so on the cells next to it: a tile is
laid with a margin of one cell, and a tile that changes makes those beside it stale too.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Generic

import numpy as np

from agents.geometry import Bools, GridFrame
from agents.layers import Anchor
from agents.maps.kind import EVERYWHERE, E, MapKind, S, Window
from agents.store import AnchorKey, Origin

MARGIN_CELLS = 1


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
    def across(self) -> int:
        """Tiles in one row of the team's grid."""
        return -(-(self.whole or self.frame).cols // self.tile_cells)

    @cached_property
    def count(self) -> int:
        """Tiles of the team's grid in all."""
        return self.across * -(-(self.whole or self.frame).rows // self.tile_cells)

    @cached_property
    def _corner(self) -> tuple[int, int]:
        """Row and column, in tiles, of the region's south-west corner."""
        whole, frame = self.whole or self.frame, self.frame
        side_m = self.tile_cells * frame.cell_m
        return round((frame.y_m - whole.y_m) / side_m), round((frame.x_m - whole.x_m) / side_m)

    @cached_property
    def tiles(self) -> tuple[int, ...]:
        """The tiles of the region, ascending."""
        side, (row0, col0) = self.tile_cells, self._corner
        rows, cols = -(-self.frame.rows // side), -(-self.frame.cols // side)
        return tuple(
            (row0 + row) * self.across + col0 + col for row in range(rows) for col in range(cols)
        )

    @cached_property
    def _held(self) -> frozenset[int]:
        return frozenset(self.tiles)

    def holds(self, tile: int) -> bool:
        """Say whether a tile lies in the region."""
        return tile in self._held

    def window(self, tile: int, margin: int = 0) -> Window:
        """Return the cells of a tile; tiles at the north and east edge may be smaller.

        With a margin of so many cells on each side, as far as the region goes.
        """
        row, col = divmod(tile, self.across)
        row, col = row - self._corner[0], col - self._corner[1]
        side = self.tile_cells
        return (
            slice(max(0, row * side - margin), min((row + 1) * side + margin, self.frame.rows)),
            slice(max(0, col * side - margin), min((col + 1) * side + margin, self.frame.cols)),
        )

    def shape(self, tile: int) -> tuple[int, int]:
        """Return a tile's rows and columns."""
        return shape_of(self.window(tile))

    def beside(self, tile: int) -> list[int]:
        """Return the tiles of the region that share an edge with a tile."""
        row, col = divmod(tile, self.across)
        places = ((row - 1, col), (row, col - 1), (row, col + 1), (row + 1, col))
        near = [r * self.across + c for r, c in places if 0 <= c < self.across]
        return [other for other in near if other in self._held]

    def touched(self, mask: Bools) -> list[int]:
        """Return the tiles in which a mask (rows, cols) of the region has a cell."""
        rows, cols = np.nonzero(mask)
        row0, col0 = self._corner
        tiles = (rows // self.tile_cells + row0) * self.across + cols // self.tile_cells + col0
        return [int(t) for t in np.unique(tiles)]


def shape_of(window: Window) -> tuple[int, int]:
    """Return a window's rows and columns."""
    rows, cols = window
    return rows.stop - rows.start, cols.stop - cols.start


@dataclass(frozen=True)
class Sheet(Generic[E]):
    """A submap that is to be laid."""

    key: AnchorKey
    anchor: Anchor
    tile: Callable[[int], E | None]
    """What is drawn of a tile, before the anchor is applied; None: nothing."""
    revision: int
    """Grows with every change of the drawing."""


class Patchwork(Generic[S, E]):
    """All submaps laid over one another, in one way."""

    def __init__(
        self, kind: MapKind[S, E], grid: TileGrid, *, with_anchors: bool, counts_bits: bool = False
    ) -> None:
        """Lay maps of a kind, with the anchors' covariance added to each cell's or without.

        With `counts_bits` the information of each origin is kept besides.
        """
        self._kind, self._grid = kind, grid
        self._with_anchors, self._counts_bits = with_anchors, counts_bits
        self._whole: E | None = None
        self._stale = set(grid.tiles)
        self._bits: dict[Origin, dict[int, float]] = {}
        self._moved: dict[AnchorKey, tuple[tuple[int, int], dict[int, E]]] = {}
        """Tiles of submaps that lie elsewhere than they were drawn, and of which drawing."""

    def changed(self, tiles: Iterable[int]) -> None:
        """Note that something in some tiles is drawn anew."""
        for tile in tiles:
            self._stale.add(tile)
            if self._with_anchors:
                self._stale.update(self._grid.beside(tile))

    def all_changed(self) -> None:
        """Note that anything may be drawn, or lie, elsewhere."""
        self._stale.update(self._grid.tiles)

    def laid(self, sheets: Callable[[], list[Sheet[E]]]) -> E:
        """Return the whole grid; `sheets` come by origin, those of one origin oldest first.

        What was returned before stays as it was.
        """
        if self._whole is not None and not self._stale:
            return self._whole
        fresh = self._kind.blank(self._grid.frame.shape)
        if self._whole is not None and len(self._stale) < len(self._grid.tiles):
            self._kind.paste(fresh, EVERYWHERE, self._whole)
        placed = [self._placed(sheet) for sheet in sheets()]
        origins = [(o, list(group)) for o, group in groupby(placed, key=lambda s: s.key[:2])]
        for tile in sorted(self._stale):
            layers = self._layers(tile, origins)
            if layers:
                fused = self._kind.fuse(layers, self._grid.shape(tile))
                self._kind.paste(fresh, self._grid.window(tile), fused)
            elif self._whole is not None:
                blank = self._kind.blank(self._grid.shape(tile))
                self._kind.paste(fresh, self._grid.window(tile), blank)
        self._stale.clear()
        self._whole = fresh
        return fresh

    def bits(self) -> dict[Origin, float]:
        """Return the information of each origin's layer as it was last laid."""
        return {origin: math.fsum(tiles.values()) for origin, tiles in sorted(self._bits.items())}

    def _layers(self, tile: int, origins: list[tuple[tuple[int, int], list[Sheet[E]]]]) -> list[E]:
        """Return what each origin has of a tile."""
        found: list[E] = []
        for origin, sheets in origins:
            layer: E | None = None
            for sheet in sheets:
                patch = self._patch(sheet, tile)
                if patch is not None:
                    before = layer or self._kind.blank(self._grid.shape(tile))
                    layer = self._kind.surest(before, patch)
            if layer is not None:
                found.append(layer)
            if self._counts_bits:
                self._count(Origin(*origin), tile, layer)
        return found

    def _count(self, origin: Origin, tile: int, layer: E | None) -> None:
        if layer is not None:
            self._bits.setdefault(origin, {})[tile] = self._kind.bits(layer)
        elif origin in self._bits:
            self._bits[origin].pop(tile, None)

    def _patch(self, sheet: Sheet[E], tile: int) -> E | None:
        """Return what one submap has of a tile, as sure as its anchor says."""
        core = sheet.tile(tile)
        if core is None or not self._with_anchors:
            return core
        window = self._grid.window(tile, MARGIN_CELLS)
        drawing = self._kind.blank(shape_of(window))
        for near in (tile, *self._grid.beside(tile)):
            piece = sheet.tile(near)
            if piece is not None:
                there = self._grid.window(near)
                both = _overlap(there, window)
                piece = self._kind.cut(piece, _inside(both, there))
                self._kind.paste(drawing, _inside(both, window), piece)
        blurred = self._kind.blurred(drawing, sheet.anchor, self._grid.frame, window)
        return self._kind.cut(blurred, _inside(self._grid.window(tile), window))

    def _placed(self, sheet: Sheet[E]) -> Sheet[E]:
        """Return a sheet whose tiles are those where its anchor puts them."""
        if not sheet.anchor.is_moved:
            return sheet
        mark = (sheet.revision, sheet.anchor.version)
        known = self._moved.get(sheet.key)
        if known is None or known[0] != mark:
            drawing = whole_drawing(self._kind, self._grid, sheet.tile)
            moved = self._kind.moved(drawing, sheet.anchor, self._grid.frame)
            windows = {tile: self._grid.window(tile) for tile in self._grid.touched(moved.known)}
            tiles = {tile: self._copy(moved, window) for tile, window in windows.items()}
            known = self._moved[sheet.key] = (mark, tiles)
        return replace(sheet, tile=known[1].get)

    def _copy(self, drawing: E, window: Window) -> E:
        """Return a window that does not keep the whole in memory."""
        piece = self._kind.blank(shape_of(window))
        self._kind.paste(piece, EVERYWHERE, self._kind.cut(drawing, window))
        return piece


def whole_drawing(kind: MapKind[S, E], grid: TileGrid, tile_of: Callable[[int], E | None]) -> E:
    """Return a submap on the whole grid, before its anchor is applied."""
    drawing = kind.blank(grid.frame.shape)
    for tile in grid.tiles:
        piece = tile_of(tile)
        if piece is not None:
            kind.paste(drawing, grid.window(tile), piece)
    return drawing


def _overlap(one: Window, other: Window) -> Window:
    rows, cols = (
        slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(one, other, strict=True)
    )
    return rows, cols


def _inside(window: Window, frame: Window) -> Window:
    """Return a window as counted from another one's corner."""
    rows, cols = (
        slice(a.start - b.start, a.stop - b.start) for a, b in zip(window, frame, strict=True)
    )
    return rows, cols
