"""Standard deviations of cells, coarsely and never too small.

A code is a half octave: sigma = 2^(code / 2) m. A block of cells shares the largest of its members,
so what a receiver believes of a cell is never more than its sender knew.
"""

import math

import numpy as np
from numpy.typing import NDArray

from comms.errors import CodecError
from comms.kernels import kernel, warmer
from comms.logistic import Opinions, code_mixed
from comms.parts import part, whole
from comms.priors import opinions
from comms.rangecoder import Coder, Words, decoder, encoder, has_run_out

Codes = NDArray[np.int64]
Flags = NDArray[np.uint8]
Singles = NDArray[np.float32]

LOWEST, HIGHEST = -40, 24
_FIRST_GUESS = -12
_UNARY = HIGHEST - LOWEST
_DECISIONS = 8
"""The guess holds or not, the sign, then more or not: more than 1, 2, ... 5, and beyond."""
_INPUTS = 3
_STARTS = np.array([0, 25, 25 + 9], np.int64) * _DECISIONS
SLOTS = (25 + 9 + 1) * _DECISIONS
_LIMIT = 250


def sigma_opinions() -> Opinions:
    """Return the models of the codes at the start of a payload."""
    return opinions("sigma", SLOTS, _DECISIONS, _INPUTS)


def _table() -> Singles:
    """Return the standard deviation of every code, rounded up to float32."""
    codes = range(LOWEST, HIGHEST + 1)
    exact = [math.ldexp(math.sqrt(2) if code % 2 else 1.0, code // 2) for code in codes]
    return np.nextafter(np.array(exact, np.float32), np.float32(np.inf))


_SIGMA_M = _table()


def sigma_of(codes: Codes) -> Singles:
    """Return the standard deviations in metres that codes stand for."""
    return _SIGMA_M[codes - LOWEST]


def code_of(sigma_m: NDArray[np.float64], known: NDArray[np.bool_]) -> Codes:
    """Return the smallest codes that are not below the standard deviations of the known cells.

    Raises `CodecError` for one that is negative, not finite or above 4096 m.
    """
    inside = sigma_m[known]
    wrong = inside[~((inside >= 0) & (inside <= float(_SIGMA_M[-1])))]
    if wrong.size:
        raise CodecError(f"a standard deviation of {wrong[0]} m is outside 0..4096 m")
    codes = np.full(sigma_m.shape, LOWEST, np.int64)
    codes[known] = LOWEST + np.searchsorted(_SIGMA_M.astype(np.float64), inside)
    return codes


@part
def _decide(coder: Coder, mixed: Opinions, contexts: Words, decision: int, bit: int) -> int:
    for k in range(_INPUTS):
        mixed.slots[k] = contexts[k] + decision
    return code_mixed(coder, mixed, decision, _LIMIT, bit)


@part
def _code_step(coder: Coder, mixed: Opinions, contexts: Words, step: int) -> int:
    """Code how far a code lies off its guess."""
    if _decide(coder, mixed, contexts, 0, 1 if step == 0 else 0):
        return whole(0)
    up = _decide(coder, mixed, contexts, 1, 1 if step > 0 else 0)
    size, k = abs(step), whole(1)
    while k < _UNARY:
        decision = min(k + 1, _DECISIONS - 1)
        if not _decide(coder, mixed, contexts, decision, 1 if size > k else 0):
            break
        k += 1
    return k if up else -k


@part
def _clip(value: int, limit: int) -> int:
    return min(max(value, -limit), limit)


@part
def _guess(
    done: Flags, moved: Flags, codes: Codes, i: int, j: int, last: int, contexts: Words
) -> int:
    """Guess a block's code from the blocks west, north and north-west of it (as JPEG-LS does)."""
    has_west, has_north = j > 0 and done[i, j - 1] > 0, i > 0 and done[i - 1, j] > 0
    west = codes[i, j - 1] if has_west else last
    north = codes[i - 1, j] if has_north else west
    west = west if has_west else north
    corner = codes[i - 1, j - 1] if i > 0 and j > 0 and done[i - 1, j - 1] > 0 else north
    turn = 5 * (_clip(west - corner, 2) + 2) + _clip(north - corner, 2) + 2
    moves = 3 * (1 + whole(moved[i, j - 1]) if has_west else 0)
    moves += 1 + whole(moved[i - 1, j]) if has_north else 0
    contexts[0] = _STARTS[0] + _DECISIONS * turn
    contexts[1] = _STARTS[1] + _DECISIONS * moves
    contexts[2] = _STARTS[2]
    return min(max(west + north - corner, min(west, north)), max(west, north))


@kernel
def code_sigma_blocks(
    coder: Coder, mixed: Opinions, want: Flags, done: Flags, codes: Codes
) -> None:
    """Code one code for each block that `want` marks, and mark it as done.

    All arrays are (block rows, block columns). `codes` holds what to encode for wanted blocks and
    what the receiver has for done ones; it is overwritten with what is decoded.
    """
    rows, cols = want.shape
    contexts = np.zeros(_INPUTS, np.int64)
    moved = np.zeros((rows, cols), np.uint8)
    last = whole(_FIRST_GUESS)
    for i in range(rows):
        if has_run_out(coder):
            return
        for j in range(cols):
            if not want[i, j]:
                continue
            guess = _guess(done, moved, codes, i, j, last, contexts)
            step = _code_step(coder, mixed, contexts, codes[i, j] - guess)
            last = min(max(guess + step, LOWEST), HIGHEST)
            moved[i, j] = 1 if step else 0
            codes[i, j] = last
            done[i, j] = 1


@warmer
def _warm() -> None:
    for coder in (encoder(64), decoder(b"\1\2\3")):
        want, done = np.ones((2, 2), np.uint8), np.zeros((2, 2), np.uint8)
        code_sigma_blocks(coder, sigma_opinions(), want, done, np.zeros((2, 2), np.int64))
