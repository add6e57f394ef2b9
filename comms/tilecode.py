"""Tiles for the radio: one progressive payload, coarse first, every level with its bound.

Level by level the lattice of sent cells gets finer; the cells between are interpolated. A level
calls known the blocks of cells that are wholly measured and whose interpolation, at this level and
at every later one, is within the level's bound; the encoder picks the bound that tells most. At the
last level all known cells are sent, within the error bound that was asked for, under the exact
mask.

The first levels send the mask on their lattice only; the one before the last sends all of it.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from comms.blocks import block_max, spread
from comms.errors import CodecError
from comms.gridcode import check_grid
from comms.pyramid import BYTES_PER_CELL, best_profile
from comms.rangecoder import Mark, decoder, encoder, is_certain
from comms.scales import Bound, Fields, bound_for, bounded, rounding_m, spans_units
from comms.sigmacode import code_of, sigma_of
from comms.tilebase import decode_on, encode_on
from comms.tilelevels import (
    SIGMA_BLOCK,
    Head,
    Models,
    Tile,
    Truth,
    bound_of_level,
    code_head,
    code_level,
)
from comms.tileplan import plan_levels
from comms.tiletypes import DecodedTile, EncodedTile

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]
Flags = NDArray[np.uint8]
Codes = NDArray[np.int64]

LARGEST_TILE = 128
_BYTES_WORTH_LEVELS = (60, 110, 250)
"""Sizes of a payload of one level from which 2, 3 and 4 are worth their overhead."""
_BITS_PER_CELL = 1.0
"""A version built on the one before that takes no more is not held against a whole one, unless it
has more new cells than old ones."""
_LEAST_FIRST_SHARE = 0.05
"""Share of the known cells that a first level has to tell."""
_MOST_OVERHEAD = 1.1
"""Times the bytes of a single level that levels may take."""


def encode_tile(
    elevation_m: NDArray[np.floating],
    known: Bools,
    sigma_m: NDArray[np.floating],
    max_error_m: float,
    *,
    base: DecodedTile | None = None,
    alone: bool = False,
) -> EncodedTile:
    """Return a tile's payload: any prefix of it decodes to the last level that it holds.

    `elevation_m`, `sigma_m` (H, W) metres, read only where `known` (H, W); up to 128 x 128 cells.
    `base`: the whole version before, as decoded. The payload is then built on it where that is
    shorter (`needs_base`), unless it has to stand `alone`; either way no cell is told less surely
    than `base` told it, as long as it has not become less sure.
    Raises `CodecError` where float32 cannot hold the bound, or the arguments make no sense.
    """
    values = check_grid(elevation_m, known, max_error_m)
    if max(values.shape) > LARGEST_TILE:
        raise CodecError(f"a tile of {values.shape} cells is outside 1x1..128x128")
    if sigma_m.shape != values.shape:
        raise CodecError(f"elevation {values.shape} and sigma {sigma_m.shape} must be one tile")
    if base is not None and not (base.is_whole and base.known.shape == values.shape):
        raise CodecError(f"a base has to be whole, and of {values.shape} cells")
    known = np.ascontiguousarray(known)
    codes = code_of(sigma_m.astype(np.float64), known)
    bound = bound_for(max_error_m, rounding_m(values), 2)
    if bound is not None and spans_units(values, bounded(bound)):
        tile = None
        if base is not None and not alone:
            tile = encode_on(base, values, known, codes, bound)
            if tile is not None and _is_short(tile, known, base):
                return tile
        whole = _encode_at(values, known, codes, bound, *split_blocks(codes, known, base))
        best = tile if whole is None or (tile and len(tile.data) < len(whole.data)) else whole
        if best is not None:
            return best
    raise CodecError(
        f"float32 cannot hold elevations of up to {np.abs(values).max():g} m "
        f"within {max_error_m:g} m"
    )


def decode_tile(prefix: bytes, base: DecodedTile | None = None) -> DecodedTile:
    """Return what the last whole level of a payload's prefix tells; of any prefix, even none.

    `base`: the version that the payload was built on, decoded whole, if it was built on one.
    Raises `NeedsBaseError` where that is missing or another one, `CodecError` for bytes that begin
    no payload of `encode_tile`.
    """
    fields = Fields(decoder(prefix))
    if fields.bits(1):
        return decode_on(fields, base) or _nothing((1, 1), 0)
    head = code_head(fields, None)
    if not is_certain(fields.coder):
        return _nothing((1, 1), 0)
    if not 0 < head.bound.metres < 1e32:
        raise CodecError(f"an error bound of {head.bound.metres} m is not possible")
    tile, models, result = Tile.blank(head), Models(), _nothing(head.shape, head.levels)
    for level in range(head.levels):
        code = code_level(fields, models, tile, level, head.levels, None)
        if not is_certain(fields.coder):
            break
        result = _picture(tile, bound_of_level(head.bound, code), level, head.levels)
    return result


def _is_short(tile: EncodedTile, known: Bools, base: DecodedTile) -> bool:
    """Say whether a whole payload need not be tried."""
    count = int(np.count_nonzero(known))
    is_mostly_old = count <= 2 * int(np.count_nonzero(base.known))
    return is_mostly_old and 8 * len(tile.data) <= _BITS_PER_CELL * count


def split_blocks(codes: Codes, known: Bools, base: DecodedTile | None) -> tuple[Flags, Codes]:
    """Return the blocks that would tell a cell less surely than `base` did, and what to tell."""
    blocks = block_max(codes, SIGMA_BLOCK)
    shared = spread(blocks, SIGMA_BLOCK, *known.shape)
    if base is None:
        return np.zeros(blocks.shape, np.uint8), shared
    before = np.maximum(code_of(base.sigma_m.astype(np.float64), base.known), codes)
    worse = base.known & known & (shared > before)
    split = block_max(worse.astype(np.uint8), SIGMA_BLOCK)
    return split, np.where(worse, before, shared)


def _nothing(shape: tuple[int, int], levels: int) -> DecodedTile:
    empty = np.full(shape, np.nan, np.float32)
    return DecodedTile(empty, np.zeros(shape, np.bool_), empty.copy(), math.inf, -1, levels)


def _picture(tile: Tile, bound_m: float, level: int, levels: int) -> DecodedTile:
    known = tile.told.astype(np.bool_)
    painted_m = tile.scale.metres(tile.pyramid.painted())
    elevation_m = np.where(known, painted_m, np.float32(np.nan))
    if not np.isfinite(elevation_m[known]).all():
        raise CodecError("an elevation in the bytes is not finite")
    sigma_m = sigma_of(tile.cells)
    sigma_m = np.where(known, sigma_m, np.float32(np.nan))
    bound_m = bound_m if known.any() else math.inf
    return DecodedTile(elevation_m, known, sigma_m, bound_m, level, levels)


def _encode_at(
    values: Floats, known: Bools, codes: Codes, bound: Bound, split: Flags, told_codes: Codes
) -> EncodedTile | None:
    """Return the payload with this bound, or None if float32 breaks it.

    It has fewer levels where the first would tell next to nothing, or one would add no byte.
    """
    base = round(float(np.median(values[known])) / bounded(bound).step_m) if known.any() else 0
    head = Head(known.shape, bound, 1, 0, bool(known.all()), base)
    mask = known.astype(np.uint8)
    blocks = block_max(codes, SIGMA_BLOCK)
    truth = Truth(head.scale.units(values), mask, blocks, mask, 0, split, told_codes)
    head = replace(head, profile=best_profile(truth.mask, truth.y))
    tile = write(head, [truth])
    single = len(tile.data)
    most = 1 + sum(single >= least for least in _BYTES_WORTH_LEVELS)
    for levels in range(most, 0, -1):
        head = replace(head, levels=levels)
        errors_m = rehearse(values, truth, head)
        if errors_m[-1][known].max(initial=0.0) > bound.metres:
            return None
        plan = plan_levels(errors_m, known, bound, levels)
        tile = write(head, [replace(truth, told=told, bound_code=code) for code, told in plan])
        first_share = float(plan[0][1].sum()) / max(int(known.sum()), 1)
        is_progress = first_share >= _LEAST_FIRST_SHARE and len(set(tile.level_ends)) == levels
        if levels == 1 or (is_progress and len(tile.data) <= _MOST_OVERHEAD * single):
            break
    return tile


def write(head: Head, truths: list[Truth]) -> EncodedTile:
    """Return the payload whose levels tell what `truths` say."""
    fields = Fields(encoder(head.shape[0] * head.shape[1] * BYTES_PER_CELL))
    models, tile = Models(), Tile.blank(head)
    fields.bits(1, 0)
    code_head(fields, head)
    marks: list[Mark] = []
    for level, truth in enumerate(truths):
        code_level(fields, models, tile, level, head.levels, truth)
        marks.append(Mark(fields.coder))
    data = marks[-1].finish(length_is_known=False)
    return EncodedTile(data, tuple(mark.bytes_needed(data) for mark in marks))


def rehearse(values: Floats, truth: Truth, head: Head) -> list[Floats]:
    """Return the error of every cell (H, W) as a receiver will see it at each level, metres."""
    fields = Fields(encoder(values.size * BYTES_PER_CELL))
    models, tile = Models(), Tile.blank(head)
    nothing = replace(truth, told=np.zeros_like(truth.told))
    errors: list[Floats] = []
    for level in range(head.levels):
        code_level(fields, models, tile, level, head.levels, nothing)
        painted_m = tile.scale.metres(tile.pyramid.painted())
        errors.append(np.abs(painted_m.astype(np.float64) - values))
    return errors
