"""A conjugate-gradient solver with a multigrid preconditioner for Laplace with holes.

The unknown cells of a map are a graph: each has links of weight 1 to its unknown neighbours and
`pins`, links to measured ones. A coarser level joins 2x2 cells; its links are half the sum of the
links that cross (a link is a conductance: twice as long, twice as wide, two of them in parallel,
so a half of the sum), which keeps thin strips and lone measured cells right where a mask that
is only thinned out would not.
"""

from dataclasses import dataclass

import numpy as np

from agents.geometry import Floats
from comms import kernels
from comms.kernels import kernel

PIN_SHARE = 0.7
"""Share of the pins that a coarser cell inherits: a straight rim lies 1.5 fine cells away from a
coarse centre, so its conductance is 1 / 0.75 for two fine pins."""
SMALLEST_SIDE = 4
"""A level with a side no longer than this is the last one."""
LAST_SWEEPS = 12
"""Sweeps that stand for a solution on the last level."""


@dataclass(frozen=True)
class Level:
    """One level of the pyramid; all arrays (h, w)."""

    east: Floats
    north: Floats
    pins: Floats
    weight: Floats
    """Sum of a cell's links and pins; 0 where there is nothing to solve."""


@kernel
def _fine_links(known: np.ndarray, east: np.ndarray, north: np.ndarray, pins: np.ndarray) -> None:
    h, w = known.shape
    for i in range(h):
        for j in range(w):
            if known[i, j]:
                continue
            if j + 1 < w:
                if known[i, j + 1]:
                    pins[i, j] += 1.0
                else:
                    east[i, j] = 1.0
            if i + 1 < h:
                if known[i + 1, j]:
                    pins[i, j] += 1.0
                else:
                    north[i, j] = 1.0
            if j > 0 and known[i, j - 1]:
                pins[i, j] += 1.0
            if i > 0 and known[i - 1, j]:
                pins[i, j] += 1.0


@kernel
def _coarse_links(
    east: np.ndarray,
    north: np.ndarray,
    pins: np.ndarray,
    share: float,
    east2: np.ndarray,
    north2: np.ndarray,
    pins2: np.ndarray,
) -> None:
    h, w = east.shape
    for i in range(h):
        for j in range(w):
            pins2[i >> 1, j >> 1] += share * pins[i, j]
            if j & 1:
                east2[i >> 1, j >> 1] += 0.5 * east[i, j]
            if i & 1:
                north2[i >> 1, j >> 1] += 0.5 * north[i, j]


@kernel
def _weights(east: np.ndarray, north: np.ndarray, pins: np.ndarray, weight: np.ndarray) -> None:
    h, w = east.shape
    for i in range(h):
        for j in range(w):
            total = pins[i, j] + east[i, j] + north[i, j]
            if j > 0:
                total += east[i, j - 1]
            if i > 0:
                total += north[i - 1, j]
            weight[i, j] = total


@kernel
def _sweep(
    u: np.ndarray,
    f: np.ndarray,
    east: np.ndarray,
    north: np.ndarray,
    weight: np.ndarray,
    colour: int,
) -> None:
    h, w = u.shape
    for i in range(h):
        for j in range((i + colour) & 1, w, 2):
            if weight[i, j] > 0.0:
                total = f[i, j]
                if j + 1 < w:
                    total += east[i, j] * u[i, j + 1]
                if j > 0:
                    total += east[i, j - 1] * u[i, j - 1]
                if i + 1 < h:
                    total += north[i, j] * u[i + 1, j]
                if i > 0:
                    total += north[i - 1, j] * u[i - 1, j]
                u[i, j] = total / weight[i, j]


@kernel
def _apply(
    u: np.ndarray, east: np.ndarray, north: np.ndarray, weight: np.ndarray, out: np.ndarray
) -> None:
    h, w = u.shape
    for i in range(h):
        for j in range(w):
            total = 0.0
            if weight[i, j] > 0.0:
                total = weight[i, j] * u[i, j]
                if j + 1 < w:
                    total -= east[i, j] * u[i, j + 1]
                if j > 0:
                    total -= east[i, j - 1] * u[i, j - 1]
                if i + 1 < h:
                    total -= north[i, j] * u[i + 1, j]
                if i > 0:
                    total -= north[i - 1, j] * u[i - 1, j]
            out[i, j] = total


@kernel
def _near_far(index: int, limit: int) -> tuple[int, int]:
    """Return the coarse cell that holds a fine one, and the next nearest (cell-centred)."""
    near = index >> 1
    far = near + 1 if index & 1 else near - 1
    if far < 0 or far >= limit:
        far = near
    return near, far


@kernel
def _restrict(residual: np.ndarray, weight2: np.ndarray, out: np.ndarray) -> None:
    """Add fine residuals into the coarse cells: the transpose of `_prolong`."""
    h, w = residual.shape
    h2, w2 = out.shape
    out[:] = 0.0
    for i in range(h):
        a, b = _near_far(i, h2)
        for j in range(w):
            r = residual[i, j]
            if r != 0.0:
                c, d = _near_far(j, w2)
                out[a, c] += 0.5625 * r
                out[a, d] += 0.1875 * r
                out[b, c] += 0.1875 * r
                out[b, d] += 0.0625 * r
    for i in range(h2):
        for j in range(w2):
            if weight2[i, j] == 0.0:
                out[i, j] = 0.0


@kernel
def _prolong(coarse: np.ndarray, weight: np.ndarray, u: np.ndarray) -> None:
    """Add the bilinearly interpolated coarse correction to the fine cells."""
    h, w = u.shape
    h2, w2 = coarse.shape
    for i in range(h):
        a, b = _near_far(i, h2)
        for j in range(w):
            if weight[i, j] > 0.0:
                c, d = _near_far(j, w2)
                u[i, j] += (
                    0.5625 * coarse[a, c]
                    + 0.1875 * coarse[a, d]
                    + 0.1875 * coarse[b, c]
                    + 0.0625 * coarse[b, d]
                )


@kernel
def _dot(a: np.ndarray, b: np.ndarray) -> float:
    """Return the scalar product, always summed in the same order (BLAS has threads)."""
    total = 0.0
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            total += a[i, j] * b[i, j]
    return total


def _finest(known: np.ndarray) -> Level:
    east, north, pins, weight = (np.zeros(known.shape) for _ in range(4))
    _fine_links(known, east, north, pins)
    _weights(east, north, pins, weight)
    return Level(east, north, pins, weight)


def _coarser(fine: Level) -> Level:
    h, w = fine.east.shape
    shape = ((h + 1) // 2, (w + 1) // 2)
    east, north, pins, weight = (np.zeros(shape) for _ in range(4))
    _coarse_links(fine.east, fine.north, fine.pins, PIN_SHARE, east, north, pins)
    _weights(east, north, pins, weight)
    return Level(east, north, pins, weight)


def pyramid(known: np.ndarray) -> list[Level]:
    """Return the levels of a map of known cells (H, W) bool, finest first."""
    levels = [_finest(known)]
    while min(levels[-1].east.shape) > SMALLEST_SIDE:
        levels.append(_coarser(levels[-1]))
    return levels


def _smooth(level: Level, u: Floats, f: Floats, first: int) -> None:
    for colour in (first, 1 - first):
        _sweep(u, f, level.east, level.north, level.weight, colour)


def _correction(levels: list[Level], k: int, f: Floats) -> Floats:
    """Return one symmetric V-cycle's answer to `A u = f` on level k, from u = 0."""
    level = levels[k]
    u = np.zeros_like(f)
    if k == len(levels) - 1:
        for _ in range(LAST_SWEEPS):
            _smooth(level, u, f, 0)
            _smooth(level, u, f, 1)
        return u
    _smooth(level, u, f, 0)
    residual = np.empty_like(f)
    _apply(u, level.east, level.north, level.weight, residual)
    np.subtract(f, residual, out=residual)
    coarse_f = np.empty(levels[k + 1].east.shape)
    _restrict(residual, levels[k + 1].weight, coarse_f)
    _prolong(_correction(levels, k + 1, coarse_f), level.weight, u)
    _smooth(level, u, f, 1)
    return u


def solve(levels: list[Level], u: Floats, f: Floats, tolerance: float, max_steps: int) -> int:
    """Improve u (H, W) in place until `A u = f` on the unknown cells; return the steps taken.

    It stops when a whole V-cycle would move no cell by more than half the tolerance.
    """
    fine = levels[0]
    product = np.empty_like(u)
    _apply(u, fine.east, fine.north, fine.weight, product)
    residual = f - product
    direction = np.zeros_like(u)
    energy = 1.0
    for step in range(max_steps):
        wanted = _correction(levels, 0, residual)
        if np.abs(wanted).max(initial=0.0) <= 0.5 * tolerance:
            u += wanted
            return step
        energy, before = _dot(residual, wanted), energy
        direction = wanted + (energy / before if step else 0.0) * direction
        _apply(direction, fine.east, fine.north, fine.weight, product)
        length = energy / _dot(direction, product)
        u += length * direction
        residual -= length * product
    return max_steps


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    known = np.zeros((16, 16), dtype=np.bool_)
    known[3, 3] = True
    solve(pyramid(known), np.ones((16, 16)) * ~known, np.zeros((16, 16)), 1e-3, 5)
