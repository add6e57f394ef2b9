"""What stands out of the ground: the compiled kernel against the definition in plain numpy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.ground.surface import standing_out

CELL_M, WHEEL_M, FOOTPRINT_M = 0.1, 0.2, 0.8


def steps(length_cells):
    straight, slanted = max(1, round(length_cells)), max(1, round(length_cells * math.sqrt(0.5)))
    return [(0, straight), (straight, 0), (slanted, slanted), (slanted, -slanted)]


def moved(z, dy, dx):
    rows = np.clip(np.arange(z.shape[0]) + dy, 0, z.shape[0] - 1)
    cols = np.clip(np.arange(z.shape[1]) + dx, 0, z.shape[1] - 1)
    return z[np.ix_(rows, cols)]


def slow(z):
    """Return rocks and ledges by whole arrays, direction by direction."""
    out = np.zeros_like(z)
    near, far = steps(0.5 * WHEEL_M / CELL_M), steps(0.5 * FOOTPRINT_M / CELL_M)
    for (y1, x1), (y2, x2) in zip(near, far, strict=True):
        rise = moved(z, y1, x1) - moved(z, -y1, -x1)
        slope = moved(z, y2, x2) - moved(z, -y2, -x2)
        out = np.maximum(out, np.abs(rise - math.hypot(y1, x1) / math.hypot(y2, x2) * slope))
    for reach_m in (WHEEL_M, 0.5 * FOOTPRINT_M):
        sides = [moved(z, y, x) + moved(z, -y, -x) for y, x in steps(reach_m / CELL_M)]
        out = np.maximum(out, np.min([z - 0.5 * both for both in sides], axis=0))
    return out


@given(st.integers(1, 20), st.integers(1, 20), st.integers(0, 1000))
@settings(max_examples=60, deadline=None)
def test_the_kernel_is_the_definition_to_the_last_bit(rows, cols, seed):
    z = np.random.default_rng(seed).normal(size=(rows, cols))
    assert np.array_equal(standing_out(z, WHEEL_M, FOOTPRINT_M, CELL_M), slow(z))


def test_a_rock_stands_out_by_its_height_and_a_slope_does_not():
    y, _ = np.mgrid[:40, :40] * CELL_M
    z = 0.5 * y
    assert standing_out(z, WHEEL_M, FOOTPRINT_M, CELL_M)[5:35, 5:35].max() < 1e-12
    z[20, 20] += 0.3
    assert standing_out(z, WHEEL_M, FOOTPRINT_M, CELL_M)[20, 20] == pytest.approx(0.3)
