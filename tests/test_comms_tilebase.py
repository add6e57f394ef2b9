"""Versions built on the one before: exact, shorter, never less sure, useless without their base."""

import contextlib
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from comms.changecode import change_opinions, code_changes
from comms.codec import (
    CodecError,
    DecodedTile,
    EncodedTile,
    NeedsBaseError,
    decode_tile,
    encode_tile,
)
from comms.rangecoder import Mark, decoder, encoder

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
BOUND_M = 0.05
few = settings(max_examples=40, deadline=None)
more = settings(max_examples=100, deadline=None)


class Ground:
    """A tile of rough ground, and what a robot knows of it after some looks."""

    def __init__(self, side: int, seed: int) -> None:
        """Nothing was measured yet."""
        self.rng = np.random.default_rng(seed)
        self.side = side
        rows, cols = np.indices((side, side)) / 10
        swell = np.sin(rows * self.rng.uniform(0.5, 2) + cols) + 0.3 * np.cos(3 * cols - rows)
        self.z = 0.4 * swell + self.rng.normal(0, 0.02, (side, side))
        self.information = np.zeros((side, side))
        self.weighted_m = np.zeros((side, side))

    def look(self, sigma_m: float = 0.03) -> None:
        """Measure half a plane of the tile, with noise."""
        angle, offset = self.rng.uniform(0, 2 * np.pi), self.rng.uniform(-0.3, 0.3) * self.side
        rows, cols = np.indices(self.z.shape) - self.side / 2
        seen = rows * np.cos(angle) + cols * np.sin(angle) > offset
        seen &= self.rng.random(self.z.shape) < 0.97
        sigmas_m = sigma_m * np.exp(self.rng.normal(0, 0.2, self.z.shape))
        weight = seen / sigmas_m**2
        self.information += weight
        self.weighted_m += weight * (self.z + self.rng.normal(0, 0.5 * sigmas_m))

    @property
    def known(self) -> Bools:
        """Cells that were measured."""
        return self.information > 0

    def tile(self) -> tuple[Floats, Bools, Floats]:
        """Elevation, mask and standard deviation, as `encode_tile` takes them."""
        information = np.where(self.known, self.information, 1.0)
        return self.weighted_m / information, self.known, 1 / np.sqrt(information)


def whole(ground: Ground) -> DecodedTile:
    return decode_tile(encode_tile(*ground.tile(), BOUND_M).data)


def assert_next_holds(ground: Ground, base: DecodedTile, tile: EncodedTile) -> DecodedTile:
    """Hold every prefix of a version against what it promises; return all of it."""
    z, known, sigma_m = ground.tile()
    given_base = base if tile.needs_base else None
    told, last_bound_m = np.zeros(known.shape, np.bool_), np.inf
    for length in range(len(tile.data) + 1):
        got = decode_tile(tile.data[:length], given_base)
        assert got.level == sum(end <= length for end in tile.level_ends) - 1
        if got.level < 0:
            continue
        assert not (got.known & ~known).any()
        assert not (told & ~got.known).any()
        errors_m = np.abs(got.elevation_m.astype(np.float64) - z)[got.known]
        assert errors_m.max(initial=0.0) <= got.bound_m <= last_bound_m
        assert (got.sigma_m[got.known] >= sigma_m[got.known]).all()
        told, last_bound_m = got.known, got.bound_m
    got = decode_tile(tile.data, given_base)
    assert got.is_whole
    assert np.array_equal(got.known, known)
    assert got.bound_m <= BOUND_M or not known.any()
    assert (got.sigma_m <= base.sigma_m)[base.known].all()
    return got


@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 5, 16, 32]), st.integers(0, 2))
@few
def test_any_succession_of_versions_keeps_its_promises(seed: int, side: int, looks: int):
    ground = Ground(side, seed)
    ground.look()
    base = whole(ground)
    for _ in range(2):
        for _ in range(looks):
            ground.look()
        tile = encode_tile(*ground.tile(), BOUND_M, base=base)
        base = assert_next_holds(ground, base, tile)


@pytest.mark.parametrize("seed", range(3))
def test_a_version_on_its_base_is_shorter(seed: int):
    ground = Ground(32, seed)
    sizes = np.zeros(2)
    for _ in range(3):
        ground.look()
    base = whole(ground)
    for _ in range(4):
        ground.look()
        tile = encode_tile(*ground.tile(), BOUND_M, base=base)
        sizes += [len(tile.data), len(encode_tile(*ground.tile(), BOUND_M).data)]
        base = assert_next_holds(ground, base, tile)
    assert sizes[0] < 0.75 * sizes[1]


def test_what_did_not_change_costs_a_few_bytes():
    ground = Ground(32, 5)
    ground.look()
    base = whole(ground)
    tile = encode_tile(*ground.tile(), BOUND_M, base=base)
    assert tile.needs_base
    assert len(tile.data) <= 14
    again = decode_tile(tile.data, base)
    assert np.array_equal(again.elevation_m, base.elevation_m, equal_nan=True)
    assert np.array_equal(again.sigma_m, base.sigma_m, equal_nan=True)


def test_new_cells_come_before_what_moved():
    ground = Ground(32, 6)
    for _ in range(2):
        ground.look()
    base = whole(ground)
    for _ in range(3):
        ground.look()
    tile = encode_tile(*ground.tile(), BOUND_M, base=base)
    assert len(tile.level_ends) == 2
    first = decode_tile(tile.data[: tile.level_ends[0]], base)
    assert np.array_equal(first.known, ground.known)
    assert first.bound_m > BOUND_M
    assert np.abs(first.elevation_m - base.elevation_m)[base.known].max() <= BOUND_M / 255


@pytest.mark.parametrize("seed", range(4))
def test_a_version_that_stands_alone_is_never_less_sure(seed: int):
    ground = Ground(32, seed)
    for _ in range(3):
        ground.look()
    base = whole(ground)
    ground.look(sigma_m=0.3)
    plain = decode_tile(encode_tile(*ground.tile(), BOUND_M).data)
    assert (plain.sigma_m > base.sigma_m)[base.known].any(), "the look must be a poor one"
    tile = encode_tile(*ground.tile(), BOUND_M, base=base, alone=True)
    assert not tile.needs_base
    assert_next_holds(ground, base, tile)


def test_a_cell_that_was_lost_or_became_less_sure_is_told_whole():
    ground = Ground(16, 7)
    ground.look()
    base = whole(ground)
    z, known, sigma_m = ground.tile()
    fewer = known.copy()
    fewer[np.unravel_index(known.argmax(), known.shape)] = False
    assert not encode_tile(z, fewer, sigma_m, BOUND_M, base=base).needs_base
    assert not encode_tile(z, known, 8 * sigma_m, BOUND_M, base=base).needs_base
    nothing = decode_tile(encode_tile(z, known & False, sigma_m, BOUND_M).data)
    assert not encode_tile(z, known, sigma_m, BOUND_M, base=nothing).needs_base


def test_a_version_cannot_be_read_without_its_base():
    ground = Ground(24, 8)
    ground.look()
    base = whole(ground)
    ground.look()
    tile = encode_tile(*ground.tile(), BOUND_M, base=base)
    assert tile.needs_base
    with pytest.raises(NeedsBaseError, match="on top of the whole one"):
        decode_tile(tile.data)
    with pytest.raises(NeedsBaseError, match="on top of the whole one"):
        decode_tile(tile.data, replace(base, level=base.level - 1))
    other = replace(base, elevation_m=base.elevation_m + np.float32(0.01))
    with pytest.raises(NeedsBaseError, match="another one"):
        decode_tile(tile.data, other)
    assert decode_tile(tile.data[:1]).level == -1


def test_a_base_of_another_shape_or_not_whole_is_refused():
    ground = Ground(16, 9)
    ground.look()
    base = whole(ground)
    zeros, all_known = np.zeros((8, 8)), np.ones((8, 8), np.bool_)
    for wrong, tile in (
        (base, (zeros, all_known, zeros)),
        (replace(base, levels=base.levels + 1), ground.tile()),
    ):
        with pytest.raises(CodecError, match="has to be whole"):
            encode_tile(*tile, BOUND_M, base=wrong)


@given(
    st.lists(st.integers(-40, 40), min_size=16, max_size=16),
    st.lists(st.integers(0, 5), min_size=16, max_size=16),
    st.integers(0, 2**16 - 1),
)
@more
def test_changes_come_back_to_within_half_a_step(moves: list[int], falls: list[int], which: int):
    step = 255
    rng = np.random.default_rng(which)
    x = rng.integers(-2000, 2000, (4, 4))
    y = x + np.array(moves).reshape(4, 4) * 101
    old = ((which >> np.arange(16)) & 1).astype(np.uint8).reshape(4, 4)
    known = np.maximum(old, rng.integers(0, 2, (4, 4), np.uint8))
    fall = np.array(falls).reshape(4, 4)
    sent = x.copy()
    coder = encoder(1000)
    code_changes(coder, change_opinions(), old, known, fall, sent, y, step)
    assert np.abs(sent - y)[old > 0].max(initial=0) <= step // 2
    assert np.array_equal(sent[old == 0], x[old == 0])
    heard = x.copy()
    back = decoder(Mark(coder).finish(length_is_known=False))
    code_changes(back, change_opinions(), old, known, fall, heard, heard, step)
    assert np.array_equal(heard, sent)


@given(st.binary(max_size=120))
@more
def test_hostile_bytes_on_a_base_decode_or_are_refused(data: bytes):
    ground = Ground(16, 10)
    ground.look()
    base = whole(ground)
    for start in range(4):
        with contextlib.suppress(CodecError):
            tile = decode_tile(bytes([255 - start]) + data, base)
            assert max(tile.known.shape) <= 128
            assert np.isfinite(tile.elevation_m[tile.known]).all()


@given(st.integers(0, 2**32 - 1))
@more
def test_damaged_versions_decode_or_are_refused(seed: int):
    rng = np.random.default_rng(seed)
    ground = Ground(16, 11)
    ground.look()
    base = whole(ground)
    ground.look()
    bad = bytearray(encode_tile(*ground.tile(), BOUND_M, base=base).data)
    for _ in range(2):
        bad[int(rng.integers(1, len(bad)))] ^= 1 << int(rng.integers(8))
    with contextlib.suppress(CodecError):
        tile = decode_tile(bytes(bad[: int(rng.integers(len(bad) + 1))]), base)
        assert np.isfinite(tile.elevation_m[tile.known]).all()
        assert tile.level < 0 or not (base.known & ~tile.known).any()


def test_the_format_of_versions_is_what_it_was():
    """New priors are a new format too: robots then do not understand older ones."""
    i, j = np.indices((32, 32))
    z = np.asarray(((i - 9) ** 2 + (j - 20) ** 2) / 256 + (i * i * 3 + i * j * 5) % 97 / 512)
    sigma_m = np.asarray(0.04 - 0.001 * i, np.float64)
    base = decode_tile(encode_tile(z, i + 3 * j > 50, sigma_m, 0.1).data)
    moved_m = np.where((i * 7 + j * 3) % 23 == 0, 0.15, 0.01)
    tile = encode_tile(z + moved_m, i + 3 * j > 25, sigma_m / 2, 0.1, base=base)
    assert tile.needs_base
    assert (len(tile.data), tile.level_ends) == GOLDEN_SIZES
    assert zlib.crc32(tile.data) == GOLDEN_CRC
    told = decode_tile(tile.data, base)
    assert zlib.crc32(told.elevation_m[told.known].tobytes()) == GOLDEN_ELEVATION_CRC


GOLDEN_SIZES = (107, (68, 107))
GOLDEN_CRC = 3838574437
GOLDEN_ELEVATION_CRC = 4144688929
