"""Where rays end in what nobody measured yet: a small network's guess, mended look by look.

A cell that a look reaches for the first time is solid with a probability that depends on what lies
about it (`surroundings`). A network of two hidden layers, trained on made-up buildings and squares
(`benchmarks/train_hazard.py`), turns that into log-odds. How far it can be trusted the robot finds
out by itself: each look tells of some hundreds of cells which they were, so it keeps count of
them, all together and by the log-odds that were guessed, and shifts the guesses to fit: its world
may be more built up than those that the network knows, and what looks open there be walls here.
"""

import base64
import zlib
from functools import cache
from itertools import pairwise

import numpy as np

from agents.geometry import Bools, Floats
from agents.ground.markov import distance_to_known_m
from agents.planar.hazard_data import LAYERS
from agents.planar.record import Record, chance
from agents.planar.surroundings import NUMBERS, surroundings
from agents.planar.view import PlanarView

Layers = list[tuple[Floats, Floats]]
"""Weights (inputs, outputs) and biases (outputs,) of each layer."""
EDGES = np.array([-4.0, -3.3, -2.7, -2.2, -1.7, -1.2, -0.7, 0.0, 0.8, 1.6])
"""Guessed log-odds at which the counts are told apart."""
WITHIN_M = 8.0
"""Cells farther than that from all that is known to be free get `FAR_OFF`."""
FAR_OFF = -2.5
"""Log-odds of a cell of which nothing is known."""
PRIOR_CELLS = 60.0
"""The guesses count like so many cells, all together and in each bin."""
PRIOR_SHARE = 0.12
"""Of all cells that looks reached in training, the share that was solid."""

SIZES = (NUMBERS, 24, 12, 1)
"""Inputs, hidden units and output of the network."""


class Hazard:
    """What one robot has learned of the world that it explores."""

    def __init__(self) -> None:
        """Begin with the network alone."""
        self._record = Record(EDGES, PRIOR_CELLS, PRIOR_SHARE)
        self._before: tuple[Bools, Floats] | None = None

    def take(self, view: PlanarView) -> Floats:
        """Learn from what was measured since the last call; return each cell's p of being solid.

        Only of unmeasured cells (rows, cols) is anything said.
        """
        if self._before is not None:
            unknown, guess = self._before
            fresh = unknown & (view.log_odds != 0)
            self._record.count(guess[fresh], view.log_odds[fresh] > 0)
        guess = _guesses(view)
        self._before = (view.log_odds == 0, guess)
        return chance(guess + self._record.shifts()[np.searchsorted(EDGES, guess)])


def _guesses(view: PlanarView) -> Floats:
    """Return the network's log-odds (rows, cols) that cells are solid."""
    log_odds, frame = view.log_odds, view.frame
    guess = np.full(frame.shape, FAR_OFF)
    near = distance_to_known_m(log_odds < 0, frame.cell_m) < WITHIN_M
    cells = np.argwhere((log_odds == 0) & near)
    if len(cells):
        guess[cells[:, 0], cells[:, 1]] = network(surroundings(log_odds, cells, frame), _layers())
    return guess


def network(numbers: Floats, layers: Layers) -> Floats:
    """Return log-odds (N,) of inputs (N, `NUMBERS`): affine maps, what is negative cut between."""
    for n, (weight, bias) in enumerate(layers):
        numbers = (np.maximum(numbers, 0.0) if n else numbers) @ weight + bias
    return numbers[:, 0]


@cache
def _layers() -> Layers:
    return unpacked(LAYERS)


def packed(layers: Layers) -> str:
    """Return a network as text."""
    raw = b"".join(part.astype("<f2").tobytes() for layer in layers for part in layer)
    return base64.b85encode(zlib.compress(raw, 9)).decode()


def unpacked(text: str) -> Layers:
    """Return the network that a text holds."""
    numbers = np.frombuffer(zlib.decompress(base64.b85decode(text)), dtype="<f2")
    layers: Layers = []
    at = 0
    for inputs, outputs in pairwise(SIZES):
        weight = numbers[at : at + inputs * outputs].reshape(inputs, outputs)
        at += inputs * outputs
        layers.append((weight.astype(np.float64), numbers[at : at + outputs].astype(np.float64)))
        at += outputs
    return layers
