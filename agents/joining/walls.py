"""How far a point is from the next wall of a map, along that wall's own direction.

A wall's cells lie on a line, give or take the cell that they fell into. Of a long wall only the
distance across counts, for its cells slide along it; of a pillar or a corner the whole distance.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from agents.geometry import Bools, Floats

NEXT_CELLS = 2.6
"""A wall's direction is that of its cells so near to each other ..."""
STRAIGHT = 0.2
"""... if they spread less across it than by this share (of the variance along it)."""
END_CELLS = 0.75
"""What is farther along than that from the next cell of a wall is beyond its end."""
GATE_CELLS = 3.0
"""A wall farther off is another one."""
SPREAD_CELLS = 0.4
"""Standard deviation of where two maps draw the same piece of wall: each to a whole cell."""


@dataclass(frozen=True)
class Lines:
    """`agents.joining.fitting.Reading` of the walls of a floor."""

    places_m: Floats
    """(N, 2) middles of solid cells."""
    cell_m: float

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.places_m)

    @cached_property
    def _lines(self) -> tuple[Floats, Floats, Bools]:
        """Return a point and the normal (N, 2) of each cell's wall, and if that is straight."""
        middles, normals = self.places_m.copy(), np.zeros_like(self.places_m)
        straight = np.zeros(len(self.places_m), dtype=np.bool_)
        around = self._tree.query_ball_point(self.places_m, NEXT_CELLS * self.cell_m)
        for n, near in enumerate(around):
            if len(near) < 3:
                continue
            spots = self.places_m[np.sort(near)]
            values, vectors = np.linalg.eigh(np.cov(spots.T))
            if values[0] <= STRAIGHT * values[1]:
                middles[n], normals[n], straight[n] = spots.mean(axis=0), vectors[:, 0], True
        return middles, normals, straight

    def at(self, xy_m: Floats) -> tuple[Bools, Floats, Floats, Floats]:
        """Return which points (N, 2) are near a wall, how far (K,), its variance, and where to.

        As `agents.joining.fitting.Field.at` does.
        """
        away, which = self._tree.query(xy_m)
        away, which = np.asarray(away), np.asarray(which)
        known: Bools = np.asarray(away <= GATE_CELLS * self.cell_m, dtype=np.bool_)
        points, nearest = xy_m[known], which[known]
        middles, normals, straight = (of[nearest] for of in self._lines)
        way = points - self.places_m[nearest]
        along = np.abs(way[:, 0] * normals[:, 1] - way[:, 1] * normals[:, 0])
        beside = np.logical_and(straight, along <= END_CELLS * self.cell_m)
        across = ((points - middles) * normals).sum(axis=1)
        whole = np.maximum(away[known], 1e-9)
        value = np.where(beside, across, whole)
        slope = np.where(beside[:, None], normals, way / whole[:, None])
        variance = np.full(len(points), (SPREAD_CELLS * self.cell_m) ** 2)
        return known, value, variance, slope
