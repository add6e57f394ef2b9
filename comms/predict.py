"""What a cell's elevation should be, from the decoded cells around it.

First an interpolation along the two lines through the cell (cubic where it can be), each weighed by
how well its ends are known. Where all four nearest cells are coded, an adaptive filter moves it by
what the lines' disagreement, the errors of the cells before and the wider ring have come to mean.
All in integer units.

Source of the filter: normalised least mean squares, Haykin, "Adaptive Filter Theory", ch. 6.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comms.parts import part, whole
from comms.rangecoder import Words

Units = NDArray[np.int64]


DIAGONAL, ODD_ROW, EVEN_ROW = 0, 1, 2
"""Stages: the cells between four diagonal neighbours; those between two rows, or two columns, of
the coarser lattice."""


class Cells(NamedTuple):
    """A grid while it is coded, all (H, W)."""

    x: Units
    """Decoded or estimated elevations."""
    coded: NDArray[np.uint8]
    residuals: NDArray[np.int8]
    """In steps, clipped to +-127."""
    errors: NDArray[np.int32]
    """Decoded less interpolated."""


class Place(NamedTuple):
    """Where a cell is, and on what lattice."""

    i: int
    j: int
    spacing: int
    stage: int
    level: int
    """Binary logarithm of the spacing."""


STAGES = np.array(
    [
        [[1, 1], [1, -1], [0, -2], [-2, 0], [-2, -2], [-2, 2], [3, 1], [1, 3]],
        [[1, 0], [0, 1], [-1, -1], [-1, 1], [0, -2], [-2, 0], [2, 1], [1, 2]],
        [[0, 1], [1, 0], [-1, -1], [-1, 1], [0, -2], [-2, 0], [1, 2], [2, 1]],
    ],
    np.int64,
)
"""By stage, (row, column) in spacings: the two lines; four cells coded before in the same stage;
the two halves of the ring around, to be mirrored in both axes. The first line is through the cells
of the coarser lattice."""

TAPS = 7
TAP_SETS = 6
_LEARNING_SHIFT = 5


@part
def _peek(cells: Cells, i: int, j: int) -> tuple[int, int]:
    """Return a cell's value and how well it is known: 0 outside, 1 estimated, 2 coded."""
    h, w = cells.x.shape
    if i < 0 or j < 0 or i >= h or j >= w:
        return whole(0), whole(0)
    return cells.x[i, j], 1 + whole(cells.coded[i, j])


@part
def _line(cells: Cells, i: int, j: int, di: int, dj: int) -> tuple[int, int]:
    """Interpolate at (i, j) along (di, dj): twice the value, and how far to trust it (0..8)."""
    a, knows_a = _peek(cells, i - di, j - dj)
    b, knows_b = _peek(cells, i + di, j + dj)
    if knows_a and knows_b:
        p, trust = a + b, max(4 * (knows_a + knows_b - 2), 1)
        if trust == 8:
            c, knows_c = _peek(cells, i - 3 * di, j - 3 * dj)
            d, knows_d = _peek(cells, i + 3 * di, j + 3 * dj)
            if knows_c == 2 and knows_d == 2:
                p += (a + b - c - d) >> 5
        return p, trust
    if knows_a:
        return 2 * a, 2 * knows_a - 1
    return 2 * b, max(2 * knows_b - 1, 0)


@part
def interpolate(cells: Cells, place: Place) -> tuple[int, int, int]:
    """Return the interpolated value, twice how far the lines disagree, and the trust (0..16)."""
    stage, s = STAGES[place.stage], place.spacing
    p, n = _line(cells, place.i, place.j, stage[0, 0] * s, stage[0, 1] * s)
    q, m = _line(cells, place.i, place.j, stage[1, 0] * s, stage[1, 1] * s)
    if n == 0 and m == 0:
        return whole(0), whole(0), whole(0)
    if n == 0 or m == 0:
        return (p + q) >> 1, whole(0), n + m
    if n == m:
        return (p + q + 2) >> 2, p - q, n + m
    return (n * p + m * q + n + m) // (2 * (n + m)), p - q, n + m


@part
def _error(errors: NDArray[np.int32], i: int, j: int) -> int:
    if i < 0 or j < 0 or j >= errors.shape[1]:
        return whole(0)
    return whole(errors[i, j])


@part
def _ring(x: Units, i: int, j: int, di: int, dj: int) -> int:
    return x[i - di, j - dj] + x[i - di, j + dj] + x[i + di, j - dj] + x[i + di, j + dj]


@part
def adjustment(
    cells: Cells, place: Place, taps: Words, inputs: Words, spread: int, step: int
) -> int:
    """Return how far to move the interpolated value; leaves the filter's inputs in `inputs`."""
    stage, i, j, s = STAGES[place.stage], place.i, place.j, place.spacing
    h, w = cells.x.shape
    limit = 64 * step
    inputs[0] = spread >> 1
    for k in range(4):
        inputs[1 + k] = _error(cells.errors, i + stage[2 + k, 0] * s, j + stage[2 + k, 1] * s)
    inputs[5] = 0
    inputs[6] = 0
    if i >= 3 * s and j >= 3 * s and i + 3 * s < h and j + 3 * s < w:
        middle = _ends(cells.x, place)
        for k in range(2):
            di, dj = stage[6 + k, 0] * s, stage[6 + k, 1] * s
            inputs[5 + k] = (_ring(cells.x, i, j, di, dj) - middle) >> 2
    moved = whole(32768)
    for k in range(TAPS):
        inputs[k] = min(max(inputs[k], -limit), limit)
        moved += taps[k] * inputs[k]
    return whole(min(max(moved >> 16, -limit), limit))


@part
def _ends(x: Units, place: Place) -> int:
    """Return the sum of the four nearest."""
    stage, i, j, s = STAGES[place.stage], place.i, place.j, place.spacing
    total = whole(0)
    for k in range(2):
        di, dj = stage[k, 0] * s, stage[k, 1] * s
        total += whole(x[i - di, j - dj]) + whole(x[i + di, j + dj])
    return total


@part
def learn(taps: Words, inputs: Words, r: int, step: int) -> None:
    """Move the filter's weights towards what would have predicted `r` steps more."""
    norm = 4 * step * step
    for k in range(TAPS):
        norm += inputs[k] * inputs[k]
    gain = ((min(max(r, -8), 8) * step) << 24) // norm
    for k in range(TAPS):
        change = (gain * inputs[k]) >> (8 + _LEARNING_SHIFT)
        taps[k] = min(max(taps[k] + change, -(1 << 20)), 1 << 20)
