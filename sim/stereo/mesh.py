"""Triangles with paint: terrain, robots and the landmark, ready for Embree.

Coordinates are the world's less an origin near the ground, so that single precision keeps tenths
of millimetres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Floats, Pose
from agents.stereo.shape import Shape, box_triangles, shape_of
from agents.stereo.tagmodel import CENTRE_M, PANEL_M, SIDES, panels
from sim.ground import Terrain

Faces = NDArray[np.int32]
Cell = TypeVar("Cell", bound=np.generic)
BARE = -1
"""The tag of a face that carries none."""
ROBOT_ALBEDO, MAST_ALBEDO = 0.35, 0.2
MAST_M = 0.08
"""Side of a robot's square mast."""


@dataclass(frozen=True)
class Mesh:
    """Triangles, each with an albedo; some of them panels with a tag."""

    vertices_m: Floats
    """(V, 3)."""
    faces: Faces
    """(F, 3) indices of vertices, counter-clockwise seen from outside."""
    albedo: Floats
    """(F,) in [0, 1]."""
    tag: NDArray[np.int32]
    """(F,) the tag painted on the face, `BARE` for none."""
    panel: Floats
    """(F, 9) of a painted face: its panel's centre, right and down (world axes); else 0."""
    pebbled: NDArray[np.bool_]
    """(F,) the face has a fine pattern of its own, so that it can be matched."""


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Return one mesh of several; at least one is needed."""
    starts = np.cumsum([0, *(m.vertices_m.shape[0] for m in meshes[:-1])])
    return Mesh(
        np.concatenate([m.vertices_m for m in meshes]),
        np.concatenate([m.faces + np.int32(s) for m, s in zip(meshes, starts, strict=True)]),
        np.concatenate([m.albedo for m in meshes]),
        np.concatenate([m.tag for m in meshes]),
        np.concatenate([m.panel for m in meshes]),
        np.concatenate([m.pebbled for m in meshes]),
    )


def plain(vertices_m: Floats, faces: Faces, albedo: float, pebbled: bool = False) -> Mesh:
    """Return a mesh of one albedo without tags."""
    count = faces.shape[0]
    return Mesh(
        vertices_m.astype(np.float64),
        faces.astype(np.int32),
        np.full(count, albedo),
        np.full(count, BARE, dtype=np.int32),
        np.zeros((count, 9)),
        np.full(count, pebbled, dtype=np.bool_),
    )


def terrain_faces(terrain: Terrain, origin_m: Floats) -> tuple[Floats, Faces]:
    """Return vertices (V, 3), the cell centres, and faces of the ground; the unknown is open."""
    frame = terrain.frame
    x = frame.x_m + (np.arange(frame.cols) + 0.5) * frame.cell_m - origin_m[0]
    y = frame.y_m + (np.arange(frame.rows) + 0.5) * frame.cell_m - origin_m[1]
    z = terrain.elevation_m.astype(np.float64) - origin_m[2]
    grid = np.stack((*np.meshgrid(x, y), z), axis=-1)
    index = np.arange(z.size, dtype=np.int32).reshape(z.shape)
    known = np.isfinite(z)
    a, b, c, d = _corners(index)
    whole = _corners(known)
    first = np.column_stack((a, b, d))[whole[0] & whole[1] & whole[3]]
    second = np.column_stack((a, d, c))[whole[0] & whole[2] & whole[3]]
    vertices = np.where(np.isfinite(grid), grid, 0.0).reshape(-1, 3)
    return vertices, np.concatenate((first, second))


def _corners(grid: NDArray[Cell]) -> list[NDArray[Cell]]:
    """Return the south-west, south-east, north-west and north-east corners of all squares."""
    return [g.ravel() for g in (grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:])]


def box(size_m: Sequence[float], centre_m: Sequence[float], albedo: float, pebbled: bool) -> Mesh:
    """Return an upright box."""
    return plain(*box_triangles(size_m, centre_m), albedo, pebbled)


def _panel_mesh(robot: int, count: int) -> Mesh:
    """Return the first tag panels of a robot, a hair outside its box, in the robot's frame."""
    made: list[Mesh] = []
    for panel in panels(robot)[:count]:
        out = np.cross(panel.down, panel.right)
        corners = panel.corners_m(PANEL_M) + 0.002 * out
        faces = np.array([(0, 3, 2), (0, 2, 1)], dtype=np.int32)
        base = plain(corners, faces, 1.0)
        frame = np.concatenate((panel.centre_m + 0.002 * out, panel.right, panel.down))
        made.append(
            Mesh(
                base.vertices_m,
                base.faces,
                base.albedo,
                np.full(2, panel.tag, dtype=np.int32),
                np.tile(frame, (2, 1)),
                base.pebbled,
            )
        )
    return joined(made)


def robot_mesh(robot: int, mast_m: float) -> Mesh:
    """Return a robot in its own frame: a box with tags, and a mast with a head or a lid."""
    height = 2 * CENTRE_M
    masted = mast_m > height
    parts = [
        box((PANEL_M, PANEL_M, height), (0, 0, height / 2), ROBOT_ALBEDO, True),
        _panel_mesh(robot, SIDES if masted else SIDES + 1),
    ]
    if masted:
        parts.append(
            box((MAST_M, MAST_M, mast_m - height), (0, 0, (mast_m + height) / 2), MAST_ALBEDO, True)
        )
    return joined(parts)


def shape_mesh(shape: Shape) -> Mesh:
    """Return a landmark of known geometry, in its own frame."""
    mesh = plain(shape.vertices_m, shape.faces, 1.0, pebbled=True)
    return replace(mesh, albedo=shape.albedo)


def lander_mesh() -> Mesh:
    """Return the built-in lander."""
    return shape_mesh(shape_of("lander"))


def placed(mesh: Mesh, pose: Pose, origin_m: Floats) -> Mesh:
    """Return a mesh of a robot's frame where a pose puts it, in world axes less an origin."""
    turn = Pose(0.0, 0.0, 0.0, pose.yaw_rad)
    panel = mesh.panel.copy()
    for k in range(0, 9, 3):
        panel[:, k : k + 3] = turn.team_from_robot(panel[:, k : k + 3])
    panel[:, :3] += np.array([pose.x_m, pose.y_m, pose.z_m]) - origin_m
    vertices = pose.team_from_robot(mesh.vertices_m) - origin_m
    return Mesh(vertices, mesh.faces, mesh.albedo, mesh.tag, panel, mesh.pebbled)
