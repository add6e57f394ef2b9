"""Square blocks of cells: their extremes, their counts, and back to cells.

Blocks begin at the first row and column; the last ones may be smaller.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", bound=np.generic)


def block_max(cells: NDArray[Number], side: int) -> NDArray[Number]:
    """Return the largest of each block of side x side cells."""
    rows, cols = cells.shape
    by_row = np.maximum.reduceat(cells, np.arange(0, rows, side), axis=0)
    return np.maximum.reduceat(by_row, np.arange(0, cols, side), axis=1)


def spread(blocks: NDArray[Number], side: int, rows: int, cols: int) -> NDArray[Number]:
    """Return each block's value at each of its cells."""
    return np.repeat(np.repeat(blocks, side, 0), side, 1)[:rows, :cols]


def block_min(cells: NDArray[Number], side: int) -> NDArray[Number]:
    """Return the smallest of each block of side x side cells."""
    rows, cols = cells.shape
    by_row = np.minimum.reduceat(cells, np.arange(0, rows, side), axis=0)
    return np.minimum.reduceat(by_row, np.arange(0, cols, side), axis=1)


def block_count(cells: NDArray[np.bool_], side: int) -> NDArray[np.int64]:
    """Return how many cells are set in each block of side x side."""
    rows, cols = cells.shape
    by_row = np.add.reduceat(cells.astype(np.int64), np.arange(0, rows, side), axis=0)
    return np.add.reduceat(by_row, np.arange(0, cols, side), axis=1)
