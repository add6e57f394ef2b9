"""Opinions about one bit, weighed by how often they were right, and judged by what came of it.

As `comms.logistic`, with two things more, which occupancy needs for its many contexts: an opinion
that has seen little says little, and what the opinions come to is corrected by what it came to
before, in two small contexts (secondary estimation). All of it is whole numbers.

Source of the idea: M. Mahoney, "Adaptive weighing of context models for lossless data compression",
Florida Tech. CS-2005-16, and the later PAQ archivers.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comms.logistic import (
    COUNT_BITS,
    COUNT_MASK,
    LEAST_CHANCE,
    WIDEST,
    Opinions,
    chances_of_odds,
)
from comms.parts import part, whole
from comms.rangecoder import Coder, code_bit


class Judge(NamedTuple):
    """What one kind of symbol is coded with; it learns as it codes."""

    opinions: Opinions
    verdicts: NDArray[np.uint32]
    """Probabilities in 22 bits, by context and by what the opinions came to (33 knots)."""


_KNOTS = 33
_SPACING = 144
_VERDICT_SHIFT = 13
_SQUASH = chances_of_odds()
_STRETCH = (np.searchsorted(_SQUASH, np.arange(8, 65536, 16)) - WIDEST).astype(np.int16)
_RECIPROCAL = (65535 * 2 // (2 * np.arange(1 << COUNT_BITS) + 3)).astype(np.uint16)
_counts = np.arange(1 << COUNT_BITS)
_TRUST = np.where(_counts > 0, 256 * (5 * _counts + 3) // (5 * _counts + 8), 0).astype(np.int16)
"""How much an opinion counts for after so many bits, in 1/256."""
_FIRST_VERDICTS = np.array(
    [int(_SQUASH[min(max(k * _SPACING - 1, 0), 2 * WIDEST)]) << 6 for k in range(_KNOTS)],
    np.uint32,
)


def judge(opinions: Opinions, contexts: int) -> Judge:
    """Return a judge of so many contexts who has seen nothing yet."""
    return Judge(opinions, np.tile(_FIRST_VERDICTS, (contexts, 1)))


@part
def code_judged(
    coder: Coder, judge: Judge, chosen: int, first: int, second: int, limit: int, bit: int
) -> int:
    """Code one bit with the models at `opinions.slots` and learn it.

    `chosen` is the set of mixing weights, `first` and `second` the contexts of the verdict. Models
    settle at a rate of 1 / `limit`.
    """
    models, weights, slots, odds = judge.opinions
    verdicts = judge.verdicts
    total = whole(0)
    for k in range(slots.size):
        model = whole(models[slots[k]])
        said = whole(_STRETCH[model >> (COUNT_BITS + 10)])
        odds[k] = (said * whole(_TRUST[model & COUNT_MASK])) >> 8
        total += weights[chosen, k] * odds[k]
    total = min(max((total + 32768) >> 16, -WIDEST), WIDEST)
    chance = whole(_SQUASH[total + WIDEST])
    knot = (total + WIDEST + 1) // _SPACING
    upper = total + WIDEST + 1 - knot * _SPACING
    lower = _SPACING - upper
    said = whole(verdicts[first, knot]) + whole(verdicts[second, knot])
    after = whole(verdicts[first, knot + 1]) + whole(verdicts[second, knot + 1])
    judged = (said * lower + after * upper) // (_SPACING << 6)
    final = (2 * chance + judged + 2) >> 2
    bit = code_bit(coder, min(max(final, LEAST_CHANCE), 65536 - LEAST_CHANCE), bit)
    surprise = (65536 if bit else 0) - chance
    target = (1 << 22) - 1 if bit else 0
    for k in range(slots.size):
        weights[chosen, k] += (odds[k] * surprise + 32768) >> 16
        model = whole(models[slots[k]])
        count = model & COUNT_MASK
        probability = model >> COUNT_BITS
        probability += ((target - probability) * whole(_RECIPROCAL[count])) >> 16
        models[slots[k]] = (probability << COUNT_BITS) | min(count + 1, limit)
    for context in (first, second):
        for k, share in ((knot, lower), (knot + 1, upper)):
            verdict = whole(verdicts[context, k])
            verdicts[context, k] = verdict + (((target - verdict) * share) >> _VERDICT_SHIFT)
    return bit
