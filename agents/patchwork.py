"""Submaps laid over one another on the team's grid, tile by tile: only what changed is laid anew.

Within one origin the surest submap of each cell counts; over origins information adds up. What an
anchor's covariance adds to a cell may depend on the cells next to it, as on a slope: where the kind
of map says so, a tile that changes makes those beside it stale too.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Generic

from agents.layers import Anchor
from agents.maps.kind import EVERYWHERE, Beside, E, MapKind, S, Window
from agents.store import AnchorKey, Origin
from agents.tiles import TileGrid, shape_of


@dataclass(frozen=True)
class Sheet(Generic[E]):
    """A submap that is to be laid."""

    key: AnchorKey
    anchor: Anchor
    tile: Callable[[int], E | None]
    """What is drawn of a tile, before the anchor is applied; None: nothing."""
    revision: int
    """Grows with every change of the drawing."""
    stamps: Mapping[int, int] | None = None
    """By tile, a number that grows with every change of it or of those beside it; None: those that
    change at all change as a whole."""
    on: Collection[int] | None = None
    """The tiles on which anything may be drawn; None: any."""
    is_own: bool = False
    """It is drawn in two ways, as measured and as sent: what is laid of it is not kept."""

    def stamp(self, tile: int) -> int:
        """Return a number that what is laid of a tile has for as long as it does not change."""
        return self.revision if self.stamps is None else self.stamps.get(tile, 0)


class Laid(Generic[E]):
    """Tiles of submaps as their anchors have them laid, for all patchworks that lay them so.

    Of the submaps on a tile most have not changed when one has.
    """

    def __init__(self) -> None:
        """Begin without any."""
        self._kept: dict[tuple[AnchorKey, int], tuple[int, Anchor, E]] = {}

    def find(self, sheet: Sheet[E], tile: int) -> E | None:
        """Return what was laid of a tile, if the sheet and its anchor are what they were."""
        known = self._kept.get((sheet.key, tile))
        if known is None or known[:2] != (sheet.stamp(tile), sheet.anchor):
            return None
        return known[2]

    def keep(self, sheet: Sheet[E], tile: int, patch: E) -> None:
        """Keep what was laid of a tile."""
        if not sheet.is_own:
            self._kept[sheet.key, tile] = (sheet.stamp(tile), sheet.anchor, patch)


class Patchwork(Generic[S, E]):
    """All submaps laid over one another, in one way."""

    def __init__(
        self,
        kind: MapKind[S, E],
        grid: TileGrid,
        laid: Laid[E] | None = None,
        *,
        counts_bits: bool = False,
    ) -> None:
        """Lay maps of a kind, with the anchors' covariance added to each cell's if `laid` is given.

        With `counts_bits` the information of each origin is kept besides.
        """
        self._kind, self._grid = kind, grid
        self._laid, self._counts_bits = laid, counts_bits
        self._looks_beside = kind.looks_beside and laid is not None
        self._whole: E | None = None
        self._stale = set(grid.tiles)
        self._bits: dict[int, dict[Origin, float]] = {}
        """By tile, what each origin's layer of it tells."""
        self._moved: dict[AnchorKey, tuple[tuple[int, int], dict[int, E]]] = {}
        """Tiles of submaps that lie elsewhere than they were drawn, and of which drawing."""

    def changed(self, tiles: Iterable[int]) -> None:
        """Note that something in some tiles is drawn anew."""
        for tile in tiles:
            self._stale.add(tile)
            if self._looks_beside:
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
        fresh = self._kind.blank(self._grid.cells)
        if self._whole is not None and len(self._stale) < len(self._grid.tiles):
            self._kind.paste(fresh, EVERYWHERE, self._whole)
        found = self._found(sheets())
        for tile in sorted(self._stale):
            layers = self._layers(tile, found[tile])
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
        found: dict[Origin, list[float]] = defaultdict(list)
        for layers in self._bits.values():
            for origin, bits in layers.items():
                found[origin].append(bits)
        return {origin: math.fsum(found[origin]) for origin in sorted(found)}

    def _found(self, sheets: list[Sheet[E]]) -> dict[int, list[Sheet[E]]]:
        """Return the sheets on which something may be drawn of each stale tile, in their order.

        In a large team most of what there is lies elsewhere.
        """
        found: dict[int, list[Sheet[E]]] = {tile: [] for tile in self._stale}
        for sheet in map(self._placed, sheets):
            for tile in self._stale if sheet.on is None else self._stale.intersection(sheet.on):
                found[tile].append(sheet)
        return found

    def _layers(self, tile: int, sheets: list[Sheet[E]]) -> list[E]:
        """Return what each origin has of a tile."""
        found: list[E] = []
        bits: dict[Origin, float] = {}
        for origin, group in groupby(sheets, key=lambda sheet: sheet.key[:2]):
            layer: E | None = None
            for sheet in group:
                patch = self._patch(sheet, tile)
                if patch is not None:
                    layer = patch if layer is None else self._kind.surest(layer, patch)
            if layer is not None:
                found.append(layer)
                if self._counts_bits:
                    bits[Origin(*origin)] = self._kind.bits(layer)
        if self._counts_bits:
            self._bits[tile] = bits
        return found

    def _patch(self, sheet: Sheet[E], tile: int) -> E | None:
        """Return what one submap has of a tile, as sure as its anchor says."""
        core = sheet.tile(tile)
        if core is None or self._laid is None:
            return core
        known = self._laid.find(sheet, tile)
        if known is not None:
            return known
        window, around = self._grid.window(tile), self._around(sheet, tile)
        patch = self._kind.blurred(core, sheet.anchor, self._grid.frame, window, *around)
        self._laid.keep(sheet, tile, patch)
        return patch

    def _around(self, sheet: Sheet[E], tile: int) -> tuple[Beside[E]] | tuple[()]:
        """Return what is drawn around a tile, if that is asked for."""
        if not self._looks_beside:
            return ()
        near = (None if at is None else sheet.tile(at) for at in self._grid.sides(tile))
        south, north, west, east = near
        return ((south, north, west, east),)

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
        return replace(sheet, tile=known[1].get, stamps=None, on=known[1])

    def _copy(self, drawing: E, window: Window) -> E:
        """Return a window that does not keep the whole in memory."""
        piece = self._kind.blank(shape_of(window))
        self._kind.paste(piece, EVERYWHERE, self._kind.cut(drawing, window))
        return piece


def whole_drawing(kind: MapKind[S, E], grid: TileGrid, tile_of: Callable[[int], E | None]) -> E:
    """Return a submap on the whole grid, before its anchor is applied."""
    drawing = kind.blank(grid.cells)
    for tile in grid.tiles:
        piece = tile_of(tile)
        if piece is not None:
            kind.paste(drawing, grid.window(tile), piece)
    return drawing
