"""Where one map lies on another to a part of a cell: Gauss-Newton on the residuals of all cells.

Cells of the moving map are held against a fixed one that is read between its cells. Each residual
counts by its variance, and less the farther it is off (Geman & McClure, 1987): what hides behind a
rock from here is seen from there.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from agents.geometry import Bools, Floats, GridFrame
from agents.joining.searching import turning

OUTLYING = 3.0
"""Residuals of so many standard deviations count a quarter."""
FAR_CELLS = 2.0
"""No step goes farther than so many cells."""
STILL = 1e-3
"""Steps below this share of a cell are the last."""
LEAST = 12
"""So many cells must overlap."""


class Reading(Protocol):
    """The fixed map, as it is read at any point."""

    @property
    def cell_m(self) -> float:
        """Side of its cells."""
        ...

    def at(self, xy_m: Floats) -> tuple[Bools, Floats, Floats, Floats]:
        """Return which points (N, 2) have a value, that (K,), its variance and slope (K, 2)."""
        ...


@dataclass(frozen=True)
class Field:
    """A map of values: values (rows, cols) and their variances, read between cells."""

    frame: GridFrame
    value: Floats
    """Finite, whatever it is where the variance is not."""
    variance: Floats
    """inf where unknown."""

    @property
    def cell_m(self) -> float:
        """See `Reading.cell_m`."""
        return self.frame.cell_m

    def at(self, xy_m: Floats) -> tuple[Bools, Floats, Floats, Floats]:
        """Return whether points (N, 2) lie among four known cells, and what is there.

        Value (K,), variance (K,) and slope (K, 2) of the value; only of those that do.
        """
        u = (xy_m[:, 0] - self.frame.x_m) / self.frame.cell_m - 0.5
        v = (xy_m[:, 1] - self.frame.y_m) / self.frame.cell_m - 0.5
        col, row = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
        known = (col >= 0) & (row >= 0) & (col < self.frame.cols - 1) & (row < self.frame.rows - 1)
        base = np.where(known, row * self.frame.cols + col, 0)
        corners = (base, base + 1, base + self.frame.cols, base + self.frame.cols + 1)
        spread = sum((self.variance.ravel()[corner] for corner in corners), np.zeros(len(base)))
        known &= np.isfinite(spread)
        a, b = (u - col)[known], (v - row)[known]
        sw, se, nw, ne = (self.value.ravel()[corner[known]] for corner in corners)
        value = (1 - b) * ((1 - a) * sw + a * se) + b * ((1 - a) * nw + a * ne)
        east = ((1 - b) * (se - sw) + b * (ne - nw)) / self.frame.cell_m
        north = ((1 - a) * (nw - sw) + a * (ne - se)) / self.frame.cell_m
        return known, value, spread[known] / 4.0, np.column_stack((east, north))


@dataclass(frozen=True)
class Moving:
    """The cells that are moved: their places (N, 2), values and variances (N,)."""

    xy_m: Floats
    value: Floats
    variance: Floats
    common_m: tuple[float, float]
    """Side of the blocks of which all cells share an error, and its standard deviation."""
    lifts: bool
    """Whether all values may be off by one number, as heights are."""

    def thinned(self, most: int) -> "Moving":
        """Return no more than so many of the cells, or hardly."""
        part = slice(None, None, max(1, len(self.xy_m) // most))
        xy_m, value, variance = self.xy_m[part], self.value[part], self.variance[part]
        return Moving(xy_m, value, variance, self.common_m, self.lifts)


@dataclass(frozen=True)
class Fit:
    """Where the moving map lies: turned about the origin of its frame, then shifted and lifted."""

    turn_rad: float
    x_m: float
    y_m: float
    lift: float
    cells: int
    """That lie on known ground."""
    misfit: float
    """Mean of residuals squared in units of their variance, each no more than 9."""
    covariance: Floats
    """(4, 4) of (x, y, lift) of `middle_m`, and of the turn, by the residuals' information."""
    middle_m: Floats
    """(2,) of the overlap, in the fixed frame."""

    def carried(self, xy_m: Floats) -> Floats:
        """Return where points (N, 2) of the moving frame come to lie."""
        return xy_m @ turning(self.turn_rad).T + (self.x_m, self.y_m)


@dataclass(frozen=True)
class _Apart:
    """The residuals of the cells that lie on known ground."""

    apart: Floats
    """(K,) fixed less moving, before the lift."""
    variance: Floats
    """Of both."""
    slope: Floats
    """(K, 2)."""
    xy_m: Floats
    common_m: tuple[float, float]
    lifts: bool

    @property
    def middle_m(self) -> Floats:
        return self.xy_m.mean(axis=0)

    @property
    def arm_m(self) -> float:
        """How far cells are from the middle: what a turn moves them by."""
        return float(np.sqrt(((self.xy_m - self.middle_m) ** 2).sum(axis=1).mean()))

    def normal(self, lift: float) -> tuple[Floats, Floats]:
        """Return the information (4, 4) of (x, y, lift, turn), and the pull (4,) towards less."""
        residual = self.apart - lift
        weight = (1.0 + residual**2 / self.variance / OUTLYING**2) ** -2 / self.variance
        arm = self.xy_m - self.middle_m
        by_turn = self.slope[:, 1] * arm[:, 0] - self.slope[:, 0] * arm[:, 1]
        lifted = np.full(len(residual), -1.0 if self.lifts else 0.0)
        jacobian = np.column_stack((self.slope, lifted, by_turn))
        weighed = jacobian * weight[:, None]
        bend, pull = weighed.T @ jacobian, -weighed.T @ residual
        # What the cells of a block share is taken out of what they tell (Woodbury).
        side_m, sigma_m = self.common_m
        _, block = np.unique(np.floor(self.xy_m / side_m), axis=0, return_inverse=True)
        block = block.ravel()
        columns = np.stack([np.bincount(block, column) for column in weighed.T], axis=1)
        shared = sigma_m**2 / (1.0 + sigma_m**2 * np.bincount(block, weight))
        bend -= (columns * shared[:, None]).T @ columns
        pull += columns.T @ (shared * np.bincount(block, weight * residual))
        if not self.lifts:
            bend[2, 2] = 1.0
        return bend + np.diag(1e-6 * np.diag(bend) + 1e-9), pull


def _apart(
    moving: Moving, field: Reading, turn_rad: float, x_m: float, y_m: float
) -> _Apart | None:
    there = moving.xy_m @ turning(turn_rad).T + (x_m, y_m)
    known, value, variance, slope = field.at(there)
    if np.count_nonzero(known) < LEAST:
        return None
    own, spread = moving.value[known], moving.variance[known]
    return _Apart(
        value - own, variance + spread, slope, there[known], moving.common_m, moving.lifts
    )


def fit(
    moving: Moving,
    field: Reading,
    start: tuple[float, float, float],
    *,
    steps: int,
    broad: Reading | None = None,
) -> Fit | None:
    """Return the best fit near a start (turn, x, y), or None where too little overlaps.

    The noise of a map has slopes too, by which even ground would seem to tell where it lies. So
    what slopes tell is reckoned by those of a broader drawing of the fixed map, if there is one.
    """
    turn_rad, x_m, y_m = start
    now, lift = _apart(moving, field, turn_rad, x_m, y_m), 0.0
    if now is not None and moving.lifts:
        lift = float(np.median(now.apart))
    for _ in range(steps):
        if now is None:
            return None
        step = np.linalg.solve(*now.normal(lift))
        longest = max(abs(step[0]), abs(step[1]), abs(step[3]) * now.arm_m)
        step = step * min(1.0, FAR_CELLS * field.cell_m / max(longest, 1e-12))
        place = np.array((x_m, y_m)) - now.middle_m
        x_m, y_m = (float(v) for v in turning(step[3]) @ place + now.middle_m + step[:2])
        turn_rad, lift = turn_rad + float(step[3]), lift + float(step[2])
        now = _apart(moving, field, turn_rad, x_m, y_m)
        if longest < STILL * field.cell_m:
            break
    if now is None:
        return None
    worth = np.minimum((now.apart - lift) ** 2 / now.variance, 9.0)
    told = now if broad is None else _apart(moving, broad, turn_rad, x_m, y_m)
    if told is None:
        return None
    covariance: Floats = np.linalg.inv(told.normal(lift)[0]).astype(np.float64)
    turn_rad, misfit = math.remainder(turn_rad, 2 * math.pi), float(worth.mean())
    return Fit(turn_rad, x_m, y_m, lift, len(worth), misfit, covariance, told.middle_m)
