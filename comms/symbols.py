"""Adaptive models for the symbols of a coded map, on top of the binary range coder.

A bit model is one int64: the probability of a 1 in 22 bits above a count in 10 bits. It learns
fast while it is young and settles at a rate of 1 / `limit`.
"""

import numpy as np
from numpy.typing import NDArray

from comms.kernels import kernel
from comms.rangecoder import Bytes, Words, code_bit, code_even_bits

Models = NDArray[np.int64]
"""Bit models, any shape that the symbol wants."""

_COUNT_BITS = 10
_COUNT_MASK = (1 << _COUNT_BITS) - 1
_LIMIT = 160
_LARGEST_EXPONENT = 40


def fresh_models(shape: tuple[int, ...], chance: float = 0.5) -> Models:
    """Return models that expect a 1 with the same chance and will learn quickly."""
    return np.full(shape, round(chance * (1 << 22)) << _COUNT_BITS, np.int64)


@kernel
def code_adaptive(state: Words, buffer: Bytes, models: Models, at: int, bit: int) -> int:
    """Code one bit with models[at], and let the model learn it."""
    model = models[at]
    probability, count = model >> _COUNT_BITS, model & _COUNT_MASK
    chance = min(max(probability >> 6, 24), 65536 - 24)
    bit = code_bit(state, buffer, chance, bit)
    target = (1 << 22) - 1 if bit else 0
    probability += (target - probability) * 2 // (2 * count + 3)
    if count < _LIMIT:
        count += 1
    models[at] = (probability << _COUNT_BITS) | count
    return bit


@kernel
def code_exponential(state: Words, buffer: Bytes, models: Models, value: int) -> int:
    """Code an integer >= 0 of unknown size: its length adaptively, its lower bits evenly.

    `models` holds `_LARGEST_EXPONENT` + 1 bit models. Hostile bytes end at that exponent.
    """
    exponent = 0
    while value + 1 >= 1 << (exponent + 1) and exponent < _LARGEST_EXPONENT:
        exponent += 1
    k = 0
    while k < _LARGEST_EXPONENT and code_adaptive(state, buffer, models, k, int(k < exponent)):
        k += 1
    rest = value + 1 - (1 << k)
    return (1 << k) - 1 + code_even_bits(state, buffer, k, rest)
