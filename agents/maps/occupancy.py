"""What is alike in planar and voxel occupancy maps: log-odds, how they are told, and who is surer.

A cell keeps summed log-odds `log(p / (1 - p))` and the number of looks behind them, so that one
more look is one more addition; 0 is p = 0.5, positive is occupied. A cell is *mapped* when p is off
by more than 0.4 from 0.5. What nobody measured is unknown, and counts as nothing.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Floats
from agents.payloads import OccupancyPayloads, OccupancyPyramid
from agents.planar.sensing import MAPPED
from agents.tiles import Shape

__all__ = ["LARGEST", "MAPPED", "Counts", "OccupancyKind", "probability", "surer"]

Counts = NDArray[np.uint16]
LARGEST = 5.29
"""Log-odds are summed up to this (p = 0.995): what was never seen to change may still change."""


class _Told(Protocol):
    @property
    def information_bits(self) -> float: ...


def probability(log_odds: Floats) -> Floats:
    """Return the probability that log-odds stand for, elementwise."""
    return 1.0 / (1.0 + np.exp(-log_odds))


def surer(first: Floats, second: Floats) -> Floats:
    """Take each cell's log-odds from the surer of two estimates whose errors are shared.

    Of two that are equally sure of opposite things, the one that says occupied: what order they
    come in must not matter, and to stay clear of nothing costs less than to run into something.
    """
    size, other = np.abs(first), np.abs(second)
    return np.where((other > size) | ((other == size) & (second > first)), second, first)


class OccupancyKind:
    """What both kinds answer alike to `agents.maps.kind.MapKind`."""

    def __init__(self, payloads: OccupancyPayloads | None = None) -> None:
        """Take how the team writes its tiles."""
        self.payloads: OccupancyPayloads = payloads or OccupancyPyramid()

    @property
    def least_bits_per_byte(self) -> float:
        """A mapped cell has less than one bit: some ten cells for 100 bytes."""
        return 0.08

    @property
    def looks_beside(self) -> bool:
        """A cell is no less sure for what is beside it."""
        return False

    def level(self, prefix: bytes, shape: Shape) -> int:
        """Return the last whole level."""
        told = self.payloads.decode(prefix, shape)
        return -1 if told is None else told.level

    def bits(self, estimate: _Told) -> float:
        """Return the sum over cells of 1 - h(p): by how much they are surer than p = 0.5."""
        return estimate.information_bits
