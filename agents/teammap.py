"""The team map: what the store and a robot's own layer say together of the ground.

Derived, never sent. Nobody fuses fused maps: within one origin, whose submaps share their drift,
the surest submap of each cell counts; over origins, which measured independently, information
adds up (Sujan & Meggiolaro, Eqs. 19-21). Laying a tile adds the covariance of its anchor, and of
the codec's error bound. What that means for a cell is its kind's affair (`agents.maps.kind`); how
tiles are laid, `agents.patchwork`'s.
"""

import math
from collections.abc import Iterable
from functools import partial, reduce
from typing import Generic

import numpy as np

from agents.geometry import Floats
from agents.layers import OwnLayer
from agents.maps.kind import E, MapKind, Mask, S
from agents.patchwork import Laid, Patchwork, Sheet, whole_drawing
from agents.store import AnchorKey, Origin, Store, TileKey
from agents.tiles import TileGrid

__all__ = ["TeamMap", "TileGrid"]


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
        self._undrawn: set[TileKey] = set()
        """Tiles of which more is in the store than is drawn."""
        self._revisions: dict[AnchorKey, int] = {}
        self._stamps: dict[AnchorKey, dict[int, int]] = {}
        self._known_cells: dict[AnchorKey, dict[int, int]] = {}
        self._decoded: dict[TileKey, list[tuple[tuple[int, int], E]]] = {}
        self._own_drawn: dict[tuple[int, int, bool], E | None] = {}
        """Tiles of own submaps, by (submap, tile, as sent), made when they are first needed."""
        laid: Laid[E] = Laid()
        self._fused: Patchwork[S, E] = Patchwork(kind, grid, laid)
        self._relative: Patchwork[S, E] = Patchwork(kind, grid)
        self._heard: Patchwork[S, E] = Patchwork(kind, grid, laid, counts_bits=True)

    # --- what changed ---------------------------------------------------------------------

    def tile_changed(self, key: TileKey) -> None:
        """Note that a tile's payload grew; it is decoded when somebody asks for the map."""
        self._undrawn.add(key)

    def _draw(self) -> None:
        """Draw all tiles whose payload grew."""
        heard: dict[AnchorKey, list[int]] = {}
        for key in sorted(self._undrawn):
            anchor_key = AnchorKey(*key[:3])
            if key[:2] != self.me:  # of its own it has the whole
                heard.setdefault(anchor_key, []).append(key.tile)
            tile = self.tile_estimate(key)
            cells = int(tile.known.sum())
            if cells or key.tile in self._drawn.get(anchor_key, {}):
                self._drawn.setdefault(anchor_key, {})[key.tile] = tile
                self._known_cells.setdefault(anchor_key, {})[key.tile] = cells
                self._revisions[anchor_key] = self._revisions.get(anchor_key, 0) + 1
                stamps = self._stamps.setdefault(anchor_key, {})
                for near in (key.tile, *self.grid.beside(key.tile)):
                    stamps[near] = stamps.get(near, 0) + 1
        self._undrawn.clear()
        for anchor_key, tiles in heard.items():
            self._lies_anew(anchor_key, tiles)

    def anchor_changed(self, key: AnchorKey) -> None:
        """Note that a submap has an anchor now, or another one; what is undrawn is so anyhow."""
        self._lies_anew(key, list(self._drawn.get(key, {})))

    def _lies_anew(self, key: AnchorKey, tiles: list[int]) -> None:
        anchor = self.store.anchors.get(key)
        for patchwork in (self._fused, self._relative, self._heard):
            if anchor is not None and (anchor.is_moved or anchor.version > 0):
                patchwork.all_changed()  # it lies where its anchor was moved to
            else:
                patchwork.changed(tiles)

    def own_tiles_changed(self, submap: int, tiles: Iterable[int]) -> None:
        """Note that this robot measured something in tiles of a submap."""
        tiles = list(tiles)
        for tile in tiles:
            for as_sent in (False, True):
                self._own_drawn.pop((submap, tile, as_sent), None)
        for patchwork in (self._fused, self._relative, self._heard):
            if self.own.submaps[submap].anchor.is_moved:
                patchwork.all_changed()
            else:
                patchwork.changed(tiles)

    def own_changed(self) -> None:
        """Note that anything may have changed, of its own layer or of the anchors."""
        self._own_drawn.clear()
        for patchwork in (self._fused, self._relative, self._heard):
            patchwork.all_changed()

    # --- what is heard --------------------------------------------------------------------

    def tile_estimate(self, key: TileKey) -> E:
        """Decode what the store has of a tile, before its anchor is applied.

        A version newer than the newest complete one may be known only coarsely: each cell is
        taken from whichever version knows it best, so no update makes a map worse.
        """
        versions = self._decode(key)
        if not versions:
            return self.kind.blank(self.grid.shape(key.tile))
        return reduce(self.kind.surest, versions)

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

    # --- what is known --------------------------------------------------------------------

    def fused(self) -> E:
        """Return the team map as this robot plans on it: its own layer at full fineness."""
        self._draw()
        return self._fused.laid(lambda: self._sheets(own_as_sent=False))

    def relative(self) -> E:
        """Return the team map without the anchors' covariance: each place against its neighbours.

        How sure the map is of its place as a whole does not matter to a wheel.
        """
        self._draw()
        return self._relative.laid(lambda: self._sheets(own_as_sent=False))

    def as_heard(self) -> E:
        """Return the team map with the own cells no finer than team-mates can have them."""
        self._draw()
        return self._heard.laid(lambda: self._sheets(own_as_sent=True))

    def layer_bits(self) -> dict[Origin, float]:
        """Return the information that is here of each origin's layer, each taken by itself.

        The own layer counts as team-mates can have it, once all of it was sent.
        """
        self.as_heard()
        return self._heard.bits()

    def known_entries(self) -> int:
        """Count the known (origin, submap, cell) entries, own unpublished cells included."""
        self._draw()
        heard = sum(
            sum(cells.values())
            for key, cells in self._known_cells.items()
            if Origin(key.robot, key.incarnation) != self.me
        )
        return heard + self.own.known_cells()

    def published_mask(self, origin: Origin, submap: int) -> Mask:
        """Return the cells of a submap of which anything was published (and is here)."""
        self._draw()
        tiles = self._drawn.get(AnchorKey(*origin, submap), {})
        return whole_drawing(self.kind, self.grid, tiles.get).known

    def placing(self, xy_m: tuple[float, float], reach_m: float) -> Floats:
        """Return how unsure (4,) the place of what was heard round a point is, by its anchors.

        Variances of (x, y, z, yaw) there, by the cells that each submap has on tiles in reach. All
        may err alike: so no more is told of it than their mean.
        """
        total, cells = np.zeros(4), 0
        for key, known in sorted(self._known_cells.items()):
            anchor = self.store.anchors.get(key)
            if key[:2] == self.me or anchor is None or not anchor.is_located:
                continue
            near = sum(
                count
                for tile, count in sorted(known.items())
                if math.dist(self.grid.centre_m(tile), xy_m) < reach_m
            )
            x, y, z, yaw = anchor.variance
            dx, dy = xy_m[0] - anchor.corrected.x_m, xy_m[1] - anchor.corrected.y_m
            total += near * np.array((x + dy * dy * yaw, y + dx * dx * yaw, z, yaw))
            cells += near
        return total / max(cells, 1)

    def _sheets(self, *, own_as_sent: bool) -> list[Sheet[E]]:
        """Return all submaps that can be laid, by origin, oldest first.

        Without an anchor, or with one that is lost itself, nobody knows where a submap lies.
        """
        heard = [
            Sheet(key, anchor, tiles.get, self._revisions[key], self._stamps[key], tiles)
            for key, tiles in self._drawn.items()
            if key[:2] != self.me and (anchor := self.store.anchors.get(key)) and anchor.is_located
        ]
        mine = [
            Sheet(
                AnchorKey(*self.me, index),
                submap.anchor,
                partial(self._own_tile, index, own_as_sent),
                submap.revision,
                is_own=True,
            )
            for index, submap in enumerate(self.own.submaps)
            if submap.anchor.is_located
        ]
        return sorted([*heard, *mine], key=lambda sheet: sheet.key)

    def _own_tile(self, index: int, as_sent: bool, tile: int) -> E | None:
        """Return what was measured of a tile of an own submap; None: nothing."""
        place = (index, tile, as_sent)
        if place not in self._own_drawn:
            submap, window = self.own.submaps[index], self.grid.window(tile)
            drawn = (self.kind.as_sent if as_sent else self.kind.drawn)(submap, window)
            self._own_drawn[place] = drawn if drawn.known.any() else None
        return self._own_drawn[place]
