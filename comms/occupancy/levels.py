"""The levels of an occupancy payload: what both sides do, the encoder and the decoder."""

from dataclasses import dataclass

import numpy as np

from comms.occupancy import planar, voxels
from comms.occupancy.blockcode import block_judge, code_blocks, told_by
from comms.occupancy.classes import Symbols
from comms.occupancy.field import Field, Palette, inside
from comms.occupancy.judge import Judge
from comms.occupancy.sizes import size_judge
from comms.rangecoder import Coder
from comms.scales import Fields

Shape = tuple[int, int, int]

_LEAST_HASH_BITS, _MOST_HASH_BITS = 13, 20


@dataclass(frozen=True)
class Models:
    """All that is learned while a payload is coded."""

    blocks: Judge
    block_sizes: Judge
    calm: Judge
    states: Judge
    sizes: Judge

    @classmethod
    def fresh(cls, shape: Shape, palette: Palette) -> "Models":
        """Begin with what was learned beforehand."""
        cells = shape[0] * shape[1] * shape[2]
        bits = min(max(cells.bit_length(), _LEAST_HASH_BITS), _MOST_HASH_BITS)
        name, kind = ("planar", planar) if shape[0] == 1 else ("voxel", voxels)
        size_bits = bits if palette.sizes & (palette.sizes - 1) else 3
        return cls(
            block_judge(name),
            size_judge(f"{name} block", 12),
            voxels.calm_judge(),
            kind.state_judge(bits),
            size_judge(name, size_bits),
        )


def code_palette(fields: Fields, given: Palette | None) -> Palette:
    """Code which symbols a map has, of which at least one cell is known."""
    given = given or Palette(0, 0, 0, 0)
    all_known = fields.bits(1, given.all_known)
    has_free = fields.bits(1, given.has_free)
    has_occupied = fields.bits(1, given.has_occupied) if has_free else 1
    only_top = fields.bits(1, int(given.sizes == 128))
    sizes = 128 if only_top else fields.bits(8, given.sizes)
    return Palette(all_known, has_free, has_occupied, sizes)


def code_level(
    coder: Coder, models: Models, palette: Palette, field: Field, side: int, truth: Symbols | None
) -> None:
    """Code the blocks of one side (of 1: the cells) on top of those before.

    `truth` (layers, rows, cols): the symbols to encode; None to decode.
    """
    shape: Shape = field.fixed.shape
    if side > 1:
        told = (
            np.zeros(tuple(-(-length // side) for length in shape), np.uint8)
            if truth is None
            else told_by(truth, side, palette)
        )
        code_blocks(coder, models.blocks, models.block_sizes, palette, field, side, told)
        return
    cells = np.zeros(shape, np.uint8) if truth is None else truth
    if shape[0] == 1:
        planar.code_plane(coder, models.states, models.sizes, palette, field, cells)
    else:
        voxels.code_block(coder, models.calm, models.states, models.sizes, palette, field, cells)


def symbols_told(field: Field) -> Symbols:
    """Return the symbols (layers, rows, cols) that are told so far."""
    return inside(field.symbols).copy()
