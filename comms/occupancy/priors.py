"""What the models of occupancy know before a payload begins: learned from synthetic worlds.

Small payloads are over before models have learned much, so they start from what was learned once,
on made-up floors and scenes that a scanner looked at; the program `benchmarks/train_occupancy.py`
writes `prior_data.py`. Both sides must hold the same file: it is part of the format.
"""

import base64
import zlib
from functools import cache

import numpy as np

from comms.logistic import (
    COUNT_BITS,
    COUNT_MASK,
    WIDEST,
    Models,
    Opinions,
    Weights,
    chances_of_odds,
    fresh_models,
)
from comms.occupancy.prior_data import PRIORS

_COUNT_DIVISOR = 4
_LARGEST_COUNT = 16
_COARSENESS = 1 << 6
_CHANCES = chances_of_odds()[WIDEST % 18 :: 18].astype(np.int64)
"""Probabilities that priors are rounded to, in 1/65536, evenly spaced in log odds."""
_shared: dict[str, Opinions] = {}


def opinions(name: str, size: int, sets: int, inputs: int) -> Opinions:
    """Return the opinions of one kind of symbol at the start of a payload.

    `size` bit models (those beyond the learned ones know nothing), `sets` of mixing weights.
    """
    if name in _shared:
        return _shared[name]
    models, weights = fresh_models(size), np.full((sets, inputs), 65536 * 3 // 2 // inputs)
    if name in PRIORS:
        learned, weights = _unpacked(name, (sets, inputs))
        models[: learned.size] = learned
    scratch = np.zeros((2, inputs), np.int64)
    return Opinions(models, weights.astype(np.int64), scratch[0], scratch[1])


def share(opinions_by_name: dict[str, Opinions]) -> None:
    """From now on let all payloads learn in the same models: for training, never for coding."""
    _shared.clear()
    _shared.update(opinions_by_name)


def pack(learned: Opinions, slots: int) -> str:
    """Return the first `slots` models and all weights as text, for `prior_data.py`."""
    models = learned.models[:slots].astype(np.int64)
    counts = np.minimum(-(-(models & COUNT_MASK) // _COUNT_DIVISOR), _LARGEST_COUNT)
    between = (_CHANCES[1:] + _CHANCES[:-1]) / 2
    odds = np.searchsorted(between, models >> (COUNT_BITS + 6)) - 127
    weights = np.clip(learned.weights // _COARSENESS, -32768, 32767).astype("<i2").tobytes()
    data = odds.astype(np.int8).tobytes() + counts.astype(np.uint8).tobytes() + weights
    return base64.b85encode(zlib.compress(slots.to_bytes(4, "little") + data, 9)).decode()


@cache
def _unpacked(name: str, shape: tuple[int, int]) -> tuple[Models, Weights]:
    data = zlib.decompress(base64.b85decode(PRIORS[name]))
    slots = int.from_bytes(data[:4], "little")
    odds, counts = np.frombuffer(data, np.int8, 2 * slots, 4).astype(np.int64).reshape(2, slots)
    models = _CHANCES[odds + 127] << (COUNT_BITS + 6) | counts
    weights = np.frombuffer(data, "<i2", -1, 4 + 2 * slots).astype(np.int64) * _COARSENESS
    return models.astype(np.uint32), weights.reshape(shape)
