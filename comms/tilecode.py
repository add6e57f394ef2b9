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

from comms.errors import CodecError
from comms.gridcode import block_max, check_grid, spread
from comms.maskcode import code_mask, mask_opinions
from comms.pyramid import PROFILES, Pyramid
from comms.rangecoder import Coder, Mark, decoder, encoder, is_certain
from comms.scales import (
    Bound,
    Fields,
    Scale,
    bound_for,
    bounded,
    rounding_m,
    spans_units,
)
from comms.sigmacode import (
    code_of,
    code_sigma_blocks,
    sigma_of,
    sigma_opinions,
)

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]
Flags = NDArray[np.uint8]
Codes = NDArray[np.int64]

LARGEST_TILE = 128
_SPACINGS = {1: (1,), 2: (4, 1), 3: (8, 2, 1), 4: (8, 4, 2, 1)}
"""Spacing of the sent lattice at each level, by the number of levels."""
SIGMA_BLOCK = 4
_BOUND_CODES = 32
_BYTES_WORTH_LEVELS = (45, 90, 240)
"""Sizes of a payload of one level from which 2, 3 and 4 are worth their overhead."""


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


@dataclass
class _Tile:
    """What both sides hold of a tile while its levels are coded."""

    scale: Scale
    pyramid: Pyramid
    mask: Flags
    """Which cells are measured, where `settled`."""
    settled: Flags
    told: Flags
    """Which cells are called known."""
    codes: Codes
    """Standard deviations, one code per block of `SIGMA_BLOCK` cells a side."""
    coded: Flags
    """Which of these were sent."""
    highest_bound: int

    @classmethod
    def blank(cls, head: "Head") -> "_Tile":
        """Return a tile of which nothing is known, but perhaps that all of it is measured."""
        rows, cols = head.shape
        blocks = (-(-rows // SIGMA_BLOCK), -(-cols // SIGMA_BLOCK))
        return cls(
            head.scale,
            Pyramid.blank(head.shape, head.profile, snaps=False),
            np.full(head.shape, int(head.whole), np.uint8),
            np.full(head.shape, int(head.whole), np.uint8),
            np.zeros(head.shape, np.uint8),
            np.zeros(blocks, np.int64),
            np.zeros(blocks, np.uint8),
            _BOUND_CODES - 1,
        )


class _Models:
    """The adaptive models of masks and standard deviations."""

    def __init__(self) -> None:
        self.rest = mask_opinions("rest")
        self.lattice = mask_opinions("lattice")
        self.blocks = mask_opinions("blocks")
        self.sigma = sigma_opinions()


@dataclass(frozen=True)
class Head:
    """What a payload says first."""

    shape: tuple[int, int]
    bound: Bound
    levels: int
    profile: int
    whole: bool
    """Whether every cell is measured."""
    base: int
    """Elevation of the middle, in steps."""

    @property
    def scale(self) -> Scale:
        """The scale of the elevations."""
        return replace(bounded(self.bound), base=self.base)


@dataclass(frozen=True)
class Truth:
    """What an encoder knows and a decoder is told."""

    y: NDArray[np.int64]
    """Elevations in units, (H, W)."""
    mask: Flags
    codes: Codes
    told: Flags
    """Which cells this level calls known."""
    bound_code: int


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
    inside = values[known]
    values = np.where(known, values, inside[0] if inside.size else 0.0)
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
    head = _code_head(fields, None)
    if not is_certain(fields.coder):
        return _nothing((1, 1), 0)
    tile, models, result = _Tile.blank(head), _Models(), _nothing(head.shape, head.levels)
    for level in range(head.levels):
        code = _code_level(fields, models, tile, level, head.levels, None)
        if not is_certain(fields.coder):
            break
        result = _picture(tile, bound_of_level(head.bound, code), level, head.levels)
    return result


def _nothing(shape: tuple[int, int], levels: int) -> DecodedTile:
    empty = np.full(shape, np.nan, np.float32)
    return DecodedTile(empty, np.zeros(shape, np.bool_), empty.copy(), math.inf, -1, levels)


def bound_of_level(bound: Bound, code: int) -> float:
    """Return the bound that a level's code stands for: quarter octaves above the last level's."""
    return bound.metres * math.ldexp((1.0, 1.19, 1.42, 1.69)[code % 4], code // 4)


def _code_head(fields: Fields, given: Head | None) -> Head:
    head = given or Head((1, 1), Bound(10, 0), 1, 0, False, 0)
    rows, cols = head.shape
    if fields.bits(1, int(rows == cols and rows.bit_count() == 1)):
        rows = cols = 1 << fields.bits(3, rows.bit_length() - 1)
    else:
        rows, cols = fields.bits(7, rows - 1) + 1, fields.bits(7, cols - 1) + 1
    bound = fields.bound(head.bound if given else None)
    if not 0 < bound.metres < 1e32:
        raise CodecError(f"an error bound of {bound.metres} m is not possible")
    levels = fields.bits(2, head.levels - 1) + 1
    profile = fields.bits(2, head.profile)
    whole = fields.bits(1, int(head.whole)) == 1
    return Head((rows, cols), bound, levels, profile, whole, fields.whole(head.base))


def _code_level(
    fields: Fields, models: _Models, tile: _Tile, level: int, levels: int, truth: Truth | None
) -> int:
    """Code one level on top of those before; return its bound's code."""
    spacing, is_last = _SPACINGS[levels][level], level == levels - 1
    coder = fields.coder
    _code_lattice_mask(coder, models, tile, 1 if level >= levels - 2 else spacing, truth)
    if is_last:
        tile.told, code = tile.mask.copy(), 0
    else:
        code = fields.bits(tile.highest_bound.bit_length(), truth.bound_code if truth else 0)
        tile.highest_bound = code
        _code_told(coder, models, tile, spacing, truth)
    _code_sigmas(coder, models, tile, truth)
    tile.pyramid.code(coder, tile.mask, truth.y if truth else None, spacing)
    return code


def _code_lattice_mask(
    coder: Coder, models: _Models, tile: _Tile, lattice: int, truth: Truth | None
) -> None:
    """Code which cells of a lattice are measured."""
    settled = tile.settled[::lattice, ::lattice].copy()
    mask = (truth or tile).mask[::lattice, ::lattice].copy()
    code_mask(coder, models.rest if lattice == 1 else models.lattice, settled, mask)
    tile.mask[::lattice, ::lattice] = mask
    tile.settled[::lattice, ::lattice] = 1


def _code_told(coder: Coder, models: _Models, tile: _Tile, side: int, truth: Truth | None) -> None:
    """Code which blocks of side x side cells a level calls known; their cells are measured."""
    rows, cols = tile.told.shape
    flags = block_min((truth or tile).told, side)
    impossible = block_max((tile.settled & (1 - tile.mask)).astype(np.int64), side)
    settled = block_min(tile.told, side) | impossible.astype(np.uint8)
    code_mask(coder, models.blocks, settled, flags)
    tile.told = spread(flags.astype(np.int64), side, rows, cols).astype(np.uint8)
    tile.mask |= tile.told
    tile.settled |= tile.told


def _code_sigmas(coder: Coder, models: _Models, tile: _Tile, truth: Truth | None) -> None:
    """Code the standard deviations of the blocks that a level is the first to touch."""
    touched = block_max(tile.told.astype(np.int64), SIGMA_BLOCK).astype(np.uint8)
    want = touched & (1 - tile.coded)
    tile.codes = np.where(want, (truth or tile).codes, tile.codes)
    code_sigma_blocks(coder, models.sigma, want, tile.coded, tile.codes)


def _picture(tile: _Tile, bound_m: float, level: int, levels: int) -> DecodedTile:
    known = tile.told.astype(np.bool_)
    painted_m = tile.scale.metres(tile.pyramid.painted())
    elevation_m = np.where(known, painted_m, np.float32(np.nan))
    sigma_m = sigma_of(spread(tile.codes, SIGMA_BLOCK, *known.shape))
    sigma_m = np.where(known, sigma_m, np.float32(np.nan))
    bound_m = bound_m if known.any() else math.inf
    return DecodedTile(elevation_m, known, sigma_m, bound_m, level, levels)


def block_min(cells: Flags, side: int) -> Flags:
    """Return the smallest of each block of side x side cells; the last blocks may be smaller."""
    rows, cols = cells.shape
    by_row = np.minimum.reduceat(cells, np.arange(0, rows, side), axis=0)
    return np.minimum.reduceat(by_row, np.arange(0, cols, side), axis=1)


def _encode_at(values: Floats, known: Bools, codes: Codes, bound: Bound) -> EncodedTile | None:
    """Return the payload with this bound, or None if float32 breaks it."""
    base = round(float(np.median(values[known])) / bounded(bound).step_m) if known.any() else 0
    head = Head(known.shape, bound, 1, 0, bool(known.all()), base)
    truth = Truth(
        head.scale.units(values), known.astype(np.uint8), codes, known.astype(np.uint8), 0
    )
    heads = [replace(head, profile=profile) for profile in range(len(PROFILES))]
    plain = [write(head, [truth]) for head in heads]
    size, profile = min((len(tile.data), k) for k, tile in enumerate(plain))
    levels = 1 + sum(size >= least for least in _BYTES_WORTH_LEVELS)
    head = replace(heads[profile], levels=levels)
    errors_m = rehearse(values, truth, head)
    if errors_m[-1][known].max(initial=0.0) > bound.metres:
        return None
    plan = plan_levels(errors_m, known, bound, levels)
    return write(head, [replace(truth, told=told, bound_code=code) for code, told in plan])


def write(head: Head, truths: list[Truth]) -> EncodedTile:
    """Return the payload whose levels tell what `truths` say."""
    fields = Fields(encoder(head.shape[0] * head.shape[1] * 12 + 256))
    models, tile = _Models(), _Tile.blank(head)
    _code_head(fields, head)
    marks: list[Mark] = []
    for level, truth in enumerate(truths):
        _code_level(fields, models, tile, level, head.levels, truth)
        marks.append(Mark(fields.coder))
    data = marks[-1].finish(length_is_known=False)
    return EncodedTile(data, tuple(mark.bytes_needed(data) for mark in marks))


def rehearse(values: Floats, truth: Truth, head: Head) -> list[Floats]:
    """Return the error of every cell (H, W) as a receiver will see it at each level, metres."""
    fields = Fields(encoder(values.size * 12 + 256))
    models, tile = _Models(), _Tile.blank(head)
    nothing = replace(truth, told=np.zeros_like(truth.told))
    errors: list[Floats] = []
    for level in range(head.levels):
        _code_level(fields, models, tile, level, head.levels, nothing)
        painted_m = tile.scale.metres(tile.pyramid.painted())
        errors.append(np.abs(painted_m.astype(np.float64) - values))
    return errors


def plan_levels(
    errors_m: list[Floats], known: Bools, bound: Bound, levels: int
) -> list[tuple[int, Flags]]:
    """Choose each level's bound code and the cells that it calls known.

    A cell's error counts as the worst that it will have from this level on, so that bounds never
    rise; a level's bound is the one that makes blocks told times bits told per cell largest.
    """
    mask = known.astype(np.uint8)
    plans: list[tuple[int, Flags]] = [(0, mask)]
    worst = np.where(known, errors_m[-1], np.inf)
    envelopes = [worst]
    for level in range(levels - 2, -1, -1):
        worst = np.maximum(worst, np.where(known, errors_m[level], np.inf))
        envelopes.insert(0, worst)
    relief_m = max(float(np.ptp(errors_m[0])), bound.metres)
    chosen: list[tuple[int, Flags]] = []
    told, highest = np.zeros_like(mask), _BOUND_CODES - 1
    for level in range(levels - 1):
        side = _SPACINGS[levels][level]
        blocks = _largest_of_blocks(envelopes[level], side)
        lowest_m = float(envelopes[level][told.astype(np.bool_)].max(initial=0.0))
        code = _best_code(blocks, bound, lowest_m, highest, relief_m)
        told = told | _tell(blocks <= bound_of_level(bound, code), side, mask.shape)
        chosen.append((code, told))
        highest = code
    return [*chosen, *plans]


def _largest_of_blocks(cells: Floats, side: int) -> Floats:
    rows, cols = cells.shape
    by_row = np.maximum.reduceat(cells, np.arange(0, rows, side), axis=0)
    return np.maximum.reduceat(by_row, np.arange(0, cols, side), axis=1)


def _tell(flags: Bools, side: int, shape: tuple[int, int]) -> Flags:
    return spread(flags.astype(np.int64), side, *shape).astype(np.uint8)


def _best_code(blocks: Floats, bound: Bound, lowest_m: float, highest: int, relief_m: float) -> int:
    best, best_worth = highest, -1.0
    for code in range(highest, -1, -1):
        level_m = bound_of_level(bound, code)
        if level_m < lowest_m:
            break
        worth = float((blocks <= level_m).sum()) * math.log2(1 + relief_m / level_m)
        if worth > best_worth:
            best, best_worth = code, worth
    return best


def sigma_as_sent(sigma_m: Floats, known: Bools) -> Floats:
    """Return the standard deviations (H, W) that a receiver of the last level would be told.

    For whole maps too, whose tiles have sides of a multiple of the blocks that sigmas share.
    """
    codes = block_max(code_of(sigma_m, known), SIGMA_BLOCK)
    return sigma_of(spread(codes, SIGMA_BLOCK, *known.shape)).astype(np.float64)
