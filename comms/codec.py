"""The map codec: elevation grids in few bytes, every known cell within a stated bound.

Two forms share one model. `encode_grid` makes a whole map as small as it gets. `encode_tile` makes
one progressive payload for the radio: cut after any byte, it decodes to the last level that is
whole, and each level states a bound that holds for every cell that it calls known.

Elevations are float32 when decoded, and the bounds hold for these: the encoder compares what the
decoder will give with what it was given, never with what it should be. Unknown cells are NaN.
"""

from comms.errors import CodecError
from comms.gridcode import decode_grid, decode_grid_sigma, encode_grid
from comms.tilecode import DecodedTile, EncodedTile, decode_tile, encode_tile, sigma_as_sent

__all__ = [
    "CodecError",
    "DecodedTile",
    "EncodedTile",
    "decode_grid",
    "decode_grid_sigma",
    "decode_tile",
    "encode_grid",
    "encode_tile",
    "sigma_as_sent",
]
