"""What each level of a tile tells: the bound and the blocks that are worth most together."""

import math

import numpy as np
from numpy.typing import NDArray

from comms.blocks import block_count, block_max, spread
from comms.scales import Bound
from comms.tilelevels import BOUND_CODES, SPACINGS, block_side, bound_of_level

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Flags = NDArray[np.uint8]
Codes = NDArray[np.int64]


def plan_levels(
    errors_m: list[Floats], known: Bools, bound: Bound, levels: int
) -> list[tuple[int, Flags]]:
    """Choose each level's bound code and the cells that it calls known.

    A cell's error counts as the worst that it will have from this level on, so that bounds never
    rise; a level's bound is the one that makes cells told times bits told per cell largest.
    """
    worst_m = errors_m[-1]
    envelopes = [worst_m]
    for error_m in reversed(errors_m[:-1]):
        worst_m = np.maximum(worst_m, error_m)
        envelopes.insert(0, worst_m)
    relief_m = max(float(errors_m[0][known].max(initial=0.0)), bound.metres)
    plan: list[tuple[int, Flags]] = []
    told, highest = np.zeros(known.shape, np.bool_), BOUND_CODES - 1
    for level in range(levels - 1):
        side = block_side(known.shape, level, SPACINGS[levels][level])
        unknown_m = 0.0 if level >= levels - 2 else math.inf
        blocks_m = block_max(np.where(known, envelopes[level], unknown_m), side)
        cells = block_count(known, side)
        lowest_m = float(envelopes[level][told].max(initial=0.0))
        highest = _best_code(blocks_m, cells, bound, lowest_m, highest, relief_m)
        flags = blocks_m <= bound_of_level(bound, highest)
        told = told | (spread(flags, side, *known.shape) & known)
        plan.append((highest, told.astype(np.uint8)))
    return [*plan, (0, known.astype(np.uint8))]


def _best_code(
    blocks_m: Floats, cells: Codes, bound: Bound, lowest_m: float, highest: int, relief_m: float
) -> int:
    best, best_worth = highest, -1.0
    for code in range(highest, -1, -1):
        level_m = bound_of_level(bound, code)
        if level_m < lowest_m:
            break
        worth = float(cells[blocks_m <= level_m].sum()) * math.log2(1 + relief_m / level_m)
        if worth > best_worth:
            best, best_worth = code, worth
    return best
