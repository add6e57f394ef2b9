"""What the record wants of a robot's map, by its kind: how right it is, and its grids to keep."""

import math
from typing import Any, Protocol

import numpy as np

from agents.geometry import Bools, Floats, Singles
from agents.maps.elevation import Estimate
from agents.maps.occupancy import MAPPED
from agents.maps.planar import Occupancy
from agents.maps.voxel import VoxelOccupancy
from agents.voxel.frame import VoxelFrame
from scenarios.scores.occupancy import floor_heights
from sim.planar_world import PlanarWorld
from sim.voxel.world import VoxelWorld
from sim.worlds import World


class Scorer(Protocol):
    """Weighs one kind of map against the world."""

    def done(self, estimate: Any) -> Bools:
        """Return the cells (rows, cols), or (layers, rows, cols), that count as mapped."""
        ...

    def error_m(self, estimate: Any) -> float | None:
        """Return the root mean square elevation error; None where there are no heights."""
        ...

    def grids(self, estimate: Any) -> dict[str, Floats]:
        """Return the grids of all cells that are kept at the end, by name; NaN unknown."""
        ...

    def charts(self, estimate: Any) -> dict[str, Floats]:
        """Return the grids (rows, cols) that a robot's log keeps of its map on the way."""
        ...


def scorer_of(world: World) -> Scorer:
    """Return the scorer of the maps that are made of a world."""
    if isinstance(world, VoxelWorld):
        return _SpaceScorer(world.frame)
    if isinstance(world, PlanarWorld):
        return _FloorScorer()
    return _GroundScorer(world.elevation_m)


class _GroundScorer:
    def __init__(self, elevation_m: Singles) -> None:
        self._truth_m = elevation_m

    def done(self, estimate: Estimate) -> Bools:
        return estimate.known

    def error_m(self, estimate: Estimate) -> float | None:
        errors = estimate.elevation_m - self._truth_m
        errors = errors[np.isfinite(errors)]
        return float(np.sqrt(np.mean(errors**2))) if errors.size else None

    def grids(self, estimate: Estimate) -> dict[str, Floats]:
        return {"elevation": estimate.elevation_m, "sigma": np.sqrt(estimate.variance_m2)}

    def charts(self, estimate: Estimate) -> dict[str, Floats]:
        return self.grids(estimate)


class _FloorScorer:
    def done(self, estimate: Occupancy) -> Bools:
        return estimate.mapped

    def error_m(self, estimate: Occupancy) -> float | None:
        del estimate
        return None

    def grids(self, estimate: Occupancy) -> dict[str, Floats]:
        return {"log_odds": np.where(estimate.known, estimate.log_odds, np.nan)}

    def charts(self, estimate: Occupancy) -> dict[str, Floats]:
        return self.grids(estimate)


class _SpaceScorer:
    """The world has all its cells at hand, and so may lay out a map's; no robot does."""

    def __init__(self, frame: VoxelFrame) -> None:
        self._frame = frame

    def done(self, estimate: VoxelOccupancy) -> Bools:
        return np.abs(np.nan_to_num(estimate.dense(self._frame))) > MAPPED

    def error_m(self, estimate: VoxelOccupancy) -> float | None:
        del estimate
        return None

    def grids(self, estimate: VoxelOccupancy) -> dict[str, Floats]:
        return {"log_odds": estimate.dense(self._frame)}

    def charts(self, estimate: VoxelOccupancy) -> dict[str, Floats]:
        """Return the map from above: how low it is known to be free, to a third of a cell."""
        free = np.nan_to_num(estimate.dense(self._frame)) < 0
        heights_m = floor_heights(free, self._frame)
        sigma_m = np.where(np.isfinite(heights_m), self._frame.cell_m / math.sqrt(12), np.nan)
        return {"elevation": heights_m, "sigma": sigma_m}
