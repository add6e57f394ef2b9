"""Elevations from coarse to fine: predicted from what is decoded, the rest of the way coded.

A grid is visited on ever finer lattices. Halving the spacing s takes two stages: first the cells
with four decoded neighbours on their diagonals, then those with four along the axes. Each cell is
predicted from decoded values (a closed loop), and what the prediction lacks is sent as a whole
number of steps. A step is an odd number of units, so the error of the integers is at most
(step - 1) / 2 units, and half a unit more for having made the elevations integers.

Cells that are not to be coded keep their prediction as an estimate, which later cells may use; so a
stage that codes nothing paints the picture that a receiver sees before the finer lattices arrive.

Source of the idea: Zhao et al., "Optimizing error-bounded lossy compression for scientific data by
dynamic spline interpolation", ICDE 2021 (SZ3); the order and the models are ours.
"""

import numpy as np
from numpy.typing import NDArray

from comms.kernels import kernel, warmer
from comms.rangecoder import Bytes, Words, decoder, encoder, has_run_out
from comms.symbols import Models, code_adaptive, code_exponential, fresh_models

Units = NDArray[np.int64]
Flags = NDArray[np.uint8]

ESTIMATED, CODED = 0, 1
STEP_UNITS = 255
"""Units to one step at the finest lattice; odd."""

_CONTEXTS = 12
_UNARY = 14
_ZERO, _SIGN, _MORE = 0, 1, 2
_DECISIONS = _UNARY + 2
_TAIL = _CONTEXTS * _DECISIONS * 2
_FAR = np.int64(1) << 46
_ENERGY_LIMITS = np.array([16, 27, 46, 78, 133, 226, 384, 653, 1110, 1887, 3208], np.int64)


def fresh_residual_models() -> Models:
    """Return the models of the residuals, before anything was learned."""
    return fresh_models((_TAIL + 48,))


def top_spacing(rows: int, cols: int) -> int:
    """Return the spacing of the coarsest lattice: a power of two that leaves one cell of it."""
    return 1 << (max(rows, cols) - 1).bit_length()


def steps_of(top: int) -> Units:
    """Return the step of every spacing from 1 to `top`, in units."""
    return np.full(top.bit_length(), STEP_UNITS, np.int64)


@kernel
def _line(x: Units, state: Flags, i: int, j: int, di: int, dj: int) -> tuple[int, int]:
    """Interpolate at (i, j) along (di, dj): twice the value, and how far to trust it (0..8)."""
    h, w = x.shape
    i0, j0, i1, j1 = i - di, j - dj, i + di, j + dj
    a = 0 <= i0 < h and 0 <= j0 < w
    b = 0 <= i1 < h and 0 <= j1 < w
    if a and b:
        p = x[i0, j0] + x[i1, j1]
        trust = 4 * (np.int64(state[i0, j0]) + np.int64(state[i1, j1]))
        i2, j2, i3, j3 = i - 3 * di, j - 3 * dj, i + 3 * di, j + 3 * dj
        if (
            0 <= i2 < h
            and 0 <= j2 < w
            and 0 <= i3 < h
            and 0 <= j3 < w
            and trust == 8
            and state[i2, j2]
            and state[i3, j3]
        ):
            p += (p - x[i2, j2] - x[i3, j3]) // 12
        return p, max(trust, 1)
    if a:
        return 2 * x[i0, j0], 1 + 2 * np.int64(state[i0, j0])
    if b:
        return 2 * x[i1, j1], 1 + 2 * np.int64(state[i1, j1])
    return 0, 0


@kernel
def _code_residual(state: Words, buffer: Bytes, models: Models, context: int, r: int) -> int:
    """Code a whole number of steps: zero or not, its sign, then its size."""
    at = context * _DECISIONS
    if code_adaptive(state, buffer, models, at + _ZERO, int(r == 0)):
        return 0
    positive = code_adaptive(state, buffer, models, at + _SIGN, int(r > 0))
    size = abs(r)
    k = 1
    while k < _UNARY and code_adaptive(state, buffer, models, at + _MORE + k - 1, int(size > k)):
        k += 1
    if k == _UNARY:
        k += code_exponential(state, buffer, models[_TAIL:], size - k)
    return k if positive else -k


@kernel
def _visit(
    coder: Words,
    buffer: Bytes,
    models: Models,
    y: Units,
    want: Flags,
    x: Units,
    state: Flags,
    sizes: Flags,
    i: int,
    j: int,
    s: int,
    diagonal: bool,
    step: int,
    snap: bool,
) -> None:
    if state[i, j] == CODED:
        return
    h, w = x.shape
    if diagonal:
        p1, n1 = _line(x, state, i, j, s, s)
        p2, n2 = _line(x, state, i, j, s, -s)
    else:
        p1, n1 = _line(x, state, i, j, s, 0)
        p2, n2 = _line(x, state, i, j, 0, s)
    trust = n1 + n2
    p = (n1 * p1 + n2 * p2 + trust) // (2 * trust) if trust else np.int64(0)
    r = 0
    if want[i, j]:
        energy = abs(p1 - p2) * 16 // step if (n1 and n2) else 32
        near, found = 0, 0
        for a in range(max(i - s, 0), min(i + s, h - 1) + 1, s):
            for b in range(max(j - s, 0), min(j + s, w - 1) + 1, s):
                if state[a, b]:
                    near += np.int64(sizes[a, b])
                    found += 1
        energy += near * 64 // found if found else 64
        context = 0
        while context < _CONTEXTS - 1 and energy > _ENERGY_LIMITS[context]:
            context += 1
        if snap:
            p = (p + step // 2) // step * step
        r = (y[i, j] - p + step // 2) // step
        r = _code_residual(coder, buffer, models, context, r)
        state[i, j] = CODED
        sizes[i, j] = min(abs(r), 255)
    x[i, j] = min(max(p + r * step, -_FAR), _FAR)


@kernel
def sweep(
    coder: Words,
    buffer: Bytes,
    models: Models,
    y: Units,
    want: Flags,
    x: Units,
    state: Flags,
    sizes: Flags,
    top: int,
    bottom: int,
    steps: Units,
    snap: bool,
) -> None:
    """Visit the lattices of spacing `top` down to `bottom` (powers of two).

    Codes what `want` marks and is not yet coded; all other cells get an estimate. `y` holds what to
    encode in units (ignored when decoding), `x` what a receiver then has, `steps[k]` the step of
    spacing 2^k. `snap` keeps every coded cell on whole steps. Decoding stops early once the bytes have
    run out.
    """
    h, w = x.shape
    s = top
    level = 0
    while 1 << level < s:
        level += 1
    for i in range(0, h, s):
        for j in range(0, w, s):
            _visit(
                coder, buffer, models, y, want, x, state, sizes, i, j, s, False, steps[level], snap
            )
    while s > bottom:
        s //= 2
        level -= 1
        step = steps[level]
        for i in range(s, h, 2 * s):
            if has_run_out(coder):
                return
            for j in range(s, w, 2 * s):
                _visit(coder, buffer, models, y, want, x, state, sizes, i, j, s, True, step, snap)
        for i in range(0, h, s):
            if has_run_out(coder):
                return
            for j in range(s if (i // s) % 2 == 0 else 0, w, 2 * s):
                _visit(coder, buffer, models, y, want, x, state, sizes, i, j, s, False, step, snap)


@warmer
def _warm() -> None:
    shape = (3, 3)
    for coder, buffer in (encoder(64), decoder(b"\1\2\3")):
        sweep(
            coder,
            buffer,
            fresh_residual_models(),
            np.zeros(shape, np.int64),
            np.ones(shape, np.uint8),
            np.zeros(shape, np.int64),
            np.zeros(shape, np.uint8),
            np.zeros(shape, np.uint8),
            4,
            1,
            np.full(3, STEP_UNITS, np.int64),
            False,
        )
