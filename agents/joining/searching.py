"""Where one map may lie on another, with no first guess: every turn and every shift, by FFT.

What speaks for a place is a sum over the cells that both maps know, of products of what each knows
of the cell (`Comparing`): a log-likelihood ratio of "the same ground" against "unrelated ground".
For one turn, all shifts are one correlation, which costs a few Fourier transforms however large
the overlap; so the search is exhaustive at its resolution, and needs no bound as branch and bound
does. Cells that only one of the two knows count nothing (masked correlation; Padfield, 2012).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import ndimage
from scipy.fft import next_fast_len

from agents.geometry import Bools, Floats, GridFrame, Singles

SECTORS = 24
"""The best turn is kept by place within each of so many sectors of the circle."""
PER_SECTOR = 6
"""So many places are kept of each."""
PEAK_CELLS = 5
"""Of places nearer to each other than half of this, the best is kept."""


@dataclass(frozen=True)
class Strewn:
    """A map as loose cells: where each is, and what adds up when several fall into one."""

    xy_m: Floats
    """(N, 2) their middles."""
    planes: Floats
    """(P, N)."""

    def turned(self, turn_rad: float, x_m: float, y_m: float) -> "Strewn":
        """Return it turned about the origin of its frame, and then shifted."""
        return Strewn(self.xy_m @ turning(turn_rad).T + (x_m, y_m), self.planes)

    @property
    def size(self) -> int:
        """How many cells it has."""
        return len(self.xy_m)

    @cached_property
    def middle_m(self) -> Floats:
        """(2,) the mean of the cells' places."""
        return self.xy_m.mean(axis=0)

    def binned(self, frame: GridFrame) -> Floats:
        """Return the planes (P, rows, cols), summed over the cells of a grid."""
        cells = frame.cells_of(self.xy_m)
        inside = ((cells >= 0) & (cells < frame.shape)).all(axis=1)
        flat, size = cells[inside, 0] * frame.cols + cells[inside, 1], frame.rows * frame.cols
        summed = [np.bincount(flat, plane[inside], size) for plane in self.planes]
        return np.array(summed, dtype=np.float64).reshape(-1, *frame.shape)


class Comparing(Protocol):
    """What two maps of a kind say together of a cell that both know."""

    @property
    def mix(self) -> Floats:
        """(C, C): a cell speaks by `own @ mix @ team`, of what `channels` makes of either map."""
        ...

    def channels(self, planes: Floats, cell_m: float) -> Floats:
        """Return (C, rows, cols) of planes (P, rows, cols); all 0 where nothing is known.

        The first is by how much a cell counts, 0 to 1.
        """
        ...


@dataclass(frozen=True)
class Guess:
    """Where a map may lie: turned about the origin of its frame, then shifted."""

    turn_rad: float
    x_m: float
    y_m: float
    gain: float
    """What speaks for it, in nats as if all cells were independent."""

    def middle_of(self, strewn: Strewn) -> Floats:
        """Return where (2,) the middle of a map comes to lie."""
        return turning(self.turn_rad) @ strewn.middle_m + (self.x_m, self.y_m)


def middles_m(frame: GridFrame, cells: Bools) -> Floats:
    """Return the middles (N, 2) of the cells of a mask (rows, cols), row by row."""
    rows, cols = np.nonzero(cells)
    x_m = frame.x_m + (cols + 0.5) * frame.cell_m
    return np.column_stack((x_m, frame.y_m + (rows + 0.5) * frame.cell_m)).astype(np.float64)


def turning(turn_rad: float) -> Floats:
    """Return the (2, 2) matrix of a turn."""
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    return np.array(((c, -s), (s, c)))


def around(strewn: Strewn, cell_m: float, times: int = 1) -> GridFrame:
    """Return the least grid that holds a map of cells, its own of so many times the side.

    Each holds so many by so many whole ones: else their middles were not its own.
    """
    low, high = strewn.xy_m.min(axis=0), strewn.xy_m.max(axis=0)
    side_m = times * cell_m
    cols, rows = (int(n) for n in np.floor((high - low) / side_m + 0.5 / times) + 1)
    x_m, y_m = (float(v) - 0.5 * cell_m for v in low)
    return GridFrame(x_m, y_m, side_m, rows, cols)


def reach_m(strewn: Strewn) -> float:
    """Return how far from its middle a map reaches."""
    return float(np.hypot(*(strewn.xy_m - strewn.middle_m).T).max())


def turns(strewn: Strewn, cell_m: float) -> Floats:
    """Return all turns, one cell apart at two thirds of the way to the farthest cell."""
    step_rad = cell_m / (0.67 * reach_m(strewn))
    count = max(8, math.ceil(2 * math.pi / step_rad))
    return np.linspace(0.0, 2 * math.pi, count, endpoint=False, dtype=np.float64)


def search(
    own: Strewn, team: Strewn, grid: GridFrame, comparing: Comparing, least_cells: float
) -> list[Guess]:
    """Return where a map may lie on another, what most speaks for first.

    Args:
        own: the map that is to be placed.
        team: that on which it is placed.
        grid: so fine to search; it holds all of the team's map.
        comparing: what cells say.
        least_cells: so much overlap, in cells, a place must have.

    """
    cell_m = grid.cell_m
    side = 2 * math.ceil(reach_m(own) / cell_m) + 3
    half_m = 0.5 * side * cell_m
    patch = GridFrame(-half_m, -half_m, cell_m, side, side)
    shape = (_fast(grid.rows + side), _fast(grid.cols + side))
    seen = comparing.channels(team.binned(grid), cell_m).astype(np.float32)
    fixed = np.fft.rfft2(seen, shape)
    mixed = np.tensordot(comparing.mix.astype(np.float32), fixed, axes=1)
    centred = own.turned(0.0, *(-own.middle_m))
    all_turns = turns(own, cell_m)
    best = np.full((SECTORS, *shape), -np.inf, dtype=np.float32)
    which = np.zeros((SECTORS, *shape), dtype=np.int32)
    for number, turn_rad in enumerate(all_turns):
        planes = centred.turned(float(turn_rad), 0.0, 0.0).binned(patch)
        moving = np.conj(np.fft.rfft2(comparing.channels(planes, cell_m).astype(np.float32), shape))
        overlap = np.fft.irfft2(moving[0] * fixed[0], shape)
        gain = np.fft.irfft2((moving * mixed).sum(axis=0), shape)
        gain = np.where(overlap >= least_cells, gain, -np.inf)
        sector = number * SECTORS // len(all_turns)
        better = gain > best[sector]
        best[sector] = np.where(better, gain, best[sector])
        which[sector][better] = number
    found: list[Guess] = []
    for sector in range(SECTORS):
        for row, col in _peaks(best[sector]):
            turn_rad = float(all_turns[which[sector, row, col]])
            rows = row if row < grid.rows else row - shape[0]
            cols = col if col < grid.cols else col - shape[1]
            place = np.array((grid.x_m + cols * cell_m, grid.y_m + rows * cell_m)) + half_m
            x_m, y_m = place - turning(turn_rad) @ own.middle_m
            found.append(Guess(turn_rad, float(x_m), float(y_m), float(best[sector, row, col])))
    return sorted(found, key=lambda guess: (-guess.gain, guess.turn_rad, guess.x_m, guess.y_m))


def alike(fields: Floats, known: Floats) -> float:
    """Return how many cells tell no more than one, because neighbours are alike.

    Of two fields of one autocorrelation r the sample correlation is as sure as one of N / sum of
    r^2 independent pairs (Bartlett, 1935).

    Args:
        fields: (F, rows, cols) of mean 0, 0 where unknown.
        known: (rows, cols) 1 or 0.

    """
    shape = (_fast(2 * known.shape[0]), _fast(2 * known.shape[1]))
    pairs = np.fft.irfft2(np.abs(np.fft.rfft2(known, shape)) ** 2, shape)
    power = (np.abs(np.fft.rfft2(fields, shape)) ** 2).sum(axis=0)
    mean = np.fft.irfft2(power, shape) / np.maximum(pairs, 1.0)
    # At long lags there is little but chance, which would add up.
    rows, cols = (np.minimum(np.arange(n), n - np.arange(n)) for n in shape)
    near = np.ix_(rows <= known.shape[0] // 4, cols <= known.shape[1] // 4)
    share = pairs[near] / max(float(pairs[0, 0]), 1.0)
    return float((share * (mean[near] / max(float(mean[0, 0]), 1e-12)) ** 2).sum())


def _fast(length: int) -> int:
    """Return a length no shorter that is quickly transformed."""
    fast = next_fast_len(length, real=True)
    assert fast is not None
    return fast


def _peaks(gain: Singles) -> list[tuple[int, int]]:
    """Return the highest places (row, col) of a map of gains, none next to another."""
    crest = (gain == ndimage.maximum_filter(gain, PEAK_CELLS, mode="wrap")) & np.isfinite(gain)
    rows, cols = np.nonzero(crest)
    order = np.argsort(-gain[rows, cols], kind="stable")[:PER_SECTOR]
    return [(int(rows[n]), int(cols[n])) for n in order]
