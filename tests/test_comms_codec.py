"""The map codec: bounds hold, masks are exact, prefixes decode, hostile bytes are refused."""

import contextlib
import itertools
import math
import os
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from comms import pyramid, scales, sigmacode
from comms.blocks import block_max
from comms.codec import (
    CodecError,
    decode_grid,
    decode_grid_sigma,
    decode_tile,
    encode_grid,
    encode_tile,
)
from comms.logistic import chances_of_odds
from comms.rangecoder import Mark, code_bit, code_even_bits, decoder, encoder, is_certain

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

SHARED = Path(os.environ.get("ROPETEAM_SHARED", Path(__file__).parents[2] / "shared"))
BOUNDS_M = (0.02, 0.05, 0.1, 0.25)
few = settings(max_examples=40, deadline=None)
more = settings(max_examples=100, deadline=None)


def fractal(side: int, seed: int, rms_m: float = 0.5) -> Floats:
    """A rough surface with a power spectrum 1 / f^3.4."""
    rng = np.random.default_rng(seed)
    f = np.hypot(np.fft.fftfreq(2 * side)[:, None], np.fft.rfftfreq(2 * side)[None])
    f[0, 0] = np.inf
    noise = rng.normal(size=f.shape) + 1j * rng.normal(size=f.shape)
    z = np.fft.irfft2(noise * f**-1.7)[:side, :side]
    return (z - z.mean()) * (rms_m / z.std())


def half_seen(z: Floats, seed: int) -> Bools:
    """A mask with large holes and ragged edges."""
    rng = np.random.default_rng(seed)
    hidden = fractal(z.shape[0], seed + 1, 1.0)[: z.shape[0], : z.shape[1]] > 0.3
    return ~(hidden | (rng.random(z.shape) < 0.02))


def sigma_like(z: Floats) -> Floats:
    """Standard deviations that grow with the square of the distance from a corner."""
    squares = np.square(np.indices(z.shape, np.float64)).sum(0)
    return 0.0008 * (1 + 0.01 * squares)


def worst_error_m(decoded: NDArray[np.float32], z: Floats, known: Bools) -> float:
    return float(np.abs(decoded.astype(np.float64) - z)[known].max(initial=0.0))


def assert_holds(z: Floats, known: Bools, bound_m: float) -> bytes:
    data = encode_grid(z, known, bound_m)
    decoded, mask = decode_grid(data)
    assert decoded.dtype == np.float32
    assert np.array_equal(mask, known)
    assert np.isnan(decoded[~known]).all()
    assert worst_error_m(decoded, z, known) <= bound_m
    return data


@st.composite
def grids(draw: st.DrawFn, side: int = 24) -> tuple[Floats, Bools]:
    shape = draw(hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=side))
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    smooth = np.cumsum(np.cumsum(rng.normal(size=shape), 0), 1) * draw(st.sampled_from([0.01, 0.3]))
    rough = rng.normal(size=shape) * draw(st.sampled_from([0.0, 0.02, 5.0, 1e4]))
    offset_m = draw(st.sampled_from([0.0, 3.2, -4472.6, 1e6]))
    known = rng.random(shape) < draw(st.sampled_from([0.0, 0.3, 0.9, 1.0]))
    return smooth + rough + offset_m, known


# ------------------------------------------------------------------ the range coder


def reference_code(bits: list[int], chances: list[int]) -> tuple[int, int, int]:
    """The interval that range coding comes to: low and width in units of 2^-depth."""
    low, width, depth = 0, 1 << 40, 40
    for bit, chance in zip(bits, chances, strict=True):
        while width < 1 << 32:
            low, width, depth = low << 8, width << 8, depth + 8
        ones = (width >> 16) * chance
        low, width = (low, ones) if bit else (low + ones, width - ones)
    return low, width, depth


@given(st.lists(st.tuples(st.booleans(), st.integers(1, 65535)), min_size=1, max_size=400))
@more
def test_coded_bits_lie_in_the_interval_of_exact_arithmetic(symbols: list[tuple[bool, int]]):
    bits, chances = [int(b) for b, _ in symbols], [c for _, c in symbols]
    coder = encoder(2000)
    for bit, chance in zip(bits, chances, strict=True):
        code_bit(coder, chance, bit)
    data = Mark(coder).finish(length_is_known=False)
    low, width, depth = reference_code(bits, chances)
    first = int.from_bytes(data, "big") << max(depth - 8 * len(data), 0)
    low, width = low << max(8 * len(data) - depth, 0), width << max(8 * len(data) - depth, 0)
    assert low <= first < first + (1 << max(depth - 8 * len(data), 0)) <= low + width
    back = decoder(data)
    assert [code_bit(back, chance, 0) for chance in chances] == bits
    assert is_certain(back)


@given(st.lists(st.integers(0, 4), min_size=1, max_size=60), st.integers(1, 65535))
@more
def test_a_prefix_is_certain_exactly_from_the_length_that_the_mark_says(
    runs: list[int], chance: int
):
    coder, marks = encoder(2000), []
    for run in runs:
        for _ in range(run):
            code_bit(coder, chance, run % 2)
        marks.append(Mark(coder))
    data = marks[-1].finish(length_is_known=False)
    needed = [mark.bytes_needed(data) for mark in marks]
    for length in range(len(data) + 1):
        back = decoder(data[:length])
        for run, least in zip(runs, needed, strict=True):
            decoded = [code_bit(back, chance, 0) for _ in range(run)]
            assert is_certain(back) == (length >= least)
            if length < least:
                break
            assert decoded == [run % 2] * run


def test_the_buffer_of_a_coder_is_never_overrun():
    coder = encoder(0)
    for _ in range(10 * coder.buffer.size):
        code_even_bits(coder, 8, 255)
    with pytest.raises(AssertionError):
        Mark(coder)


def test_log_odds_table_is_the_logistic_function():
    table = chances_of_odds()
    odds = np.arange(len(table)) - len(table) // 2
    assert np.abs(table - 65536 / (1 + np.exp(-odds / 256))).max() <= 0.5001
    assert np.all(np.diff(table.astype(int)) >= 0)


# ------------------------------------------------------------------ grids


@given(grids(), st.sampled_from([0.003, 0.02, 0.25, 1.7]))
@more
def test_every_known_cell_is_within_the_bound_and_the_mask_is_exact(
    grid: tuple[Floats, Bools], bound_m: float
):
    z, known = grid
    try:
        assert_holds(z, known, bound_m)
    except CodecError:
        held = np.abs(z.astype(np.float32).astype(np.float64) - z)[known]
        assert held.max() > bound_m


@given(
    hnp.arrays(
        np.float32,
        hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=9),
        elements=st.floats(width=32, allow_nan=False, allow_infinity=False),
    ),
    st.floats(1e-6, 1e6),
)
@more
def test_any_finite_float32_survives(z: NDArray[np.float32], bound_m: float):
    assert_holds(z.astype(np.float64), np.ones(z.shape, np.bool_), bound_m)


@pytest.mark.parametrize("bound_m", BOUNDS_M)
def test_rough_ground_with_holes_is_held(bound_m: float):
    z = fractal(96, 3)
    assert_holds(z, half_seen(z, 4), bound_m)
    assert_holds(z[:, :37], np.ones((96, 37), np.bool_), bound_m)


@pytest.mark.parametrize("offset_m", [0.0, -4472.67, 1e6])
def test_an_offset_costs_little(offset_m: float):
    z = fractal(64, 5)
    known = np.ones(z.shape, np.bool_)
    plain = len(assert_holds(z, known, 0.25))
    assert len(assert_holds(z + offset_m, known, 0.25)) <= 1.5 * plain + 8


def test_little_is_sent_for_little():
    flat = np.full((256, 256), 12.34)
    assert len(assert_holds(flat, np.ones(flat.shape, np.bool_), 0.05)) <= 24
    assert len(assert_holds(flat, np.zeros(flat.shape, np.bool_), 0.05)) <= 5
    one = np.zeros((1, 1))
    assert len(assert_holds(one, np.ones((1, 1), np.bool_), 0.05)) <= 10


def test_whole_metres_are_sent_without_loss_when_that_is_coarser():
    z = np.rint(fractal(64, 6, 20.0))
    data = encode_grid(z, np.ones(z.shape, np.bool_), 0.1)
    assert np.array_equal(decode_grid(data)[0], z)
    assert len(data) < 0.75 * len(encode_grid(z + fractal(64, 7, 0.3), z < np.inf, 0.1))


def test_values_beyond_float32_are_refused_and_said_so():
    with pytest.raises(CodecError, match="float32 cannot hold"):
        encode_grid(np.array([[1e300]]), np.array([[True]]), 0.1)
    with pytest.raises(CodecError, match="float32 cannot hold"):
        encode_grid(np.array([[1e6 + 0.03]]), np.array([[True]]), 1e-4)


@pytest.mark.parametrize(
    ("z", "known", "bound_m", "says"),
    [
        (np.zeros((2, 2)), np.ones((2, 3), np.bool_), 0.1, "one grid"),
        (np.zeros((0, 2)), np.ones((0, 2), np.bool_), 0.1, "outside 1x1"),
        (np.zeros((1, 4097)), np.ones((1, 4097), np.bool_), 0.1, "4097"),
        (np.zeros((2, 2)), np.ones((2, 2), np.bool_), 0.0, "error bound of 0.0"),
        (np.zeros((2, 2)), np.ones((2, 2), np.bool_), math.nan, "error bound of nan"),
        (np.full((2, 2), np.inf), np.ones((2, 2), np.bool_), 0.1, "finite"),
    ],
)
def test_arguments_without_sense_are_refused(z: Floats, known: Bools, bound_m: float, says: str):
    with pytest.raises(CodecError, match=says):
        encode_grid(z, known, bound_m)


def test_unknown_cells_may_hold_anything():
    z = fractal(20, 8)
    known = half_seen(z, 9)
    assert encode_grid(np.where(known, z, np.nan), known, 0.05) == encode_grid(
        np.where(known, z, -1e30), known, 0.05
    )


def test_grids_carry_standard_deviations_that_are_never_too_small():
    z = fractal(40, 10)
    known, sigma_m = half_seen(z, 11), sigma_like(z)
    _, mask, decoded = decode_grid_sigma(encode_grid(z, known, 0.05, sigma_m=sigma_m))
    assert decoded is not None
    assert np.array_equal(mask, known)
    assert (decoded[known] >= sigma_m[known]).all()
    blocks = block_max(np.where(known, sigma_m, 0), 4)
    largest = np.repeat(np.repeat(blocks, 4, 0), 4, 1)
    assert (decoded[known] <= 1.4143 * largest[known]).all()


def test_a_narrower_bound_never_decodes_to_a_wider_one():
    z = fractal(64, 12)
    known = np.ones(z.shape, np.bool_)
    sizes = [len(assert_holds(z, known, bound_m)) for bound_m in BOUNDS_M]
    assert sizes == sorted(sizes, reverse=True)


# ------------------------------------------------------------------ equations


def test_units_and_back_stay_within_half_a_unit():
    bound = scales.bound_for(0.05, 1e-7, 2)
    assert bound is not None
    scale = scales.bounded(bound)
    z = np.linspace(-3, 3, 1001)[None]
    back = scale.metres(scale.units(z)).astype(np.float64)
    assert np.abs(back - z).max() <= scale.step_m / pyramid.STEP_UNITS / 2 + 2e-7


@given(st.floats(1e-3, 1e3), st.sampled_from([2, 4]))
@more
def test_the_coded_bound_is_the_largest_with_its_digits(limit_m: float, digits: int):
    bound = scales.largest_bound(limit_m, digits)
    assert bound.metres <= limit_m
    assert scales.Bound(bound.mantissa + 1, bound.exponent).metres > limit_m * (1 - 1e-9)
    assert 10 ** (digits - 1) <= bound.mantissa <= 10**digits


@pytest.mark.parametrize("bound_m", [0.001, 0.02, 0.05, 0.1, 0.25, 0.81])
def test_usual_bounds_are_coded_exactly_in_a_byte(bound_m: float):
    bound = scales.largest_bound(bound_m, 2)
    assert bound.metres == pytest.approx(bound_m, rel=1e-12)
    assert bound.short_code >= 0


@given(st.floats(0, 4096))
@more
def test_a_standard_deviation_is_rounded_up_by_less_than_a_half_octave(sigma_m: float):
    codes = sigmacode.code_of(np.array([[sigma_m]]), np.array([[True]]))
    decoded = float(sigmacode.sigma_of(codes)[0, 0])
    assert decoded >= sigma_m
    assert decoded <= max(math.sqrt(2) * 1.000001 * sigma_m, 2.0**-20 * 1.000001)


@pytest.mark.parametrize("sigma_m", [-1.0, math.inf, math.nan, 5000.0])
def test_impossible_standard_deviations_are_refused(sigma_m: float):
    with pytest.raises(CodecError, match="standard deviation"):
        encode_tile(np.zeros((8, 8)), np.ones((8, 8), np.bool_), np.full((8, 8), sigma_m), 0.1)


# ------------------------------------------------------------------ tiles


def assert_tile_holds(z: Floats, known: Bools, sigma_m: Floats, bound_m: float) -> bytes:
    """Decode every prefix; hold it against all that a tile promises."""
    tile = encode_tile(z, known, sigma_m, bound_m)
    assert tile.level_ends[-1] == len(tile.data)
    assert list(tile.level_ends) == sorted(set(tile.level_ends))
    told, last_bound_m = np.zeros(z.shape, np.bool_), math.inf
    for length in range(len(tile.data) + 1):
        at_end = length in tile.level_ends
        got = decode_tile(tile.data[:length]) if at_end or length % 7 == 0 else None
        if got is None:
            continue
        assert got.level == sum(end <= length for end in tile.level_ends) - 1
        if got.level < 0:
            assert not got.known.any()
            continue
        assert got.levels == len(tile.level_ends)
        assert not (got.known & ~known).any()
        assert not (told & ~got.known).any()
        assert np.isnan(got.elevation_m[~got.known]).all()
        if got.known.any():
            assert worst_error_m(got.elevation_m, z, got.known) <= got.bound_m
        assert got.bound_m <= last_bound_m
        assert (got.sigma_m[got.known] >= sigma_m[got.known]).all()
        told, last_bound_m = got.known, got.bound_m
    assert np.array_equal(told, known)
    assert last_bound_m <= bound_m or not known.any()
    return tile.data


@given(grids(40), st.sampled_from([0.02, 0.1, 0.4]))
@few
def test_any_tile_keeps_its_promises_at_every_prefix(grid: tuple[Floats, Bools], bound_m: float):
    z, known = grid
    try:
        assert_tile_holds(z, known, sigma_like(z), bound_m)
    except CodecError:
        assert np.spacing(np.float32(np.abs(z).max())) > 0.9 * bound_m


@pytest.mark.parametrize(("side", "bound_m"), [(32, 0.05), (64, 0.05), (64, 0.1), (128, 0.1)])
@pytest.mark.parametrize("partly", [False, True])
def test_rough_tiles_keep_their_promises(side: int, bound_m: float, partly: bool):
    z = fractal(side, side)
    known = half_seen(z, 13) if partly else np.ones(z.shape, np.bool_)
    assert_tile_holds(z, known, sigma_like(z), bound_m)


def test_a_first_level_tells_most_of_a_tile_in_few_bytes():
    z = fractal(64, 14)
    known = np.ones(z.shape, np.bool_)
    tile = encode_tile(z, known, np.full(z.shape, 0.01), 0.05)
    first = decode_tile(tile.data[: tile.level_ends[0]])
    assert len(tile.level_ends) == 4
    assert tile.level_ends[0] <= 60
    assert first.known.mean() > 0.7
    assert first.bound_m < np.ptp(z) / 3


@pytest.mark.parametrize("side", [16, 32, 64])
@pytest.mark.parametrize("bound_m", [0.02, 0.05, 0.1])
def test_levels_cost_at_most_a_tenth(side: int, bound_m: float):
    for seed, rms_m in itertools.product(range(15, 18), (0.05, 0.5)):
        z = fractal(side, seed, rms_m)
        known = half_seen(z, seed) if seed % 2 else np.ones(z.shape, np.bool_)
        tile = encode_tile(z, known, np.full(z.shape, 0.01), bound_m)
        # A tile says how sure it is, which takes 2 to 3 bytes more than the plain grid.
        assert len(tile.data) <= 1.10 * (len(encode_grid(z, known, bound_m)) + 3)


def test_a_tile_without_known_cells_says_so():
    z = np.zeros((32, 32))
    data = assert_tile_holds(z, np.zeros(z.shape, np.bool_), z, 0.05)
    assert len(data) <= 8


def test_tiles_that_are_too_large_or_do_not_fit_are_refused():
    with pytest.raises(CodecError, match="129"):
        encode_tile(np.zeros((129, 4)), np.ones((129, 4), np.bool_), np.zeros((129, 4)), 0.1)
    with pytest.raises(CodecError, match="one tile"):
        encode_tile(np.zeros((4, 4)), np.ones((4, 4), np.bool_), np.zeros((4, 5)), 0.1)
    with pytest.raises(CodecError, match="float32 cannot hold"):
        encode_tile(np.array([[0.1, 1e9]]), np.ones((1, 2), np.bool_), np.zeros((1, 2)), 1e-3)


def test_encoding_is_the_same_every_time():
    z = fractal(48, 20)
    known = half_seen(z, 21)
    assert encode_grid(z, known, 0.05) == encode_grid(z.copy(), known.copy(), 0.05)
    tiles = [encode_tile(z, known, sigma_like(z), 0.05) for _ in range(2)]
    assert tiles[0] == tiles[1]


GOLDEN = bytes.fromhex(
    "974b7e06981ae3b20b6119fee29526d2f1b013ac1d5949cce32c4ab0490f77289b1134ae4afa0a19dda65ea0"
    "755905740293b5fab747fffa0983c011f16525d75ae1823d1c9b1c698812826e474f3ff357f1d936b1d7da86"
    "66e308b7a5dd036009d03f5db4e599b6082e01cb05b0ef54470e714da850a8b396812189789955900deb8d91"
    "05797499bf6ea0f9f287f8bc4e58d263c77b3347ac93021d5b248c3cf4869adca61a2871649d7e72841efaf5"
    "83a06338d2abd7"
)
GOLDEN_ENDS = (20, 85, 183)


def golden_ground() -> tuple[Floats, Bools, Floats]:
    """Ground made of whole numbers and powers of two, the same on any machine."""
    i, j = np.indices((32, 32))
    bowl = ((i - 9) ** 2 + (j - 20) ** 2) / 256
    rough = (i * i * 3 + i * j * 5 + j * j * 2) % 97 / 512
    step = np.where(i + 2 * j > 60, 0.75, 0.0)
    z = np.asarray(bowl + rough + step, np.float64)
    return z, (i + 3 * j) % 64 > 5, np.asarray(0.01 + 0.001 * i, np.float64)


def test_the_format_is_what_it_was():
    """New priors are a new format too: robots then do not understand older ones."""
    z, known, sigma_m = golden_ground()
    tile = encode_tile(z, known, sigma_m, 0.1)
    assert (tile.data, tile.level_ends) == (GOLDEN, GOLDEN_ENDS)
    decoded = decode_tile(GOLDEN)
    assert zlib.crc32(decoded.elevation_m[decoded.known].tobytes()) == 3791206441
    assert zlib.crc32(decoded.sigma_m[decoded.known].tobytes()) == 4026595066


# ------------------------------------------------------------------ hostile bytes


@given(st.binary(max_size=200))
@more
def test_hostile_bytes_decode_or_are_refused(data: bytes):
    with contextlib.suppress(CodecError):
        tile = decode_tile(data)
        assert max(tile.known.shape) <= 128
        assert tile.level < 0 or (tile.sigma_m[tile.known] > 0).all()
    with contextlib.suppress(CodecError):
        z, known = decode_grid(data)
        assert z.shape == known.shape
        assert np.isnan(z[~known]).all()


@given(st.integers(0, 2**32 - 1), st.booleans())
@more
def test_damaged_payloads_decode_or_are_refused(seed: int, cut: bool):
    rng = np.random.default_rng(seed)
    z = fractal(24, 22)
    known = half_seen(z, 23)
    good = encode_grid(z, known, 0.05)
    bad = bytearray(good)
    bad[int(rng.integers(len(bad)))] ^= 1 << int(rng.integers(8))
    if cut:
        bad = bad[: int(rng.integers(len(bad)))]
    try:
        decode_grid(bytes(bad))
    except CodecError:
        return


@pytest.mark.parametrize("fill", [0, 255])
def test_few_bytes_cannot_claim_much_memory(fill: int):
    heads = [bytes([255, 255, 255, first]) + bytes([fill]) * 60 for first in range(0, 256, 5)]
    tracemalloc.start()
    try:
        for data in heads:
            try:
                decode_grid(data)
            except CodecError:
                continue
        assert tracemalloc.get_traced_memory()[1] < 200e6
    finally:
        tracemalloc.stop()


def test_a_grid_that_was_cut_is_refused():
    z = fractal(64, 24)
    data = encode_grid(z, np.ones(z.shape, np.bool_), 0.02)
    with pytest.raises(CodecError, match="64 x 64 cells takes"):
        decode_grid(data[: len(data) // 2])
    with pytest.raises(CodecError, match="64 x 64 cells takes"):
        decode_grid(data[:-8])
    with pytest.raises(CodecError, match="64 x 64 cells takes"):
        decode_grid(data + b"and more")
    with pytest.raises(CodecError, match="cannot hold"):
        decode_grid(b"")


def test_a_large_flat_grid_is_sent_in_few_bytes_and_not_taken_for_an_attack():
    flat = np.full((1024, 700), -3.3)
    data = assert_holds(flat, np.ones(flat.shape, np.bool_), 0.05)
    assert len(data) < 60


# ------------------------------------------------------------------ real ground


@pytest.mark.parametrize(
    ("name", "rescale", "bound_m", "most_bits_per_cell"),
    [
        ("marsyard_erc2021_0p09m", 1.0, 0.05, 0.16),
        ("mars_gale_hirise_1m", 10.0, 0.02, 0.15),
        ("alps_sertig_5m", 50.0, 0.05, 0.27),
        ("ames_yard_0p5m", 1.0, 0.05, 0.20),
        ("west_bijou_gully_3m", 1.0, 0.25, 6.0),
    ],
)
def test_real_ground_is_held_and_small(
    name: str, rescale: float, bound_m: float, most_bits_per_cell: float
):
    path = SHARED / "data" / "dem" / f"{name}.npz"
    if not path.exists():
        pytest.skip(f"real data is not here: {path}")
    with np.load(path) as file:
        z = file["elevation"][::-1].astype(np.float64)
    known = np.isfinite(z)
    z = (z - np.nanmean(z)) / rescale if rescale > 1 else z
    data = assert_holds(np.where(known, z, 0.0), known, bound_m)
    assert 8 * len(data) / known.sum() <= most_bits_per_cell
