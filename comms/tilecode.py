"""Tiles for the radio: one progressive payload, coarse first, every level with its bound.

Level by level the lattice of sent cells gets finer; the cells between are interpolated. A level
calls known the blocks of cells that are wholly measured and whose interpolation, at this level and
at every later one, is within the level's bound; the encoder picks the bound that tells most. At the
last level all known cells are sent, within the error bound that was asked for, under the exact
mask.

The first levels send the mask on their lattice only; the one before the last sends all of it.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comms.blocks import block_max, spread
from comms.errors import CodecError
from comms.gridcode import check_grid
from comms.pyramid import BYTES_PER_CELL, best_profile
from comms.rangecoder import Mark, decoder, encoder, is_certain
from comms.scales import Bound, Fields, bound_for, bounded, rounding_m, spans_units
from comms.sigmacode import code_of, sigma_of
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

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]
Flags = NDArray[np.uint8]
Codes = NDArray[np.int64]

LARGEST_TILE = 128
_BYTES_WORTH_LEVELS = (60, 110, 250)
"""Sizes of a payload of one level from which 2, 3 and 4 are worth their overhead."""
_LEAST_FIRST_SHARE = 0.05
"""Share of the known cells that a first level has to tell."""


@dataclass(frozen=True)
class EncodedTile:
    """One progressive payload; `data[: level_ends[k]]` decodes to level k."""

    data: bytes
    level_ends: tuple[int, ...]


@dataclass(frozen=True)
class DecodedTile:
    """What a prefix of a payload tells: arrays (H, W), row order as encoded, lengths in metres."""

    elevation_m: Singles
    """NaN where not (yet) known."""
    known: Bools
    sigma_m: Singles
    """Never below the standard deviation that was encoded; NaN where not known."""
    bound_m: float
    """Largest elevation error of the known cells; infinite where none is."""
    level: int
    """The last level that is whole, or -1."""
    levels: int
    """How many levels the payload has; 0 where not even that is certain."""


def encode_tile(
    elevation_m: NDArray[np.floating],
    known: Bools,
    sigma_m: NDArray[np.floating],
    max_error_m: float,
) -> EncodedTile:
    """Return a tile's payload: any prefix of it decodes to the last level that it holds.

    `elevation_m`, `sigma_m` (H, W) metres, read only where `known` (H, W); up to 128 x 128 cells.
    Raises `CodecError` where float32 cannot hold the bound, or the arguments make no sense.
    """
    values = check_grid(elevation_m, known, max_error_m)
    if max(values.shape) > LARGEST_TILE:
        raise CodecError(f"a tile of {values.shape} cells is outside 1x1..128x128")
    if sigma_m.shape != values.shape:
        raise CodecError(f"elevation {values.shape} and sigma {sigma_m.shape} must be one tile")
    known = np.ascontiguousarray(known)
    codes = block_max(code_of(sigma_m.astype(np.float64), known), SIGMA_BLOCK)
    bound = bound_for(max_error_m, rounding_m(values), 2)
    if bound is not None and spans_units(values, bounded(bound)):
        tile = _encode_at(values, known, codes, bound)
        if tile is not None:
            return tile
    raise CodecError(
        f"float32 cannot hold elevations of up to {np.abs(values).max():g} m "
        f"within {max_error_m:g} m"
    )


def decode_tile(prefix: bytes) -> DecodedTile:
    """Return what the last whole level of a payload's prefix tells; of any prefix, even none.

    Raises `CodecError` for bytes that begin no payload of `encode_tile`.
    """
    fields = Fields(decoder(prefix))
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


def _nothing(shape: tuple[int, int], levels: int) -> DecodedTile:
    empty = np.full(shape, np.nan, np.float32)
    return DecodedTile(empty, np.zeros(shape, np.bool_), empty.copy(), math.inf, -1, levels)


def _picture(tile: Tile, bound_m: float, level: int, levels: int) -> DecodedTile:
    known = tile.told.astype(np.bool_)
    painted_m = tile.scale.metres(tile.pyramid.painted())
    elevation_m = np.where(known, painted_m, np.float32(np.nan))
    if not np.isfinite(elevation_m[known]).all():
        raise CodecError("an elevation in the bytes is not finite")
    sigma_m = sigma_of(spread(tile.codes, SIGMA_BLOCK, *known.shape))
    sigma_m = np.where(known, sigma_m, np.float32(np.nan))
    bound_m = bound_m if known.any() else math.inf
    return DecodedTile(elevation_m, known, sigma_m, bound_m, level, levels)


def _encode_at(values: Floats, known: Bools, codes: Codes, bound: Bound) -> EncodedTile | None:
    """Return the payload with this bound, or None if float32 breaks it.

    It has fewer levels where the first would tell next to nothing, or one would add no byte.
    """
    base = round(float(np.median(values[known])) / bounded(bound).step_m) if known.any() else 0
    head = Head(known.shape, bound, 1, 0, bool(known.all()), base)
    truth = Truth(
        head.scale.units(values), known.astype(np.uint8), codes, known.astype(np.uint8), 0
    )
    head = replace(head, profile=best_profile(truth.mask, truth.y))
    tile = write(head, [truth])
    most = 1 + sum(len(tile.data) >= least for least in _BYTES_WORTH_LEVELS)
    for levels in range(most, 0, -1):
        head = replace(head, levels=levels)
        errors_m = rehearse(values, truth, head)
        if errors_m[-1][known].max(initial=0.0) > bound.metres:
            return None
        plan = plan_levels(errors_m, known, bound, levels)
        tile = write(head, [replace(truth, told=told, bound_code=code) for code, told in plan])
        first_share = float(plan[0][1].sum()) / max(int(known.sum()), 1)
        if len(set(tile.level_ends)) == levels and first_share >= _LEAST_FIRST_SHARE:
            break
    return tile


def write(head: Head, truths: list[Truth]) -> EncodedTile:
    """Return the payload whose levels tell what `truths` say."""
    fields = Fields(encoder(head.shape[0] * head.shape[1] * BYTES_PER_CELL))
    models, tile = Models(), Tile.blank(head)
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
