"""Blocks of cells that are alike, coarse before fine: a quadtree, or an octree, of log odds.

A block is mixed, or all its cells are not known, free or occupied. What is told of a free or an
occupied block is the least size of its cells: so nobody is told more of a cell than is true. Blocks
of a finer level are coded where the coarser ones were mixed, and refined where they were told.
"""

from typing import NamedTuple

import numpy as np

from comms.kernels import kernel, warmer
from comms.occupancy.classes import (
    FREE,
    NOT_KNOWN,
    OCCUPIED,
    OPEN,
    STATE_OF,
    UNKNOWN,
    ZERO,
    Symbols,
)
from comms.occupancy.field import (
    LAYER_MARGIN,
    MARGIN,
    SETTLED,
    TOLD,
    UNDECIDED,
    Field,
    Flags,
    Palette,
    blank,
)
from comms.occupancy.judge import Judge, code_judged, judge
from comms.occupancy.priors import opinions
from comms.occupancy.sizes import Near, code_size, hashed, size_judge
from comms.parts import part, whole
from comms.rangecoder import Coder, decoder, encoder, has_run_out

MIXED = OPEN
"""The state of a block whose cells are not alike."""
_NOT_YET = 4
"""What a neighbouring block counts as that is not coded yet."""
_PAD = 2
_SIDES = 4
_INPUTS = 5
_NODES = 4
_DENSE_CONTEXTS = (_SIDES * 125, _SIDES * 625)
_STARTS = np.cumsum((0, *_DENSE_CONTEXTS)).astype(np.int64) * _NODES
DENSE = int(_STARTS[-1])
"""Models of contexts that are counted, not hashed; the first ones."""
_HASH_BITS = 14
_VERDICTS = _SIDES * 25 * _NODES
_LIMIT = 400


class Blocks(NamedTuple):
    """The blocks of one side, of a map (layers, rows, cols) of blocks with margins."""

    states: Flags
    symbols: Flags
    """The symbol that is told of each, 0 where none is."""


def block_judge(name: str) -> Judge:
    """Return the models of the blocks of a kind of map at the start of a payload."""
    slots = DENSE + (1 << _HASH_BITS)
    contexts = _VERDICTS + 125 * _NODES
    return judge(opinions(f"{name} blocks", slots, _SIDES * _NODES, _INPUTS), contexts)


def told_by(symbols: Symbols, side: int, palette: Palette) -> Symbols:
    """Return what blocks (layers, rows, cols) tell of their cells, 16 where they are mixed."""

    states = STATE_OF[symbols]
    lowest, highest = _reduced(np.minimum, states, side), _reduced(np.maximum, states, side)
    sizes = np.abs(symbols.astype(np.int8) - ZERO).astype(np.uint8)
    least = _reduced(np.minimum, sizes, side)
    is_single = palette.sizes & (palette.sizes - 1) == 0
    mixed = (lowest != highest) | ((highest != NOT_KNOWN) & (least == 0) & (not is_single))
    told = np.where(highest == OCCUPIED, ZERO + least, ZERO - least)
    told[highest == NOT_KNOWN] = UNKNOWN
    told[mixed] = 16
    return told.astype(np.uint8)


def _reduced(least_or_most: np.ufunc, cells: Flags, side: int) -> Flags:
    for axis in range(3):
        starts = np.arange(0, cells.shape[axis], side)
        cells = least_or_most.reduceat(cells, starts, axis=axis)
    return cells


@part
def _context(blocks: Flags, d: int, i: int, j: int, side: int, judge: Judge) -> tuple[int, int]:
    """Write the first slot of each opinion; return two contexts for who is to be believed."""
    slots = judge.opinions.slots
    mask = (judge.opinions.models.size - DENSE - 1) & ~whole(_NODES - 1)
    west, north, below = blocks[d, i, j - 1], blocks[d, i - 1, j], blocks[d - 1, i, j]
    northwest, northeast = blocks[d, i - 1, j - 1], blocks[d, i - 1, j + 1]
    east, south, on_top = blocks[d, i, j + 1], blocks[d, i + 1, j], blocks[d + 1, i, j]
    pair = (whole(side) * 5 + west) * 5 + north
    ahead = (whole(east) * 5 + south) * 5
    slots[0] = (pair * 5 + below) * _NODES
    slots[1] = _STARTS[1] + ((pair * 5 + northwest) * 5 + northeast) * _NODES
    slots[2] = DENSE + hashed(pair * 125 + ahead + on_top, 3, mask)
    key = ((pair * 125 + ahead + on_top) * 5 + below) * 25 + whole(northwest) * 5 + northeast
    slots[3] = DENSE + hashed(key, 1, mask)
    key = (pair * 5 + blocks[d, i, j - 2]) * 5 + blocks[d, i - 2, j]
    slots[4] = DENSE + hashed(key * 125 + ahead + below, 2, mask)
    return pair * _NODES, _VERDICTS + (ahead + below) * _NODES


@part
def _decide(coder: Coder, judge: Judge, at: tuple[int, int], side: int, node: int, bit: int) -> int:
    slots = judge.opinions.slots
    for k in range(_INPUTS):
        slots[k] += node
    bit = code_judged(coder, judge, side * _NODES + node, at[0] + node, at[1] + node, _LIMIT, bit)
    for k in range(_INPUTS):
        slots[k] -= node
    return bit


@part
def _code_state(
    coder: Coder, judge: Judge, palette: Palette, at: tuple[int, int], side: int, state: int
) -> int:
    """Code what a block's cells are."""
    if _decide(coder, judge, at, side, 0, 1 if state == MIXED else 0):
        return whole(MIXED)
    if not palette.all_known and _decide(coder, judge, at, side, 1, 1 if state == NOT_KNOWN else 0):
        return whole(NOT_KNOWN)
    if palette.has_free and palette.has_occupied:
        occupied = _decide(coder, judge, at, side, 2, 1 if state == OCCUPIED else 0)
        return whole(OCCUPIED) if occupied else whole(FREE)
    return whole(OCCUPIED) if palette.has_occupied else whole(FREE)


@part
def _fill(
    field: Field, palette: Palette, block: tuple[int, int, int], side: int, symbol: int
) -> None:
    """Decide the cells of a block."""
    layers, rows, cols = field.fixed.shape
    deep = 0 if field.states.shape[0] == 1 else LAYER_MARGIN
    state = STATE_OF[symbol]
    least = abs(symbol - ZERO) if symbol else whole(0)
    fixed = TOLD if symbol and palette.sizes >> (least + 1) else SETTLED
    for d in range(block[0] * side, min((block[0] + 1) * side, layers)):
        for i in range(block[1] * side, min((block[1] + 1) * side, rows)):
            for j in range(block[2] * side, min((block[2] + 1) * side, cols)):
                field.states[d + deep, i + MARGIN, j + MARGIN] = state
                field.symbols[d + deep, i + MARGIN, j + MARGIN] = symbol
                field.least[d, i, j] = least
                field.fixed[d, i, j] = fixed


@part
def _begin(field: Field, deep: int, blocks: Blocks, side: int) -> None:
    """Fill in the blocks that coarser ones have decided."""
    layers, rows, cols = blocks.states.shape
    for d in range(_PAD, layers - _PAD):
        for i in range(_PAD, rows - _PAD):
            for j in range(_PAD, cols - _PAD):
                x, y, z = (d - _PAD) * side, (i - _PAD) * side, (j - _PAD) * side
                blocks.states[d, i, j] = _NOT_YET
                if field.fixed[x, y, z] != UNDECIDED:
                    blocks.states[d, i, j] = field.states[x + deep, y + MARGIN, z + MARGIN]
                    blocks.symbols[d, i, j] = field.symbols[x + deep, y + MARGIN, z + MARGIN]


@kernel
def code_blocks(
    coder: Coder,
    judge: Judge,
    sizes: Judge,
    palette: Palette,
    field: Field,
    side: int,
    truth: Symbols,
) -> None:
    """Code the blocks of a side; `truth` (layers, rows, cols) is what `told_by` says."""
    layers, rows, cols = truth.shape
    deep = 0 if field.states.shape[0] == 1 else LAYER_MARGIN
    shape = (layers + 2 * _PAD, rows + 2 * _PAD, cols + 2 * _PAD)
    blocks = Blocks(np.full(shape, NOT_KNOWN, np.uint8), np.zeros(shape, np.uint8))
    _begin(field, deep, blocks, side)
    kind = whole(0)
    while kind < _SIDES - 1 and 2 << kind < side:
        kind += 1
    for layer in range(layers):
        for row in range(rows):
            if has_run_out(coder):
                return
            for col in range(cols):
                d, i, j = layer + _PAD, row + _PAD, col + _PAD
                state, symbol = whole(blocks.states[d, i, j]), whole(truth[layer, row, col])
                least = whole(1)
                if state == NOT_KNOWN:
                    continue
                if state == _NOT_YET:
                    state = whole(MIXED) if symbol == 16 else whole(STATE_OF[symbol])
                    at = _context(blocks.states, d, i, j, kind, judge)
                    state = _code_state(coder, judge, palette, at, kind, state)
                    blocks.states[d, i, j] = state
                else:
                    least = abs(whole(blocks.symbols[d, i, j]) - ZERO)
                if state in (FREE, OCCUPIED):
                    near = Near(
                        whole(blocks.symbols[d, i, j - 1]),
                        whole(blocks.symbols[d, i - 1, j]),
                        whole(blocks.symbols[d - 1, i, j]),
                        whole(blocks.symbols[d, i - 1, j + 1]),
                        whole(blocks.symbols[d, i, j - 2]),
                        whole(blocks.symbols[d, i - 2, j]),
                        whole(blocks.symbols[d - 1, i, j + 1]),
                        whole(blocks.symbols[d, i - 1, j - 1]),
                        whole(blocks.symbols[d, i, j + 1]),
                        whole(blocks.symbols[d, i + 1, j]),
                    )
                    occupied = 1 if state == OCCUPIED else 0
                    size = abs(symbol - ZERO)
                    size = code_size(coder, sizes, palette, near, occupied, least, size)
                    symbol = ZERO + (size if occupied else -size)
                    blocks.symbols[d, i, j] = symbol
                elif state == NOT_KNOWN:
                    symbol = whole(UNKNOWN)
                if state != MIXED:
                    _fill(field, palette, (layer, row, col), side, symbol)


@warmer
def _warm() -> None:
    for coder in (encoder(64), decoder(b"\1\2\3")):
        truth = np.full((1, 2, 2), ZERO + 1, np.uint8)
        judges = block_judge("planar"), size_judge("planar block", 10)
        code_blocks(coder, *judges, Palette(0, 1, 1, 255), blank((1, 3, 3)), 2, truth)
