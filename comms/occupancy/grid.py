"""Whole occupancy maps: one level, as small as it gets."""

import numpy as np
from numpy.typing import NDArray

from comms.errors import CodecError
from comms.occupancy.classes import UNKNOWN, Symbols, log_odds_of, symbols_of
from comms.occupancy.field import Palette, blank, palette_of
from comms.occupancy.levels import Models, Shape, code_level, code_palette, symbols_told
from comms.rangecoder import Mark, decoder, encoder, is_whole
from comms.scales import Fields

Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]

LARGEST_SIDE, LARGEST_BLOCK = 4096, 128
"""Rows and columns of a planar map; layers, rows and columns of a voxel block."""
BYTES_PER_CELL = 12
"""More than a cell and its share of the blocks can take."""
_SIDE_BITS, _BLOCK_BITS = 12, 7
_LADDERS = ((1,), (16, 1)), ((1,), (8, 1))
"""Sides of the blocks before the cells, of planes and of voxels: none, or large ones."""
_FEW_CELLS = 40_000
"""Up to so many cells it is tried whether blocks pay; beyond they do, if only in time."""


def check_map(
    log_odds: NDArray[np.floating], known: Bools, largest_side: int, largest_block: int
) -> Symbols:
    """Return the symbols (layers, rows, cols) of a map, or say what is wrong with it."""
    shape = log_odds.shape
    if shape != known.shape:
        raise CodecError(f"log odds {shape} and mask {known.shape} must be one map")
    largest = {2: largest_side, 3: largest_block}.get(len(shape), 0)
    if largest == 0 or not (min(shape) >= 1 and max(shape) <= largest):
        raise CodecError(
            f"a map of {shape} cells is neither a plane of up to {largest_side}x{largest_side} "
            f"nor a block of up to {largest_block}x{largest_block}x{largest_block}"
        )
    symbols = symbols_of(log_odds, known.astype(np.bool_))
    return np.ascontiguousarray(symbols.reshape((1,) * (3 - len(shape)) + shape))


def log_odds_as_sent(log_odds: NDArray[np.floating], known: Bools) -> Singles:
    """Return the log odds (any shape) that a receiver of everything would be told; 0 if unknown."""
    return log_odds_of(symbols_of(log_odds, known))


def encode_occupancy(log_odds: NDArray[np.floating], known: Bools) -> bytes:
    """Return a payload from which the mask comes back exactly and log odds as `SIZES` has them.

    `log_odds` of occupancy, read only where `known`: a plane (rows, cols) of up to 4096 x 4096
    cells or a block (layers, rows, cols) of up to 128 x 128 x 128.
    Raises `CodecError` where the arguments make no sense.
    """
    symbols = check_map(log_odds, known, LARGEST_SIDE, LARGEST_BLOCK)
    choices = (0, 1) if symbols.size <= _FEW_CELLS and symbols.any() else (1,)
    return min((_write(symbols, log_odds.ndim == 3, ladder) for ladder in choices), key=len)


def decode_occupancy(data: bytes) -> tuple[Singles, Bools]:
    """Return log odds, 0 where unknown, and the mask of known cells, in the shape encoded.

    Raises `CodecError` for bytes that are no payload of `encode_occupancy`.
    """
    fields = Fields(decoder(data))
    is_block = fields.bits(1) == 1
    shape = _code_shape(fields, is_block, (1, 1, 1))
    symbols = np.full(shape, UNKNOWN, np.uint8)
    if fields.bits(1):
        palette = code_palette(fields, None)
        symbols = _code_cells(fields, is_block, palette, shape, fields.bits(1), None)
    if not is_whole(fields.coder):
        raise CodecError(f"{len(data)} bytes are not what a map of {shape} cells takes")
    symbols = symbols if is_block else symbols[0]
    return log_odds_of(symbols), symbols != UNKNOWN


def _write(symbols: Symbols, is_block: bool, ladder: int) -> bytes:
    fields = Fields(encoder(symbols.size * BYTES_PER_CELL))
    fields.bits(1, int(is_block))
    _code_shape(fields, is_block, symbols.shape)
    if fields.bits(1, int(bool(symbols.any()))):
        palette = code_palette(fields, palette_of(symbols))
        _code_cells(fields, is_block, palette, symbols.shape, fields.bits(1, ladder), symbols)
    return Mark(fields.coder).finish(length_is_known=True)


def _code_shape(fields: Fields, is_block: bool, shape: Shape) -> Shape:
    layers, rows, cols = shape
    if is_block:
        layers, rows, cols = (fields.bits(_BLOCK_BITS, length - 1) + 1 for length in shape)
        return layers, rows, cols
    return 1, fields.bits(_SIDE_BITS, rows - 1) + 1, fields.bits(_SIDE_BITS, cols - 1) + 1


def _code_cells(
    fields: Fields,
    is_block: bool,
    palette: Palette,
    shape: Shape,
    ladder: int,
    truth: Symbols | None,
) -> Symbols:
    models, field = Models.fresh(shape, palette), blank(shape)
    for side in _LADDERS[is_block][ladder]:
        code_level(fields.coder, models, palette, field, side, truth)
    return symbols_told(field)
