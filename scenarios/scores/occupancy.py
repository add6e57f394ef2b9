"""How much of a floor, or of a cave, is mapped, and how right that is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agents.geometry import Bools, Floats, Singles
from agents.maps.occupancy import MAPPED
from agents.voxel.frame import VoxelFrame


@dataclass(frozen=True)
class PlanarTruth:
    """The floor as it is."""

    solid: Bools
    """(H, W), row 0 south."""
    observable: Bools
    """(H, W): cells that the team could see from where it can stand."""


@dataclass(frozen=True)
class VoxelTruth(PlanarTruth):
    """A cave as it is: both arrays are (L, H, W), the lowest layer first."""

    frame: VoxelFrame
    """Of both."""


@dataclass(frozen=True)
class FloorScore:
    """How good an occupancy map is against the truth."""

    mapped_cells: int
    """Observable cells whose occupancy is off by more than 0.4 from 0.5."""
    coverage: float
    """The same as a share of the observable ones; 0 where nothing is observable."""
    wrong_cells: int
    """Mapped cells, observable or not, that are not what the map says."""


def score_floor(log_odds: Singles, truth: PlanarTruth) -> FloorScore:
    """Return how good a map of log-odds is; NaN unknown."""
    mapped = np.abs(np.nan_to_num(log_odds)) > MAPPED
    observable = int(truth.observable.sum())
    count = int((mapped & truth.observable).sum())
    wrong = mapped & ((log_odds > 0) != truth.solid)
    return FloorScore(count, count / observable if observable else 0.0, int(wrong.sum()))


def union_floor(maps: Sequence[Singles], shape: tuple[int, ...]) -> Singles:
    """Return the union of team maps: of each cell whichever is surest, the first if equal.

    Maps are not added up: they share their measurements.
    """
    best = np.full(shape, np.nan, np.float32)
    for log_odds in maps:
        better = np.isnan(best) & np.isfinite(log_odds) | (np.abs(log_odds) > np.abs(best))
        best[better] = log_odds[better]
    return best


def floor_heights(free: Bools, frame: VoxelFrame) -> Floats:
    """Return the height (H, W) of each column's lowest free cell (L, H, W); NaN where none is."""
    lowest = np.argmax(free, axis=0)
    return np.where(free.any(axis=0), frame.z_m + lowest * frame.cell_m, np.nan)
