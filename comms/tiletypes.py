"""A tile's payload, and what a prefix of it tells."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comms.errors import CodecError


class NeedsBaseError(CodecError):
    """A payload that is built on a version before it, and that version is not at hand."""


@dataclass(frozen=True)
class EncodedTile:
    """One progressive payload; `data[: level_ends[k]]` decodes to level k."""

    data: bytes
    level_ends: tuple[int, ...]
    needs_base: bool = False
    """Whether it can be decoded only on top of the version before."""


@dataclass(frozen=True)
class DecodedTile:
    """What a prefix of a payload tells: arrays (H, W), row order as encoded, lengths in metres."""

    elevation_m: NDArray[np.float32]
    """NaN where not (yet) known."""
    known: NDArray[np.bool_]
    sigma_m: NDArray[np.float32]
    """Never below the standard deviation that was encoded; NaN where not known."""
    bound_m: float
    """Largest elevation error of the known cells; infinite where none is."""
    level: int
    """The last level that is whole, or -1."""
    levels: int
    """How many levels the payload has; 0 where not even that is certain."""

    @property
    def is_whole(self) -> bool:
        """Whether every level is here."""
        return 0 <= self.level == self.levels - 1
