"""The cells of a planar map, row by row: known or not, occupied or not, and how sure.

Twelve opinions look at what is decided: templates of 4 to 21 cells, the columns and rows that lead
to the cell, where edges ran in the three rows before, a coarse picture of what lies further off,
and the nearest decided cells ahead.

Source of the idea: ITU-T T.82 (JBIG) for the templates.
"""

from typing import NamedTuple

import numpy as np

from comms.kernels import kernel, warmer
from comms.occupancy.classes import FREE, NOT_KNOWN, OCCUPIED, OPEN, STATE_OF, ZERO
from comms.occupancy.field import (
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
        [0, -1], [-1, 0], [-1, -1], [-1, 1], [0, -2], [-2, 0], [-1, -2], [-1, 2], [-2, -1],
        [-2, 1], [-2, -2], [-2, 2], [0, -3], [-3, 0], [-1, -3], [-1, 3], [-3, -1], [-3, 1],
        [0, -4], [-4, 0], [-2, -3],
    ],
    np.int64,
)  # fmt: skip
"""Neighbours decided before, (row, column), nearest first."""
_FAR = 8
"""How far ahead to look for decided cells."""
_INPUTS = 12
_DENSE_CONTEXTS = (81, 729, 6561, 216 * 9, 6 * 4 * 6 * 4 * 9)
_STARTS = np.cumsum((0, *_DENSE_CONTEXTS)).astype(np.int64) * 2
DENSE = int(_STARTS[-1])
"""Models of contexts that are counted, not hashed; the first ones."""
_VERDICTS = 2 * 729
_LIMIT = 1000
_OF_DISTANCE = np.array([0, 0, 1, 2, 3, 3, 4, 4, 4, 5], np.int64)


def state_judge(hash_bits: int) -> Judge:
    """Return the models of the cells' states at the start of a payload."""
    slots = DENSE + (1 << hash_bits)
    return judge(opinions("planar states", slots, 2 * 81, _INPUTS), _VERDICTS + 2 * 216 * 3)


class _Above(NamedTuple):
    """What is kept of the rows before, by column."""

    columns: Words
    """The last ten states, in base 3."""
    runs: Words
    """(4, width): how many cells from here to the right are alike, of the last four rows."""
    coarse: Words
    """(4, width): what three rows hold around here, by the last of the three rows."""


@part
def _note_row(states: Flags, above: _Above, i: int) -> None:
    """Note what contexts need of row `i` once it is decided."""
    columns, runs, coarse = above
    width = states.shape[1]
    run = whole(1)
    for j in range(width - 2, -1, -1):
        run = run + 1 if states[i, j] == states[i, j + 1] else whole(1)
        runs[i & 3, j] = run
    for j in range(1, width - 1):
        columns[j] = (columns[j] * 3 + whole(states[i, j])) % 59049
        known, occupied = whole(0), whole(0)
        for a in range(3):
            for b in range(-1, 2):
                state = states[i - a, j + b]
                known += 1 if state != NOT_KNOWN else 0
                occupied |= 1 if state == OCCUPIED else 0
        coarse[i & 3, j] = (0 if known == 0 else 1 + known // 9) + 3 * occupied


@part
def _ahead(states: Flags, i: int, j: int, di: int, dj: int) -> int:
    """Return how far off the next decided cell in a direction is, and its state."""
    k = whole(1)
    while k < _FAR + 1 and states[i + k * di, j + k * dj] == OPEN:
        k += 1
    return _OF_DISTANCE[k] * 4 + (whole(states[i + k * di, j + k * dj]) if k <= _FAR else OPEN)


@part
def _templates(states: Flags, i: int, j: int, slots: Words, mask: int) -> tuple[int, int]:
    """Write the slots of the templates; return the contexts of four and of six cells."""
    key, four, six = whole(0), whole(0), whole(0)
    for k in range(_TEMPLATE.shape[0]):
        key = key * 3 + whole(states[i + _TEMPLATE[k, 0], j + _TEMPLATE[k, 1]])
        if k == 3:
            four = key
        elif k == 5:
            six = key
        elif k == 7:
            slots[2] = _STARTS[2] + key * 2
        elif k == 10:
            slots[5] = DENSE + hashed(key, 1, mask)
        elif k == 14:
            slots[6] = DENSE + hashed(key, 2, mask)
    slots[7] = DENSE + hashed(key, 3, mask)
    slots[0] = four * 2
    slots[1] = _STARTS[1] + six * 2
    return four, six


@part
def _look(
    states: Flags, above: _Above, i: int, j: int, left: int, slots: Words, mask: int
) -> tuple[int, int, int]:
    """Write the first slot of each opinion; return three contexts for who is to be believed."""
    mask &= ~whole(1)
    four, six = _templates(states, i, j, slots, mask)
    west, north, northeast = whole(states[i, j - 1]), whole(states[i - 1, j]), states[i - 1, j + 1]
    pair = west * 3 + north
    near, far = above.coarse[(i - 1) & 3], above.coarse[i & 3]
    picture = (near[j] * 6 + near[j - 3]) * 6 + near[j + 3]
    slots[3] = _STARTS[3] + (picture * 9 + pair) * 2
    ahead = _ahead(states, i, j, 0, 1) * 24 + _ahead(states, i, j, 1, 0)
    slots[4] = _STARTS[4] + (ahead * 9 + pair) * 2
    runs = above.runs
    edges = min(runs[(i - 1) & 3, j - 1], 9) * 256 + min(runs[(i - 2) & 3, j - 2], 13) * 16
    edges += min(runs[(i - 3) & 3, j - 3], 15)
    slots[8] = DENSE + hashed(edges * 9 + pair, 4, mask)
    slots[9] = DENSE + hashed(above.columns[j] * 9 + west * 3 + northeast, 5, mask)
    slots[10] = DENSE + hashed(left * 9 + north * 3 + northeast, 6, mask)
    wide = ((picture * 6 + near[j - 6]) * 6 + near[j + 6]) * 216
    wide += (far[j] * 6 + far[j - 3]) * 6 + far[j + 3]
    slots[11] = DENSE + hashed(wide * 9 + pair, 7, mask)
    return four, six, picture * 3 + west


@part
def _code_state(
    coder: Coder, states: Judge, palette: Palette, at: tuple[int, int, int], state: int
) -> int:
    """Code a cell's state, with the opinions of `_look`."""
    four, six, picture = at
    slots = states.opinions.slots
    known = whole(1)
    if not palette.all_known:
        known = code_judged(
            coder, states, four * 2, six * 2, _VERDICTS + picture * 2, _LIMIT,
            1 if state != NOT_KNOWN else 0,
        )  # fmt: skip
    if not known:
        return whole(NOT_KNOWN)
    if palette.has_free and palette.has_occupied:
        for k in range(_INPUTS):
            slots[k] += 1
        occupied = code_judged(
            coder, states, four * 2 + 1, six * 2 + 1, _VERDICTS + picture * 2 + 1, _LIMIT,
            1 if state == OCCUPIED else 0,
        )  # fmt: skip
        return whole(OCCUPIED) if occupied else whole(FREE)
    return whole(OCCUPIED) if palette.has_occupied else whole(FREE)


@part
def _near(symbols: Flags, i: int, j: int) -> Near:
    return Near(
        whole(symbols[i, j - 1]),
        whole(symbols[i - 1, j]),
        whole(symbols[i - 1, j - 1]),
        whole(symbols[i - 1, j + 1]),
        whole(symbols[i, j - 2]),
        whole(symbols[i - 2, j]),
        whole(symbols[i - 2, j + 1]),
        whole(symbols[i - 1, j - 2]),
        whole(symbols[i, j + 1]),
        whole(symbols[i + 1, j]),
    )


@kernel
def code_plane(
    coder: Coder, states: Judge, sizes: Judge, palette: Palette, field: Field, truth: Flags
) -> None:
    """Code all cells of a plane that are not settled; `truth` (1, rows, cols) are its symbols."""
    _, rows, cols = truth.shape
    plane, symbols = field.states[0], field.symbols[0]
    width = plane.shape[1]
    above = _Above(
        np.full(width, 29524, np.int64),
        np.ones((4, width), np.int64),
        np.zeros((4, width), np.int64),
    )
    mask = states.opinions.models.size - DENSE - 1
    for i in range(MARGIN - 4, MARGIN):
        _note_row(plane, above, i)
    for row in range(rows):
        if has_run_out(coder):
            return
        i = row + MARGIN
        left = whole(29524)
        for col in range(cols):
            j = col + MARGIN
            fixed = field.fixed[0, row, col]
            state = whole(STATE_OF[truth[0, row, col]])
            if fixed == UNDECIDED:
                at = _look(plane, above, i, j, left, states.opinions.slots, mask)
                state = _code_state(coder, states, palette, at, state)
                plane[i, j] = state
            else:
                state = whole(plane[i, j])
            left = (left * 3 + state) % 59049
            if fixed != SETTLED and state != NOT_KNOWN:
                occupied = 1 if state == OCCUPIED else 0
                size = abs(whole(truth[0, row, col]) - ZERO)
                least = whole(field.least[0, row, col])
                size = code_size(coder, sizes, palette, _near(symbols, i, j), occupied, least, size)
                symbols[i, j] = ZERO + (size if occupied else -size)
        _note_row(plane, above, i)


@warmer
def _warm() -> None:
    for coder in (encoder(64), decoder(b"\1\2\3")):
        truth = np.full((1, 3, 3), ZERO, np.uint8)
        judges = state_judge(10), size_judge("planar", 10)
        code_plane(coder, *judges, Palette(0, 1, 1, 255), blank((1, 3, 3)), truth)
