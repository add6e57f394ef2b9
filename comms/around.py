"""What surrounds a cell that is about to be coded, gathered relative to the step."""

from comms.parts import part, whole
from comms.predict import DIAGONAL, STAGES, Cells, Place
from comms.residuals import Around


@part
def around(
    cells: Cells, place: Place, guess: int, spread: int, moved: int, trust: int, step: int
) -> Around:
    """Return what surrounds a cell, relative to its step."""
    per_step = (1 << 24) // step
    i, j, s, stage = place.i, place.j, place.spacing, STAGES[place.stage]
    a = _residual(cells, i + stage[2, 0] * s, j + stage[2, 1] * s)
    b = _residual(cells, i + stage[3, 0] * s, j + stage[3, 1] * s)
    c = _residual(cells, i + stage[4, 0] * s, j + stage[4, 1] * s)
    d = _residual(cells, i + stage[5, 0] * s, j + stage[5, 1] * s)
    e, f, low, high = _ends(cells, i, j, stage[0, 0] * s, stage[0, 1] * s, guess)
    g, h, lower, higher = _ends(cells, i, j, stage[1, 0] * s, stage[1, 1] * s, guess)
    relief = min(max(high, higher) - min(low, lower), 128 * step)
    near = abs(a) + abs(b) + abs(e) + abs(f) + abs(g) + abs(h)
    return Around(
        min(place.level, 3) * 2 + (1 if place.stage == DIAGONAL else 0),
        min((abs(spread) * per_step) >> 20, 2000),
        min(near * 10, 1023),
        min((relief * per_step) >> 20, 2000),
        (a, b, c, d),
        (e, f, g, h),
        min(max((moved * per_step) >> 21, -5), 5),
        min(trust >> 2, 4),
    )


@part
def _residual(cells: Cells, i: int, j: int) -> int:
    rows, cols = cells.x.shape
    if i < 0 or j < 0 or i >= rows or j >= cols:
        return whole(0)
    return whole(cells.residuals[i, j])


@part
def _ends(cells: Cells, i: int, j: int, di: int, dj: int, guess: int) -> tuple[int, int, int, int]:
    """Return the residuals of a line's two ends, and the lower and the higher of their values."""
    a, b = _value(cells, i - di, j - dj, guess), _value(cells, i + di, j + dj, guess)
    before, after = _residual(cells, i - di, j - dj), _residual(cells, i + di, j + dj)
    return before, after, min(a, b), max(a, b)


@part
def _value(cells: Cells, i: int, j: int, outside: int) -> int:
    rows, cols = cells.x.shape
    if i < 0 or j < 0 or i >= rows or j >= cols:
        return outside
    return whole(cells.x[i, j])
