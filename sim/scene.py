"""True ground made ready for looking at: rays over it, and what comes back along them."""

from functools import lru_cache

import numpy as np

from agents.geometry import Floats
from sim.ground import Terrain
from sim.raycast import block_tops, cast, cast_one, grid_point

BLIND_FACING, CLEAR_FACING = 0.03, 0.10
"""Cosine of incidence at which nothing returns, and from which the angle does no harm."""
BLIND_TEXTURE, CLEAR_TEXTURE = 0.1, 0.4
"""Texture at which nothing is matched, and from which it does no harm."""
BEST_RETURN = 0.98
"""Probability of a return from well-textured ground seen squarely."""


def return_probability(facing: Floats, texture: Floats) -> Floats:
    """Return the probability that a ray gives a point, by its incidence and the texture."""
    angle = np.clip((facing - BLIND_FACING) / (CLEAR_FACING - BLIND_FACING), 0, 1)
    match = np.clip((texture - BLIND_TEXTURE) / (CLEAR_TEXTURE - BLIND_TEXTURE), 0, 1)
    return BEST_RETURN * angle * match


class Scene:
    """A terrain made ready for casting rays; shared by all looks."""

    def __init__(self, terrain: Terrain) -> None:
        """Find the highest points of the ground's blocks."""
        self.terrain = terrain
        self.ground = np.ascontiguousarray(terrain.elevation_m, dtype=np.float32)
        self.tops = block_tops(self.ground)

    def cast(self, eye_m: Floats, rays: Floats, limits_m: Floats) -> Floats:
        """Return (N, 4): distance in m, cosine of incidence, u, v; NaN where nothing is met."""
        cell_m = self.terrain.frame.cell_m
        return cast(self.ground, self.tops, cell_m, self._point(eye_m), rays, limits_m)

    def clear(self, eye_m: Floats, target_m: Floats) -> bool:
        """Say whether no ground lies between two points of the world."""
        way = target_m - eye_m
        distance = float(np.linalg.norm(way))
        cell_m = self.terrain.frame.cell_m
        hit = cast_one(self.ground, self.tops, cell_m, self._point(eye_m), way / distance, distance)
        return not hit < distance

    def texture_at(self, u: Floats, v: Floats) -> Floats:
        """Return the texture of the cells nearest to (u, v)."""
        rows = np.floor(v + 0.5).astype(np.int64)
        cols = np.floor(u + 0.5).astype(np.int64)
        return self.terrain.texture[rows, cols].astype(np.float64)

    def _point(self, eye_m: Floats) -> Floats:
        return grid_point(self.terrain.frame, float(eye_m[0]), float(eye_m[1]), float(eye_m[2]))


@lru_cache(maxsize=2)
def scene_of(terrain: Terrain) -> Scene:
    """Return a terrain made ready, once for all cameras in a process."""
    return Scene(terrain)
