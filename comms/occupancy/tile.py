"""Occupancy for the radio: one progressive payload, coarse blocks before finer ones and cells.

A level tells the blocks whose cells are all known and all free, or all occupied, with the least of
their log odds: what it calls known is known, and it tells no cell more than the sender knew. Later
levels add blocks and certainty; the last is exact in mask and classes.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comms.errors import CodecError
from comms.occupancy.classes import UNKNOWN, Symbols, log_odds_of
from comms.occupancy.field import Palette, blank, palette_of
from comms.occupancy.grid import BYTES_PER_CELL, check_map
from comms.occupancy.levels import Models, Shape, code_level, code_palette, symbols_told
from comms.rangecoder import Mark, decoder, encoder, is_certain
from comms.scales import Fields
from comms.tilecode import EncodedTile

Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]

LARGEST_TILE, LARGEST_BLOCK = 128, 64
"""Rows and columns of a planar tile; layers, rows and columns of a block of voxels."""
LADDERS = ((1,), (4, 1), (8, 1), (8, 2, 1), (8, 4, 1), (8, 4, 2, 1))
"""Sides of the blocks, level by level, by the code that a payload says."""
_LADDER_BITS = 3
_PREFERRED = (5, 4, 3, 1, 2)
_BYTES_WORTH_LEVELS = {2: 60, 3: 110, 4: 250}
"""Sizes of a payload of one level from which more are worth their overhead."""
_MOST_OVERHEAD = 1.1
_LEAST_FIRST_SHARE = 0.05
"""Share of the known cells that a first level has to tell."""


@dataclass(frozen=True)
class DecodedOccupancy:
    """What a prefix of a payload tells: arrays in the shape and order as encoded."""

    log_odds: Singles
    """Never further from 0 than what was encoded, nor of the other sign; 0 where not known."""
    known: Bools
    level: int
    """The last level that is whole, or -1."""
    levels: int
    """How many levels the payload has; 0 where not even that is certain."""


def encode_occupancy_tile(log_odds: NDArray[np.floating], known: Bools) -> EncodedTile:
    """Return a tile's payload: any prefix of it decodes to the last level that it holds.

    `log_odds` of occupancy, read only where `known`: (rows, cols) of up to 128 x 128 cells or
    (layers, rows, cols) of up to 64 x 64 x 64. It has one level more only where all levels together
    take at most a tenth more bytes than a single one.
    Raises `CodecError` where the arguments make no sense.
    """
    symbols = check_map(log_odds, known, LARGEST_TILE, LARGEST_BLOCK)
    is_block = log_odds.ndim == 3
    single, _ = _write(symbols, is_block, 0)
    size = len(single.data)
    for code in _PREFERRED:
        levels = len(LADDERS[code])
        if size >= _BYTES_WORTH_LEVELS[levels]:
            tile, first_share = _write(symbols, is_block, code)
            is_small = len(tile.data) <= _MOST_OVERHEAD * size
            all_tell = len(set(tile.level_ends)) == levels and first_share >= _LEAST_FIRST_SHARE
            if is_small and all_tell:
                return tile
    return single


def decode_occupancy_tile(prefix: bytes) -> DecodedOccupancy:
    """Return what the last whole level of a payload's prefix tells; of any prefix, even none.

    Raises `CodecError` for bytes that begin no payload of `encode_occupancy_tile`.
    """
    fields = Fields(decoder(prefix))
    is_block = fields.bits(1) == 1
    shape = _code_shape(fields, is_block, (1, 1, 1))
    code = fields.bits(_LADDER_BITS)
    is_any = fields.bits(1)
    palette = code_palette(fields, None) if is_any else Palette(0, 0, 0, 0)
    if not is_certain(fields.coder):
        return _picture(np.zeros((1, 1, 1), np.uint8), False, -1, 0)
    _refuse_unless_possible(is_block, shape, code)
    if not is_any:
        return _picture(np.zeros(shape, np.uint8), is_block, 0, 1)
    models, field = Models.fresh(shape, palette), blank(shape)
    told, level = np.full(shape, UNKNOWN, np.uint8), -1
    for side in LADDERS[code]:
        code_level(fields.coder, models, palette, field, side, None)
        if not is_certain(fields.coder):
            break
        told, level = symbols_told(field), level + 1
    return _picture(told, is_block, level, len(LADDERS[code]))


def _picture(symbols: Symbols, is_block: bool, level: int, levels: int) -> DecodedOccupancy:
    symbols = symbols if is_block else symbols[0]
    return DecodedOccupancy(log_odds_of(symbols), symbols != UNKNOWN, level, levels)


def _write(symbols: Symbols, is_block: bool, code: int) -> tuple[EncodedTile, float]:
    """Return a payload, and the share of the known cells that its first level tells."""
    fields = Fields(encoder(symbols.size * BYTES_PER_CELL))
    fields.bits(1, int(is_block))
    _code_shape(fields, is_block, symbols.shape)
    is_any = bool(symbols.any())
    fields.bits(_LADDER_BITS, code)
    fields.bits(1, int(is_any))
    if not is_any:
        data = Mark(fields.coder).finish(length_is_known=False)
        return EncodedTile(data, (len(data),)), 0.0
    palette = code_palette(fields, palette_of(symbols))
    models, field = Models.fresh(symbols.shape, palette), blank(symbols.shape)
    marks: list[Mark] = []
    shares: list[float] = []
    for side in LADDERS[code]:
        code_level(fields.coder, models, palette, field, side, symbols)
        marks.append(Mark(fields.coder))
        shares.append(np.count_nonzero(symbols_told(field)) / np.count_nonzero(symbols))
    data = marks[-1].finish(length_is_known=False)
    return EncodedTile(data, tuple(mark.bytes_needed(data) for mark in marks)), shares[0]


def _refuse_unless_possible(is_block: bool, shape: Shape, code: int) -> None:
    if code >= len(LADDERS):
        raise CodecError(f"levels of kind {code} are not one of the {len(LADDERS)} that there are")
    if is_block and max(shape) > LARGEST_BLOCK:
        raise CodecError(f"a block of {shape} voxels is larger than {LARGEST_BLOCK} a side")


def _code_shape(fields: Fields, is_block: bool, shape: Shape) -> Shape:
    """Code the lengths of a tile: 4 bits if they are one power of two."""
    used = shape if is_block else shape[1:]
    is_cube = len(set(used)) == 1 and used[0].bit_count() == 1
    if fields.bits(1, int(is_cube)):
        side = 1 << fields.bits(3, used[0].bit_length() - 1)
        return (side if is_block else 1), side, side
    lengths = [fields.bits(6 if is_block else 7, length - 1) + 1 for length in used]
    return (lengths[0] if is_block else 1), lengths[-2], lengths[-1]
