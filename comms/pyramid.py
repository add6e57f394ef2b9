"""Elevations from coarse to fine: predicted from what is decoded, the rest of the way coded.

A grid is visited on ever finer lattices. Halving the spacing s takes two stages: first the cells
with four decoded neighbours on their diagonals, then those with four along the axes. Each cell is
predicted from decoded values (a closed loop), and what the prediction lacks is sent as a whole
number of steps. A step is an odd number of units, so the error of the integers is at most
(step - 1) / 2 units, and half a unit more for having made the elevations integers.

Cells that are not to be coded keep their prediction as an estimate, which later cells may use; so a
stage that codes nothing paints the picture that a receiver sees before the finer lattices arrive.

Source of the idea: Zhao et al., "Optimizing error-bounded lossy compression for scientific data by
dynamic spline interpolation", ICDE 2021 (SZ3), and for the finer steps far apart Liu et al.,
"Dynamic quality metric oriented error-bounded lossy compression", SC 2022 (QoZ); the order and the
models are ours.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comms.around import around
from comms.kernels import kernel, warmer
from comms.logistic import Opinions
from comms.parts import part, whole
from comms.predict import (
    DIAGONAL,
    EVEN_ROW,
    ODD_ROW,
    TAP_SETS,
    TAPS,
    Cells,
    Place,
    adjustment,
    interpolate,
    learn,
)
from comms.priors import taps
from comms.rangecoder import (
    DECODING,
    Coder,
    Words,
    bits_written,
    decoder,
    encoder,
    has_run_out,
)
from comms.residuals import code_residual, look, residual_opinions

Units = NDArray[np.int64]
Flags = NDArray[np.uint8]

STEP_UNITS = 255
"""Units to one step at the finest lattice; odd."""
PROFILES = np.array(
    [
        [255] * 13,
        [255, 255, 201, 181, 161] + [141] * 8,
        [255, 255, 181, 181, 181] + [181] * 8,
        [255, 221, 221, 201, 181] + [181] * 8,
    ],
    np.int64,
)
"""Steps in units at the spacings 1, 2, 4 ...: finer ones far apart make better predictions near by,
which pays where the bound is wide."""
BYTES_PER_CELL = 24
"""More than the longest residual takes."""
_SMALL_SIDE = 128
_TRIAL_SIDE = 96
_FINER_STEPS_BITS = 0.45
"""Bits per cell above which finer steps far apart have never paid."""
_FAR = whole(1) << 46


@dataclass
class Pyramid:
    """A grid while it is coded from coarse to fine; both sides keep the same."""

    cells: Cells
    mixed: Opinions
    taps: Units
    steps: Units
    snaps: bool

    @classmethod
    def blank(cls, shape: tuple[int, int], profile: int, *, snaps: bool) -> "Pyramid":
        """Return a grid of which nothing is coded. `snaps` keeps cells on whole steps."""
        cells = Cells(
            np.zeros(shape, np.int64),
            np.zeros(shape, np.uint8),
            np.zeros(shape, np.int8),
            np.zeros(shape, np.int32),
        )
        return cls(cells, residual_opinions(), taps(TAP_SETS, TAPS), PROFILES[profile], snaps)

    def code(self, coder: Coder, want: Flags, y: Units | None, bottom: int = 1) -> None:
        """Code the cells that `want` (H, W) marks on the lattices down to a spacing.

        `y` (H, W): what to encode, in units. Cells coded before stay as they are.
        """
        y = self.cells.x if y is None else y
        top = top_spacing(*want.shape)
        sweep(
            coder, self.mixed, self.taps, self.cells, want, y, top, bottom, self.steps, self.snaps
        )

    def painted(self) -> Units:
        """Return elevations (H, W) in units as a receiver sees them, interpolated if not coded."""
        cells = self.cells._replace(x=self.cells.x.copy(), errors=self.cells.errors.copy())
        replace(self, cells=cells).code(encoder(0), np.zeros(cells.x.shape, np.uint8), None)
        return cells.x


def best_profile(want: Flags, y: Units) -> int:
    """Return the profile that codes a grid (its middle, if it is large) in the fewest bits."""
    rows, cols = want.shape
    is_small = max(rows, cols) <= _SMALL_SIDE
    side = _SMALL_SIDE if is_small else _TRIAL_SIDE
    top, left = max(rows - side, 0) // 2, max(cols - side, 0) // 2
    cut = np.s_[top : top + side, left : left + side]
    want, y = np.ascontiguousarray(want[cut]), np.ascontiguousarray(y[cut])
    bits = [_bits_of(0, want, y)]
    if bits[0] < _FINER_STEPS_BITS * int(want.sum()):
        profiles = range(1, len(PROFILES) if is_small else 2)
        bits += [_bits_of(profile, want, y) for profile in profiles]
    return bits.index(min(bits))


def _bits_of(profile: int, want: Flags, y: Units) -> float:
    coder = encoder(want.size * BYTES_PER_CELL)
    Pyramid.blank(want.shape, profile, snaps=False).code(coder, want, y)
    return bits_written(coder)


def top_spacing(rows: int, cols: int) -> int:
    """Return the spacing of the coarsest lattice: a power of two that leaves one cell of it."""
    return 1 << (max(rows, cols) - 1).bit_length()


@part
def _row(
    coder: Coder,
    mixed: Opinions,
    all_taps: Units,
    inputs: Words,
    contexts: Words,
    cells: Cells,
    want: Flags,
    y: Units,
    i: int,
    first: int,
    stride: int,
    s: int,
    stage: int,
    level: int,
    step: int,
    snaps: bool,
) -> None:
    """Visit every `stride`-th cell of a row, beginning at column `first`."""
    decoding = coder.state[DECODING] != 0
    set_of_taps = all_taps[(0 if stage == DIAGONAL else 1) + 2 * min(level, 2)]
    for j in range(first, cells.x.shape[1], stride):
        if cells.coded[i, j]:
            continue
        place = Place(i, j, s, stage, level)
        guess, spread, trust = interpolate(cells, place)
        spread = min(max(spread, -64 * step), 64 * step)
        moved = whole(0)
        if trust == 16:
            moved = adjustment(cells, place, set_of_taps, inputs, spread, step)
        p, r = guess + moved, whole(0)
        if want[i, j]:
            group = look(around(cells, place, guess, spread, moved, trust, step), contexts)
            if snaps:
                p = (p + (step >> 1)) // step * step
            if not decoding:
                r = (y[i, j] - p + (step >> 1)) // step
            r = code_residual(coder, mixed, contexts, group, r)
            cells.coded[i, j] = 1
            cells.residuals[i, j] = min(max(r, -127), 127)
            if r != 0 and trust == 16:
                learn(set_of_taps, inputs, r, step)
        value = min(max(p + r * step, -_FAR), _FAR)
        cells.x[i, j] = value
        cells.errors[i, j] = min(max(value - guess, -64 * step), 64 * step)


@kernel
def sweep(
    coder: Coder,
    mixed: Opinions,
    all_taps: Units,
    cells: Cells,
    want: Flags,
    y: Units,
    top: int,
    bottom: int,
    steps: Units,
    snaps: bool,
) -> None:
    """Visit the lattices of spacing `top` down to `bottom` (powers of two).

    Codes what `want` marks and is not yet coded; all other cells get an estimate. `steps[k]` is the
    step at spacing 2^k. Decoding stops early once the bytes have run out.
    """
    contexts = np.zeros(mixed.slots.size, np.int64)
    inputs = np.zeros(TAPS, np.int64)
    level = whole(0)
    while whole(1) << level < top:
        level += 1
    s, diagonal = whole(top), False
    while s >= bottom:
        first = s if diagonal else whole(0)
        for i in range(first, cells.x.shape[0], 2 * s if diagonal else s):
            if has_run_out(coder):
                return
            stage = DIAGONAL if diagonal else (ODD_ROW if (i // s) & 1 else EVEN_ROW)
            start, stride = first, 2 * s
            if stage == EVEN_ROW:
                start = s
            if s == top:
                start, stride = whole(0), s
            _row(
                coder,
                mixed,
                all_taps,
                inputs,
                contexts,
                cells,
                want,
                y,
                i,
                start,
                stride,
                s,
                stage,
                level,
                steps[level],
                snaps,
            )
        if not diagonal:
            s >>= 1
            level -= 1
        diagonal = not diagonal


@warmer
def _warm() -> None:
    for coder in (encoder(64), decoder(b"\1\2\3")):
        grid = Pyramid.blank((3, 3), 0, snaps=False)
        grid.code(coder, np.ones((3, 3), np.uint8), np.zeros((3, 3), np.int64))
