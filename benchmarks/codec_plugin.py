"""The map codec as a plug-in for a table of error-bounded codecs (`--plugin`).

A codec there is any object with a name, `encode(z, known, eps) -> bytes` and
`decode(bytes) -> (z, known)`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comms.codec import decode_grid, decode_tile, encode_grid, encode_tile

Grid = NDArray[np.floating]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class GridCodec:
    name: str = "ropeteam grid"
    ideal: None = None
    bounded: bool = True
    slow: bool = False

    def encode(self, z: Grid, known: Bools, eps: float) -> bytes:
        return encode_grid(z, known, eps)

    def decode(self, data: bytes) -> tuple[Grid, Bools]:
        return decode_grid(data)


@dataclass(frozen=True)
class TileCodec:
    """The progressive payload, with a standard deviation of 0.01 m for every cell."""

    name: str = "ropeteam tile (progressive)"
    ideal: None = None
    bounded: bool = True
    slow: bool = False

    def encode(self, z: Grid, known: Bools, eps: float) -> bytes:
        return encode_tile(z, known, np.full(z.shape, 0.01), eps).data

    def decode(self, data: bytes) -> tuple[Grid, Bools]:
        tile = decode_tile(data)
        return tile.elevation_m, tile.known


def grid() -> GridCodec:
    return GridCodec()


def tile() -> TileCodec:
    return TileCodec()
