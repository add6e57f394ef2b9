"""Worlds from meshes and point clouds: the cells that a surface touches are solid.

A mesh is what encloses the free space (a scanned cave, a building's inside), not the rock itself:
what lies behind its surface is free as well, and nobody gets there. About all of it lies one layer
of solid cells.
"""

from pathlib import Path
from typing import Any, cast

import numpy as np

from agents.geometry import Bools, Floats, Ints
from agents.voxel.frame import VoxelFrame
from agents.voxel.ground import Build
from sim.errors import WorldError
from sim.voxel.world import VoxelWorld, best_start

SUFFIXES = (".ply", ".obj")
MOST_CELLS = 200_000_000
MOST_SAMPLES = 20_000_000
"""Points by which a mesh's triangles are laid over the cells at once."""


def read_world(path: Path, *, cell_m: float, build: Build) -> VoxelWorld:
    """Return the world of a .ply or .obj file, x east, y north, z up, metres.

    The team starts in the middle of the largest floor that a robot can move on.

    Raises:
        WorldError: the file can't be read, holds nothing, or has no room for the robot.
    """
    points = _read(path)
    cells = _touched(points, cell_m)
    low, high = cells.min(axis=0), cells.max(axis=0)
    room = high - low + 1 + 2
    if int(np.prod(room)) > MOST_CELLS:
        raise WorldError(
            f"{path}: takes {' x '.join(str(n) for n in room)} cells of {cell_m:g} m; allowed are"
            f" {MOST_CELLS:,} in all: take a larger world.cell_m"
        )
    layers, rows, cols = (int(n) for n in room)
    solid: Bools = np.zeros((layers, rows, cols), dtype=np.bool_)
    solid[[0, -1]] = solid[:, [0, -1]] = solid[:, :, [0, -1]] = True
    solid[tuple((cells - low + 1).T)] = True
    z, y, x = ((low - 1) * cell_m).tolist()
    frame = VoxelFrame(float(x), float(y), cell_m, rows, cols, float(z), layers)
    return best_start(VoxelWorld(frame, solid, (0, 0, 0)), build)


def _read(path: Path) -> Floats | tuple[Floats, Ints]:
    """Return points (N, 3), or vertices and triangles (M, 3)."""
    import trimesh  # noqa: PLC0415  (only who reads a mesh waits for it)

    if path.suffix.lower() not in SUFFIXES:
        raise WorldError(f"{path}: is no mesh or point cloud; allowed are {', '.join(SUFFIXES)}")
    try:
        loaded: Any = trimesh.load(str(path), process=False)
    except Exception as error:
        raise WorldError(f"{path}: can't be read as a mesh or point cloud: {error}") from error
    if isinstance(loaded, trimesh.Scene):
        loaded = cast("Any", loaded.to_geometry())
    vertices = np.asarray(loaded.vertices, dtype=np.float64).reshape(-1, 3)
    if len(vertices) == 0 or not np.isfinite(vertices).all():
        raise WorldError(f"{path}: holds no points, or some that are not finite")
    faces = getattr(loaded, "faces", None)
    if faces is None or len(faces) == 0:
        return vertices
    return vertices, np.asarray(faces, dtype=np.int64)


def _touched(found: Floats | tuple[Floats, Ints], cell_m: float) -> Ints:
    """Return the cells (N, 3) that points or triangles lie in, (layer, row, column) of any sign."""
    if not isinstance(found, tuple):
        return _cells(found, cell_m)
    vertices, faces = found
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    # Points at most half a cell apart leave no hole that a ray slips through from face to face.
    parts = np.maximum(1, np.ceil(longest / (0.5 * cell_m)).astype(np.int64))
    kept: list[Ints] = [_cells(vertices, cell_m)]
    for count in np.unique(parts):
        weights = _lattice(int(count))
        chosen = corners[parts == count]
        at_once = max(1, MOST_SAMPLES // len(weights))
        for start in range(0, len(chosen), at_once):
            samples = np.einsum("wk,fkx->fwx", weights, chosen[start : start + at_once])
            kept.append(_cells(samples.reshape(-1, 3), cell_m))
    return np.unique(np.concatenate(kept), axis=0)


def _lattice(parts: int) -> Floats:
    """Return barycentric weights (N, 3) of the corners when each edge is cut in so many parts."""
    a, b = np.meshgrid(np.arange(parts + 1), np.arange(parts + 1), indexing="ij")
    a, b = a[a + b <= parts], b[a + b <= parts]
    return np.column_stack((a, b, parts - a - b)) / parts


def _cells(points_m: Floats, cell_m: float) -> Ints:
    return np.unique(np.floor(points_m[:, ::-1] / cell_m).astype(np.int64), axis=0)
