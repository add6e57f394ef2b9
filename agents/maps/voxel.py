"""Voxel occupancy maps (3-D): how sure it is that a cube of space is solid, or free.

Like planar ones (`agents.maps.planar`), a submap keeps summed log-odds per cell and the number of
looks behind them; only blocks of 16 x 16 x 16 cells are kept in which something was measured.
"""

from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np

from agents.geometry import Bools, Floats, GridFrame
from agents.layers import Anchor, drawn_at
from agents.maps.kind import ALONE, EVERYWHERE, Beside
from agents.maps.occupancy import LARGEST, Counts, OccupancyKind, probability, surer
from agents.maps.voxellook import VoxelLook
from agents.planning.information import binary_entropy
from agents.tiles import Shape, TileGrid, Window
from agents.voxel.frame import CUBE, Block, VoxelFrame, VoxelSet, by_block
from agents.voxel.tiles import VoxelTiles
from agents.voxelcast import SIDE
from comms.codec import EncodedTile


class Cube(NamedTuple):
    """The cells (16, 16, 16) of one block."""

    log_odds: Floats
    """Of being occupied; 0 where unknown."""
    looks: Counts


Cubes = dict[Block, Cube]


def _empty() -> Cube:
    return Cube(np.zeros(CUBE), np.zeros(CUBE, dtype=np.uint16))


def _known(cubes: Cubes) -> VoxelSet:
    return VoxelSet({block: cube.looks > 0 for block, cube in cubes.items()})


class VoxelSubmap:
    """One stretch of a robot's own voxel map."""

    def __init__(self, frame: VoxelFrame, anchor: Anchor) -> None:
        """Make an empty submap anchored at a pose."""
        self.frame = frame
        self.anchor = anchor
        self.cubes: Cubes = {}
        self.revision = 0
        """Grows with every change of the cells."""

    @property
    def known(self) -> VoxelSet:
        """The cells that were measured."""
        return _known(self.cubes)

    def observe(self, look: VoxelLook) -> None:
        """Add one look's measurements."""
        for block, which, places in by_block(look.cells):
            cube = self.cubes.setdefault(block, _empty())
            odds, looks = cube.log_odds.ravel(), cube.looks.ravel()
            odds[places] = np.clip(odds[places] + look.log_odds[which], -LARGEST, LARGEST)
            looks[places] += 1
        self.revision += 1

    def take(self, other: "VoxelSubmap", cells: VoxelSet) -> None:
        """Take over some cells from another submap."""
        for block in sorted(other.cubes):
            mask = cells.mask(block)
            if mask.any():
                cube, theirs = self.cubes.setdefault(block, _empty()), other.cubes[block]
                cube.log_odds[mask] = theirs.log_odds[mask]
                cube.looks[mask] = theirs.looks[mask]
        self.revision += 1

    def cells(self) -> list[bytes]:
        """Return the cells that it knows as plain bytes."""
        where = self.known.cells()
        parts = by_block(where)
        odds = [self.cubes[block].log_odds.ravel()[places] for block, _, places in parts]
        looks = [self.cubes[block].looks.ravel()[places] for block, _, places in parts]
        return [
            where.astype(np.int32).tobytes(),
            b"".join(part.tobytes() for part in odds),
            b"".join(part.tobytes() for part in looks),
        ]


@dataclass(frozen=True)
class VoxelOccupancy:
    """Log-odds of being occupied and the looks behind them, in the blocks of which any is known."""

    cubes: Cubes

    @property
    def known(self) -> VoxelSet:
        """The cells of which something is known."""
        return _known(self.cubes)

    @property
    def information_bits(self) -> float:
        """Return the sum over cells of 1 - h(p): by how much they are surer than p = 0.5."""
        return sum(
            float(np.sum(1.0 - binary_entropy(probability(cube.log_odds[cube.looks > 0]))))
            for cube in self.cubes.values()
        )

    def dense(self, frame: VoxelFrame) -> Floats:
        """Return all log-odds of a grid (layers, rows, cols), NaN unknown: for those who judge."""
        room = tuple(n * SIDE for n in frame.blocks)
        out = np.full(room, np.nan)
        for block, cube in self.cubes.items():
            if all(0 <= b < n for b, n in zip(block, frame.blocks, strict=True)):
                place = tuple(slice(b * SIDE, (b + 1) * SIDE) for b in block)
                out[place] = np.where(cube.looks > 0, cube.log_odds, np.nan)
        layers, rows, cols = frame.voxels
        return out[:layers, :rows, :cols]


def surest(first: VoxelOccupancy, second: VoxelOccupancy) -> VoxelOccupancy:
    """Take each cell from the surer of two estimates of one origin, as `agents.maps.planar`."""
    cubes = dict(first.cubes)
    for block, theirs in second.cubes.items():
        mine = cubes.get(block)
        cubes[block] = theirs if mine is None else _surer(mine, theirs)
    return VoxelOccupancy(cubes)


def _surer(first: Cube, second: Cube) -> Cube:
    log_odds = surer(first.log_odds, second.log_odds)
    return Cube(log_odds, np.maximum(first.looks, second.looks))


def add_up(layers: list[VoxelOccupancy]) -> VoxelOccupancy:
    """Add up the log-odds of independent origins, cell by cell (Bayes' rule)."""
    blocks = sorted({block for layer in layers for block in layer.cubes})
    cubes: Cubes = {}
    for block in blocks:
        total = _empty()
        for layer in layers:
            cube = layer.cubes.get(block)
            if cube is not None:
                total.log_odds[:] += cube.log_odds
                total.looks[:] += cube.looks
        np.clip(total.log_odds, -LARGEST, LARGEST, out=total.log_odds)
        cubes[block] = total
    return VoxelOccupancy(cubes)


class VoxelKind(OccupancyKind):
    """`agents.maps.kind.MapKind` of voxel maps."""

    def tiles(self, frame: GridFrame, tile_cells: int, whole: GridFrame | None = None) -> TileGrid:
        """Return cubes; a robot keeps all of space."""
        assert whole is None, "no regions of a voxel map are kept"
        return VoxelTiles(frame, tile_cells)

    def submap(self, frame: GridFrame, anchor: Anchor) -> VoxelSubmap:
        """Return an empty submap."""
        return VoxelSubmap(cast("VoxelFrame", frame), anchor)

    def blank(self, shape: Shape) -> VoxelOccupancy:
        """Return an estimate of space of which nothing is known, however much of it."""
        del shape
        return VoxelOccupancy({})

    def drawn(self, submap: VoxelSubmap, window: Window) -> VoxelOccupancy:
        """Return what the robot measured itself."""
        return VoxelOccupancy(_within(submap.cubes, window))

    def as_sent(self, submap: VoxelSubmap, window: Window) -> VoxelOccupancy:
        """Return a tile as the codec at its finest level would give it to a listener."""
        return VoxelOccupancy(
            {
                block: Cube(self.payloads.as_sent(cube.log_odds, cube.looks > 0), cube.looks)
                for block, cube in _within(submap.cubes, window).items()
            }
        )

    def offer(self, submap: VoxelSubmap, window: Window) -> tuple[float, int]:
        """Return the information of a window as sent, and about its bytes."""
        sent = self.as_sent(submap, window)
        return sent.information_bits, 16 + sent.known.sum() // 32

    def encode(self, submap: VoxelSubmap, window: Window) -> EncodedTile:
        """Return the payload of a window."""
        shape = tuple(part.stop - part.start for part in window)
        log_odds, known = np.zeros(shape), np.zeros(shape, dtype=np.bool_)
        for block, cube in _within(submap.cubes, window).items():
            place = _place(block)
            log_odds[place], known[place] = cube.log_odds, cube.looks > 0
        return self.payloads.encode(log_odds, known)

    def decode(self, prefix: bytes, shape: Shape) -> VoxelOccupancy | None:
        """Return what a prefix tells."""
        told = self.payloads.decode(prefix, shape)
        return None if told is None else VoxelOccupancy(_cut(told.log_odds, told.known))

    def paste(self, drawing: VoxelOccupancy, window: Window, tile: VoxelOccupancy) -> None:
        """Replace a window of a drawing by a tile."""
        for block in _within(drawing.cubes, window, moved=False):
            del drawing.cubes[block]
        first = _corner(window)
        for (layer, row, col), cube in tile.cubes.items():
            drawing.cubes[first[0] + layer, first[1] + row, first[2] + col] = cube

    def cut(self, estimate: VoxelOccupancy, window: Window) -> VoxelOccupancy:
        """Return a window of an estimate, its blocks numbered from the window's corner."""
        return VoxelOccupancy(_within(estimate.cubes, window))

    def surest(self, first: VoxelOccupancy, second: VoxelOccupancy) -> VoxelOccupancy:
        """See `surest`."""
        return surest(first, second)

    def fuse(self, layers: list[VoxelOccupancy], shape: Shape) -> VoxelOccupancy:
        """See `add_up`."""
        del shape
        return add_up(layers)

    def moved(self, drawing: VoxelOccupancy, anchor: Anchor, frame: GridFrame) -> VoxelOccupancy:
        """Resample a submap at its corrected pose: every cell takes the nearest drawn one.

        What comes to lie outside of the grid is left out.
        """
        grid = cast("VoxelFrame", frame)
        known = drawing.known.cells()
        if len(known) == 0:
            return drawing
        lift = round((anchor.corrected.z_m - anchor.pose.z_m) / grid.cell_m)
        around = np.stack(np.meshgrid(*[np.array((-1, 0, 1))] * 3, indexing="ij"), -1)
        there = grid.voxels_of(_carried(anchor, grid.centres_m(known)))
        near = np.unique((there[:, None] + around.reshape(1, 27, 3)).reshape(-1, 3), axis=0)
        near = near[np.all((near >= 0) & (near < np.array(grid.voxels)), axis=1)]
        drawn = grid.centres_m(near)
        drawn[:, :2] = drawn_at(anchor, drawn[:, :2])
        source = grid.voxels_of(drawn)
        source[:, 0] = near[:, 0] - lift
        log_odds, looks = _gathered(drawing.cubes, source)
        return VoxelOccupancy(_scattered(near[looks > 0], log_odds[looks > 0], looks[looks > 0]))

    def blurred(
        self,
        drawing: VoxelOccupancy,
        anchor: Anchor,
        frame: GridFrame,
        window: Window = EVERYWHERE,
        beside: Beside[VoxelOccupancy] = ALONE,
    ) -> VoxelOccupancy:
        """Divide log-odds by 1 + (variance of the cell's place) / cell^2, as on a floor.

        Of the variance along the ground and that of the height the larger counts.
        """
        del beside
        grid = cast("VoxelFrame", frame)
        var_x, var_y, var_z, var_yaw = anchor.variance
        along = np.arange(SIDE) + 0.5
        _, south, west = _corner(window)
        cubes: Cubes = {}
        for (layer, row, col), cube in drawing.cubes.items():
            dx = grid.x_m + ((west + col) * SIDE + along) * grid.cell_m - anchor.corrected.x_m
            dy = grid.y_m + ((south + row) * SIDE + along) * grid.cell_m - anchor.corrected.y_m
            level = 0.5 * (var_x + var_y) + (dx[None, :] ** 2 + dy[:, None] ** 2) * var_yaw
            unsure = 1.0 + np.maximum(level, var_z) / grid.cell_m**2
            cubes[layer, row, col] = Cube(cube.log_odds / unsure, cube.looks)
        return VoxelOccupancy(cubes)

    def restored(self, frame: GridFrame, anchor: Anchor, cells: list[bytes]) -> VoxelSubmap:
        """Return the submap that `VoxelSubmap.cells` wrote."""
        where_data, log_odds, looks = cells
        submap = self.submap(frame, anchor)
        where = np.frombuffer(where_data, np.int32).reshape(-1, 3).astype(np.int64)
        counts = np.frombuffer(looks, np.uint16)
        submap.cubes.update(_scattered(where, np.frombuffer(log_odds), counts))
        return submap


def _place(block: Block) -> tuple[slice, ...]:
    return tuple(slice(b * SIDE, (b + 1) * SIDE) for b in block)


def _corner(window: Window) -> Block:
    """Return the first block of a window."""
    if window == EVERYWHERE:
        return (0, 0, 0)
    layer, row, col = (part.start // SIDE for part in window)
    return (layer, row, col)


def _within(cubes: Cubes, window: Window, *, moved: bool = True) -> Cubes:
    """Return the blocks of a window, numbered from its corner unless they are not to be `moved`."""
    if window == EVERYWHERE:
        return dict(cubes)
    low = _corner(window)
    high = [-(-part.stop // SIDE) for part in window]
    found: Cubes = {}
    for layer in range(low[0], high[0]):
        for row in range(low[1], high[1]):
            for col in range(low[2], high[2]):
                cube = cubes.get((layer, row, col))
                if cube is not None:
                    at = (layer - low[0], row - low[1], col - low[2])
                    found[at if moved else (layer, row, col)] = cube
    return found


def _cut(log_odds: Floats, known: Bools) -> Cubes:
    """Return the blocks of a tile (layers, rows, cols) in which anything is known."""
    cubes: Cubes = {}
    for layer, row, col in np.ndindex(*(n // SIDE for n in known.shape)):
        place = _place((layer, row, col))
        if known[place].any():
            cubes[layer, row, col] = Cube(log_odds[place], known[place].astype(np.uint16))
    return cubes


def _carried(anchor: Anchor, points_m: Floats) -> Floats:
    """Return where points (N, 3), as drawn, lie by the corrected anchor."""
    back = Anchor(anchor.version, anchor.corrected, anchor.pose, anchor.variance)
    lift_m = anchor.corrected.z_m - anchor.pose.z_m
    return np.column_stack((drawn_at(back, points_m[:, :2]), points_m[:, 2] + lift_m))


def _gathered(cubes: Cubes, cells: np.ndarray) -> tuple[Floats, Counts]:
    """Return log-odds and looks (N,) of cells (N, 3)."""
    log_odds, looks = np.zeros(len(cells)), np.zeros(len(cells), dtype=np.uint16)
    for block, which, places in by_block(cells):
        cube = cubes.get(block)
        if cube is not None:
            log_odds[which] = cube.log_odds.ravel()[places]
            looks[which] = cube.looks.ravel()[places]
    return log_odds, looks


def _scattered(cells: np.ndarray, log_odds: Floats, looks: Counts) -> Cubes:
    """Return the blocks that hold cells (N, 3) with log-odds and looks (N,)."""
    cubes: Cubes = {}
    for block, which, places in by_block(cells):
        cube = cubes.setdefault(block, _empty())
        cube.log_odds.ravel()[places] = log_odds[which]
        cube.looks.ravel()[places] = looks[which]
    return cubes
