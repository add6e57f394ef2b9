"""Several opinions about one bit, mixed: adaptive models in their contexts, weighed as they prove.

Each opinion is a bit model; its log odds are added with weights that are learned from bit to bit
(by gradient descent on the coding cost), so that contexts which tell much come to weigh much. All
of it is whole numbers: log odds in 1/256, probabilities in 16 and 22 bits, weights in 1/65536.

Source of the idea: M. Mahoney, "Adaptive weighing of context models for lossless data compression",
Florida Tech. CS-2005-16 (the PAQ archivers).
"""

import numpy as np
from numpy.typing import NDArray

from comms.kernels import kernel
from comms.rangecoder import Bytes, Words, code_bit

Models = NDArray[np.int64]
"""Bit models: the probability of a 1 in 22 bits, above a count of what was learned in 10 bits."""
Weights = NDArray[np.int64]

COUNT_BITS = 10
WIDEST = 2303
"""Largest log odds, in 1/256."""
_COUNT_MASK = (1 << COUNT_BITS) - 1
_LEAST_CHANCE = 8
_LEARNING_SHIFT = 14


def _chances() -> NDArray[np.int64]:
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
    return np.array(mirrored + table, np.int64)


_SQUASH = _chances()
_STRETCH = (np.searchsorted(_SQUASH, np.arange(8, 65536, 16)) - WIDEST).astype(np.int64)
_RECIPROCAL = (65536 * 2 // (2 * np.arange(1 << COUNT_BITS) + 3)).astype(np.int64)


def fresh_models(size: int, chance: float = 0.5) -> Models:
    """Return models that expect a 1 with the same chance and will learn quickly."""
    return np.full(size, round(chance * (1 << 22)) << COUNT_BITS, np.int64)


def even_weights(sets: int, inputs: int, total: float = 1.0) -> Weights:
    """Return sets of weights that trust every input alike."""
    return np.full((sets, inputs), round(65536 * total / inputs), np.int64)


@kernel
def code_mixed(
    coder: Words,
    buffer: Bytes,
    models: Models,
    slots: Words,
    weights: Weights,
    chosen: int,
    odds: Words,
    limit: int,
    bit: int,
) -> int:
    """Code one bit with the models at `slots`, mixed by the weights of set `chosen`; learn from it.

    `odds` is scratch space of the size of `slots`; models settle at a rate of 1 / `limit`.
    """
    total = 0
    for k in range(slots.size):
        odds[k] = _STRETCH[models[slots[k]] >> (COUNT_BITS + 10)]
        total += weights[chosen, k] * odds[k]
    total = min(max((total + 32768) >> 16, -WIDEST), WIDEST)
    chance = min(max(_SQUASH[total + WIDEST], _LEAST_CHANCE), 65536 - _LEAST_CHANCE)
    bit = code_bit(coder, buffer, chance, bit)
    surprise = (65536 if bit else 0) - chance
    for k in range(slots.size):
        push = odds[k] * surprise
        weights[chosen, k] += (push + (1 << (_LEARNING_SHIFT - 1))) >> _LEARNING_SHIFT
        model = models[slots[k]]
        count = model & _COUNT_MASK
        probability = model >> COUNT_BITS
        target = (1 << 22) - 1 if bit else 0
        probability += ((target - probability) * _RECIPROCAL[count]) >> 16
        models[slots[k]] = (probability << COUNT_BITS) | min(count + 1, limit)
    return bit
