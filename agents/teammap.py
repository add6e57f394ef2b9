"""The team map: what the store and a robot's own layer say together of the ground.

Derived, never sent. Nobody fuses fused maps: within one origin, whose submaps share their drift,
the surest submap of each cell counts; over origins, which measured independently, information
adds up (Sujan & Meggiolaro, Eqs. 19-21). Laying a tile adds the covariance of its anchor, and of
the codec's error bound. What that means for a cell is its kind's affair (`agents.maps.kind`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Generic

from agents.layers import Anchor, OwnLayer
from agents.maps.kind import EVERYWHERE, E, MapKind, Mask, S
from agents.store import AnchorKey, Origin, Store, TileKey
from agents.tiles import TileGrid

__all__ = ["TeamMap", "TileGrid"]


@dataclass(frozen=True)
class _Sheet(Generic[E]):
    """A submap that is to be laid."""

    mark: tuple[int, int]
    """Changes when the drawing or its anchor does."""
    draw: Callable[[], E]
    anchor: Anchor


class TeamMap(Generic[S, E]):
    """Keeps one robot's team map up to date, tile by tile, as its layer and its store change."""

    def __init__(
        self, grid: TileGrid, store: Store, own: OwnLayer[S], me: Origin, kind: MapKind[S, E]
    ) -> None:
        """Make the team map of robot `me`, of a kind, over its store and its own layer."""
        self.kind = kind
        self.grid = grid
        self.store = store
        self.own = own
        self.me = me
        self._drawn: dict[AnchorKey, dict[int, E]] = {}
        """The tiles of each submap that tell something: a grid each would let a few bytes, which
        name many submaps, take much memory."""
        self._revisions: dict[AnchorKey, int] = {}
        self._folds: dict[
            tuple[Origin, tuple[bool, bool]], tuple[tuple[tuple[int, int], ...], E]
        ] = {}
        self._decoded: dict[TileKey, list[tuple[tuple[int, int], E]]] = {}
        self._fused: E | None = None
        self._heard: E | None = None
        self._layers: dict[Origin, E] | None = None
        self._relative: E | None = None

    def tile_changed(self, key: TileKey) -> None:
        """Redraw a tile whose payload grew."""
        anchor_key = AnchorKey(key.robot, key.incarnation, key.submap)
        tile = self.tile_estimate(key)
        if not tile.known.any() and key.tile not in self._drawn.get(anchor_key, {}):
            return
        self._drawn.setdefault(anchor_key, {})[key.tile] = tile
        self._revisions[anchor_key] = self._revisions.get(anchor_key, 0) + 1
        self.own_changed()

    def own_changed(self) -> None:
        """Note that this robot measured something, or that an anchor moved."""
        self._fused = self._heard = self._layers = self._relative = None

    def tile_estimate(self, key: TileKey) -> E:
        """Decode what the store has of a tile, before its anchor is applied.

        A version newer than the newest complete one may be known only coarsely: each cell is
        taken from whichever version knows it best, so no update makes a map worse.
        """
        best = self.kind.blank(self.grid.shape(key.tile))
        for tile in self._decode(key):
            best = self.kind.surest(best, tile)
        return best

    def _decode(self, key: TileKey) -> list[E]:
        """Return the decoded versions of a tile, newest first, each decoded once per prefix."""
        cached = dict(self._decoded.get(key, []))
        fresh: list[tuple[tuple[int, int], E]] = []
        for version in self.store.versions(key):
            mark = (version.number, version.prefix_bytes)
            tile = cached.get(mark)
            if tile is None and version.prefix_bytes:
                tile = self.kind.decode(version.prefix, self.grid.shape(key.tile))
            if tile is not None:
                fresh.append((mark, tile))
        self._decoded[key] = fresh
        return [tile for _, tile in fresh]

    def fused(self) -> E:
        """Return the team map as this robot plans on it: its own layer at full fineness."""
        if self._fused is None:
            self._fused = self._fuse((False, True))
        return self._fused

    def relative(self) -> E:
        """Return the team map without the anchors' covariance: each place against its neighbours.

        How sure the map is of its place as a whole does not matter to a wheel.
        """
        if self._relative is None:
            self._relative = self._fuse((False, False))
        return self._relative

    def as_heard(self) -> E:
        """Return the team map with the own cells no finer than team-mates can have them."""
        if self._heard is None:
            layers = list(self._layers_as_heard().values())
            self._heard = self.kind.fuse(layers, self.grid.frame.shape)
        return self._heard

    def layer_bits(self) -> dict[Origin, float]:
        """Return the information that is here of each origin's layer, each taken by itself.

        The own layer counts as team-mates can have it, once all of it was sent.
        """
        layers = self._layers_as_heard()
        return {origin: self.kind.bits(layer) for origin, layer in layers.items()}

    def _layers_as_heard(self) -> dict[Origin, E]:
        if self._layers is None:
            self._layers = self._fold_all((True, True))
        return self._layers

    def known_entries(self) -> int:
        """Count the known (origin, submap, cell) entries, own unpublished cells included."""
        heard = sum(
            int(tile.known.sum())
            for key, tiles in self._drawn.items()
            for tile in tiles.values()
            if Origin(key.robot, key.incarnation) != self.me
        )
        return heard + self.own.known_cells()

    def published_mask(self, origin: Origin, submap: int) -> Mask:
        """Return the cells of a submap of which anything was published (and is here)."""
        return self._drawing(AnchorKey(*origin, submap)).known

    def _fuse(self, way: tuple[bool, bool]) -> E:
        """Fuse all layers: with the own one (as sent), with the anchors' covariance."""
        return self.kind.fuse(list(self._fold_all(way).values()), self.grid.frame.shape)

    def _fold_all(self, way: tuple[bool, bool]) -> dict[Origin, E]:
        origins = self._sheets(own_as_sent=way[0])
        return {origin: self._fold(origin, origins[origin], way) for origin in sorted(origins)}

    def _sheets(self, *, own_as_sent: bool) -> dict[Origin, list[_Sheet[E]]]:
        """Return all submaps that can be laid, by origin, oldest first."""
        origins: dict[Origin, list[_Sheet[E]]] = {}
        for key in sorted(self._drawn):
            origin = Origin(key.robot, key.incarnation)
            anchor = self.store.anchors.get(key)
            if origin == self.me or anchor is None:
                continue  # without an anchor nobody knows where the submap lies
            mark = (self._revisions[key], anchor.version)
            sheet = _Sheet(mark, partial(self._drawing, key), anchor)
            origins.setdefault(origin, []).append(sheet)
        draw = self._own_as_sent if own_as_sent else self._own_drawing
        for index, submap in enumerate(self.own.submaps):
            mark = (submap.revision, submap.anchor.version)
            sheet = _Sheet(mark, partial(draw, index), submap.anchor)
            origins.setdefault(self.me, []).append(sheet)
        return origins

    def _drawing(self, key: AnchorKey) -> E:
        """Return all that was heard of a submap, before its anchor is applied."""
        drawing = self.kind.blank(self.grid.frame.shape)
        for number, tile in self._drawn.get(key, {}).items():
            self.kind.paste(drawing, self.grid.window(number), tile)
        return drawing

    def _own_drawing(self, index: int) -> E:
        return self.kind.drawn(self.own.submaps[index], EVERYWHERE)

    def _own_as_sent(self, index: int) -> E:
        return self.kind.as_sent(self.own.submaps[index])

    def _fold(self, origin: Origin, sheets: list[_Sheet[E]], way: tuple[bool, bool]) -> E:
        """Return the surest of an origin's submaps, cell by cell.

        All but the newest seldom change: they are laid once, and kept laid.
        """
        older, newest = sheets[:-1], sheets[-1]
        marks = tuple(sheet.mark for sheet in older)
        kept = self._folds.get((origin, way))
        if kept is None or kept[0] != marks:
            fold = self.kind.blank(self.grid.frame.shape)
            for sheet in older:
                fold = self.kind.surest(fold, self._laid(sheet, way))
            kept = (marks, fold)
            self._folds[origin, way] = kept
        return self.kind.surest(kept[1], self._laid(newest, way))

    def _laid(self, sheet: _Sheet[E], way: tuple[bool, bool]) -> E:
        """Lay a submap by its anchor: move it to the corrected pose and add its covariance."""
        drawing, frame = sheet.draw(), self.grid.frame
        if sheet.anchor.is_moved:
            drawing = self.kind.moved(drawing, sheet.anchor, frame)
        return self.kind.blurred(drawing, sheet.anchor, frame) if way[1] else drawing
