"""The world as Embree sees it: what a ray meets, and whether the sun reaches it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from agents.geometry import Bools, Floats, Ints, Singles
from sim.ground import Terrain, filled
from sim.stereo.mesh import Mesh, joined, terrain_faces

NOTHING_M = 1e30
"""Embree's distances beyond this mean that nothing was met."""
CLEAR_M = 2e-3
"""Shadow rays start this far off the surface, or it would shade itself."""


@dataclass(frozen=True)
class Met:
    """What rays (N) met: the ground, or a face of the objects' mesh, or nothing."""

    range_m: Floats
    """(N,) along the rays in units of their length; inf where nothing was met."""
    face: Ints
    """(N,) a face of the objects' mesh; -1 for the ground or nothing."""
    normal: Floats
    """(N, 3) the face's unit normal, towards the ray's origin; of the ground too."""


class _Cast:
    """One Embree scene of one mesh."""

    def __init__(self, vertices_m: Floats, faces: np.ndarray[Any, Any]) -> None:
        self._scene = EmbreeScene()
        # Embree reads the mesh's memory as long as the scene lives: the mesh is kept with it.
        self._mesh = TriangleMesh(self._scene, vertices_m.astype(np.float32), faces)

    def met(self, eyes_m: Singles, rays: Singles) -> tuple[Floats, Ints, Floats]:
        found: dict[str, Any] = self._scene.run(eyes_m, rays, query="INTERSECT", output=True)
        hit = np.asarray(found["geomID"]) >= 0
        range_m = np.where(hit, found["tfar"], np.inf).astype(np.float64)
        return (
            range_m,
            np.asarray(found["primID"], dtype=np.int64),
            np.asarray(found["Ng"], dtype=np.float64),
        )

    def dark(self, points_m: Singles, rays: Singles) -> Bools:
        return np.asarray(self._scene.run(points_m, rays, query="OCCLUDED")) >= 0


class World:
    """Ground and things that stand still, made ready once; things that move are given per look."""

    def __init__(self, terrain: Terrain, still: Sequence[Mesh] = ()) -> None:
        """Build the ground; `still` are meshes in world axes less `origin_m`."""
        frame = terrain.frame
        full = filled(terrain.elevation_m)
        self.terrain = terrain
        self.origin_m: Floats = origin_of(terrain)
        self._ground = _Cast(*terrain_faces(terrain, self.origin_m))
        self._still = tuple(still)
        north, east = np.gradient(full, frame.cell_m)
        self.north: Singles = np.asarray(north, dtype=np.float32)
        """Slope of the ground towards north at the cell centres; `east` likewise."""
        self.east: Singles = np.asarray(east, dtype=np.float32)

    def with_moving(self, moving: Sequence[Mesh]) -> "Moment":
        """Return the world with things where they are at one moment."""
        things = [*self._still, *moving]
        return Moment(self, joined(things) if things else None)

    def cells_at(self, points_m: Floats) -> tuple[Floats, Floats]:
        """Return columns u and rows v, cell centres whole, of points (N, 3) less the origin."""
        frame = self.terrain.frame
        u = (points_m[:, 0] + self.origin_m[0] - frame.x_m) / frame.cell_m - 0.5
        v = (points_m[:, 1] + self.origin_m[1] - frame.y_m) / frame.cell_m - 0.5
        return u, v

    def ground_met(self, eyes_m: Singles, rays: Singles) -> tuple[Floats, Ints, Floats]:
        """Return range (N,), face (N,) and normal (N, 3, any length) of the ground under rays."""
        return self._ground.met(eyes_m, rays)

    def ground_dark(self, points_m: Singles, rays: Singles) -> Bools:
        """Say where the ground is in the way of rays."""
        return self._ground.dark(points_m, rays)


def origin_of(terrain: Terrain) -> Floats:
    """Return the point (3,) that meshes of this terrain's world are told from."""
    west, east, south, north = terrain.frame.extent_m
    return np.array(
        [(west + east) / 2, (south + north) / 2, float(filled(terrain.elevation_m).mean())]
    )


class Moment:
    """The world at one instant."""

    def __init__(self, world: World, things: Mesh | None) -> None:
        """Join the ground with things."""
        self.world = world
        self.things = things
        self._things = None if things is None else _Cast(things.vertices_m, things.faces)

    def cast(self, eye_m: Floats, rays: Floats) -> Met:
        """Return what rays (N, 3) from one eye (3,), less the world's origin, meet first."""
        single = np.ascontiguousarray(rays, dtype=np.float32)
        eyes = np.tile(np.asarray(eye_m, dtype=np.float32), (single.shape[0], 1))
        range_m, _, normal = self.world.ground_met(eyes, single)
        face = np.full(single.shape[0], -1, dtype=np.int64)
        if self._things is not None:
            nearer_m, its_face, its_normal = self._things.met(eyes, single)
            nearer = nearer_m < range_m
            range_m = np.where(nearer, nearer_m, range_m)
            face = np.where(nearer, its_face, face)
            normal = np.where(nearer[:, None], its_normal, normal)
        length = np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        towards = np.where(np.einsum("ij,ij->i", normal, rays) > 0, -1.0, 1.0)
        return Met(range_m, face, normal / length * towards[:, None])

    def in_shadow(self, points_m: Floats, normals: Floats, sun: Floats) -> Bools:
        """Say which points (N, 3) the sun, in direction (3,), does not reach."""
        starts = np.ascontiguousarray(points_m + CLEAR_M * normals, dtype=np.float32)
        rays = np.tile(sun.astype(np.float32), (starts.shape[0], 1))
        dark = self.world.ground_dark(starts, rays)
        if self._things is not None:
            dark |= self._things.dark(starts, rays)
        return dark
