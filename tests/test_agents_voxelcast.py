"""The voxel ray caster against every cell of a small world."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents import voxelcast
from agents.voxelcast import SIDE, VoxelBlocks, VoxelError

CELL_M = 0.25
CORNER_M = (-3.0, 2.0, -1.0)


def slow_cast(occupancy, eye_m, ray, limit_m, occupied_p):
    """Return (cell, distance, clear): every cell cut by the ray as a box, in the order of entry."""
    zyx = np.indices(occupancy.shape).reshape(3, -1).T
    low = np.array(CORNER_M) + zyx[:, ::-1] * CELL_M
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - eye_m) / ray, (low + CELL_M - eye_m) / ray
    enter = np.maximum(np.minimum(a, b).max(axis=1), 0.0)
    leave = np.maximum(a, b).min(axis=1)
    cut = np.flatnonzero((leave > enter) & (enter <= limit_m))
    clear = 1.0
    for n in cut[np.argsort(enter[cut], kind="stable")]:
        p = float(occupancy[tuple(zyx[n])])
        if p >= occupied_p:
            return tuple(zyx[n]), enter[n], clear
        clear *= 1.0 - p
    return (-1, -1, -1), np.nan, clear


@st.composite
def worlds(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = tuple(draw(st.integers(3, 34)) for _ in range(3))
    dense = np.zeros(shape, dtype=np.float32)
    known = np.zeros(shape, dtype=bool)
    for _ in range(draw(st.integers(0, 4))):
        at = [int(rng.integers(0, n)) for n in shape]
        box = tuple(slice(a, a + int(rng.integers(2, 12))) for a in at)
        known[box] = True
    dense[known] = rng.uniform(0, 0.3, known.sum())
    dense[known & (rng.random(shape) < 0.05)] = 0.9
    room = np.array(shape[::-1]) * CELL_M
    eye = np.array(CORNER_M) + rng.uniform(0.01, 0.99, 3) * room
    rays = rng.normal(size=(8, 3))
    if draw(st.booleans()):
        rays[::3, int(rng.integers(3))] = 0.0
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return dense, known, eye, rays, float(rng.uniform(0.3, 12))


@given(worlds(), st.sampled_from([0.0, 0.1]))
@settings(max_examples=30, deadline=None)
def test_rays_meet_what_cutting_every_cell_says(world, absent_p):
    dense, known, eye, rays, limit_m = world
    voxels = VoxelBlocks.from_dense(CORNER_M, CELL_M, dense, known)
    got = voxelcast.cast(voxels, tuple(eye), rays, limit_m, absent_p=absent_p)
    room = tuple(n * SIDE for n in voxels.index.shape)
    whole = np.zeros(room, dtype=np.float32)
    whole[tuple(slice(0, n) for n in dense.shape)] = dense
    absent = np.repeat(np.repeat(np.repeat(voxels.index < 0, SIDE, 0), SIDE, 1), SIDE, 2)
    whole[absent] = absent_p
    for n, ray in enumerate(rays):
        cell, distance_m, clear_p = slow_cast(whole, eye, ray, limit_m, 0.5)
        assert tuple(got.cells[n]) == cell
        assert got.distance_m[n] == pytest.approx(distance_m, abs=1e-9, nan_ok=True)
        assert got.clear_p[n] == pytest.approx(clear_p, rel=1e-5)


def test_a_ray_along_an_axis_by_hand():
    dense = np.zeros((4, 4, 40), dtype=np.float32)
    dense[1, 2, 5], dense[1, 2, 30] = 0.25, 1.0
    voxels = VoxelBlocks.from_dense((0.0, 0.0, 0.0), 0.5, dense, dense > 0)
    assert (voxels.index >= 0).sum() == 2
    got = voxelcast.cast(voxels, (0.25, 1.25, 0.75), np.array([[1.0, 0.0, 0.0]]), 20.0)
    assert tuple(got.cells[0]) == (1, 2, 30)
    assert got.distance_m[0] == pytest.approx(15.0 - 0.25)
    assert got.clear_p[0] == pytest.approx(0.75)
    short = voxelcast.cast(voxels, (0.25, 1.25, 0.75), np.array([[1.0, 0.0, 0.0]]), 14.0)
    assert np.isnan(short.distance_m[0])
    assert tuple(short.cells[0]) == (-1, -1, -1)


def test_voxels_and_rays_that_make_no_sense_are_refused():
    empty = np.zeros((2, 2, 2), dtype=np.float32)
    voxels = VoxelBlocks.from_dense((0.0, 0.0, 0.0), 1.0, empty, empty > 0)
    with pytest.raises(VoxelError, match="outside the voxels"):
        voxelcast.cast(voxels, (-1.0, 0.0, 0.0), np.eye(3), 1.0)
    with pytest.raises(VoxelError, match=r"absent_p is 0\.7"):
        voxelcast.cast(voxels, (1.0, 1.0, 1.0), np.eye(3), 1.0, absent_p=0.7)
    with pytest.raises(VoxelError, match="allowed is -1 to -1"):
        VoxelBlocks((0.0, 0.0, 0.0), 1.0, np.zeros((1, 1, 1), dtype=np.int32), voxels.cells)
    with pytest.raises(VoxelError, match="blocks of shape"):
        VoxelBlocks((0.0, 0.0, 0.0), 1.0, voxels.index, np.zeros((1, 8, 8, 8), dtype=np.float32))
