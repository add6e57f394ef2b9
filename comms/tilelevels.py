"""The levels of a tile's payload: what both sides do, told by the encoder, heard by the decoder.

A level adds, in this order: which cells of its lattice are measured (the level before the last
sends the whole mask), its bound and the blocks that it calls known, their standard deviations, and
the elevations of its lattice. The last level may split blocks whose cells are unlike, and give each
cell a standard deviation of its own.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comms.blocks import block_max, block_min, spread
from comms.maskcode import code_mask, mask_opinions
from comms.pyramid import Pyramid, top_spacing
from comms.rangecoder import Coder
from comms.scales import Bound, Fields, Scale, bounded
from comms.sigmachange import cell_opinions, code_sigma_cells
from comms.sigmacode import code_sigma_blocks, sigma_opinions

Flags = NDArray[np.uint8]
Codes = NDArray[np.int64]

SPACINGS = {1: (1,), 2: (4, 1), 3: (8, 2, 1), 4: (8, 4, 2, 1)}
"""Spacing of the sent lattice at each level, by the number of levels."""
SIGMA_BLOCK = 4
"""Cells of a block this wide share one standard deviation, the largest of theirs."""
BOUND_CODES = 32


@dataclass
class Tile:
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
    cells: Codes
    """The same for each cell (H, W): its block's, or its own where blocks were split."""
    highest_bound: int

    @classmethod
    def blank(cls, head: "Head") -> "Tile":
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
            np.zeros(head.shape, np.int64),
            BOUND_CODES - 1,
        )


class Models:
    """The adaptive models of masks and standard deviations."""

    def __init__(self) -> None:
        """Begin with what was learned beforehand."""
        self.rest = mask_opinions("rest")
        self.lattice = mask_opinions("lattice")
        self.blocks = mask_opinions("blocks")
        self.sigma = sigma_opinions()
        self.sigma_cells = cell_opinions()


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
    split: Flags
    """Which blocks tell each cell's own standard deviation, at the last level."""
    cell_codes: Codes
    """Each cell's own code, (H, W)."""


def bound_of_level(bound: Bound, code: int) -> float:
    """Return the bound that a level's code stands for: quarter octaves above the last level's."""
    return bound.metres * math.ldexp((1.0, 1.19, 1.42, 1.69)[code % 4], code // 4)


def code_head(fields: Fields, given: Head | None) -> Head:
    """Code what a payload says first. A decoder has to see whether it was certain."""
    head = given or Head((1, 1), Bound(10, 0), 1, 0, False, 0)
    rows, cols = head.shape
    if fields.bits(1, int(rows == cols and rows.bit_count() == 1)):
        rows = cols = 1 << fields.bits(3, rows.bit_length() - 1)
    else:
        rows, cols = fields.bits(7, rows - 1) + 1, fields.bits(7, cols - 1) + 1
    bound = fields.bound(head.bound if given else None)
    levels = fields.bits(2, head.levels - 1) + 1
    profile = fields.bits(2, head.profile)
    whole = fields.bits(1, int(head.whole)) == 1
    return Head((rows, cols), bound, levels, profile, whole, fields.whole(head.base))


def code_level(
    fields: Fields, models: Models, tile: Tile, level: int, levels: int, truth: Truth | None
) -> int:
    """Code one level on top of those before; return its bound's code."""
    spacing, is_last = SPACINGS[levels][level], level == levels - 1
    coder = fields.coder
    _code_lattice_mask(coder, models, tile, 1 if level >= levels - 2 else spacing, truth)
    if is_last:
        tile.told, code = tile.mask.copy(), 0
    else:
        code = fields.bits(tile.highest_bound.bit_length(), truth.bound_code if truth else 0)
        tile.highest_bound = code
        _code_told(coder, models, tile, block_side(tile.told.shape, level, spacing), truth)
    _code_sigmas(coder, models, tile, truth)
    if is_last:
        _code_splits(coder, models, tile, truth)
    tile.pyramid.code(coder, tile.mask, truth.y if truth else None, spacing)
    return code


def block_side(shape: tuple[int, int], level: int, spacing: int) -> int:
    """Return the side of the blocks that a level tells: a tile has at most 8 x 8, later 16 x 16."""
    return max(spacing, top_spacing(*shape) // (8 if level == 0 else 16))


def _code_lattice_mask(
    coder: Coder, models: Models, tile: Tile, lattice: int, truth: Truth | None
) -> None:
    """Code which cells of a lattice are measured."""
    settled = tile.settled[::lattice, ::lattice].copy()
    mask = (truth or tile).mask[::lattice, ::lattice].copy()
    code_mask(coder, models.rest if lattice == 1 else models.lattice, settled, mask)
    tile.mask[::lattice, ::lattice] = mask
    tile.settled[::lattice, ::lattice] = 1


def _code_told(coder: Coder, models: Models, tile: Tile, side: int, truth: Truth | None) -> None:
    """Code which blocks of side x side cells a level calls known.

    Until the whole mask is sent, a block that is told is measured throughout; then it is told as
    far as it is measured.
    """
    unknown = tile.settled & (1 - tile.mask)
    mask_is_sent = bool(tile.settled.all())
    beside = unknown if mask_is_sent else np.zeros_like(unknown)
    flags = block_min((truth or tile).told | beside, side)
    settled = block_min(tile.told | beside, side)
    settled |= block_max((unknown & (1 - beside)).astype(np.int64), side).astype(np.uint8)
    code_mask(coder, models.blocks, settled, flags)
    tile.told = spread(flags.astype(np.int64), side, *tile.told.shape).astype(np.uint8)
    tile.told &= 1 - beside
    tile.mask |= tile.told
    tile.settled |= tile.told


def _code_sigmas(coder: Coder, models: Models, tile: Tile, truth: Truth | None) -> None:
    """Code the standard deviations of the blocks that a level is the first to touch."""
    touched = block_max(tile.told.astype(np.int64), SIGMA_BLOCK).astype(np.uint8)
    want = touched & (1 - tile.coded)
    tile.codes = np.where(want, (truth or tile).codes, tile.codes)
    code_sigma_blocks(coder, models.sigma, want, tile.coded, tile.codes)
    tile.cells = spread(tile.codes, SIGMA_BLOCK, *tile.told.shape)


def _code_splits(coder: Coder, models: Models, tile: Tile, truth: Truth | None) -> None:
    """Code which blocks are split, and the codes of their cells."""
    split = truth.split.copy() if truth else np.zeros_like(tile.coded)
    own = spread(split, SIGMA_BLOCK, *tile.cells.shape).astype(np.bool_)
    tile.cells = np.where(own, truth.cell_codes if truth else 0, tile.cells)
    code_sigma_cells(coder, models.sigma_cells, tile.told, split, SIGMA_BLOCK, tile.cells)
