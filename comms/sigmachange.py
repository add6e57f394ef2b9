"""Standard deviations against those of the version before: which fell, and which must not rise.

A block of cells shares one code, the largest of theirs. Two things are told beside that. A version
that is built on the one before codes each block against what was told then, and no cell is believed
less than before. A version that stands alone may split a block: then each of its cells has a code
of its own, so that a sure cell beside a fresh, unsure one is told no less surely than it was.
"""

import numpy as np
from numpy.typing import NDArray

from comms.kernels import kernel, warmer
from comms.logistic import Opinions, code_mixed
from comms.parts import part, whole
from comms.priors import opinions
from comms.rangecoder import Coder, Words, code_even_bits, decoder, encoder, has_run_out
from comms.sigmacode import HIGHEST, LOWEST

Codes = NDArray[np.int64]
Flags = NDArray[np.uint8]

_UNARY = HIGHEST - LOWEST
_DECISIONS = 7
"""The guess holds or not, the sign, then more or not: more than 1, 2, ... 4, and beyond."""
_INPUTS = 3
_SHARES = 3
_STARTS = np.array([0, 16 * _SHARES, 16 * _SHARES + 5 * 4], np.int64) * _DECISIONS
CHANGE_SLOTS = (16 * _SHARES + 5 * 4 + _SHARES) * _DECISIONS
_CELL_DECISIONS = 6
"""As sure as the block or not, then more or not: more than 1, 2, ... 4, and beyond."""
_CELL_STARTS = np.array([0, 36, 36 + 6], np.int64) * _CELL_DECISIONS
_SPLIT = int(_CELL_STARTS[2])
CELL_SLOTS = _SPLIT + 9
_CELL_INPUTS = 2
_LIMIT = 250


def change_opinions() -> Opinions:
    """Return the models of how blocks changed, at the start of a payload."""
    return opinions("sigma-changes", CHANGE_SLOTS, _DECISIONS, _INPUTS)


def cell_opinions() -> Opinions:
    """Return the models of blocks that were split, at the start of a payload."""
    return opinions("sigma-cells", CELL_SLOTS, _CELL_DECISIONS + 1, _CELL_INPUTS)


@part
def _decide(coder: Coder, mixed: Opinions, contexts: Words, decision: int, bit: int) -> int:
    for k in range(mixed.slots.size):
        mixed.slots[k] = contexts[k] + decision
    return code_mixed(coder, mixed, decision, _LIMIT, bit)


@part
def _code_change(coder: Coder, mixed: Opinions, contexts: Words, change: int) -> int:
    if _decide(coder, mixed, contexts, 0, 1 if change == 0 else 0):
        return whole(0)
    up = _decide(coder, mixed, contexts, 1, 1 if change > 0 else 0)
    size, k = abs(change), whole(1)
    while k < _UNARY:
        decision = min(k + 1, _DECISIONS - 1)
        if not _decide(coder, mixed, contexts, decision, 1 if size > k else 0):
            break
        k += 1
    return k if up else -k


@part
def _sense(known: Flags, changes: Codes, i: int, j: int) -> int:
    """Return how a block before changed: 0 not known, 1 not at all, 2 fell, 3 rose."""
    if i < 0 or j < 0 or not known[i, j]:
        return whole(0)
    return whole(1 if changes[i, j] == 0 else (2 if changes[i, j] < 0 else 3))


@kernel
def code_sigma_changes(
    coder: Coder, mixed: Opinions, old: Flags, grown: Codes, before: Codes, codes: Codes
) -> None:
    """Code the code of each block that `old` marks, against what it was `before`.

    All arrays are (block rows, block columns). `grown` says which blocks hold cells that were not
    known before: 0 none, 1 some, 2 more than were known. `codes` is overwritten with what is
    decoded.
    """
    rows, cols = old.shape
    contexts = np.zeros(_INPUTS, np.int64)
    changes = np.zeros((rows, cols), np.int64)
    for i in range(rows):
        if has_run_out(coder):
            return
        for j in range(cols):
            if not old[i, j]:
                continue
            west, north = _sense(old, changes, i, j - 1), _sense(old, changes, i - 1, j)
            last = changes[i, j - 1] if west else (changes[i - 1, j] if north else 0)
            share = grown[i, j]
            contexts[0] = _STARTS[0] + _DECISIONS * ((west * 4 + north) * _SHARES + share)
            contexts[1] = _STARTS[1] + _DECISIONS * ((min(max(last, -2), 2) + 2) * 4 + north)
            contexts[2] = _STARTS[2] + _DECISIONS * share
            change = _code_change(coder, mixed, contexts, codes[i, j] - before[i, j])
            codes[i, j] = min(max(before[i, j] + change, LOWEST), HIGHEST)
            changes[i, j] = codes[i, j] - before[i, j]


@part
def _drop(drops: Codes, mask: Flags, i: int, j: int) -> int:
    """Return how much surer than its block a cell before is: 0..4, or 5 if it is not known."""
    if i < 0 or j < 0 or not mask[i, j] or drops[i, j] < 0:
        return whole(5)
    return min(drops[i, j], 4)


@part
def _code_drop(coder: Coder, mixed: Opinions, contexts: Words, drop: int) -> int:
    k = whole(0)
    while k < _UNARY:
        decision = min(k, _CELL_DECISIONS - 1)
        if not _decide(coder, mixed, contexts, decision, 1 if drop > k else 0):
            break
        k += 1
    return k


@kernel
def code_sigma_cells(
    coder: Coder, mixed: Opinions, mask: Flags, split: Flags, side: int, cells: Codes
) -> None:
    """Code which blocks are `split`, if any is, and in these each cell's own code.

    `mask` (H, W): the known cells. `cells` (H, W) holds each cell's own code where blocks are
    split, for an encoder, and each block's largest code elsewhere and at first for a decoder; it is
    overwritten with what is decoded. `split` (block rows, block columns) is too.
    """
    rows, cols = split.shape
    if not code_even_bits(coder, 1, whole(split.max())):
        return
    contexts = np.zeros(_CELL_INPUTS, np.int64)
    drops = np.full(mask.shape, -1, np.int64)
    height, width = mask.shape
    for a in range(rows):
        if has_run_out(coder):
            return
        for b in range(cols):
            bottom, right = min((a + 1) * side, height), min((b + 1) * side, width)
            count, top = whole(0), whole(LOWEST)
            for i in range(a * side, bottom):
                for j in range(b * side, right):
                    if mask[i, j]:
                        count += 1
                        top = max(top, cells[i, j])
            if count < 2:
                split[a, b] = 0
                continue
            west = 1 + whole(split[a, b - 1]) if b > 0 else whole(0)
            north = 1 + whole(split[a - 1, b]) if a > 0 else whole(0)
            mixed.slots[0] = _SPLIT + west * 3 + north
            mixed.slots[1] = _SPLIT + west * 3 + north
            split[a, b] = code_mixed(coder, mixed, _CELL_DECISIONS, _LIMIT, whole(split[a, b]))
            if not split[a, b]:
                continue
            for i in range(a * side, bottom):
                for j in range(b * side, right):
                    if not mask[i, j]:
                        continue
                    left, above = _drop(drops, mask, i, j - 1), _drop(drops, mask, i - 1, j)
                    contexts[0] = _CELL_STARTS[0] + _CELL_DECISIONS * (left * 6 + above)
                    contexts[1] = _CELL_STARTS[1] + _CELL_DECISIONS * min(left, above)
                    drops[i, j] = _code_drop(coder, mixed, contexts, top - cells[i, j])
                    cells[i, j] = max(top - drops[i, j], LOWEST)


@warmer
def _warm() -> None:
    for coder in (encoder(64), decoder(b"\1\2\3")):
        flags, codes = np.ones((2, 2), np.uint8), np.zeros((2, 2), np.int64)
        code_sigma_changes(coder, change_opinions(), flags, codes, codes, codes.copy())
        code_sigma_cells(coder, cell_opinions(), flags, flags.copy(), 2, codes.copy())
