"""Elevation maps (2.5-D): a height and how sure it is, in information form.

A submap keeps the sum of 1/sigma^2, the sum of z/sigma^2 and the number of looks per cell, so that
one more look is one more addition (Sujan & Meggiolaro, Eqs. 19-21, for independent measurements).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Bools, Floats, GridFrame
from agents.layers import Anchor, drawn_cells
from agents.maps.elevationlaying import add_layer, fill_blurred, fill_slope, take_surer
from agents.maps.elevationlook import LookCells
from agents.maps.kind import ALONE, EVERYWHERE, Beside, Shape, Window
from agents.payloads import Payloads, Pyramid
from agents.tiles import TileGrid
from comms.codec import DecodedTile, EncodedTile, sigma_as_sent

if TYPE_CHECKING:
    from agents.teammap import TeamMap

Counts = NDArray[np.uint16]
UNIFORM = 1.0 / 3.0
"""Variance of an error spread evenly within a bound of 1."""


class Submap:
    """One stretch of a robot's own elevation map, in information form on the team grid."""

    def __init__(self, frame: GridFrame, anchor: Anchor) -> None:
        """Make an empty submap anchored at a pose."""
        self.frame = frame
        self.anchor = anchor
        self.information = np.zeros(frame.shape)
        self.weighted_z = np.zeros(frame.shape)
        self.looks: Counts = np.zeros(frame.shape, dtype=np.uint16)
        self.revision = 0
        """Grows with every change of the cells."""

    @property
    def known(self) -> Bools:
        """Mask of the cells that were measured, (rows, cols)."""
        return self.information > 0

    def observe(self, look: LookCells) -> None:
        """Add one look's measurements."""
        weight = 1.0 / look.variance_m2
        self.information[look.rows, look.cols] += weight
        self.weighted_z[look.rows, look.cols] += weight * look.mean_m
        self.looks[look.rows, look.cols] += 1
        self.revision += 1

    def take(self, other: "Submap", cells: Bools) -> None:
        """Take over the cells of a mask (rows, cols) from another submap."""
        self.information[cells] = other.information[cells]
        self.weighted_z[cells] = other.weighted_z[cells]
        self.looks[cells] = other.looks[cells]
        self.revision += 1

    def estimate(self, window: Window) -> tuple[Floats, Floats]:
        """Return elevation (NaN unknown) and variance (inf unknown) of a window of cells."""
        information = self.information[window]
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.weighted_z[window] / information, 1.0 / information

    def cells(self) -> list[bytes]:
        """Return the cells that it knows as plain bytes."""
        where = np.flatnonzero(self.information)
        return [
            where.astype(np.int32).tobytes(),
            self.information.ravel()[where].tobytes(),
            self.weighted_z.ravel()[where].tobytes(),
            self.looks.ravel()[where].tobytes(),
        ]


@dataclass(frozen=True)
class Estimate:
    """Elevation (NaN unknown), its variance (inf unknown) and the looks behind it, per cell."""

    elevation_m: Floats
    variance_m2: Floats
    looks: Counts

    @property
    def known(self) -> Bools:
        """Mask of the cells of which something is known."""
        return np.isfinite(self.variance_m2)

    def information_bits(self, prior_sigma_m: float) -> float:
        """Return the sum over cells of log2(prior sigma / posterior sigma)."""
        variance = self.variance_m2[self.known]
        return float(np.sum(np.maximum(0.0, 0.5 * np.log2(prior_sigma_m**2 / variance))))


def blank(shape: Shape) -> Estimate:
    """Return an estimate of ground of which nothing is known."""
    return Estimate(
        np.full(shape, np.nan), np.full(shape, np.inf), np.zeros(shape, dtype=np.uint16)
    )


def surest(first: Estimate, second: Estimate) -> Estimate:
    """Take each cell from the surer of two estimates of one origin, whose errors are shared."""
    best = Estimate(first.elevation_m.copy(), first.variance_m2.copy(), first.looks.copy())
    take_surer(best.elevation_m, best.variance_m2, best.looks, *_arrays(second))
    return best


def fuse_origins(layers: list[Estimate], shape: Shape) -> Estimate:
    """Add up the information of independent origins, cell by cell (Eqs. 19-21)."""
    information = np.zeros(shape)
    weighted = np.zeros(shape)
    looks = np.zeros(shape, dtype=np.uint16)
    for layer in layers:
        add_layer(information, weighted, looks, *_arrays(layer))
    with np.errstate(divide="ignore", invalid="ignore"):
        return Estimate(weighted / information, 1.0 / information, looks)


def _arrays(estimate: Estimate) -> tuple[Floats, Floats, Counts]:
    """Return elevation, variance and looks as the kernels take them."""
    return (
        np.ascontiguousarray(estimate.elevation_m),
        np.ascontiguousarray(estimate.variance_m2),
        np.ascontiguousarray(estimate.looks),
    )


def slope_of(elevation_m: Floats, cell_m: float) -> Floats:
    """Return the magnitude of the gradient, 0 where a neighbour is unknown; clipped at 3."""
    slope = np.empty(elevation_m.shape)
    fill_slope(np.ascontiguousarray(elevation_m, dtype=np.float64), cell_m, slope)
    return slope


def cell_variance(
    anchor: Anchor, frame: GridFrame, slope: Floats, window: Window = EVERYWHERE
) -> Floats:
    """Return what an anchor's covariance adds to each cell's elevation variance, m^2.

    `slope` is that of a window of the frame's cells.

    A shift of the map moves the elevation of a cell by the slope times the shift.
    """
    return anchor.variance[2] + slope * slope * anchor.shift_variance(frame, window)


class ElevationKind:
    """`agents.maps.kind.MapKind` of elevation maps."""

    def __init__(
        self, max_error_m: float, prior_sigma_m: float, payloads: Payloads | None = None
    ) -> None:
        """Take the bound within which the team sends elevations, and how it writes its tiles.

        `prior_sigma_m` is how unsure a cell is that nobody measured, for counting information.
        """
        self.max_error_m = max_error_m
        self.prior_sigma_m = prior_sigma_m
        self.payloads: Payloads = payloads or Pyramid()

    @property
    def least_bits_per_byte(self) -> float:
        """A cell measured to centimetres has about five bits: some three cells for 100 bytes.

        A link that has better to send sends that first; this is what an idle one is used for.
        """
        return 0.15

    @property
    def looks_beside(self) -> bool:
        """The slope of a cell is that to the cells next to it."""
        return True

    def tiles(self, frame: GridFrame, tile_cells: int, whole: GridFrame | None = None) -> TileGrid:
        """Return square tiles; see `TileGrid`."""
        return TileGrid(frame, tile_cells, whole)

    def submap(self, frame: GridFrame, anchor: Anchor) -> Submap:
        """Return an empty submap."""
        return Submap(frame, anchor)

    def blank(self, shape: Shape) -> Estimate:
        """See `blank`."""
        return blank(shape)

    def drawn(self, submap: Submap, window: Window) -> Estimate:
        """Return what the robot measured itself."""
        return Estimate(*submap.estimate(window), submap.looks[window])

    def as_sent(self, submap: Submap, window: Window) -> Estimate:
        """Return a tile as the codec at its finest level would give it to a listener."""
        elevation, variance = submap.estimate(window)
        known = np.isfinite(variance)
        sigma = sigma_as_sent(np.sqrt(np.where(known, variance, 0.0)), known)
        sent = np.where(known, sigma**2 + self.max_error_m**2 * UNIFORM, np.inf)
        return Estimate(elevation, sent, submap.looks[window])

    def offer(self, submap: Submap, window: Window) -> tuple[float, int]:
        """Return the information of a window with the codec's bound, and about its bytes."""
        elevation, variance = submap.estimate(window)
        bound = self.max_error_m**2 * UNIFORM
        estimate = Estimate(elevation, variance + bound, submap.looks[window])
        return self.bits(estimate), 24 + int(np.count_nonzero(estimate.known)) // 5

    def encode(self, submap: Submap, window: Window) -> EncodedTile:
        """Return the payload of a window."""
        elevation, variance = submap.estimate(window)
        known = np.isfinite(variance)
        sigma = np.sqrt(np.where(known, variance, 0.0))
        return self.payloads.encode(elevation, known, sigma, self.max_error_m)

    def decode(self, prefix: bytes, shape: Shape) -> Estimate | None:
        """Return what a prefix tells, the codec's error bound in its variances."""
        tile = self.payloads.decode(prefix, shape)
        return None if tile is None or tile.level < 0 else _estimate_of(tile)

    def level(self, prefix: bytes, shape: Shape) -> int:
        """Return the last whole level."""
        tile = self.payloads.decode(prefix, shape)
        return -1 if tile is None else tile.level

    def paste(self, drawing: Estimate, window: Window, tile: Estimate) -> None:
        """Replace a window of a drawing by a tile."""
        drawing.elevation_m[window] = tile.elevation_m
        drawing.variance_m2[window] = tile.variance_m2
        drawing.looks[window] = tile.looks

    def cut(self, estimate: Estimate, window: Window) -> Estimate:
        """Return a window of an estimate."""
        return Estimate(
            estimate.elevation_m[window], estimate.variance_m2[window], estimate.looks[window]
        )

    def surest(self, first: Estimate, second: Estimate) -> Estimate:
        """See `surest`."""
        return surest(first, second)

    def fuse(self, layers: list[Estimate], shape: Shape) -> Estimate:
        """See `fuse_origins`."""
        return fuse_origins(layers, shape)

    def moved(self, drawing: Estimate, anchor: Anchor, frame: GridFrame) -> Estimate:
        """Resample a submap at its corrected pose, lifted as its anchor was."""
        row, col, inside = drawn_cells(anchor, frame)
        # The nearest drawn cell lies up to half a cell off, both ways.
        slope = slope_of(drawing.elevation_m, frame.cell_m)
        rounded = drawing.variance_m2 + slope * slope * frame.cell_m**2 / 12.0
        lift_m = anchor.corrected.z_m - anchor.pose.z_m
        return Estimate(
            np.where(inside, drawing.elevation_m[row, col] + lift_m, np.nan),
            np.where(inside, rounded[row, col], np.inf),
            np.where(inside, drawing.looks[row, col], 0).astype(np.uint16),
        )

    def blurred(
        self,
        drawing: Estimate,
        anchor: Anchor,
        frame: GridFrame,
        window: Window = EVERYWHERE,
        beside: Beside[Estimate] = ALONE,
    ) -> Estimate:
        """Add the anchor's covariance to each cell's (`cell_variance`)."""
        elevation, variance, looks = _arrays(drawing)
        out = np.empty(elevation.shape)
        corner_m, at_m = (frame.x_m, frame.y_m), (anchor.corrected.x_m, anchor.corrected.y_m)
        rows, cols = (part.indices(n) for part, n in zip(window, frame.shape, strict=True))
        edges = _edges(elevation, beside, frame, rows[:2], cols[:2])
        first = (rows[0], cols[0])
        fill_blurred(
            elevation, variance, edges, frame.cell_m, corner_m, first, at_m, anchor.variance, out
        )
        return Estimate(elevation, out, looks)

    def bits(self, estimate: Estimate) -> float:
        """See `Estimate.information_bits`."""
        return estimate.information_bits(self.prior_sigma_m)

    def restored(self, frame: GridFrame, anchor: Anchor, cells: list[bytes]) -> Submap:
        """Return the submap that `Submap.cells` wrote."""
        where_data, information, weighted_z, looks = cells
        submap = Submap(frame, anchor)
        where = np.frombuffer(where_data, np.int32)
        submap.information.ravel()[where] = np.frombuffer(information)
        submap.weighted_z.ravel()[where] = np.frombuffer(weighted_z)
        submap.looks.ravel()[where] = np.frombuffer(looks, np.uint16)
        return submap


Edges = tuple[Floats, Floats, Floats, Floats]


def _edges(
    elevation_m: Floats,
    beside: Beside[Estimate],
    frame: GridFrame,
    rows: tuple[int, int],
    cols: tuple[int, int],
) -> Edges:
    """Return the elevations next to a window in the south, north, west and east.

    Beyond the map's edge they are the window's own; where nothing is drawn they are NaN.
    """
    south, north, west, east = (None if one is None else one.elevation_m for one in beside)
    height, width = elevation_m.shape
    return (
        elevation_m[0] if rows[0] == 0 else _edge(south, np.s_[-1], width),
        elevation_m[-1] if rows[1] == frame.rows else _edge(north, np.s_[0], width),
        np.ascontiguousarray(
            elevation_m[:, 0] if cols[0] == 0 else _edge(west, np.s_[:, -1], height)
        ),
        np.ascontiguousarray(
            elevation_m[:, -1] if cols[1] == frame.cols else _edge(east, np.s_[:, 0], height)
        ),
    )


def _edge(elevation_m: Floats | None, where: Any, length: int) -> Floats:
    return np.full(length, np.nan) if elevation_m is None else elevation_m[where]


def _estimate_of(tile: DecodedTile) -> Estimate:
    sigma = tile.sigma_m.astype(np.float64)
    variance = np.where(tile.known, sigma**2 + tile.bound_m**2 * UNIFORM, np.inf)
    elevation = np.where(tile.known, tile.elevation_m.astype(np.float64), np.nan)
    return Estimate(elevation, variance, tile.known.astype(np.uint16))


def relief_sigma_m(team: "TeamMap[Submap, Estimate]") -> Floats:
    """Return each cell's standard deviation (inf unknown) against the ground next to it."""
    return np.sqrt(team.relative().variance_m2)
