"""The team map: what the store and a robot's own layer say together of the ground.

Derived, never sent. Nobody fuses fused maps: within one origin, whose submaps share their drift,
the surest submap of each cell counts; over origins, which measured independently, information
adds up (Sujan & Meggiolaro, Eqs. 19-21). Laying a tile adds the covariance of its anchor, and of
the codec's error bound.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Bools, Floats, GridFrame
from agents.layers import Anchor, OwnLayer, drawn_at, slope_of
from agents.payloads import Payloads, Pyramid
from agents.store import AnchorKey, Origin, Store, TileKey
from comms.codec import DecodedTile, sigma_as_sent

UNIFORM = 1.0 / 3.0
"""Variance of an error spread evenly within a bound of 1."""


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

    def window(self, tile: int) -> tuple[slice, slice]:
        """Return the cells of a tile; tiles at the north and east edge may be smaller."""
        row, col = divmod(tile, self.across)
        side = self.tile_cells
        return (
            slice(row * side, min((row + 1) * side, self.frame.rows)),
            slice(col * side, min((col + 1) * side, self.frame.cols)),
        )

    def shape(self, tile: int) -> tuple[int, int]:
        """Return a tile's rows and columns."""
        rows, cols = self.window(tile)
        return rows.stop - rows.start, cols.stop - cols.start

    def touched(self, mask: Bools) -> list[int]:
        """Return the tiles in which a mask (rows, cols) has a cell."""
        rows, cols = np.nonzero(mask)
        tiles = (rows // self.tile_cells) * self.across + cols // self.tile_cells
        return [int(t) for t in np.unique(tiles)]


@dataclass(frozen=True)
class Estimate:
    """Elevation (NaN unknown), its variance (inf unknown) and the looks behind it, per cell."""

    elevation_m: Floats
    variance_m2: Floats
    looks: NDArray[np.uint16]

    @property
    def known(self) -> Bools:
        """Mask of the cells of which something is known."""
        return np.isfinite(self.variance_m2)

    def information_bits(self, prior_sigma_m: float) -> float:
        """Return the sum over cells of log2(prior sigma / posterior sigma)."""
        variance = self.variance_m2[self.known]
        return float(np.sum(np.maximum(0.0, 0.5 * np.log2(prior_sigma_m**2 / variance))))


def blank(shape: tuple[int, int]) -> Estimate:
    """Return an estimate of ground of which nothing is known."""
    return Estimate(
        np.full(shape, np.nan), np.full(shape, np.inf), np.zeros(shape, dtype=np.uint16)
    )


def surest(first: Estimate, second: Estimate) -> Estimate:
    """Take each cell from the surer of two estimates of one origin, whose errors are shared."""
    better = second.variance_m2 < first.variance_m2
    return Estimate(
        np.where(better, second.elevation_m, first.elevation_m),
        np.where(better, second.variance_m2, first.variance_m2),
        np.maximum(first.looks, second.looks),
    )


def fuse_origins(layers: list[Estimate], shape: tuple[int, int]) -> Estimate:
    """Add up the information of independent origins, cell by cell (Eqs. 19-21)."""
    information = np.zeros(shape)
    weighted = np.zeros(shape)
    looks = np.zeros(shape, dtype=np.uint16)
    for layer in layers:
        weight = 1.0 / layer.variance_m2
        information += weight
        weighted += np.where(weight > 0, weight * np.nan_to_num(layer.elevation_m), 0.0)
        looks += layer.looks
    with np.errstate(divide="ignore", invalid="ignore"):
        return Estimate(weighted / information, 1.0 / information, looks)


@dataclass(frozen=True)
class _Sheet:
    """A submap that is to be laid."""

    mark: tuple[int, int]
    """Changes when the drawing or its anchor does."""
    draw: Callable[[], Estimate]
    anchor: Anchor


class TeamMap:
    """Keeps one robot's team map up to date, tile by tile, as its layer and its store change."""

    def __init__(
        self,
        grid: TileGrid,
        store: Store,
        own: OwnLayer,
        me: Origin,
        max_error_m: float,
        payloads: Payloads | None = None,
    ) -> None:
        """Make the team map of robot `me`, over its store and its own layer.

        `max_error_m` is the bound within which the team's codec sends elevations; `payloads` is how
        the team writes its tiles.
        """
        self.max_error_m = max_error_m
        self.payloads: Payloads = payloads or Pyramid()
        self.grid = grid
        self.store = store
        self.own = own
        self.me = me
        self._drawn: dict[AnchorKey, dict[int, Estimate]] = {}
        """The tiles of each submap that tell something: a grid each would let a few bytes, which
        name many submaps, take much memory."""
        self._revisions: dict[AnchorKey, int] = {}
        self._folds: dict[
            tuple[Origin, tuple[bool, bool]], tuple[tuple[tuple[int, int], ...], Estimate]
        ] = {}
        self._decoded: dict[TileKey, list[tuple[tuple[int, int], DecodedTile]]] = {}
        self._fused: Estimate | None = None
        self._heard: Estimate | None = None
        self._layers: dict[Origin, Estimate] | None = None
        self._relief: Floats | None = None

    def tile_changed(self, key: TileKey) -> None:
        """Redraw a tile whose payload grew."""
        anchor_key = AnchorKey(key.robot, key.incarnation, key.submap)
        tile = self.tile_estimate(key)
        if not tile.known.any() and key.tile not in self._drawn.get(anchor_key, {}):
            return
        self._drawn.setdefault(anchor_key, {})[key.tile] = tile
        self._revisions[anchor_key] = self._revisions.get(anchor_key, 0) + 1
        self._fused = self._heard = self._layers = self._relief = None

    def own_changed(self) -> None:
        """Note that this robot measured something, or that an anchor moved."""
        self._fused = self._heard = self._layers = self._relief = None

    def tile_estimate(self, key: TileKey) -> Estimate:
        """Decode what the store has of a tile, before its anchor is applied.

        A version newer than the newest complete one may be known only coarsely: each cell is
        taken from whichever version knows it best, so no update makes a map worse.
        """
        best = blank(self.grid.shape(key.tile))
        for tile in self.decoded(key):
            variance = np.where(
                tile.known,
                tile.sigma_m.astype(np.float64) ** 2 + tile.bound_m**2 * UNIFORM,
                np.inf,
            )
            elevation = np.where(tile.known, tile.elevation_m.astype(np.float64), np.nan)
            best = surest(best, Estimate(elevation, variance, tile.known.astype(np.uint16)))
        return best

    def decoded(self, key: TileKey) -> list[DecodedTile]:
        """Return the decoded versions of a tile, newest first, each decoded once per prefix."""
        cached = dict(self._decoded.get(key, []))
        fresh: list[tuple[tuple[int, int], DecodedTile]] = []
        for version in self.store.versions(key):
            mark = (version.number, version.prefix_bytes)
            tile = cached.get(mark)
            if tile is None and version.prefix_bytes:
                tile = self.payloads.decode(version.prefix, self.grid.shape(key.tile))
            if tile is not None and tile.level >= 0:
                fresh.append((mark, tile))
        self._decoded[key] = fresh
        return [tile for _, tile in fresh]

    def fused(self) -> Estimate:
        """Return the team map as this robot plans on it: its own layer at full fineness."""
        if self._fused is None:
            self._fused = self._fuse(own_as_sent=False)
        return self._fused

    def relief_sigma_m(self) -> Floats:
        """Return each cell's standard deviation (inf unknown) against the ground next to it.

        How sure the map is of its place as a whole does not matter to a wheel: the anchors'
        covariance is left out.
        """
        if self._relief is None:
            relief = self._fuse(own_as_sent=False, with_anchors=False)
            self._relief = np.sqrt(relief.variance_m2)
        return self._relief

    def as_heard(self) -> Estimate:
        """Return the team map with the own cells no finer than team-mates can have them."""
        if self._heard is None:
            self._heard = fuse_origins(
                list(self._layers_as_heard().values()), self.grid.frame.shape
            )
        return self._heard

    def layer_bits(self, prior_sigma_m: float) -> dict[Origin, float]:
        """Return the information that is here of each origin's layer, each taken by itself.

        The own layer counts as team-mates can have it, once all of it was sent.
        """
        layers = self._layers_as_heard()
        return {origin: layer.information_bits(prior_sigma_m) for origin, layer in layers.items()}

    def _layers_as_heard(self) -> dict[Origin, Estimate]:
        if self._layers is None:
            self._layers = self._fold_all((True, True))
        return self._layers

    def known_entries(self) -> int:
        """Count the known (origin, submap, cell) entries, own unpublished cells included."""
        heard = sum(
            int(np.count_nonzero(tile.known))
            for key, tiles in self._drawn.items()
            for tile in tiles.values()
            if Origin(key.robot, key.incarnation) != self.me
        )
        return heard + self.own.known_cells()

    def own_as_sent(self, submap_index: int) -> Estimate:
        """Return an own submap as the codec at its finest level would give it to a listener."""
        submap = self.own.submaps[submap_index]
        elevation, variance = submap.estimate((slice(None), slice(None)))
        known = np.isfinite(variance)
        sigma = sigma_as_sent(np.sqrt(np.where(known, variance, 0.0)), known)
        sent = np.where(known, sigma**2 + self.max_error_m**2 * UNIFORM, np.inf)
        return Estimate(elevation, sent, submap.looks)

    def published_mask(self, origin: Origin, submap: int) -> Bools:
        """Return the cells of a submap of which anything was published (and is here)."""
        return self._drawing(AnchorKey(*origin, submap)).known

    def _fuse(self, *, own_as_sent: bool, with_anchors: bool = True) -> Estimate:
        layers = self._fold_all((own_as_sent, with_anchors))
        return fuse_origins(list(layers.values()), self.grid.frame.shape)

    def _fold_all(self, kind: tuple[bool, bool]) -> dict[Origin, Estimate]:
        origins = self._sheets(own_as_sent=kind[0])
        return {origin: self._fold(origin, origins[origin], kind) for origin in sorted(origins)}

    def _sheets(self, *, own_as_sent: bool) -> dict[Origin, list[_Sheet]]:
        """Return all submaps that can be laid, by origin, oldest first."""
        origins: dict[Origin, list[_Sheet]] = {}
        for key in sorted(self._drawn):
            origin = Origin(key.robot, key.incarnation)
            anchor = self.store.anchors.get(key)
            if origin == self.me or anchor is None:
                continue  # without an anchor nobody knows where the submap lies
            mark = (self._revisions[key], anchor.version)
            sheet = _Sheet(mark, partial(self._drawing, key), anchor)
            origins.setdefault(origin, []).append(sheet)
        draw = self.own_as_sent if own_as_sent else self._own_drawing
        for index, submap in enumerate(self.own.submaps):
            mark = (submap.revision, submap.anchor.version)
            sheet = _Sheet(mark, partial(draw, index), submap.anchor)
            origins.setdefault(self.me, []).append(sheet)
        return origins

    def _drawing(self, key: AnchorKey) -> Estimate:
        """Return all that was heard of a submap, before its anchor is applied."""
        drawing = blank(self.grid.frame.shape)
        for number, tile in self._drawn.get(key, {}).items():
            window = self.grid.window(number)
            drawing.elevation_m[window] = tile.elevation_m
            drawing.variance_m2[window] = tile.variance_m2
            drawing.looks[window] = tile.looks
        return drawing

    def _own_drawing(self, index: int) -> Estimate:
        submap = self.own.submaps[index]
        return Estimate(*submap.estimate((slice(None), slice(None))), submap.looks)

    def _fold(self, origin: Origin, sheets: list[_Sheet], kind: tuple[bool, bool]) -> Estimate:
        """Return the surest of an origin's submaps, cell by cell.

        All but the newest seldom change: they are laid once, and kept laid.
        """
        older, newest = sheets[:-1], sheets[-1]
        marks = tuple(sheet.mark for sheet in older)
        kept = self._folds.get((origin, kind))
        if kept is None or kept[0] != marks:
            fold = blank(self.grid.frame.shape)
            for sheet in older:
                fold = surest(fold, self._laid(sheet, kind))
            kept = (marks, fold)
            self._folds[origin, kind] = kept
        return surest(kept[1], self._laid(newest, kind))

    def _laid(self, sheet: _Sheet, kind: tuple[bool, bool]) -> Estimate:
        return self.lay(sheet.draw(), sheet.anchor, with_covariance=kind[1])

    def lay(self, drawing: Estimate, anchor: Anchor, *, with_covariance: bool = True) -> Estimate:
        """Lay a submap by its anchor: move it to the corrected pose and add its covariance."""
        frame = self.grid.frame
        if anchor.is_moved:
            drawing = moved(drawing, anchor, frame)
        if not with_covariance:
            return drawing
        variance = drawing.variance_m2 + anchor.cell_variance(
            frame, slope_of(drawing.elevation_m, frame.cell_m)
        )
        return Estimate(drawing.elevation_m, variance, drawing.looks)


def moved(drawing: Estimate, anchor: Anchor, frame: GridFrame) -> Estimate:
    """Resample a submap at its corrected pose: each cell takes the nearest drawn cell's value."""
    rows, cols = np.indices(frame.shape)
    centres: Floats = np.column_stack(
        (
            frame.x_m + (cols.ravel() + 0.5) * frame.cell_m,
            frame.y_m + (rows.ravel() + 0.5) * frame.cell_m,
        )
    ).astype(np.float64)
    source = frame.cells_of(drawn_at(anchor, centres))
    inside = (
        (source[:, 0] >= 0)
        & (source[:, 0] < frame.rows)
        & (source[:, 1] >= 0)
        & (source[:, 1] < frame.cols)
    )
    row = np.where(inside, source[:, 0], 0)
    col = np.where(inside, source[:, 1], 0)
    inside = inside.reshape(frame.shape)
    lift_m = anchor.corrected.z_m - anchor.pose.z_m
    return Estimate(
        np.where(inside, drawing.elevation_m[row, col].reshape(frame.shape) + lift_m, np.nan),
        np.where(inside, drawing.variance_m2[row, col].reshape(frame.shape), np.inf),
        np.where(inside, drawing.looks[row, col].reshape(frame.shape), 0).astype(np.uint16),
    )
