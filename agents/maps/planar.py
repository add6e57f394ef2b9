"""Planar occupancy maps (2-D): how sure it is that a place of the floor is solid, or free.

A submap keeps summed log-odds per cell and the number of looks behind them
(`agents.maps.occupancy`).
"""

from dataclasses import dataclass

import numpy as np

from agents.geometry import Bools, Floats, GridFrame
from agents.layers import Anchor, drawn_cells
from agents.maps.kind import ALONE, EVERYWHERE, Beside, Shape, Window
from agents.maps.occupancy import LARGEST, MAPPED, Counts, OccupancyKind, probability, surer
from agents.maps.planarlook import LookOdds
from agents.planning.information import binary_entropy
from agents.tiles import TileGrid
from comms.codec import EncodedTile


class PlanarSubmap:
    """One stretch of a robot's own planar map, in information form on the team grid."""

    def __init__(self, frame: GridFrame, anchor: Anchor) -> None:
        """Make an empty submap anchored at a pose."""
        self.frame = frame
        self.anchor = anchor
        self.log_odds = np.zeros(frame.shape)
        self.looks: Counts = np.zeros(frame.shape, dtype=np.uint16)
        self.revision = 0
        """Grows with every change of the cells."""

    @property
    def known(self) -> Bools:
        """Mask of the cells that were measured, (rows, cols)."""
        return self.looks > 0

    def observe(self, look: LookOdds) -> None:
        """Add one look's measurements."""
        summed = self.log_odds[look.rows, look.cols] + look.log_odds
        self.log_odds[look.rows, look.cols] = np.clip(summed, -LARGEST, LARGEST)
        self.looks[look.rows, look.cols] += 1
        self.revision += 1

    def take(self, other: "PlanarSubmap", cells: Bools) -> None:
        """Take over the cells of a mask (rows, cols) from another submap."""
        self.log_odds[cells] = other.log_odds[cells]
        self.looks[cells] = other.looks[cells]
        self.revision += 1

    def cells(self) -> list[bytes]:
        """Return the cells that it knows as plain bytes."""
        where = np.flatnonzero(self.looks)
        return [
            where.astype(np.int32).tobytes(),
            self.log_odds.ravel()[where].tobytes(),
            self.looks.ravel()[where].tobytes(),
        ]


@dataclass(frozen=True)
class Occupancy:
    """Log-odds of being occupied (0 where unknown) and the looks behind them, per cell."""

    log_odds: Floats
    looks: Counts

    @property
    def known(self) -> Bools:
        """Mask of the cells of which something is known."""
        return self.looks > 0

    @property
    def mapped(self) -> Bools:
        """Mask of the cells whose occupancy is off by more than 0.4 from 0.5."""
        return np.abs(self.log_odds) > MAPPED

    @property
    def information_bits(self) -> float:
        """Return the sum over cells of 1 - h(p): by how much they are surer than p = 0.5."""
        return float(np.sum(1.0 - binary_entropy(probability(self.log_odds[self.known]))))


def nothing(shape: Shape) -> Occupancy:
    """Return an estimate of a floor of which nothing is known."""
    return Occupancy(np.zeros(shape), np.zeros(shape, dtype=np.uint16))


def surest(first: Occupancy, second: Occupancy) -> Occupancy:
    """Take each cell from the surer of two estimates of one origin (`surer`)."""
    log_odds = surer(first.log_odds, second.log_odds)
    return Occupancy(log_odds, np.maximum(first.looks, second.looks))


def add_up(layers: list[Occupancy], shape: Shape) -> Occupancy:
    """Add up the log-odds of independent origins, cell by cell (Bayes' rule)."""
    total = nothing(shape)
    for layer in layers:
        total.log_odds[:] += layer.log_odds
        total.looks[:] += layer.looks
    np.clip(total.log_odds, -LARGEST, LARGEST, out=total.log_odds)
    return total


class PlanarKind(OccupancyKind):
    """`agents.maps.kind.MapKind` of planar occupancy maps."""

    def tiles(self, frame: GridFrame, tile_cells: int, whole: GridFrame | None = None) -> TileGrid:
        """Return square tiles; see `TileGrid`."""
        return TileGrid(frame, tile_cells, whole)

    def submap(self, frame: GridFrame, anchor: Anchor) -> PlanarSubmap:
        """Return an empty submap."""
        return PlanarSubmap(frame, anchor)

    def blank(self, shape: Shape) -> Occupancy:
        """See `nothing`."""
        return nothing(shape)

    def drawn(self, submap: PlanarSubmap, window: Window) -> Occupancy:
        """Return what the robot measured itself."""
        return Occupancy(submap.log_odds[window], submap.looks[window])

    def as_sent(self, submap: PlanarSubmap, window: Window) -> Occupancy:
        """Return a tile as the codec at its finest level would give it to a listener."""
        drawn = self.drawn(submap, window)
        return Occupancy(self.payloads.as_sent(drawn.log_odds, drawn.known), drawn.looks)

    def offer(self, submap: PlanarSubmap, window: Window) -> tuple[float, int]:
        """Return the information of a window as sent, and about its bytes."""
        sent = self.as_sent(submap, window)
        return sent.information_bits, 16 + int(np.count_nonzero(sent.known)) // 16

    def encode(self, submap: PlanarSubmap, window: Window) -> EncodedTile:
        """Return the payload of a window."""
        drawn = self.drawn(submap, window)
        return self.payloads.encode(drawn.log_odds, drawn.known)

    def decode(self, prefix: bytes, shape: Shape) -> Occupancy | None:
        """Return what a prefix tells."""
        told = self.payloads.decode(prefix, shape)
        return None if told is None else Occupancy(told.log_odds, told.known.astype(np.uint16))

    def paste(self, drawing: Occupancy, window: Window, tile: Occupancy) -> None:
        """Replace a window of a drawing by a tile."""
        drawing.log_odds[window] = tile.log_odds
        drawing.looks[window] = tile.looks

    def cut(self, estimate: Occupancy, window: Window) -> Occupancy:
        """Return a window of an estimate."""
        return Occupancy(estimate.log_odds[window], estimate.looks[window])

    def surest(self, first: Occupancy, second: Occupancy) -> Occupancy:
        """See `surest`."""
        return surest(first, second)

    def fuse(self, layers: list[Occupancy], shape: Shape) -> Occupancy:
        """See `add_up`."""
        return add_up(layers, shape)

    def moved(self, drawing: Occupancy, anchor: Anchor, frame: GridFrame) -> Occupancy:
        """Resample a submap at its corrected pose."""
        row, col, inside = drawn_cells(anchor, frame)
        return Occupancy(
            np.where(inside, drawing.log_odds[row, col], 0.0),
            np.where(inside, drawing.looks[row, col], 0).astype(np.uint16),
        )

    def blurred(
        self,
        drawing: Occupancy,
        anchor: Anchor,
        frame: GridFrame,
        window: Window = EVERYWHERE,
        beside: Beside[Occupancy] = ALONE,
    ) -> Occupancy:
        """Divide log-odds by 1 + (variance of the cell's place) / cell^2.

        Whoever does not know to a cell where a map lies knows of no cell for certain: at one cell's
        standard deviation half of the log-odds is left, at three a tenth. (Our law; a blur by the
        place's distribution would rub out walls of one cell's width.)
        """
        del beside
        unsure = 1.0 + anchor.shift_variance(frame, window) / frame.cell_m**2
        return Occupancy(drawing.log_odds / unsure, drawing.looks)

    def restored(self, frame: GridFrame, anchor: Anchor, cells: list[bytes]) -> PlanarSubmap:
        """Return the submap that `PlanarSubmap.cells` wrote."""
        where_data, log_odds, looks = cells
        submap = PlanarSubmap(frame, anchor)
        where = np.frombuffer(where_data, np.int32)
        submap.log_odds.ravel()[where] = np.frombuffer(log_odds)
        submap.looks.ravel()[where] = np.frombuffer(looks, np.uint16)
        return submap
