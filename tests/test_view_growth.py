"""How maps grew is told so that a page draws them as they were; pieces of bytes read back equal."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.geometry import GridFrame
from agents.maps.elevation import Estimate
from agents.maps.planar import Occupancy
from scenarios.view.growth import MOST_CELLS, SLACK, Growth, grown, scale_of, truth_of
from scenarios.view.pack import pack, unpack
from sim.ground import Terrain
from sim.planar_world import PlanarWorld


def ground(rows: int = 9, cols: int = 7, seed: int = 1) -> Terrain:
    heights = np.random.default_rng(seed).normal(size=(rows, cols)).astype(np.float32)
    texture = np.ones((rows, cols), np.float32)
    return Terrain(GridFrame(-1.0, 2.0, 0.1, rows, cols), heights, texture)


def estimate(elevation_m: np.ndarray) -> Estimate:
    known = np.isfinite(elevation_m)
    return Estimate(elevation_m, np.where(known, 0.01, np.inf), known.astype(np.uint16))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), steps=st.integers(1, 5), share=st.floats(0, 1))
def test_what_was_told_step_by_step_is_the_map(seed: int, steps: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    world = ground()
    scale, growth = scale_of(world), Growth(world)
    shown = np.zeros(world.frame.shape, np.uint16)
    own = np.zeros(world.frame.shape, bool)
    measured = np.zeros(world.frame.shape, bool)
    for number in range(steps):
        heights = np.where(rng.random(world.frame.shape) < share, world.elevation_m, np.nan)
        heights = heights + rng.normal(scale=0.02, size=heights.shape)
        measured |= rng.random(measured.shape) < 0.3
        step = growth.step(estimate(heights), measured)
        if step is not None:
            first, data = step
            assert first == (number == 0)
            grown(shown, own, data)
        assert np.array_equal(shown > 0, np.isfinite(heights))
        assert np.array_equal(own, measured)
        told_m = scale.low + (shown.astype(float) - 1) * scale.step
        error_m = np.abs(told_m - heights)[shown > 0]
        assert error_m.size == 0 or error_m.max() <= (SLACK + 0.5 + 1e-6) * scale.step


def test_nothing_is_told_where_nothing_changed() -> None:
    world = ground()
    growth = Growth(world)
    own = np.zeros(world.frame.shape, bool)
    heights = world.elevation_m.astype(float)
    assert growth.step(estimate(heights), own) is not None
    assert growth.step(estimate(heights + 1e-4), own) is None


def test_a_life_begins_with_a_step_though_it_knows_nothing() -> None:
    world = ground()
    nothing = np.full(world.frame.shape, np.nan)
    step = Growth(world).step(estimate(nothing), np.zeros(world.frame.shape, bool))
    assert step is not None
    assert step[0]


def test_heights_beyond_the_scale_stay_on_it() -> None:
    world = ground()
    scale = scale_of(world)
    levels = scale.levels(np.array([[-1e6, 1e6]]))
    assert levels.tolist() == [[1, scale.most]]


def test_a_floor_is_told_by_how_likely_it_is_solid() -> None:
    solid = np.zeros((4, 4), bool)
    solid[0, 0] = True
    world = PlanarWorld(GridFrame(0.0, 0.0, 0.4, 4, 4), solid, (2, 2))
    odds = np.zeros((4, 4))
    odds[0, 0], odds[1, 1] = 5.0, -5.0
    looks = (odds != 0).astype(np.uint16)
    growth = Growth(world)
    step = growth.step(Occupancy(odds, looks), solid)
    assert step is not None
    shown, own = np.zeros((4, 4), np.uint16), np.zeros((4, 4), bool)
    grown(shown, own, step[1])
    most = scale_of(world).most
    assert (shown[0, 0], shown[1, 1], np.count_nonzero(shown)) == (most - 1, 2, 2)
    assert np.array_equal(truth_of(world), solid)


def test_a_large_grid_is_shown_by_fewer_cells() -> None:
    world = ground(rows=900, cols=700)
    scale = scale_of(world)
    assert scale.stride == 2
    assert scale.levels(truth_of(world)).size <= MOST_CELLS


values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.text() | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text().filter(lambda k: k != "blob"), inner),
    max_leaves=8,
)


@settings(max_examples=40, deadline=None)
@given(values)
def test_what_is_packed_reads_back_equal(value: object) -> None:
    assert unpack(pack(value)) == value


@given(st.binary(max_size=60))
def test_bytes_from_anywhere_are_refused_or_read(data: bytes) -> None:
    try:
        unpack(data)
    except ValueError:
        return


def test_a_blob_beyond_the_end_is_refused() -> None:
    whole = pack([b"abcdef"])
    with pytest.raises(ValueError, match="outside"):
        unpack(whole[:-1])
