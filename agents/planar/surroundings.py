"""What lies about a cell that nobody measured, as numbers: what is likely there depends on it.

Where a wall runs towards a cell it likely goes on; between two ends of a wall in line there is
likely wall; what lies open on three sides is likely open.
"""

import cv2
import numpy as np

from agents.geometry import Floats, GridFrame, Ints
from agents.ground.markov import distance_to_known_m
from comms import kernels
from comms.kernels import kernel

DIRECTIONS = np.array([(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)])
"""(8, 2) rows and columns of a step; each a turn of 45 degrees to the one before."""
REACH_CELLS = 16
"""Nothing farther off in any of these directions counts."""
FADES_CELLS = 4.0
"""What is so far off counts e times less."""
RUN_CELLS = 5
"""Solid cells beyond the first, in line, that are counted at most."""
NEAR_M, FAR_M = 1.0, 4.0
"""Lengths on which the distances to what is known count."""
SQUARES_CELLS = ((2, 3.0, 2.0), (6, 3.0, 2.0))
"""Half sides of squares, and by how much the share of solid and of free cells in them count."""
NUMBERS = 3 * len(DIRECTIONS) + 4 + 2 * len(SQUARES_CELLS)
"""Numbers per cell: 8 nearnesses of what is solid, 8 of what is free, 8 of walls in line, by
direction; then those that don't depend on direction."""


@kernel
def _look_about(
    state: np.ndarray, cells: np.ndarray, directions: np.ndarray, part: np.ndarray, out: np.ndarray
) -> None:
    """Fill the numbers by direction; `state` is 1 solid, -1 free, 0 unknown."""
    rows, cols = state.shape
    reach, fades, most = int(part[0]), part[1], int(part[2])
    for q in range(len(cells)):
        for k in range(len(directions)):
            di, dj = directions[k, 0], directions[k, 1]
            step = np.sqrt(float(di * di + dj * dj))
            i, j = cells[q, 0], cells[q, 1]
            for n in range(reach):
                i, j = i + di, j + dj
                if i < 0 or j < 0 or i >= rows or j >= cols:
                    break
                if state[i, j] == 0:
                    continue
                near = np.exp(-n * step / fades)
                if state[i, j] < 0:
                    out[q, 8 + k] = near
                    break
                out[q, k] = near
                run = 0
                while run < most:
                    i, j = i + di, j + dj
                    if i < 0 or j < 0 or i >= rows or j >= cols or state[i, j] <= 0:
                        break
                    run += 1
                out[q, 16 + k] = near * run / most
                break


def surroundings(log_odds: Floats, cells: Ints, frame: GridFrame) -> Floats:
    """Return what lies about unmeasured cells (N, 2) on a map (rows, cols): (N, NUMBERS)."""
    state = np.sign(log_odds).astype(np.int8)
    out = np.zeros((len(cells), NUMBERS))
    part = np.array([REACH_CELLS, FADES_CELLS, RUN_CELLS])
    _look_about(state, cells, DIRECTIONS, part, out)
    row, col = cells[:, 0], cells[:, 1]
    solid_m = distance_to_known_m(state > 0, frame.cell_m)[row, col]
    free_m = distance_to_known_m(state < 0, frame.cell_m)[row, col]
    at = 3 * len(DIRECTIONS)
    away = (solid_m / NEAR_M, free_m / NEAR_M, free_m / FAR_M, solid_m / FAR_M)
    out[:, at : at + 4] = np.exp(-np.stack(away, axis=1))
    for n, (half, solids, frees) in enumerate(SQUARES_CELLS):
        for k, (kind, counts) in enumerate(((state > 0, solids), (state < 0, frees))):
            share = cv2.boxFilter(
                kind.astype(np.float32), -1, (2 * half + 1,) * 2, borderType=cv2.BORDER_CONSTANT
            )
            out[:, at + 4 + 2 * n + k] = counts * share[row, col]
    return out


@kernels.warmer
def warm() -> None:
    """Compile the kernel of this module."""
    surroundings(np.zeros((3, 3)), np.array([[1, 1]]), GridFrame(0.0, 0.0, 1.0, 3, 3))
