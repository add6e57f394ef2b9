"""What the record wants of a robot's map, by its kind: how right it is, and its grids to keep."""

from typing import Any, Protocol

import numpy as np

from agents.geometry import Bools, Floats, Singles
from agents.maps.elevation import Estimate
from agents.maps.planar import Occupancy
from sim.ground import Terrain
from sim.planar_world import PlanarWorld


class Scorer(Protocol):
    """Weighs one kind of map against the world."""

    def done(self, estimate: Any) -> Bools:
        """Return the cells (rows, cols) that count as mapped."""
        ...

    def error_m(self, estimate: Any) -> float | None:
        """Return the root mean square elevation error; None where there are no heights."""
        ...

    def grids(self, estimate: Any) -> dict[str, Floats]:
        """Return the grids (rows, cols) that are kept at the end, by name; NaN unknown."""
        ...


def scorer_of(world: Terrain | PlanarWorld) -> Scorer:
    """Return the scorer of the maps that are made of a world."""
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


class _FloorScorer:
    def done(self, estimate: Occupancy) -> Bools:
        return estimate.mapped

    def error_m(self, estimate: Occupancy) -> float | None:
        del estimate
        return None

    def grids(self, estimate: Occupancy) -> dict[str, Floats]:
        return {"log_odds": np.where(estimate.known, estimate.log_odds, np.nan)}
