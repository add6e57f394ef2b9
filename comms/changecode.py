"""How far known ground has moved since the version before, in steps.

A cell that was not measured again has not moved at all; one that was has mostly moved by less than
the bound. What moves is told by how the standard deviation of its block fell, by what moved beside
it, and by how far it stands off its neighbours: an elevation that was decoded near the edge of its
bound is the one that leaves it.
"""

import numpy as np
from numpy.typing import NDArray

from comms.kernels import kernel, warmer
from comms.logistic import Opinions, code_mixed
from comms.parts import part, whole
from comms.priors import opinions
from comms.rangecoder import Coder, Words, decoder, encoder, has_run_out
from comms.residuals import code_size

Units = NDArray[np.int64]
Flags = NDArray[np.uint8]

_DECISIONS = 6
"""Moved or not, up or down, then more or not: more than 1, 2, 3, and beyond."""
_UNARY = 12
_INPUTS = 6
_FALLS = 6
_OFFS = 17
_CONTEXTS = (_FALLS * 4, _OFFS * 4, 81, _OFFS * _FALLS, 6 * _FALLS, _OFFS * 9)
_STARTS = np.cumsum((0, *_CONTEXTS)).astype(np.int64) * _DECISIONS
SLOTS = int(_STARTS[-1])
_LIMIT = 300


def change_opinions() -> Opinions:
    """Return the models of the changes at the start of a payload."""
    return opinions("changes", SLOTS, _FALLS * _DECISIONS, _INPUTS)


@part
def _moved(moves: Units, i: int, j: int) -> int:
    if i < 0 or j < 0 or j >= moves.shape[1]:
        return whole(0)
    return min(max(moves[i, j], -1), 1)


@part
def _off(x: Units, known: Flags, i: int, j: int, step: int) -> tuple[int, int]:
    """Return how far a cell lies below its neighbours' mean (0..16), and how rough it is there."""
    rows, cols = x.shape
    total, count, low, high = whole(0), whole(0), x[i, j], x[i, j]
    for k in range(4):
        a = i + (k == 0) - (k == 1)
        b = j + (k == 2) - (k == 3)
        if 0 <= a < rows and 0 <= b < cols and known[a, b]:
            total += x[a, b]
            count += 1
            low, high = min(low, x[a, b]), max(high, x[a, b])
    if count == 0:
        return whole(_OFFS // 2), whole(3)
    off = (8 * (total - count * x[i, j]) + ((count * step) >> 1)) // (count * step)
    rough = min((high - low) // step, 3)
    return min(max(off, -(_OFFS // 2)), _OFFS // 2) + _OFFS // 2, rough


@part
def _decide(
    coder: Coder, mixed: Opinions, contexts: Words, fall: int, decision: int, bit: int
) -> int:
    for k in range(_INPUTS):
        mixed.slots[k] = contexts[k] + decision
    return code_mixed(coder, mixed, fall * _DECISIONS + decision, _LIMIT, bit)


@part
def _code_move(coder: Coder, mixed: Opinions, contexts: Words, fall: int, r: int) -> int:
    if not _decide(coder, mixed, contexts, fall, 0, 1 if r else 0):
        return whole(0)
    up = _decide(coder, mixed, contexts, fall, 1, 1 if r > 0 else 0)
    size, k = abs(r), whole(1)
    while k < _UNARY:
        decision = min(k + 1, _DECISIONS - 1)
        if not _decide(coder, mixed, contexts, fall, decision, 1 if size > k else 0):
            break
        k += 1
    if k == _UNARY:
        k += code_size(coder, size - k)
    return k if up else -k


@kernel
def code_changes(
    coder: Coder,
    mixed: Opinions,
    old: Flags,
    known: Flags,
    falls: Units,
    x: Units,
    y: Units,
    step: int,
) -> None:
    """Code by how many steps the cells that `old` (H, W) marks have moved; move them in `x`.

    `x` (H, W): what the receiver has of all `known` cells, in units; `y`: what it should have.
    `falls` (H, W): by how many half octaves the standard deviation of a cell's block fell,
    0 to 4, or 5 where it rose.
    """
    rows, cols = x.shape
    decoding = coder.state[3] != 0
    moves = np.zeros((rows, cols), np.int64)
    contexts = np.zeros(_INPUTS, np.int64)
    for i in range(rows):
        if has_run_out(coder):
            return
        for j in range(cols):
            if not old[i, j]:
                continue
            fall = falls[i, j]
            off, rough = _off(x, known, i, j, step)
            west, north = _moved(moves, i, j - 1), _moved(moves, i - 1, j)
            corner, east = _moved(moves, i - 1, j - 1), _moved(moves, i - 1, j + 1)
            signs = ((west * 3 + north) * 3 + corner) * 3 + east + 40
            busy = abs(west) + abs(north) + abs(corner) + abs(east)
            busy += abs(_moved(moves, i, j - 2))
            contexts[0] = _STARTS[0] + _DECISIONS * (fall * 4 + min(busy, 3))
            contexts[1] = _STARTS[1] + _DECISIONS * (off * 4 + rough)
            contexts[2] = _STARTS[2] + _DECISIONS * signs
            contexts[3] = _STARTS[3] + _DECISIONS * (off * _FALLS + fall)
            contexts[4] = _STARTS[4] + _DECISIONS * (busy * _FALLS + fall)
            contexts[5] = _STARTS[5] + _DECISIONS * (off * 9 + (west + 1) * 3 + north + 1)
            r = whole(0)
            if not decoding:
                r = (y[i, j] - x[i, j] + (step >> 1)) // step
            r = _code_move(coder, mixed, contexts, fall, r)
            moves[i, j] = r
            x[i, j] += r * step


@warmer
def _warm() -> None:
    for coder in (encoder(64), decoder(b"\1\2\3")):
        flags, units = np.ones((2, 2), np.uint8), np.zeros((2, 2), np.int64)
        code_changes(coder, change_opinions(), flags, flags, units, units.copy(), units, 255)
