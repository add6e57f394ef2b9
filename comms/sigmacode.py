"""Standard deviations of cells, coarsely and never too small.

A code is a half octave: sigma = 2^(code / 2) m. A block of cells shares the largest of its members,
so what a receiver believes of a cell is never more than its sender knew.
"""

import math

import numpy as np
from numpy.typing import NDArray

from comms.errors import CodecError
from comms.kernels import kernel, warmer
from comms.rangecoder import Bytes, Words, decoder, encoder, has_run_out
from comms.symbols import Models, code_adaptive, fresh_models

Codes = NDArray[np.int64]
Flags = NDArray[np.uint8]
Singles = NDArray[np.float32]

LOWEST, HIGHEST = -40, 24
_FIRST_GUESS = -8
_UNARY = 70
_STAY, _SIGN, _MORE, _DOWN = 0, 2, 3, 12
_MODELS = 24


def fresh_sigma_models() -> Models:
    """Return the models of the codes, before anything was learned."""
    return fresh_models((_MODELS,))


def _table() -> NDArray[np.float32]:
    """Return the standard deviation of every code, rounded up to float32."""
    exact = [math.ldexp(1.0 if c % 2 == 0 else math.sqrt(2), c // 2) for c in range(-40, 25)]
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
    if inside.size and not (inside.min() >= 0 and inside.max() <= float(_SIGMA_M[-1])):
        wrong = inside[~((inside >= 0) & (inside <= float(_SIGMA_M[-1])))][0]
        raise CodecError(f"a standard deviation of {wrong} m is outside 0..4096 m")
    codes = np.full(sigma_m.shape, LOWEST, np.int64)
    codes[known] = LOWEST + np.searchsorted(_SIGMA_M.astype(np.float64), inside)
    return codes


@kernel
def _code_step(coder: Words, buffer: Bytes, models: Models, moved: int, step: int) -> int:
    if code_adaptive(coder, buffer, models, _STAY + moved, int(step == 0)):
        return 0
    up = code_adaptive(coder, buffer, models, _SIGN, int(step > 0))
    size, k = abs(step), 1
    while k < _UNARY and code_adaptive(coder, buffer, models, _MORE + min(k, 8) - 1, int(size > k)):
        k += 1
    return k if up else -k


@kernel
def code_sigma_blocks(
    coder: Words, buffer: Bytes, models: Models, want: Flags, done: Flags, codes: Codes
) -> None:
    """Code one code for each block that `want` marks; `done` ones only ever go down.

    All arrays are (block rows, block columns). `codes` holds what to encode for wanted blocks, and
    what the receiver has for done ones once that is told; it is overwritten with the decoded.
    """
    rows, cols = want.shape
    guess, moved = np.int64(_FIRST_GUESS), 0
    for i in range(rows):
        if has_run_out(coder):
            return
        for j in range(cols):
            if not want[i, j]:
                continue
            if j > 0 and done[i, j - 1]:
                guess = codes[i, j - 1]
            elif i > 0 and done[i - 1, j]:
                guess = codes[i - 1, j]
            step = _code_step(coder, buffer, models, moved, codes[i, j] - guess)
            moved = int(step != 0)
            guess = min(max(guess + step, LOWEST), HIGHEST)
            codes[i, j] = guess
            done[i, j] = 1


@kernel
def code_sigma_drops(
    coder: Words, buffer: Bytes, models: Models, drops: Flags, codes: Codes, finer: Codes
) -> None:
    """Code how far the blocks that `drops` marks fall from `codes` to `finer`, in place."""
    rows, cols = drops.shape
    moved = 0
    for i in range(rows):
        if has_run_out(coder):
            return
        for j in range(cols):
            if not drops[i, j]:
                continue
            fall, k = codes[i, j] - finer[i, j], 0
            while k < HIGHEST - LOWEST and code_adaptive(
                coder, buffer, models, _DOWN + min(2 * k + moved, 7), int(fall > k)
            ):
                k += 1
            moved = int(k > 0)
            codes[i, j] = max(codes[i, j] - k, LOWEST)


@warmer
def _warm() -> None:
    for coder, buffer in (encoder(64), decoder(b"\1\2\3")):
        want, done = np.ones((2, 2), np.uint8), np.zeros((2, 2), np.uint8)
        codes = np.zeros((2, 2), np.int64)
        code_sigma_blocks(coder, buffer, fresh_sigma_models(), want, done, codes)
        code_sigma_drops(coder, buffer, fresh_sigma_models(), want, codes, codes.copy())
