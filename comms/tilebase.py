"""A tile's next version, told by what changed since the one before.

The receiver has the version before, whole: what it lacks is which cells are newly measured, their
elevations, and the few known ones that moved by more than the bound. New elevations are predicted
from all that was known, and the standard deviations are those of the version before unless a block
says that they fell; no cell is ever told less surely than before.

Two levels where both have something to say: the new cells first, under a bound that holds for the
old ones as they were; then what moved.
"""

import math
import zlib
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comms.blocks import block_max, spread
from comms.changecode import change_opinions, code_changes
from comms.errors import CodecError
from comms.maskcode import code_mask, mask_opinions
from comms.pyramid import BYTES_PER_CELL, STEP_UNITS, Pyramid
from comms.rangecoder import Mark, encoder, is_certain
from comms.scales import Bound, Fields, Scale, bounded, spans_units
from comms.sigmachange import change_opinions as sigma_opinions_of_changes
from comms.sigmachange import code_sigma_changes
from comms.sigmacode import LOWEST, code_of, code_sigma_blocks, sigma_of, sigma_opinions
from comms.tilelevels import BOUND_CODES, SIGMA_BLOCK, bound_of_level
from comms.tiletypes import DecodedTile, EncodedTile, NeedsBaseError

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]
Flags = NDArray[np.uint8]
Codes = NDArray[np.int64]
Units = NDArray[np.int64]

_CHECK_BITS = 8
_BOUND_BITS = BOUND_CODES.bit_length() - 1


@dataclass(frozen=True)
class News:
    """What an encoder tells of the next version; all arrays (H, W)."""

    y: Units
    known: Flags
    codes: Codes
    """Each cell's own code of its standard deviation."""
    bound_code: int
    """Bound of the old cells before what moved is told."""
    levels: int


def check_of(base: DecodedTile) -> int:
    """Return eight bits that nearly any other version of a tile would not have."""
    check = zlib.crc32(np.packbits(base.known).tobytes())
    for numbers in (base.elevation_m, base.sigma_m):
        check = zlib.crc32(numbers[base.known].astype("<f4").tobytes(), check)
    return check & 255


def encode_on(
    base: DecodedTile, values: Floats, known: Bools, codes: Codes, bound: Bound
) -> EncodedTile | None:
    """Return the payload of a version that is built on `base`, or None where that can't be.

    `codes` (H, W): the least code of each cell's standard deviation. It can't be where a cell is no
    longer known or has become less sure, or where float32 cannot hold the bound.
    """
    before = base.known
    if not before.any() or (before & ~known).any() or not _is_fit(base, bound):
        return None
    scale = _scale_on(base, bound)
    had_codes = code_of(base.sigma_m.astype(np.float64), before)
    if not spans_units(values, scale) or (codes > had_codes)[before].any():
        return None
    had_m = base.elevation_m[before].astype(np.float64)
    worst_m = float(np.abs(had_m - values[before]).max()) + scale.step_m / STEP_UNITS
    fitting = [c for c in range(BOUND_CODES) if bound_of_level(bound, c) >= worst_m]
    if not fitting:
        return None
    news = News(scale.units(values), known.astype(np.uint8), codes, fitting[0], 1)
    has_two = fitting[0] > 0 and bool((known & ~before).any())
    for levels in (2, 1) if has_two else (1,):
        tile = _encoded(base, values, bound, replace(news, levels=levels))
        if tile is None or len(set(tile.level_ends)) == levels:
            return tile
    return None


def _encoded(base: DecodedTile, values: Floats, bound: Bound, news: News) -> EncodedTile | None:
    """Return the payload with so many levels, or None where one breaks its bound."""
    fields = Fields(encoder(values.size * BYTES_PER_CELL))
    pictures, marks = _code(fields, base, bound, news)
    for picture in pictures:
        error_m = np.abs(picture.elevation_m.astype(np.float64) - values)[picture.known]
        if error_m.max() > picture.bound_m:
            return None
    data = marks[-1].finish(length_is_known=False)
    return EncodedTile(data, tuple(mark.bytes_needed(data) for mark in marks), needs_base=True)


def decode_on(fields: Fields, base: DecodedTile | None) -> DecodedTile | None:
    """Return what a payload tells that is built on `base`; None where no level is whole.

    Raises `NeedsBaseError` without a base, and with another one than it was built on.
    """
    check = fields.bits(_CHECK_BITS)
    if not is_certain(fields.coder):
        return None
    if base is None or not base.is_whole:
        raise NeedsBaseError("this version can only be read on top of the whole one before it")
    if check != check_of(base):
        raise NeedsBaseError("this version was built on another one than the one given")
    bound = fields.bound()
    if not (0 < bound.metres < 1e32 and _is_fit(base, bound)):
        if not is_certain(fields.coder):
            return None
        raise CodecError(f"an error bound of {bound.metres} m is not possible")
    pictures, _ = _code(fields, base, bound, None)
    return pictures[-1] if pictures else None


def _is_fit(base: DecodedTile, bound: Bound) -> bool:
    """Say whether what was known can be told in units of this bound."""
    had_m = base.elevation_m[base.known].astype(np.float64)
    return had_m.size > 0 and spans_units(had_m, bounded(bound))


def _scale_on(base: DecodedTile, bound: Bound) -> Scale:
    scale = bounded(bound)
    middle_m = float(np.median(base.elevation_m[base.known].astype(np.float64)))
    return replace(scale, base=round(middle_m / scale.step_m))


def _code(
    fields: Fields, base: DecodedTile, bound: Bound, news: News | None
) -> tuple[list[DecodedTile], list[Mark]]:
    """Code a version on top of `base`: what each level tells, and where it ends."""
    coder = fields.coder
    if news:
        fields.bits(1, 1)
        fields.bits(_CHECK_BITS, check_of(base))
        fields.bound(bound)
    levels = 1 + fields.bits(1, news.levels - 1 if news else 0)
    bound_code = fields.bits(_BOUND_BITS, news.bound_code if news else 0) if levels > 1 else 0
    if not (news or is_certain(coder)):
        return [], []
    scale = _scale_on(base, bound)
    had = base.known.astype(np.uint8)
    known = news.known.copy() if news else had.copy()
    code_mask(coder, mask_opinions("news"), had.copy(), known)
    cell_codes, falls = _code_sigmas(fields, base, known, news)
    pyramid = _on_base(base, scale)
    fresh = known & (1 - had)
    pyramid.code(coder, fresh, news.y if news else None)
    pictures: list[DecodedTile] = []
    marks: list[Mark] = []
    for level in range(levels):
        if level == levels - 1:
            x, y = pyramid.cells.x, news.y if news else pyramid.cells.x
            code_changes(coder, change_opinions(), had, known, falls, x, y, STEP_UNITS)
        if not (news or is_certain(coder)):
            break
        bound_m = bound_of_level(bound, bound_code if level < levels - 1 else 0)
        elevation_m = scale.metres(pyramid.cells.x)
        if not np.isfinite(elevation_m[known.astype(np.bool_)]).all():
            raise CodecError("an elevation in the bytes is not finite")
        pictures.append(_picture(elevation_m, known, cell_codes, bound_m, level, levels))
        if news:
            marks.append(Mark(coder))
    return pictures, marks


def _on_base(base: DecodedTile, scale: Scale) -> Pyramid:
    """Return a pyramid that holds what was known as if it had been coded."""
    pyramid = Pyramid.blank(base.known.shape, 0, snaps=False)
    pyramid.cells.x[base.known] = scale.units(base.elevation_m[base.known].astype(np.float64))
    pyramid.cells.coded[base.known] = 1
    return pyramid


def _code_sigmas(
    fields: Fields, base: DecodedTile, known: Flags, news: News | None
) -> tuple[Codes, Codes]:
    """Code the blocks' standard deviations: those of before, then those of new ground.

    Returns each cell's code, and by how many half octaves its block's fell (5: it rose).
    """
    shape = known.shape
    had = base.known.astype(np.uint8)
    had_codes = code_of(base.sigma_m.astype(np.float64), base.known)
    before = block_max(had_codes, SIGMA_BLOCK)
    old, touched = block_max(had, SIGMA_BLOCK), block_max(known, SIGMA_BLOCK)
    grown = _grown(had, known)
    codes = block_max(news.codes, SIGMA_BLOCK) if news else before.copy()
    code_sigma_changes(fields.coder, sigma_opinions_of_changes(), old, grown, before, codes)
    code_sigma_blocks(fields.coder, sigma_opinions(), touched & (1 - old), old.copy(), codes)
    of_block = spread(codes, SIGMA_BLOCK, *shape)
    cells = np.where(base.known, np.minimum(of_block, had_codes), of_block)
    falls = before - codes
    falls = np.where(falls < 0, 5, np.minimum(falls, 4))
    return cells, np.ascontiguousarray(spread(falls, SIGMA_BLOCK, *shape))


def _grown(had: Flags, known: Flags) -> Codes:
    """Return how blocks have grown: 0 not, 1 somewhat, 2 to more than twice what was known."""
    rows, cols = had.shape

    def count(cells: Flags) -> Codes:
        by_row = np.add.reduceat(cells.astype(np.int64), np.arange(0, rows, SIGMA_BLOCK), axis=0)
        return np.add.reduceat(by_row, np.arange(0, cols, SIGMA_BLOCK), axis=1)

    before, after = count(had), count(known)
    return np.where(after == before, 0, np.where(after <= 2 * before, 1, 2))


def _picture(
    elevation_m: Singles, known: Flags, codes: Codes, bound_m: float, level: int, levels: int
) -> DecodedTile:
    mask = known.astype(np.bool_)
    nothing = np.float32(math.nan)
    sigma_m = sigma_of(np.where(mask, codes, LOWEST))
    return DecodedTile(
        np.where(mask, elevation_m, nothing),
        mask,
        np.where(mask, sigma_m, nothing),
        bound_m,
        level,
        levels,
    )
