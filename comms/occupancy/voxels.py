"""The cells of a voxel block, layer by layer: known or not, occupied or not, and how sure.

Ten opinions look at what is decided: templates of 3 to 20 cells, the lines that lead to the cell
along the three axes, the layer below around it, and the nearest decided cells ahead.
"""

from typing import NamedTuple

import numpy as np

from comms.kernels import kernel, warmer
from comms.occupancy.classes import FREE, NOT_KNOWN, OCCUPIED, OPEN, STATE_OF, ZERO
from comms.occupancy.field import (
    LAYER_MARGIN,
    MARGIN,
    SETTLED,
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
from comms.rangecoder import Coder, Words, decoder, encoder, has_run_out

_TEMPLATE = np.array(
    [
        [0, 0, -1], [0, -1, 0], [-1, 0, 0], [-1, 0, 1], [-1, 1, 0], [0, -1, 1], [0, -1, -1],
        [-1, -1, 0], [-1, 0, -1], [-1, 1, 1], [-1, -1, -1], [-1, 1, -1], [-1, -1, 1], [0, 0, -2],
        [0, -2, 0], [-2, 0, 0], [0, -1, 2], [-1, 0, 2], [-1, 2, 0], [-2, 0, 1],
    ],
    np.int64,
)  # fmt: skip
"""Neighbours decided before, (layer, row, column), those that tell most first."""
_INPUTS = 10
_DENSE_CONTEXTS = (27, 729, 6561, 19 * 10 * 27)
_STARTS = np.cumsum((0, *_DENSE_CONTEXTS)).astype(np.int64) * 2
DENSE = int(_STARTS[-1])
"""Models of contexts that are counted, not hashed; the first ones."""
_VERDICTS = 2 * 729
_UNIFORM = (3 ** len(_TEMPLATE) - 1) // 2
"""The context of the largest template where all its cells have state 1."""
_CALM_INPUTS = 3
_CALM_STARTS = np.cumsum((0, 3 * 1000, 3)).astype(np.int64)
CALM_DENSE = int(_CALM_STARTS[-1])
_CALM_HASH_BITS = 14
_LIMIT = 1000


def state_judge(hash_bits: int) -> Judge:
    """Return the models of the cells' states at the start of a payload."""
    slots = DENSE + (1 << hash_bits)
    return judge(opinions("voxel states", slots, 2 * 81, _INPUTS), _VERDICTS + 2 * 19 * 10 * 3)


def calm_judge() -> Judge:
    """Return the models of cells among cells that are all alike."""
    slots = CALM_DENSE + (1 << _CALM_HASH_BITS)
    return judge(opinions("voxel calm", slots, 3, _CALM_INPUTS), 3 * 1000 + 3)


class _View(NamedTuple):
    """What contexts are made of, around one cell."""

    three: int
    four: int
    six: int
    all: int
    """Templates of three, four, six and all cells."""
    amount: int
    """How many of these are known, and occupied."""


@part
def _line(states: Flags, at: tuple[int, int, int], step: tuple[int, int, int], count: int) -> int:
    """Return the states of the next `count` cells in a direction, in base 4."""
    key = whole(0)
    for k in range(1, count + 1):
        key = key * 4 + states[at[0] + k * step[0], at[1] + k * step[1], at[2] + k * step[2]]
    return key


@part
def _view(states: Flags, at: tuple[int, int, int], slots: Words) -> _View:
    key, three, four, six = whole(0), whole(0), whole(0), whole(0)
    known, occupied = whole(0), whole(0)
    for k in range(_TEMPLATE.shape[0]):
        state = whole(
            states[at[0] + _TEMPLATE[k, 0], at[1] + _TEMPLATE[k, 1], at[2] + _TEMPLATE[k, 2]]
        )
        key = key * 3 + state
        known += 1 if state != NOT_KNOWN else 0
        occupied += 1 if state == OCCUPIED else 0
        if k == 2:
            three = key
        elif k == 3:
            four = key
        elif k == 5:
            six = key
        elif k == 7:
            slots[2] = _STARTS[2] + key * 2
        elif k == 9:
            slots[4] = key
        elif k == 12:
            slots[5] = key
        elif k == 15:
            slots[6] = key
    return _View(three, four, six, key, min(known, 18) * 10 + min(occupied, 9))


@part
def _beside(states: Flags, at: tuple[int, int, int], step: tuple[int, int, int]) -> int:
    """Return how far off the next decided cell in a direction is, and its state, 0..9."""
    for k in range(1, 4):
        state = whole(states[at[0] + k * step[0], at[1] + k * step[1], at[2] + k * step[2]])
        if state != OPEN:
            return (k - 1) * 3 + state
    return whole(9)


@part
def _code_calm(
    coder: Coder, calm: Judge, states: Flags, at: tuple[int, int, int], state: int, like: int
) -> int:
    """Code whether a cell is like all those around it."""
    slots = calm.opinions.slots
    ahead = (_beside(states, at, (0, 0, 1)) * 10 + _beside(states, at, (0, 1, 0))) * 10
    ahead += like * 1000 + _beside(states, at, (1, 0, 0))
    slots[0] = ahead
    slots[1] = _CALM_STARTS[1] + like
    key = _line(states, at, (0, 0, -1), 4) * 256 + _line(states, at, (0, -1, 0), 4)
    key = (key * 256 + _line(states, at, (-1, 0, 0), 4)) * 3 + like
    slots[2] = CALM_DENSE + hashed(key, 1, whole((1 << _CALM_HASH_BITS) - 1))
    return code_judged(coder, calm, like, ahead, 3000 + like, _LIMIT, 1 if state == like else 0)


@part
def _look(states: Flags, view: _View, at: tuple[int, int, int], judge: Judge) -> None:
    """Write the first slot of each opinion that is not a small template."""
    slots = judge.opinions.slots
    mask = (judge.opinions.models.size - DENSE - 1) & ~whole(1)
    slots[0] = view.three * 2
    slots[1] = _STARTS[1] + view.six * 2
    slots[3] = _STARTS[3] + (view.amount * 27 + view.three) * 2
    slots[4] = DENSE + hashed(slots[4], 1, mask)
    slots[5] = DENSE + hashed(slots[5], 2, mask)
    slots[6] = DENSE + hashed(slots[6], 3, mask)
    slots[7] = DENSE + hashed(view.all, 4, mask)
    key = _line(states, at, (0, 0, -1), 3) * 64 + _line(states, at, (0, -1, 0), 3)
    slots[8] = DENSE + hashed(key * 64 + _line(states, at, (-1, 0, 0), 3), 5, mask)
    key = _line(states, at, (0, 0, 1), 4) * 256 + _line(states, at, (0, 1, 0), 4)
    key = (key * 256 + _line(states, at, (1, 0, 0), 4)) * 27 + view.three
    slots[9] = DENSE + hashed(key, 6, mask)


@part
def _code_state(
    coder: Coder, states: Judge, palette: Palette, view: _View, state: int, other: int
) -> int:
    """Code a cell's state, with the opinions of `_look`; it is not `other`."""
    slots = states.opinions.slots
    third = _VERDICTS + (view.amount * 3 + view.three // 9) * 2
    known = 1 if palette.all_known or other == NOT_KNOWN else 0
    if not known:
        known = code_judged(
            coder, states, view.four * 2, view.six * 2, third, _LIMIT,
            1 if state != NOT_KNOWN else 0,
        )  # fmt: skip
    if not known:
        return whole(NOT_KNOWN)
    can_be_free = palette.has_free and other != FREE
    if can_be_free and palette.has_occupied and other != OCCUPIED:
        for k in range(_INPUTS):
            slots[k] += 1
        occupied = code_judged(
            coder, states, view.four * 2 + 1, view.six * 2 + 1, third + 1, _LIMIT,
            1 if state == OCCUPIED else 0,
        )  # fmt: skip
        return whole(OCCUPIED) if occupied else whole(FREE)
    return whole(FREE) if can_be_free else whole(OCCUPIED)


@part
def _near(symbols: Flags, d: int, i: int, j: int) -> Near:
    return Near(
        whole(symbols[d, i, j - 1]),
        whole(symbols[d, i - 1, j]),
        whole(symbols[d - 1, i, j]),
        whole(symbols[d, i - 1, j + 1]),
        whole(symbols[d - 1, i, j + 1]),
        whole(symbols[d - 1, i + 1, j]),
        whole(symbols[d - 2, i, j]),
        whole(symbols[d, i - 1, j - 1]),
        whole(symbols[d, i, j + 1]),
        whole(symbols[d, i + 1, j]),
    )


@kernel
def code_block(
    coder: Coder,
    calm: Judge,
    states: Judge,
    sizes: Judge,
    palette: Palette,
    field: Field,
    truth: Flags,
) -> None:
    """Code all cells of a block that are not settled; `truth` (layers, rows, cols) are symbols."""
    layers, rows, cols = truth.shape
    around, symbols = field.states, field.symbols
    for layer in range(layers):
        for row in range(rows):
            if has_run_out(coder):
                return
            for col in range(cols):
                fixed = field.fixed[layer, row, col]
                if fixed == SETTLED:
                    continue
                d, i, j = layer + LAYER_MARGIN, row + MARGIN, col + MARGIN
                state = whole(STATE_OF[truth[layer, row, col]])
                if fixed == UNDECIDED:
                    view = _view(around, (d, i, j), states.opinions.slots)
                    like = view.all // _UNIFORM
                    calmly = view.all == like * _UNIFORM
                    if calmly and _code_calm(coder, calm, around, (d, i, j), state, like):
                        state = like
                    else:
                        _look(around, view, (d, i, j), states)
                        other = like if calmly else whole(OPEN)
                        state = _code_state(coder, states, palette, view, state, other)
                    around[d, i, j] = state
                else:
                    state = whole(around[d, i, j])
                if state != NOT_KNOWN:
                    occupied = 1 if state == OCCUPIED else 0
                    size = abs(whole(truth[layer, row, col]) - ZERO)
                    least = whole(field.least[layer, row, col])
                    near = _near(symbols, d, i, j)
                    size = code_size(coder, sizes, palette, near, occupied, least, size)
                    symbols[d, i, j] = ZERO + (size if occupied else -size)


@warmer
def _warm() -> None:
    for coder in (encoder(64), decoder(b"\1\2\3")):
        truth = np.full((2, 2, 2), ZERO, np.uint8)
        judges = calm_judge(), state_judge(10), size_judge("voxel", 10)
        code_block(coder, *judges, Palette(0, 1, 1, 255), blank((2, 2, 2)), truth)
