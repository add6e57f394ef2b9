"""The map codec: elevation grids in few bytes, every known cell within a stated bound.

Two forms share one model. `encode_grid` makes a whole map as small as it gets. `encode_tile` makes
one progressive payload for the radio: cut after any byte, it decodes to the last level that is
whole, and each level states a bound that holds for every cell that it calls known. A tile's next
version can be told by what changed since the one before (`base`).

Elevations are float32 when decoded, and the bounds hold for these: the encoder compares what the
decoder will give with what it was given, never with what it should be. Unknown cells are NaN.

Occupancy has the same two forms, `encode_occupancy` and `encode_occupancy_tile`, for planar grids
and for blocks of voxels. Log odds come back as one of a few classes, never surer than they were
given; where a cell is not known they are 0.
"""

import numpy as np
from numpy.typing import NDArray

from comms.blocks import block_max, spread
from comms.errors import CodecError
from comms.gridcode import decode_grid, decode_grid_sigma, encode_grid
from comms.occupancy.grid import decode_occupancy, encode_occupancy, log_odds_as_sent
from comms.occupancy.tile import DecodedOccupancy, decode_occupancy_tile, encode_occupancy_tile
from comms.sigmacode import code_of, sigma_of
from comms.tilecode import decode_tile, encode_tile
from comms.tilelevels import SIGMA_BLOCK
from comms.tiletypes import DecodedTile, EncodedTile, NeedsBaseError

__all__ = [
    "CodecError",
    "DecodedOccupancy",
    "DecodedTile",
    "EncodedTile",
    "NeedsBaseError",
    "decode_grid",
    "decode_grid_sigma",
    "decode_occupancy",
    "decode_occupancy_tile",
    "decode_tile",
    "encode_grid",
    "encode_occupancy",
    "encode_occupancy_tile",
    "encode_tile",
    "log_odds_as_sent",
    "sigma_as_sent",
]


def sigma_as_sent(sigma_m: NDArray[np.float64], known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the standard deviations (H, W) that a receiver of the last level would be told.

    For whole maps too, whose tiles have sides of a multiple of the blocks that sigmas share.
    """
    codes = block_max(code_of(sigma_m, known), SIGMA_BLOCK)
    return sigma_of(spread(codes, SIGMA_BLOCK, *known.shape)).astype(np.float64)
