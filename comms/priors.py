"""What the adaptive models know before a payload begins: learned from synthetic terrain.

Small payloads are over before models have learned much, so they start from what was learned once,
on fractal ground with rocks, craters and cliffs seen from random places; the program
`benchmarks/train_codec.py` writes `prior_data.py`. Both sides must hold the same file: it is part
of the format.
"""

import base64
import zlib
from functools import cache

import numpy as np
from numpy.typing import NDArray

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
from comms.prior_data import PRIORS

Units = NDArray[np.int64]

_COUNT_DIVISOR = 12
_LARGEST_COUNT = 24
_COARSENESS = 1 << 6
_CHANCES = chances_of_odds()[WIDEST % 18 :: 18].astype(np.int64)
"""Probabilities that priors are rounded to, in 1/65536, evenly spaced in log odds."""
_TAPS = "taps"
_shared: dict[str, Opinions] = {}
_shared_taps: list[Units] = []


def opinions(name: str, size: int, sets: int, inputs: int) -> Opinions:
    """Return the opinions of one kind of symbol at the start of a payload.

    `size` bit models (those beyond the learned ones know nothing), `sets` of mixing weights.
    """
    if name in _shared:
        return _shared[name]
    models, weights = _first(name, size, sets, inputs)
    return Opinions(
        models.copy(), weights.copy(), np.zeros(inputs, np.int64), np.zeros(inputs, np.int64)
    )


@cache
def _first(name: str, size: int, sets: int, inputs: int) -> tuple[Models, Weights]:
    models, weights = fresh_models(size), np.full((sets, inputs), 65536 * 3 // 2 // inputs)
    if name in PRIORS:
        learned, weights = _unpacked(name, (sets, inputs))
        models[: learned.size] = learned
    return models, weights.astype(np.int64)


def taps(sets: int, inputs: int) -> Units:
    """Return the weights of the adaptive predictor, (sets, inputs), in 1/65536."""
    if _shared_taps:
        return _shared_taps[0]
    if _TAPS not in PRIORS:
        return np.zeros((sets, inputs), np.int64)
    return np.frombuffer(_bytes(_TAPS), "<i2").reshape(sets, inputs).astype(np.int64)


def share(opinions_by_name: dict[str, Opinions], shared_taps: Units | None) -> None:
    """From now on let all payloads learn in the same models: for training, never for coding."""
    _shared.clear()
    _shared.update(opinions_by_name)
    _shared_taps[:] = [] if shared_taps is None else [shared_taps]


def pack_opinions(learned: Opinions, slots: int) -> str:
    """Return the first `slots` models and all weights as text, for `prior_data.py`."""
    models = learned.models[:slots].astype(np.int64)
    counts = np.minimum((models & COUNT_MASK) // _COUNT_DIVISOR, _LARGEST_COUNT)
    between = (_CHANCES[1:] + _CHANCES[:-1]) / 2
    odds = np.searchsorted(between, models >> (COUNT_BITS + 6)) - 127
    weights = np.clip(learned.weights // _COARSENESS, -32768, 32767).astype("<i2").tobytes()
    head = slots.to_bytes(4, "little")
    return _text(
        head + odds.astype(np.int8).tobytes() + counts.astype(np.uint8).tobytes() + weights
    )


def pack_taps(learned: Units) -> str:
    """Return the predictor's weights as text, for `prior_data.py`."""
    return _text(learned.astype("<i2").tobytes())


def _text(data: bytes) -> str:
    return base64.b85encode(zlib.compress(data, 9)).decode()


@cache
def _bytes(name: str) -> bytes:
    return zlib.decompress(base64.b85decode(PRIORS[name]))


def _unpacked(name: str, shape: tuple[int, int]) -> tuple[Models, Weights]:
    data = _bytes(name)
    slots = int.from_bytes(data[:4], "little")
    odds, counts = np.frombuffer(data, np.int8, 2 * slots, 4).astype(np.int64).reshape(2, slots)
    models = _CHANCES[odds + 127] << (COUNT_BITS + 6) | counts
    weights = np.frombuffer(data, "<i2", -1, 4 + 2 * slots).astype(np.int64) * _COARSENESS
    return models.astype(np.uint32), weights.reshape(shape)
