"""The quadtree of interest regions, and the one of the mask.

Sujan & Meggiolaro, section 2.4: a quadrant whose information (Eqs. 1 and 2, over its quantised
elevations) is above a cut-off is divided, down to a critical size; what is not divided further is
told by its mean. Both trees cover the smallest square of 2^n cells that holds the grid; they are
walked depth first, south-west quadrant first where row 0 is south.

A tree is a stream of symbols: first the root's state, then one for each divided quadrant, its four
quarters' states as digits, lowest first. States of the mask are 0 nothing known, 1 all known and
2 mixed; of the elevations 0 leaf and 1 divided. Where a state is no question it is 0 and costs
nothing by itself: quarters outside the grid, quarters without a known cell, and, of elevations, the
quarters of the critical size, whose symbols are left out. The mask's last symbols, those of blocks
of 2 x 2 cells, are a stream of their own, with digits 0 and 1: apart, both compress better.
"""

import math

import numpy as np
from numpy.typing import NDArray

from comms.kernels import kernel, warmer
from comms.paper.bits import Bytes, Words
from comms.parts import part, whole

Floats = NDArray[np.float64]
Flags = NDArray[np.uint8]
Singles = NDArray[np.float32]
Squares = NDArray[np.int32]

UNKNOWN, KNOWN, MIXED = 0, 1, 2
_DEEP = 64
"""Quadrants on the stack: at most three wait at each of 13 levels."""


def root_side(shape: tuple[int, int]) -> int:
    """Return the side of the smallest square of 2^n cells that holds a grid."""
    return 1 << (max(shape) - 1).bit_length()


def most_nodes(shape: tuple[int, int]) -> int:
    """Return how many divided quadrants there can be at most, the root's own state included."""
    rows, cols = shape
    count, side = 1, 2
    while side <= root_side(shape):
        count += -(-rows // side) * -(-cols // side)
        side *= 2
    return count


@part
def _state(known: Flags, i: int, j: int, side: int) -> int:
    """Return what is known of a quadrant; one outside the grid is unknown."""
    rows, cols = known.shape
    if i >= rows or j >= cols:
        return whole(UNKNOWN)
    first = known[i, j]
    for a in range(i, min(i + side, rows)):
        for b in range(j, min(j + side, cols)):
            if known[a, b] != first:
                return whole(MIXED)
    return whole(KNOWN) if first else whole(UNKNOWN)


@part
def _any_known(known: Flags, i: int, j: int, side: int) -> bool:
    rows, cols = known.shape
    for a in range(i, min(i + side, rows)):
        for b in range(j, min(j + side, cols)):
            if known[a, b]:
                return True
    return False


@part
def _push(stack: Squares, top: int, i: int, j: int, side: int, state: int) -> int:
    stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = i, j, side, state
    return top + 1


@kernel
def mask_symbols(known: Flags, side: int, out: Bytes, blocks: Bytes) -> tuple[int, int]:
    """Write the symbols of a mask (H, W) and its mixed blocks of 2 x 2; return how many of each."""
    stack = np.zeros((_DEEP, 4), np.int32)
    out[0] = _state(known, 0, 0, side)
    n, mixed = whole(1), whole(0)
    top = _push(stack, whole(0), 0, 0, side, whole(out[0]))
    while top > 0:
        top -= 1
        i, j, size, state = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        if state != MIXED:
            continue
        half, symbol = size >> 1, whole(0)
        base = whole(2) if half == 1 else whole(3)
        for quarter in range(3, -1, -1):
            a, b = i + half * (quarter >> 1), j + half * (quarter & 1)
            state = _state(known, a, b, half)
            symbol = base * symbol + state
            top = _push(stack, top, a, b, half, state)
        if half == 1:
            blocks[mixed] = symbol
            mixed += 1
        else:
            out[n] = symbol
            n += 1
    return n, mixed


@kernel
def paint_mask(symbols: Bytes, blocks: Bytes, side: int, known: Flags) -> bool:
    """Lay a mask (H, W) by its symbols; say whether they are what a mask has, none over."""
    rows, cols = known.shape
    stack = np.zeros((_DEEP, 4), np.int32)
    if symbols.size == 0 or symbols[0] > MIXED:
        return False
    n, mixed = whole(1), whole(0)
    top = _push(stack, whole(0), 0, 0, side, whole(symbols[0]))
    while top > 0:
        top -= 1
        i, j, size, state = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        if state == UNKNOWN:
            continue
        if i >= rows or j >= cols:
            return False
        if state == KNOWN:
            known[i : i + size, j : j + size] = 1
            continue
        half = size >> 1
        if half == 0 or n >= symbols.size + (half == 1) or mixed >= blocks.size + (half > 1):
            return False
        symbol = whole(blocks[mixed]) if half == 1 else whole(symbols[n])
        base = whole(2) if half == 1 else whole(3)
        if half == 1:
            mixed += 1
        else:
            n += 1
        power = base**3
        for quarter in range(3, -1, -1):
            a, b = i + half * (quarter >> 1), j + half * (quarter & 1)
            top = _push(stack, top, a, b, half, symbol // power % base)
            power //= base
    return n == symbols.size and mixed == blocks.size


@part
def _entropy_bits(
    bins: Words, known: Flags, i: int, j: int, side: int, counts: Words, plogp: Floats
) -> float:
    """Return the entropy of a quadrant's known bins in bits per cell; `counts` is 0 on both ends.

    With n log2 n in a table, H = log2 N - sum(n log2 n) / N.
    """
    rows, cols = known.shape
    total, sum_plogp = whole(0), 0.0
    for a in range(i, min(i + side, rows)):
        for b in range(j, min(j + side, cols)):
            if known[a, b]:
                n = counts[bins[a, b]] + 1
                counts[bins[a, b]] = n
                sum_plogp += plogp[n] - plogp[n - 1]
                total += 1
    for a in range(i, min(i + side, rows)):
        for b in range(j, min(j + side, cols)):
            if known[a, b]:
                counts[bins[a, b]] = 0
    return (plogp[total] - sum_plogp) / total if total else 0.0


@kernel
def elevation_tree(
    bins: Words,
    known: Flags,
    side: int,
    cutoff_bits: float,
    critical: int,
    counts: Words,
    plogp: Floats,
    symbols: Bytes,
    leaves: Squares,
) -> tuple[int, int]:
    """Divide a grid by entropy; write its symbols and its leaves (N, 3), return how many of each.

    Args:
        bins: (H, W) rank of each cell's quantised elevation.
        known: (H, W).
        side: of the root, a power of 2.
        cutoff_bits: quadrants with more than this are divided.
        critical: side of the smallest leaves, a power of 2.
        counts: zeros, one for each rank.
        plogp: n log2 n for n up to the number of cells.
        symbols: room for the symbols.
        leaves: room for first row, first column and side of each leaf.

    """
    # Rounding of sums must not divide what sits right on the cut-off.
    limit = cutoff_bits + 1e-9
    stack = np.zeros((_DEEP, 4), np.int32)
    divided = side > critical and _entropy_bits(bins, known, 0, 0, side, counts, plogp) > limit
    symbols[0] = 1 if divided else 0
    n, found = whole(1), whole(0)
    top = _push(stack, whole(0), 0, 0, side, whole(symbols[0]))
    while top > 0:
        top -= 1
        i, j, size, state = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        if not state:
            if _any_known(known, i, j, size):
                leaves[found, 0], leaves[found, 1], leaves[found, 2] = i, j, size
                found += 1
            continue
        half, symbol = size >> 1, whole(0)
        for quarter in range(3, -1, -1):
            a, b = i + half * (quarter >> 1), j + half * (quarter & 1)
            state = whole(0)
            if half > critical and _entropy_bits(bins, known, a, b, half, counts, plogp) > limit:
                state = whole(1)
            symbol = 2 * symbol + state
            top = _push(stack, top, a, b, half, state)
        if half > critical:
            symbols[n] = symbol
            n += 1
    return n, found


@kernel
def leaves_of(symbols: Bytes, known: Flags, side: int, critical: int, leaves: Squares) -> int:
    """Write the leaves (N, 3) of a tree by its symbols; return how many, -1 if it is none."""
    rows, cols = known.shape
    stack = np.zeros((_DEEP, 4), np.int32)
    if symbols.size == 0 or symbols[0] > 1:
        return whole(-1)
    n, found = whole(1), whole(0)
    top = _push(stack, whole(0), 0, 0, side, whole(symbols[0]))
    while top > 0:
        top -= 1
        i, j, size, state = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        if not state:
            if _any_known(known, i, j, size):
                leaves[found, 0], leaves[found, 1], leaves[found, 2] = i, j, size
                found += 1
            continue
        half, symbol = size >> 1, whole(0)
        if i >= rows or j >= cols or size <= critical:
            return whole(-1)
        if half > critical:
            if n >= symbols.size:
                return whole(-1)
            symbol = whole(symbols[n])
            n += 1
        for quarter in range(3, -1, -1):
            a, b = i + half * (quarter >> 1), j + half * (quarter & 1)
            top = _push(stack, top, a, b, half, (symbol >> quarter) & 1)
    return found if n == symbols.size else whole(-1)


@kernel
def leaf_means(values: Floats, known: Flags, leaves: Squares) -> tuple[Floats, Floats]:
    """Return mean and mean square deviation from it, (N,) each, of the known cells of leaves."""
    rows, cols = known.shape
    means, squares = np.zeros(len(leaves)), np.zeros(len(leaves))
    for k in range(len(leaves)):
        i, j, side = leaves[k, 0], leaves[k, 1], leaves[k, 2]
        origin, total, square, count = 0.0, 0.0, 0.0, whole(0)
        for a in range(i, min(i + side, rows)):
            for b in range(j, min(j + side, cols)):
                if known[a, b]:
                    if count == 0:
                        origin = values[a, b]
                    off = values[a, b] - origin
                    total += off
                    square += off * off
                    count += 1
        means[k] = origin + total / count
        squares[k] = max(square / count - (total / count) ** 2, 0.0)
    return means, squares


@kernel
def paint(values: Floats, known: Flags, leaves: Squares, out: Singles) -> None:
    """Lay each leaf's value (N,) on its known cells."""
    rows, cols = known.shape
    for k in range(len(leaves)):
        i, j, side = leaves[k, 0], leaves[k, 1], leaves[k, 2]
        for a in range(i, min(i + side, rows)):
            for b in range(j, min(j + side, cols)):
                if known[a, b]:
                    out[a, b] = values[k]


def plogp_table(count: int) -> Floats:
    """Return n log2 n for n = 0..count, (count + 1,)."""
    n = np.arange(count + 1, dtype=np.float64)
    return n * np.log2(np.maximum(n, 1.0))


def critical_side(cells: float) -> int:
    """Return the side of the smallest leaves: the largest power of 2 that is not above `cells`."""
    return 1 << max(math.floor(math.log2(cells)), 0)


@warmer
def _warm() -> None:
    known, bins = np.ones((2, 2), np.uint8), np.array([[0, 0], [0, 1]])
    known[0, 0] = 0
    symbols, blocks = np.zeros(8, np.uint8), np.zeros(8, np.uint8)
    leaves = np.zeros((4, 3), np.int32)
    n, mixed = mask_symbols(known, 2, symbols, blocks)
    paint_mask(symbols[:n], blocks[:mixed], 2, known)
    n, found = elevation_tree(
        bins, known, 2, 0.5, 1, np.zeros(2, np.int64), plogp_table(4), symbols, leaves
    )
    leaves_of(symbols[:n], known, 2, 1, leaves)
    means, _ = leaf_means(np.zeros((2, 2)), known, leaves[:found])
    paint(means, known, leaves[:found], np.zeros((2, 2), np.float32))
