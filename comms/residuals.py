"""How many steps a cell lies off its prediction, coded in the contexts of what surrounds it.

What surrounds a cell comes as a few whole numbers (`Around`), all relative to the step, so that the
models mean the same for every terrain and every bound.
"""

from typing import NamedTuple

import numpy as np

from comms.logistic import Opinions, code_mixed
from comms.parts import part, whole
from comms.priors import opinions
from comms.rangecoder import Coder, Words, code_bit, code_even_bits


class Around(NamedTuple):
    """What both sides see around a cell before it is coded."""

    scale: int
    """0..7: spacing (1, 2, 4, more) and stage."""
    lines: int
    """How far the two lines through the cell disagree, in 1/16 steps, 0..2000."""
    near: int
    """Sizes of the residuals of the six nearest, times 10, 0..1023."""
    relief: int
    """Highest less lowest of the four nearest, in 1/16 steps, 0..2000."""
    causal: tuple[int, int, int, int]
    """Residuals of the nearest cells of the same stage."""
    nearest: tuple[int, int, int, int]
    """Residuals of the four nearest."""
    shift: int
    """How far the adaptive predictor moved the prediction, in 1/8 steps, -5..5."""
    trust: int
    """How well the nearest cells are known, 0..4."""


DECISIONS = 12
"""Zero or not, the sign, then more or not: more than 1, 2, ... 9, and beyond."""
_UNARY = 20
_LARGEST_EXPONENT = 40
_INPUTS = 8
_CONTEXTS = (12, 8 * 8, 8 * 12, 81, 11 * 6, 5 * 6 * 6, 81, 8 * 8)
_STARTS = np.cumsum((0, *_CONTEXTS)).astype(np.int64)
SLOTS = int(_STARTS[-1]) * DECISIONS
_GROUPS = 6
_LIMIT = 1000


def _quantiser(limits: tuple[int, ...], size: int) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
    return np.searchsorted(np.array(limits), np.arange(size)).astype(np.uint8)


_OF_ENERGY = _quantiser((16, 27, 46, 78, 133, 226, 384, 653, 1110, 1887, 2600), 3100)
_OF_SIZE = _quantiser((8, 20, 40, 80, 160, 320, 640), 2048)


def residual_opinions() -> Opinions:
    """Return the models of the residuals at the start of a payload."""
    return opinions("residuals", SLOTS, _GROUPS * DECISIONS, _INPUTS)


@part
def _sign(value: int) -> int:
    return 1 + (1 if value > 0 else 0) - (1 if value < 0 else 0)


@part
def _signs(four: tuple[int, int, int, int]) -> int:
    """Return the signs of four residuals as one number, 0..80."""
    a, b, c, d = four
    return ((_sign(a) * 3 + _sign(b)) * 3 + _sign(c)) * 3 + _sign(d)


@part
def look(around: Around, contexts: Words) -> int:
    """Write the first slot of each opinion to `contexts`; return the group of mixing weights."""
    a, b, c, d = around.causal
    energy = whole(_OF_ENERGY[around.lines + around.near])
    lines, near = whole(_OF_SIZE[around.lines]), whole(_OF_SIZE[around.near])
    far = min(abs(a) + abs(b) + abs(c) + abs(d), 5)
    contexts[0] = energy
    contexts[1] = _STARTS[1] + lines * 8 + near
    contexts[2] = _STARTS[2] + around.scale * 12 + energy
    contexts[3] = _STARTS[3] + _signs(around.causal)
    contexts[4] = _STARTS[4] + around.shift + 5 + 11 * min(lines, 5)
    contexts[5] = _STARTS[5] + (around.trust * 6 + far) * 6 + min(near, 5)
    contexts[6] = _STARTS[6] + _signs(around.nearest)
    contexts[7] = _STARTS[7] + whole(_OF_SIZE[around.relief]) * 8 + around.scale
    for k in range(_INPUTS):
        contexts[k] *= DECISIONS
    return energy >> 1


@part
def _decide(
    coder: Coder, mixed: Opinions, contexts: Words, group: int, decision: int, bit: int
) -> int:
    for k in range(_INPUTS):
        mixed.slots[k] = contexts[k] + decision
    return code_mixed(coder, mixed, group * DECISIONS + decision, _LIMIT, bit)


@part
def code_residual(coder: Coder, mixed: Opinions, contexts: Words, group: int, r: int) -> int:
    """Code a whole number of steps: zero or not, its sign, then its size."""
    if _decide(coder, mixed, contexts, group, 0, 1 if r == 0 else 0):
        return whole(0)
    positive = _decide(coder, mixed, contexts, group, 1, 1 if r > 0 else 0)
    size, k = abs(r), whole(1)
    while k < _UNARY:
        decision = min(k + 1, DECISIONS - 1)
        if not _decide(coder, mixed, contexts, group, decision, 1 if size > k else 0):
            break
        k += 1
    if k == _UNARY:
        k += code_size(coder, size - k)
    return k if positive else -k


@part
def code_size(coder: Coder, value: int) -> int:
    """Code an integer >= 0 of unknown size, its length in unary; hostile bytes end at 2^41."""
    length = whole(0)
    while length < _LARGEST_EXPONENT and value + 1 >= whole(1) << (length + 1):
        length += 1
    k = whole(0)
    while k < _LARGEST_EXPONENT and code_bit(coder, 52000, 1 if k < length else 0):
        k += 1
    least = whole(1) << k
    return least - 1 + code_even_bits(coder, k, value + 1 - least)
