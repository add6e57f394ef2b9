"""How a tile of the map is written for the air and read again: one form per sharing policy.

A payload may be cut anywhere; what is decoded of a prefix is what its whole levels tell.
"""

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Bools, Floats
from comms.codec import CodecError, DecodedTile, EncodedTile, decode_tile, encode_tile
from comms.papercode import decode_paper_map, encode_paper_map
from comms.sigmacode import HIGHEST, LOWEST, code_of, sigma_of


class Payloads(Protocol):
    """One way of writing tiles."""

    def encode(
        self, elevation_m: Floats, known: Bools, sigma_m: Floats, max_error_m: float
    ) -> EncodedTile:
        """Return the payload of a tile (rows, cols), of which the `known` cells count."""
        ...

    def decode(self, prefix: bytes, shape: tuple[int, int]) -> DecodedTile | None:
        """Return what a prefix tells of a tile (rows, cols); None where it is no such payload."""
        ...


class Pyramid:
    """The project's own: progressive, every level with its bound (`comms.codec`)."""

    def encode(
        self, elevation_m: Floats, known: Bools, sigma_m: Floats, max_error_m: float
    ) -> EncodedTile:
        """See `comms.codec.encode_tile`."""
        return encode_tile(elevation_m, known, sigma_m, max_error_m)

    def decode(self, prefix: bytes, shape: tuple[int, int]) -> DecodedTile | None:
        """See `comms.codec.decode_tile`."""
        try:
            tile = decode_tile(prefix)
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

    def decode(self, prefix: bytes, shape: tuple[int, int]) -> DecodedTile | None:
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

    def decode(self, prefix: bytes, shape: tuple[int, int]) -> DecodedTile | None:
        """Return the whole map, or nothing of it."""
        try:
            paper = decode_paper_map(prefix, max_cells=shape[0] * shape[1])
        except CodecError:
            return None
        if paper.known.shape != shape or paper.sigma_m is None:
            return None
        return DecodedTile(paper.elevation_m, paper.known, paper.sigma_m, 0.0, 0, 1)
