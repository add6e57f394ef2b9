"""A lossless predictive coder like JPEG-LS, for whole grids and for the leaves of a quadtree.

Source: M. J. Weinberger, G. Seroussi, G. Sapiro, "The LOCO-I lossless image compression algorithm"
(2000): the median edge detector predicts, contexts of three gradients correct its bias and choose
Golomb codes, runs of what was foreseen are counted. Unlike JPEG-LS it takes integers of any size,
and instead of pixels row by row any squares that are laid so that what lies north and west of a
square's first cell is there before it.
"""

import numpy as np
from numpy.typing import NDArray

from comms.errors import CodecError
from comms.kernels import kernel, warmer
from comms.paper.bits import (
    Bits,
    Words,
    has_run_out,
    put,
    reader,
    take,
    writer,
    written,
)
from comms.parts import part, whole

Grid = NDArray[np.int64]
Flags = NDArray[np.uint8]
Squares = NDArray[np.int32]
"""(N, 3): first row, first column and side, in the order in which they are laid."""

_CONTEXTS = 9 * 9 * 9
_FLAT = 364
"""The context of three gradients of 0."""
_SIZES, _SUM, _COUNT, _BIAS = 0, 1, 2, 3
_LEFT, _ENDS, _FLUENCY = 0, 1, 2
_HALVE_AT = 64
_LARGEST_LEARNT = 1 << 54
_PLAIN, _PLAIN_BITS = 32, 56
"""A quotient this long is replaced by the plain number."""
_WIDEST = 55
_NOT_FLAT = -1
_ENDLESS = 1 << 40
_RUN_BITS = np.array(
    [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 9, 10, 11, 12, 13],
    np.int64,
)
"""log2 of how many foreseen squares one bit stands for, as it goes well or not."""
LARGEST = 1 << 52


def cells_in_order(rows: int, cols: int) -> Squares:
    """Return every cell of a grid as a square of its own, row by row."""
    i, j = np.divmod(np.arange(rows * cols), cols)
    return np.column_stack((i, j, np.ones_like(i))).astype(np.int32)


def residuals(values: Words, squares: Squares, shape: tuple[int, int]) -> Words:
    """Return by how much the median edge detector misses the value (N,) of each square (N, 3)."""
    return _residuals(values, squares, *_blank(shape))


def predictive_pack(values: Words, squares: Squares, shape: tuple[int, int]) -> bytes:
    """Return the bytes of the values (N,) of squares (N, 3) that lie on a grid of `shape`.

    Raises `CodecError` for values beyond 2^52.
    """
    if values.size and int(np.abs(values).max()) > LARGEST:
        raise CodecError(f"a value of {int(np.abs(values).max())} is beyond 2^52")
    bits = writer((_PLAIN + _PLAIN_BITS + 32) * values.size)
    ahead = _foreseen_ahead(values, squares, *_blank(shape))
    _code(bits, True, values.copy(), ahead, squares, *_blank(shape))
    return written(bits)


def predictive_unpack(data: bytes, squares: Squares, shape: tuple[int, int]) -> Words:
    """Return the values (N,) whose bytes these are.

    Raises `CodecError` for too few bytes.
    """
    bits = reader(data)
    values = np.zeros(len(squares), np.int64)
    _code(bits, False, values, values, squares, *_blank(shape))
    if has_run_out(bits):
        raise CodecError(f"{len(data)} bytes are too few for {len(squares)} values")
    return values


def _blank(shape: tuple[int, int]) -> tuple[Grid, Flags]:
    """Return a grid to lay squares on, and where some were laid; both with a border of one."""
    rows, cols = shape
    return np.zeros((rows + 1, cols + 2), np.int64), np.zeros((rows + 1, cols + 2), np.uint8)


@part
def _lay(grid: Grid, laid: Flags, i: int, j: int, side: int, value: int) -> None:
    for a in range(i, min(i + side, grid.shape[0] - 1)):
        for b in range(j, min(j + side, grid.shape[1] - 2)):
            grid[a + 1, b + 1] = value
            laid[a + 1, b + 1] = 1


@part
def _around(
    grid: Grid, laid: Flags, i: int, j: int, side: int, last: int
) -> tuple[int, int, int, int]:
    """Return what lies west, north, north-west and north-east; what is missing as a neighbour."""
    has_west, has_north = laid[i + 1, j], laid[i, j + 1]
    west = grid[i + 1, j] if has_west else last
    north = grid[i, j + 1] if has_north else west
    west = west if has_west or not has_north else north
    corner = grid[i, j] if laid[i, j] else north
    column = min(j + side, grid.shape[1] - 2)
    east = grid[i, column + 1] if laid[i, column + 1] else north
    return west, north, corner, east


@part
def _edge_detector(west: int, north: int, corner: int) -> int:
    low, high = min(west, north), max(west, north)
    return min(max(west + north - corner, low), high)


@part
def _step(gradient: int) -> int:
    size = abs(gradient)
    level = 0 if size == 0 else 1 if size < 3 else 2 if size < 7 else 3 if size < 21 else 4
    return 4 + (level if gradient > 0 else -level)


@kernel
def _residuals(values: Words, squares: Squares, grid: Grid, laid: Flags) -> Words:
    out = np.zeros(values.size, np.int64)
    last = whole(0)
    for k in range(values.size):
        i, j, side = squares[k, 0], squares[k, 1], squares[k, 2]
        west, north, corner, _ = _around(grid, laid, i, j, side, last)
        out[k] = values[k] - _edge_detector(west, north, corner)
        last = values[k]
        _lay(grid, laid, i, j, side, last)
    return out


@part
def _code_golomb(bits: Bits, writing: bool, k: int, value: int) -> int:
    """Write a number >= 0, or read one."""
    if writing:
        quotient = value >> k
        put(bits, 1, min(quotient, whole(_PLAIN)) + 1)
        put(bits, value, k if quotient < _PLAIN else _PLAIN_BITS)
        return value
    quotient = whole(0)
    while quotient < _PLAIN and take(bits, 1) == 0:
        quotient += 1
    if quotient == _PLAIN:
        take(bits, 1)
        return take(bits, _PLAIN_BITS)
    return (quotient << k) | take(bits, k)


@part
def _code_residual(bits: Bits, writing: bool, model: Words, missed: bool, residual: int) -> int:
    """Code a residual in its context; `missed`: both sides know that it is not 0."""
    k = whole(0)
    while (model[_COUNT] << k) < model[_SIZES] and k < _WIDEST:
        k += 1
    # What is as a rule about -1 is turned round, so that it takes the shortest code.
    turned = k == 0 and not missed and 2 * model[_SUM] <= -model[_COUNT]
    known = whole(1) if missed else whole(0)
    folded = whole(0)
    if writing:
        residual = -1 - residual if turned else residual
        folded = (2 * residual if residual >= 0 else -2 * residual - 1) - known
    folded = _code_golomb(bits, writing, k, folded) + known
    residual = folded >> 1 if folded & 1 == 0 else -((folded + 1) >> 1)
    return -1 - residual if turned else residual


@part
def _learn(model: Words, residual: int) -> None:
    """Let a context know of one more residual (LOCO-I's parameters A, B, N and C)."""
    size = min(abs(residual), _LARGEST_LEARNT)
    model[_SIZES] += size
    model[_SUM] += size if residual > 0 else -size
    model[_COUNT] += 1
    if model[_COUNT] == _HALVE_AT:
        model[_SIZES] >>= 1
        model[_SUM] >>= 1
        model[_COUNT] >>= 1
    if model[_SUM] <= -model[_COUNT]:
        model[_BIAS] -= 1
        model[_SUM] = max(model[_SUM] + model[_COUNT], 1 - model[_COUNT])
    elif model[_SUM] > 0:
        model[_BIAS] += 1
        model[_SUM] = min(model[_SUM] - model[_COUNT], whole(0))


@part
def _code_run(bits: Bits, writing: bool, run: Words, ahead: int) -> None:
    """Say how many flat squares come as foreseen: a 1 for 2^n of them, or a 0 and n bits."""
    step = whole(_RUN_BITS[run[_FLUENCY]])
    many = whole(1) << step
    goes_on = ahead >= many if writing else take(bits, 1) == 1
    if writing:
        put(bits, 1 if goes_on else 0, 1)
        if not goes_on:
            put(bits, ahead, step)
    if goes_on:
        run[_LEFT], run[_ENDS] = many, 0
        run[_FLUENCY] = min(run[_FLUENCY] + 1, whole(_RUN_BITS.size - 1))
    else:
        run[_LEFT], run[_ENDS] = ahead if writing else take(bits, step), 1
        run[_FLUENCY] = max(run[_FLUENCY] - 1, whole(0))


@part
def _context(west: int, north: int, corner: int, east: int) -> int:
    return 81 * _step(east - north) + 9 * _step(north - corner) + _step(corner - west)


@kernel
def _foreseen_ahead(values: Words, squares: Squares, grid: Grid, laid: Flags) -> Words:
    """Return for each flat square how many flat ones, from it on, are as foreseen (N,)."""
    out = np.full(values.size, _NOT_FLAT, np.int64)
    last = whole(0)
    for k in range(values.size):
        i, j, side = squares[k, 0], squares[k, 1], squares[k, 2]
        west, north, corner, east = _around(grid, laid, i, j, side, last)
        last = values[k]
        if _context(west, north, corner, east) == _FLAT:
            out[k] = 1 if last == _edge_detector(west, north, corner) else 0
        _lay(grid, laid, i, j, side, last)
    ahead = whole(_ENDLESS)
    for k in range(values.size - 1, -1, -1):
        if out[k] != _NOT_FLAT:
            ahead = ahead + 1 if out[k] else whole(0)
            out[k] = ahead
    return out


@kernel
def _code(
    bits: Bits,
    writing: bool,
    values: Words,
    ahead: Words,
    squares: Squares,
    grid: Grid,
    laid: Flags,
) -> None:
    """Write the values of all squares, or read them."""
    models = np.zeros((_CONTEXTS, 4), np.int64)
    models[:, _SIZES], models[:, _COUNT] = 2, 1
    run = np.zeros(3, np.int64)
    last = whole(0)
    for k in range(values.size):
        i, j, side = squares[k, 0], squares[k, 1], squares[k, 2]
        west, north, corner, east = _around(grid, laid, i, j, side, last)
        last = _edge_detector(west, north, corner)
        context = _context(west, north, corner, east)
        if context == _FLAT and run[_LEFT] == 0 and not run[_ENDS]:
            _code_run(bits, writing, run, ahead[k])
        if context == _FLAT and run[_LEFT] > 0:
            run[_LEFT] -= 1
        else:
            # Mirrored gradients share a context, their residuals' signs turned.
            sign = 1 if context >= _FLAT else -1
            model = models[max(context, 2 * _FLAT - context)]
            if context != _FLAT:
                last += sign * model[_BIAS]
            missed = context == _FLAT
            residual = _code_residual(bits, writing, model, missed, sign * (values[k] - last))
            _learn(model, residual)
            last += sign * residual
            if missed:
                run[_ENDS] = 0
        if has_run_out(bits):
            return
        values[k] = last
        _lay(grid, laid, i, j, side, last)


@warmer
def _warm() -> None:
    squares = cells_in_order(3, 3)
    values = np.array([0, 0, 1, 0, 0, 3, 0, 0, 0])
    predictive_unpack(predictive_pack(values, squares, (3, 3)), squares, (3, 3))
    residuals(values, squares, (3, 3))
