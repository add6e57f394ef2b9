"""How a tile of the map is written for the air and read again: one form per sharing policy.

A payload may be cut anywhere; what is decoded of a prefix is what its whole levels tell.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Bools, Floats
from agents.recall import RECALL
from agents.tiles import Shape
from comms.codec import (
    CodecError,
    DecodedTile,
    EncodedTile,
    decode_occupancy_tile,
    decode_tile,
    encode_occupancy_tile,
    encode_tile,
    log_odds_as_sent,
)
from comms.papercode import decode_paper_map, encode_paper_map
from comms.sigmacode import HIGHEST, LOWEST, code_of, sigma_of


class Payloads(Protocol):
    """One way of writing tiles."""

    def encode(
        self, elevation_m: Floats, known: Bools, sigma_m: Floats, max_error_m: float
    ) -> EncodedTile:
        """Return the payload of a tile (rows, cols), of which the `known` cells count."""
        ...

    def decode(self, prefix: bytes, shape: Shape) -> DecodedTile | None:
        """Return what a prefix tells of a tile (rows, cols); None where it is no such payload."""
        ...


class Pyramid:
    """The project's own: progressive, every level with its bound (`comms.codec`)."""

    def encode(
        self, elevation_m: Floats, known: Bools, sigma_m: Floats, max_error_m: float
    ) -> EncodedTile:
        """See `comms.codec.encode_tile`."""
        return encode_tile(elevation_m, known, sigma_m, max_error_m)

    def decode(self, prefix: bytes, shape: Shape) -> DecodedTile | None:
        """See `comms.codec.decode_tile`."""
        try:
            tile = RECALL.of(decode_tile, prefix)
        except CodecError:
            return None
        return tile if tile.level < 0 or tile.known.shape == shape else None


RUN = 16
"""Cells that share one standard deviation in a raw payload."""


class Raw:
    """Float32 elevations, row by row, NaN where unknown; for comparison.

    Each run of 16 cells is preceded by one byte, its largest standard deviation in half octaves:
    without one nothing that is heard could be fused.
    """

    def encode(
        self, elevation_m: Floats, known: Bools, sigma_m: Floats, max_error_m: float
    ) -> EncodedTile:
        """Return the payload; the bound is not used: floats are sent whole."""
        del max_error_m
        cells = np.where(known, elevation_m, np.nan).astype("<f4").ravel()
        codes = code_of(sigma_m, known).ravel() - LOWEST
        out = bytearray()
        for start in range(0, cells.size, RUN):
            out.append(int(codes[start : start + RUN].max()))
            out += cells[start : start + RUN].tobytes()
        return EncodedTile(bytes(out), tuple(_run_ends(cells.size)))

    def decode(self, prefix: bytes, shape: Shape) -> DecodedTile | None:
        """Return the cells of all runs that are whole."""
        size = shape[0] * shape[1]
        cells = np.full(size, np.nan, dtype=np.float32)
        codes = np.zeros(size, dtype=np.int64)
        ends = _run_ends(size)
        whole = [end for end in ends if end <= len(prefix)]
        start = 0
        for index, end in enumerate(whole):
            run = slice(index * RUN, min((index + 1) * RUN, size))
            codes[run] = min(prefix[start], HIGHEST - LOWEST)
            cells[run] = np.frombuffer(prefix[start + 1 : end], dtype="<f4")
            start = end
        known: NDArray[np.bool_] = np.isfinite(cells).reshape(shape)
        sigma = np.where(known, sigma_of(codes + LOWEST).reshape(shape), np.float32(np.nan))
        elevation = np.where(known, cells.reshape(shape), np.float32(np.nan))
        bound_m = 0.0 if known.any() else math.inf
        return DecodedTile(elevation, known, sigma, bound_m, len(whole) - 1, len(ends))


def _run_ends(cells: int) -> list[int]:
    ends: list[int] = []
    for start in range(0, cells, RUN):
        ends.append((ends[-1] if ends else 0) + 1 + 4 * min(RUN, cells - start))
    return ends


class Paper:
    """The paper's: an entropy quadtree of mean elevations, LZW; for comparison.

    Its error has no bound (`comms.papercode`), and nothing can be read before all has come. The
    spread of a leaf about its mean is in the standard deviations that go with it.
    """

    def encode(
        self, elevation_m: Floats, known: Bools, sigma_m: Floats, max_error_m: float
    ) -> EncodedTile:
        """Return the payload: bins of twice `max_error_m`, a cut-off of half a bit."""
        data = encode_paper_map(elevation_m, known, max_error_m, sigma_m=sigma_m).data
        return EncodedTile(data, (len(data),))

    def decode(self, prefix: bytes, shape: Shape) -> DecodedTile | None:
        """Return the whole map, or nothing of it."""
        try:
            paper = decode_paper_map(prefix, max_cells=shape[0] * shape[1])
        except CodecError:
            return None
        if paper.known.shape != shape or paper.sigma_m is None:
            return None
        return DecodedTile(paper.elevation_m, paper.known, paper.sigma_m, 0.0, 0, 1)


# --- occupancy ------------------------------------------------------------------------------


@dataclass(frozen=True)
class ToldOccupancy:
    """What a payload's prefix tells of a tile: log-odds, 0 where not known."""

    log_odds: Floats
    known: Bools
    level: int
    """The last level that is whole."""


class OccupancyPayloads(Protocol):
    """One way of writing tiles of occupancy log-odds, rounded towards 0 and never away from it.

    A tile is (rows, cols), or (layers, rows, cols) of voxels.
    """

    def encode(self, log_odds: Floats, known: Bools) -> EncodedTile:
        """Return the payload of a tile, of which the `known` cells count."""
        ...

    def decode(self, prefix: bytes, shape: Shape) -> ToldOccupancy | None:
        """Return what a prefix tells of a tile; None where that is nothing."""
        ...

    def as_sent(self, log_odds: Floats, known: Bools) -> Floats:
        """Return the log-odds (any shape) that a receiver of everything would be told."""
        ...


class OccupancyPyramid:
    """The project's own: progressive, coarse blocks before cells (`comms.occupancy.tile`)."""

    def encode(self, log_odds: Floats, known: Bools) -> EncodedTile:
        """See `comms.codec.encode_occupancy_tile`."""
        return encode_occupancy_tile(log_odds, known)

    def decode(self, prefix: bytes, shape: Shape) -> ToldOccupancy | None:
        """See `comms.codec.decode_occupancy_tile`."""
        try:
            tile = RECALL.of(decode_occupancy_tile, prefix)
        except CodecError:
            return None
        if tile.level < 0 or tile.known.shape != shape:
            return None
        return ToldOccupancy(tile.log_odds.astype(np.float64), tile.known, tile.level)

    def as_sent(self, log_odds: Floats, known: Bools) -> Floats:
        """See `comms.codec.log_odds_as_sent`."""
        return log_odds_as_sent(log_odds, known).astype(np.float64)


LOG_ODDS_STEP = 0.05
"""Raw log-odds travel in steps of this, a byte each."""
UNKNOWN_BYTE = -128


class RawOccupancy:
    """A byte per cell, row by row: log-odds in steps of 0.05, -128 unknown; for comparison."""

    def encode(self, log_odds: Floats, known: Bools) -> EncodedTile:
        """Return the payload; every cell is a level."""
        steps = np.where(known, _raw_steps(log_odds), UNKNOWN_BYTE).astype(np.int8)
        return EncodedTile(steps.tobytes(), tuple(range(1, steps.size + 1)))

    def decode(self, prefix: bytes, shape: Shape) -> ToldOccupancy | None:
        """Return the cells that came."""
        cells = np.full(math.prod(shape), UNKNOWN_BYTE, dtype=np.int8)
        if not 0 < len(prefix) <= cells.size:
            return None
        cells[: len(prefix)] = np.frombuffer(prefix, np.int8)
        known = cells.reshape(shape) != UNKNOWN_BYTE
        log_odds = np.where(known, cells.reshape(shape) * LOG_ODDS_STEP, 0.0)
        return ToldOccupancy(log_odds, known, len(prefix) - 1)

    def as_sent(self, log_odds: Floats, known: Bools) -> Floats:
        """Return log-odds rounded towards 0."""
        return np.where(known, _raw_steps(log_odds) * LOG_ODDS_STEP, 0.0)


def _raw_steps(log_odds: Floats) -> Floats:
    # A hair towards 0: a value that was sent before is sent as the same step again.
    steps = np.trunc(log_odds / LOG_ODDS_STEP + np.sign(log_odds) * 1e-6)
    return np.clip(steps, UNKNOWN_BYTE + 1, -UNKNOWN_BYTE - 1)
