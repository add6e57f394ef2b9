"""Landmarks of known geometry: built in, or read from a CAD file; their surface as points.

One definition, so that who paints a landmark and who looks for it mean the same. A landmark's own
frame: x the way that it faces, z up, its foot the origin; metres.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from agents.errors import AgentError
from agents.geometry import Floats

Faces = NDArray[np.int32]
SPACING_M = 0.05
"""Distance of the points that stand for a surface, about."""
FILE_ALBEDO = 0.6
KINDS = (".stl", ".obj", ".ply", ".off", ".glb")
LARGEST_M, SMALLEST_M = 20.0, 0.3
"""Widest and narrowest landmark."""


class ShapeError(AgentError):
    """A landmark's shape that can't be read or used."""


@dataclass(frozen=True)
class Part:
    """An upright box."""

    size_m: tuple[float, float, float]
    centre_m: tuple[float, float, float]
    albedo: float


LANDER = (
    *(Part((0.08, 0.08, 0.5), (x, y, 0.25), 0.5) for x in (-0.5, 0.5) for y in (-0.5, 0.5)),
    Part((1.2, 1.2, 0.3), (0.0, 0.0, 0.6), 0.6),
    Part((0.7, 0.7, 0.4), (0.1, 0.0, 0.95), 0.75),
    Part((0.9, 1.6, 0.03), (0.0, 1.45, 0.72), 0.12),
    Part((0.9, 1.0, 0.03), (0.0, -1.15, 0.72), 0.12),
    Part((0.06, 0.06, 0.9), (-0.5, 0.5, 1.2), 0.5),
    Part((0.3, 0.05, 0.3), (-0.5, 0.5, 1.75), 0.85),
)
"""Two decks on four legs and two solar panels. It has no symmetry, so that its pose is unique: one
panel is longer, and a mast stands at one corner."""
SOLAR_PANEL = (
    Part((0.08, 2.0, 1.0), (0.0, 0.0, 1.0), 0.2),
    Part((0.1, 0.1, 0.5), (0.0, 0.6, 0.25), 0.5),
    Part((0.1, 0.1, 0.5), (0.0, -0.6, 0.25), 0.5),
    Part((0.5, 0.5, 0.4), (0.35, -0.7, 0.2), 0.6),
)
"""A panel that stands upright on two legs, with a box beside its right one."""
MODELS: Mapping[str, Sequence[Part]] = {"lander": LANDER, "solar-panel": SOLAR_PANEL}

_BOX_FACES: Faces = np.array(
    [
        *((0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4)),
        *((1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7)),
    ],
    dtype=np.int32,
)


def box_triangles(size_m: Sequence[float], centre_m: Sequence[float]) -> tuple[Floats, Faces]:
    """Return the corners (8, 3) and faces (12, 3), outwards, of an upright box."""
    signs = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    corners = np.array([(x, y, z) for z in (-1, 1) for x, y in signs], dtype=np.float64)
    return corners * np.asarray(size_m) / 2 + np.asarray(centre_m), _BOX_FACES


@dataclass(frozen=True, eq=False)
class Shape:
    """A landmark's surface."""

    vertices_m: Floats
    """(V, 3)."""
    faces: Faces
    """(F, 3), counter-clockwise seen from outside."""
    albedo: Floats
    """(F,)"""
    points_m: Floats
    """(M, 3) points spread evenly over it."""
    normals: Floats
    """(M, 3) outward unit normals there."""

    @property
    def radius_m(self) -> float:
        """How far it reaches from its axis."""
        return float(np.hypot(self.vertices_m[:, 0], self.vertices_m[:, 1]).max())

    @property
    def height_m(self) -> float:
        """How high it is over its foot."""
        return float(self.vertices_m[:, 2].max())


@cache
def shape_of(model: str) -> Shape:
    """Return a built-in landmark by its name, or that in a CAD file (metres, z up).

    Raises ShapeError where there is none, or it is no landmark.
    """
    if model in MODELS:
        made = [(*box_triangles(p.size_m, p.centre_m), p.albedo) for p in MODELS[model]]
        starts = np.arange(len(made), dtype=np.int32) * 8
        vertices = np.concatenate([v for v, _, _ in made])
        faces = np.concatenate([f + s for (_, f, _), s in zip(made, starts, strict=True)])
        return _surfaced(vertices, faces, np.concatenate([np.full(12, a) for _, _, a in made]))
    vertices, faces = _read(model)
    width_m = float(np.ptp(vertices, axis=0).max(initial=0.0)) if len(faces) else 0.0
    if not SMALLEST_M <= width_m <= LARGEST_M:
        raise ShapeError(
            f"{model}: the shape is {width_m:g} m wide; a landmark must be {SMALLEST_M:g} to"
            f" {LARGEST_M:g} m, told in metres"
        )
    return _surfaced(vertices, faces, np.full(len(faces), FILE_ALBEDO))


def _read(path: str) -> tuple[Floats, Faces]:
    known = f"must be {', '.join(MODELS)} or a file ({', '.join(KINDS)})"
    if Path(path).suffix.lower() not in KINDS or not Path(path).is_file():
        raise ShapeError(f"{path}: no landmark of that name and no such file; {known}")
    try:
        read: Any = trimesh.load(path, force="mesh")
        vertices = np.asarray(read.vertices, dtype=np.float64)
        faces = np.asarray(read.faces, dtype=np.int32)
    except Exception as error:  # whatever the reader of that kind of file raises
        raise ShapeError(f"{path}: can't be read as a mesh ({error}); {known}") from error
    if not np.isfinite(vertices).all():
        raise ShapeError(f"{path}: has corners that are no numbers")
    return vertices, faces


def _surfaced(vertices: Floats, faces: Faces, albedo: Floats) -> Shape:
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double_m2 = np.linalg.norm(across, axis=1)
    normals = across / np.maximum(double_m2, 1e-12)[:, None]
    counts = np.where(double_m2 > 0, np.ceil(0.5 * double_m2 / SPACING_M**2), 0).astype(np.int64)
    face = np.repeat(np.arange(len(faces)), counts)
    # Points of a sequence that fills the unit square evenly, folded into the triangle.
    k = np.arange(len(face)) + 0.5
    a, b = (k * 0.7548776662466927) % 1.0, (k * 0.5698402909980532) % 1.0
    beyond = a + b > 1.0
    a, b = np.where(beyond, 1 - a, a), np.where(beyond, 1 - b, b)
    one, two, three = (corners[face, n] for n in range(3))
    points = one + a[:, None] * (two - one) + b[:, None] * (three - one)
    return Shape(vertices, faces, albedo, points, normals[face])
