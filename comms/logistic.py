"""Several opinions about one bit, mixed: adaptive models in their contexts, weighed as they prove.

Each opinion is a bit model; its log odds are added with weights that are learned from bit to bit
(by gradient descent on the coding cost), so that contexts which tell much come to weigh much. All
of it is whole numbers: log odds in 1/256, probabilities in 16 and 22 bits, weights in 1/65536.

Source of the idea: M. Mahoney, "Adaptive weighing of context models for lossless data compression",
Florida Tech. CS-2005-16 (the PAQ archivers).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comms.parts import part, whole
from comms.rangecoder import Coder, Words, code_bit

Models = NDArray[np.uint32]
"""Bit models: the probability of a 1 in 22 bits, above a count of what was learned in 10 bits."""
Weights = NDArray[np.int64]
"""Mixing weights (sets, inputs), in 1/65536."""


class Opinions(NamedTuple):
    """What one kind of symbol is coded with; it learns as it codes."""

    models: Models
    weights: Weights
    slots: Words
    """Scratch: which model each input is, set before every bit."""
    odds: Words
    """Scratch: what each input said."""


COUNT_BITS = 10
COUNT_MASK = (1 << COUNT_BITS) - 1
WIDEST = 2303
"""Largest log odds, in 1/256."""
LEAST_CHANCE = 8
"""Least probability of a bit, in 1/65536."""
_LEARNING_SHIFT = 16


def chances_of_odds() -> NDArray[np.uint16]:
    """Return 65536 / (1 + exp(-k / 256)) for k = -WIDEST..WIDEST, in integer arithmetic.

    Powers of exp(1 / 256) are kept with 96 fractional bits, so the result is rounded alike on every
    machine, which a library's exponential need not be.
    """
    one = 1 << 96
    root, term = one, one
    for k in range(1, 20):
        term = term // (256 * k)
        root += term
    power, table = one, [1 << 15]
    for _ in range(WIDEST):
        power = (power * root) >> 96
        table.append((((power << 17) // (one + power)) + 1) >> 1)
    mirrored = [65536 - chance for chance in table[:0:-1]]
    return np.array(mirrored + table, np.uint16)


_SQUASH = chances_of_odds()
_STRETCH = (np.searchsorted(_SQUASH, np.arange(8, 65536, 16)) - WIDEST).astype(np.int16)
_RECIPROCAL = (65535 * 2 // (2 * np.arange(1 << COUNT_BITS) + 3)).astype(np.uint16)


def fresh_models(size: int) -> Models:
    """Return models that know nothing and will learn quickly."""
    return np.full(size, 1 << (21 + COUNT_BITS), np.uint32)


@part
def code_mixed(coder: Coder, opinions: Opinions, chosen: int, limit: int, bit: int) -> int:
    """Code one bit with the models at `opinions.slots`, mixed by one set of weights, and learn it.

    Models settle at a rate of 1 / `limit`.
    """
    models, weights, slots, odds = opinions
    total = whole(0)
    for k in range(slots.size):
        odds[k] = _STRETCH[whole(models[slots[k]]) >> (COUNT_BITS + 10)]
        total += weights[chosen, k] * odds[k]
    total = min(max((total + 32768) >> 16, -WIDEST), WIDEST)
    chance = min(max(whole(_SQUASH[total + WIDEST]), LEAST_CHANCE), 65536 - LEAST_CHANCE)
    bit = code_bit(coder, chance, bit)
    surprise = (65536 if bit else 0) - chance
    target = (1 << 22) - 1 if bit else 0
    for k in range(slots.size):
        push = odds[k] * surprise
        weights[chosen, k] += (push + (1 << (_LEARNING_SHIFT - 1))) >> _LEARNING_SHIFT
        model = whole(models[slots[k]])
        count = model & COUNT_MASK
        probability = model >> COUNT_BITS
        probability += ((target - probability) * whole(_RECIPROCAL[count])) >> 16
        models[slots[k]] = (probability << COUNT_BITS) | min(count + 1, limit)
    return bit
