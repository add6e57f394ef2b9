"""What both sides hold of an occupancy map while it is coded: cells, decided one after another.

A planar map is a block of one layer. Cells lie within a margin that counts as not known, so that
contexts need not ask whether they look beyond the edge.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comms.occupancy.classes import NOT_KNOWN, OPEN, UNKNOWN, Symbols

Flags = NDArray[np.uint8]

MARGIN = 10
"""Rows and columns around the cells."""
LAYER_MARGIN = 4
"""Layers below and above the cells of a block; a planar map has none."""
UNDECIDED, TOLD, SETTLED = 0, 1, 2
"""A cell may be open, told (known, its sign and a least size), or settled."""


class Field(NamedTuple):
    """A map while it is coded."""

    symbols: Symbols
    """(layers, rows, cols) with margins."""
    states: Flags
    """The same shape; outside, cells are not known."""
    fixed: Flags
    """(layers, rows, cols): `UNDECIDED`, `TOLD` or `SETTLED`."""
    least: Flags
    """(layers, rows, cols): the least size of a cell that was told."""


class Palette(NamedTuple):
    """Which symbols a map has; what follows from it costs nothing."""

    all_known: int
    has_free: int
    has_occupied: int
    sizes: int
    """Bit k is set where size k occurs."""


def blank(shape: tuple[int, int, int]) -> Field:
    """Return a map (layers, rows, cols) of which nothing is decided."""
    layers, rows, cols = shape
    deep = 0 if layers == 1 else LAYER_MARGIN
    padded = (layers + 2 * deep, rows + 2 * MARGIN, cols + 2 * MARGIN)
    states = np.full(padded, NOT_KNOWN, np.uint8)
    states[deep : deep + layers, MARGIN:-MARGIN, MARGIN:-MARGIN] = OPEN
    symbols = np.full(padded, UNKNOWN, np.uint8)
    return Field(symbols, states, np.zeros(shape, np.uint8), np.zeros(shape, np.uint8))


def inside(padded: Flags) -> Flags:
    """Return the cells (layers, rows, cols) without their margins."""
    deep = 0 if padded.shape[0] == 1 else LAYER_MARGIN
    return padded[deep : padded.shape[0] - deep, MARGIN:-MARGIN, MARGIN:-MARGIN]


def palette_of(symbols: Symbols) -> Palette:
    """Return which symbols a map has."""
    present = np.bincount(symbols.ravel(), minlength=16) > 0
    sizes = sum(1 << k for k in range(8) if present[8 - k] or present[8 + k])
    return Palette(int(not present[0]), int(present[1:9].any()), int(present[9:].any()), sizes)
