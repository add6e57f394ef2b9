"""The world as Embree sees it: what a ray meets, and whether the sun reaches it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from agents.geometry import Bools, Floats, Ints, Singles
from comms import kernels
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


class _Cast:
    """One Embree scene of one mesh."""

    def __init__(self, vertices_m: Floats, faces: np.ndarray[Any, Any]) -> None:
        self._scene = EmbreeScene()
        # Embree reads the mesh's memory as long as the scene lives: the mesh is kept with it.
        self._mesh = TriangleMesh(self._scene, vertices_m.astype(np.float32), faces)

    def met(self, eye_m: Floats, rays: Singles) -> tuple[Floats, Ints]:
        """Return range (N,), inf where nothing is met, and face (N,) from one eye."""
        eyes = np.empty_like(rays)
        eyes[:] = eye_m
        found: dict[str, Any] = self._scene.run(eyes, rays, query="INTERSECT", output=True)
        hit = np.asarray(found["geomID"]) >= 0
        range_m = np.where(hit, found["tfar"], np.inf).astype(np.float64)
        return range_m, np.asarray(found["primID"], dtype=np.int64)

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
        return Moment(self, [*self._still, *moving])

    def cells_at(self, points_m: Floats) -> tuple[Floats, Floats]:
        """Return columns u and rows v, cell centres whole, of points (N, 3) less the origin."""
        frame = self.terrain.frame
        u = (points_m[:, 0] + self.origin_m[0] - frame.x_m) / frame.cell_m - 0.5
        v = (points_m[:, 1] + self.origin_m[1] - frame.y_m) / frame.cell_m - 0.5
        return u, v

    def ground_met(self, eye_m: Floats, rays: Singles) -> Floats:
        """Return how far (N,) rays from one eye go to the ground."""
        return self._ground.met(eye_m, rays)[0]

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

    def __init__(self, world: World, things: Sequence[Mesh]) -> None:
        """Join the ground with things."""
        self.world = world
        self.things = joined(things) if things else None
        self._things = None
        self._balls = np.array([_ball(mesh) for mesh in things]).reshape(-1, 4)
        if self.things is not None:
            self._things = _Cast(self.things.vertices_m, self.things.faces)
            corners = self.things.vertices_m[self.things.faces]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            self.face_normals: Floats = normal / np.linalg.norm(normal, axis=1, keepdims=True)
            """(F, 3) unit normals of the things' faces, outwards."""

    def cast(self, eye_m: Floats, rays: Floats) -> Met:
        """Return what rays (N, 3) from one eye (3,), less the world's origin, meet first."""
        single = np.ascontiguousarray(rays, dtype=np.float32)
        range_m = self.world.ground_met(eye_m, single)
        face = np.full(single.shape[0], -1, dtype=np.int64)
        if self._things is not None:
            some = np.flatnonzero(pass_near(eye_m[None, :], rays, self._balls))
            near_m, its_face = self._things.met(eye_m, single[some])
            first = near_m < range_m[some]
            range_m[some[first]] = near_m[first]
            face[some[first]] = its_face[first]
        return Met(range_m, face)

    def in_shadow(self, points_m: Floats, normals: Floats, sun: Floats) -> Bools:
        """Say which points (N, 3) the sun, in direction (3,), does not reach."""
        starts = np.ascontiguousarray(points_m + CLEAR_M * normals, dtype=np.float32)
        rays = np.empty_like(starts)
        rays[:] = sun
        dark = self.world.ground_dark(starts, rays)
        if self._things is not None:
            some = np.flatnonzero(~dark & pass_near(points_m, sun[None, :], self._balls))
            dark[some] = self._things.dark(starts[some], rays[some])
        return dark


@kernels.kernel
def pass_near(starts_m: Floats, rays: Floats, balls: Floats) -> Bools:
    """Say which rays (N, 3) from starts (N, 3) pass through any ball (B, 4) of centre and radius.

    One start or one ray (1, 3) stands for all. The others need not be cast at what the balls hold.
    """
    count = max(starts_m.shape[0], rays.shape[0])
    out = np.zeros(count, dtype=np.bool_)
    for n in range(count):
        p = starts_m[min(n, starts_m.shape[0] - 1)]
        r = rays[min(n, rays.shape[0] - 1)]
        length2 = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
        for b in range(balls.shape[0]):
            x, y, z = balls[b, 0] - p[0], balls[b, 1] - p[1], balls[b, 2] - p[2]
            beyond2 = x * x + y * y + z * z - balls[b, 3] * balls[b, 3]
            along = x * r[0] + y * r[1] + z * r[2]
            if beyond2 <= 0.0 or (along > 0.0 and along * along >= beyond2 * length2):
                out[n] = True
    return out


def _ball(mesh: Mesh) -> Floats:
    """Return a ball (4,) that holds a mesh: its centre and its radius."""
    centre = (mesh.vertices_m.min(axis=0) + mesh.vertices_m.max(axis=0)) / 2
    reach = float(np.linalg.norm(mesh.vertices_m - centre, axis=1).max())
    return np.append(centre, reach + CLEAR_M)


@kernels.warmer
def _warm() -> None:
    pass_near(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 4)))
