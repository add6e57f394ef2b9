"""The occupancy codec: masks are exact, nobody is told too much, prefixes decode."""

import bisect
import contextlib
import itertools
import math
import os
import time
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from comms.codec import (
    CodecError,
    DecodedOccupancy,
    decode_occupancy,
    decode_occupancy_tile,
    encode_occupancy,
    encode_occupancy_tile,
    log_odds_as_sent,
)
from comms.occupancy import priors
from comms.occupancy.classes import LARGEST_ERROR, SIZES, UNKNOWN, log_odds_of, symbols_of
from comms.occupancy.field import MARGIN, Palette, inside, palette_of
from comms.occupancy.field import blank as blank_field
from comms.occupancy.judge import code_judged, judge
from comms.occupancy.levels import Models, code_level
from comms.occupancy.tile import LADDERS
from comms.rangecoder import Mark, decoder, encoder

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

SHARED = Path(os.environ.get("ROPETEAM_SHARED", Path(__file__).parents[2] / "shared"))
few = settings(max_examples=40, deadline=None)
more = settings(max_examples=100, deadline=None)


def patches(shape: tuple[int, ...], seed: int, smoothing: int = 3) -> Floats:
    """Made-up log odds with large like areas and ragged edges."""
    z = np.random.default_rng(seed).normal(size=shape)
    for _ in range(smoothing):
        for axis in range(z.ndim):
            z = z + np.roll(z, 1, axis) + np.roll(z, -1, axis)
    return z / max(float(z.std()), 1e-9) * 3


@st.composite
def maps(draw: st.DrawFn, side: int = 24, block: int = 9) -> tuple[Floats, Bools]:
    dims = draw(st.sampled_from([2, 3]))
    most = side if dims == 2 else block
    shape = draw(hnp.array_shapes(min_dims=dims, max_dims=dims, min_side=1, max_side=most))
    seed = draw(st.integers(0, 2**32 - 1))
    log_odds = patches(shape, seed, draw(st.integers(0, 4)))
    kind = draw(st.sampled_from(["all", "three", "free", "occupied", "one"]))
    if kind == "three":
        log_odds = np.where(log_odds > 2, np.inf, -9.0)
    elif kind == "free":
        log_odds = -np.abs(log_odds)
    elif kind == "occupied":
        log_odds = np.abs(log_odds)
    elif kind == "one":
        log_odds = np.full(shape, float(draw(st.sampled_from([-6.0, -1.0, 0.0, 0.5, 8.0]))))
    known = patches(shape, seed + 1, draw(st.integers(0, 4))) < draw(
        st.sampled_from([-99.0, -2.0, 1.0, 99.0])
    )
    return log_odds, known


def assert_told_no_more(told: Floats, truth: Floats, known: Bools) -> None:
    """No cell is surer than it was, or of the other sign; none is told that is not known."""
    assert not told[~known].any()
    assert (np.abs(told) <= np.abs(truth))[known].all()
    assert (np.sign(told) * np.sign(truth) >= 0)[known].all()


# ------------------------------------------------------------------ classes


def test_classes_are_at_the_stated_log_odds():
    known = np.ones(3, np.bool_)
    told = log_odds_as_sent(np.array([0.4, 2.2, -5.29]), known)
    assert told == pytest.approx([0.4, 2.2, -5.29], abs=1e-6)
    told = log_odds_as_sent(np.array([0.39999, 2.19999, -5.28999]), known)
    assert told == pytest.approx([0.0, 1.38, -3.89], abs=1e-6)
    assert log_odds_as_sent(np.array([-np.inf, np.inf, 40.0]), known) == pytest.approx(
        [-5.29, 5.29, 5.29], abs=1e-6
    )


def test_a_cell_told_2_2_is_more_than_nine_tenths_sure():
    told = float(log_odds_as_sent(np.array([2.2]), np.ones(1, np.bool_))[0])
    assert 1 / (1 + math.exp(-told)) > 0.9


@given(st.floats(-30, 30))
@more
def test_information_is_rounded_down_and_not_far(value: float):
    told = float(log_odds_as_sent(np.array([value]), np.ones(1, np.bool_))[0])
    assert abs(told) <= abs(value)
    assert told * value >= 0
    within = min(abs(value), SIZES[-1])
    assert within - abs(told) <= LARGEST_ERROR
    given_p, told_p = 1 / (1 + math.exp(-within)), 1 / (1 + math.exp(-abs(told)))
    assert given_p - told_p <= 0.1 + 1e-6


def test_classes_survive_being_sent_again():
    symbols = np.arange(16, dtype=np.uint8)
    assert np.array_equal(symbols_of(log_odds_of(symbols), symbols != UNKNOWN), symbols)


def test_the_largest_error_is_the_widest_gap():
    assert pytest.approx(1.40) == LARGEST_ERROR
    assert all(a < b for a, b in itertools.pairwise(SIZES))


# ------------------------------------------------------------------ the mixing of opinions


def reference_judged(bits: list[tuple[int, int]], inputs: int) -> list[int]:
    """The same in plain Python: the chances that bits get, in 1/65536."""
    chances = [round(65536 / (1 + math.exp(-k / 256))) for k in range(-2303, 2304)]
    stretch = [bisect.bisect_left(chances, p) - 2303 for p in range(8, 65536, 16)]
    verdicts = {
        (c, k): float(chances[min(max(k * 144 - 1, 0), 4606)] * 64)
        for c in range(4)
        for k in range(33)
    }
    models = {slot: [1 << 21, 0] for slot in range(2 * inputs)}
    weights, result = [65536.0 / inputs] * inputs, []
    for context, bit in bits:
        odds = []
        for k in range(inputs):
            p, count = models[2 * k + context % 2]
            trust = math.floor(256 * (5 * count + 3) / (5 * count + 8)) if count else 0
            odds.append(math.floor(stretch[p >> 10] * trust / 256))
        total = sum(w * x for w, x in zip(weights, odds, strict=True)) / 65536
        total = min(max(math.floor(total + 0.5), -2303), 2303)
        chance, knot = chances[total + 2303], (total + 2304) // 144
        part = (total + 2304 - knot * 144) / 144
        said = sum(
            verdicts[c, knot] * (1 - part) + verdicts[c, knot + 1] * part for c in (context, 3)
        )
        result.append(math.floor((2 * chance + said / 64 + 2) / 4))
        target = (1 << 22) - 1 if bit else 0
        surprise = (65536 if bit else 0) - chance
        for k in range(inputs):
            weights[k] += odds[k] * surprise / 65536
            model = models[2 * k + context % 2]
            model[0] += math.floor((target - model[0]) / (model[1] + 1.5))
            model[1] = min(model[1] + 1, 100)
        for c in (context, 3):
            for k, share in ((knot, 1 - part), (knot + 1, part)):
                verdicts[c, k] += (target - verdicts[c, k]) * share * 144 / 8192
    return result


@given(st.lists(st.tuples(st.integers(0, 2), st.sampled_from([0, 1, 1])), max_size=150))
@few
def test_chances_are_those_of_slow_reference_code(bits: list[tuple[int, int]]):
    expected = reference_judged(bits, 3)
    opinions = priors.opinions("nobody", 6, 1, 3)
    opinions.weights[:] = 65536 // 3
    coder, verdict = encoder(4000), judge(opinions, 4)
    for (context, bit), chance in zip(bits, expected, strict=True):
        opinions.slots[:] = [2 * k + context % 2 for k in range(3)]
        before = int(coder.state[1]) >> 16
        position = int(coder.state[2])
        code_judged(coder, verdict, 0, context, 3, 100, bit)
        if int(coder.state[2]) == position:
            took = int(coder.state[1]) / before
            share = took if bit else 65536 - took
            assert share == pytest.approx(min(max(chance, 8), 65528), rel=0.02, abs=24)


# ------------------------------------------------------------------ whole maps


@given(maps())
@more
def test_masks_are_exact_and_log_odds_as_the_classes_have_them(pair: tuple[Floats, Bools]):
    log_odds, known = pair
    told, mask = decode_occupancy(encode_occupancy(log_odds, known))
    assert told.dtype == np.float32
    assert told.shape == log_odds.shape
    assert np.array_equal(mask, known)
    assert np.array_equal(told, log_odds_as_sent(log_odds, known))
    assert_told_no_more(told, log_odds, known)


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (300, 1), (1, 1, 1), (3, 1, 40), (2, 65, 17)])
@pytest.mark.parametrize("seed", [1, 2])
def test_odd_shapes_come_back(shape: tuple[int, ...], seed: int):
    log_odds = patches(shape, seed)
    known = patches(shape, seed + 1) > -1
    told, mask = decode_occupancy(encode_occupancy(log_odds, known))
    assert np.array_equal(mask, known)
    assert np.array_equal(told, log_odds_as_sent(log_odds, known))


@pytest.mark.parametrize("shape", [(4096, 4096), (128, 128, 128)])
def test_the_largest_maps_of_one_kind_take_next_to_nothing(shape: tuple[int, ...]):
    log_odds, some = np.full(shape, -7.0, np.float32), np.ones(shape, np.bool_)
    assert len(encode_occupancy(log_odds, ~some)) <= 4
    data = encode_occupancy(log_odds, some)
    assert len(data) <= 12
    told, mask = decode_occupancy(data)
    assert mask.all()
    assert told.min() == told.max() == log_odds_as_sent(log_odds[:1, :1], some[:1, :1]).item(0)


def test_what_is_not_known_does_not_matter():
    log_odds = patches((20, 20), 5)
    known = patches((20, 20), 6) > 0
    other = np.where(known, log_odds, np.nan)
    assert encode_occupancy(log_odds, known) == encode_occupancy(other, known)


@pytest.mark.parametrize(
    ("log_odds", "known", "words"),
    [
        (np.zeros((3, 4)), np.ones((4, 3), np.bool_), r"\(3, 4\) and mask \(4, 3\)"),
        (np.zeros((0, 4)), np.ones((0, 4), np.bool_), r"\(0, 4\)"),
        (np.zeros((1, 4097)), np.ones((1, 4097), np.bool_), "4096x4096"),
        (np.zeros((1, 1, 129)), np.ones((1, 1, 129), np.bool_), "128x128x128"),
        (np.zeros(4), np.ones(4, np.bool_), r"\(4,\)"),
        (np.full((2, 2), np.nan), np.ones((2, 2), np.bool_), "NaN"),
    ],
)
def test_what_makes_no_sense_is_refused(log_odds: Floats, known: Bools, words: str):
    with pytest.raises(CodecError, match=words):
        encode_occupancy(log_odds, known)


def test_tiles_have_bounds_of_their_own():
    with pytest.raises(CodecError, match="128x128"):
        encode_occupancy_tile(np.zeros((129, 1)), np.ones((129, 1), np.bool_))
    with pytest.raises(CodecError, match="64x64x64"):
        encode_occupancy_tile(np.zeros((65, 1, 1)), np.ones((65, 1, 1), np.bool_))


# ------------------------------------------------------------------ blocks and cells


@given(maps(block=12), st.sampled_from(LADDERS))
@more
def test_every_ladder_of_levels_comes_to_the_same_map(
    pair: tuple[Floats, Bools], ladder: tuple[int, ...]
):
    log_odds, known = pair
    known.flat[0] = True
    symbols = symbols_of(log_odds, known).reshape((1,) * (3 - known.ndim) + known.shape)
    palette, coder = palette_of(symbols), encoder(symbols.size * 12)
    models, field = Models.fresh(symbols.shape, palette), blank_field(symbols.shape)
    for side in ladder:
        code_level(coder, models, palette, field, side, symbols)
    data = Mark(coder).finish(length_is_known=True)
    reader, seen = decoder(data), blank_field(symbols.shape)
    models = Models.fresh(symbols.shape, palette)
    for side in ladder:
        code_level(reader, models, palette, seen, side, None)
    assert np.array_equal(inside(seen.symbols), symbols)
    assert np.array_equal(seen.symbols, field.symbols)


def test_a_block_tells_the_least_of_its_cells():
    log_odds = np.full((8, 16), -3.0)
    log_odds[5, 3], log_odds[2, 12] = -0.9, 1.0
    known = np.ones((8, 16), np.bool_)
    symbols = symbols_of(log_odds, known)[None]
    palette, coder = palette_of(symbols), encoder(2000)
    field = blank_field(symbols.shape)
    code_level(coder, Models.fresh(symbols.shape, palette), palette, field, 8, symbols)
    told = log_odds_of(inside(field.symbols))[0]
    assert told[:, :8] == pytest.approx(np.full((8, 8), -0.84), abs=1e-6)
    assert not told[:, 8:].any()


def test_a_palette_is_what_a_map_has():
    symbols = symbols_of(np.array([[-3.0, 0.0], [6.0, 1.0]]), np.array([[1, 1], [1, 0]], np.bool_))
    assert palette_of(symbols) == Palette(0, 1, 1, 1 << 0 | 1 << 5 | 1 << 7)


def test_margins_are_never_written():
    symbols = symbols_of(patches((12, 12), 3), np.ones((12, 12), np.bool_))[None]
    palette, field = palette_of(symbols), blank_field(symbols.shape)
    models, coder = Models.fresh(symbols.shape, palette), encoder(4000)
    for side in (8, 1):
        code_level(coder, models, palette, field, side, symbols)
    states = field.states[0].copy()
    states[MARGIN:-MARGIN, MARGIN:-MARGIN] = 1
    assert (states == 1).all()


# ------------------------------------------------------------------ tiles


def tiles() -> st.SearchStrategy[tuple[Floats, Bools]]:
    return maps(side=40, block=16)


@given(tiles())
@few
def test_levels_add_cells_and_certainty_and_the_last_is_exact(pair: tuple[Floats, Bools]):
    log_odds, known = pair
    tile = encode_occupancy_tile(log_odds, known)
    assert tile.level_ends[-1] == len(tile.data)
    before = DecodedOccupancy(np.zeros(known.shape), np.zeros(known.shape, np.bool_), -1, 0)
    for level, end in enumerate(tile.level_ends):
        seen = decode_occupancy_tile(tile.data[:end])
        assert (seen.level, seen.levels) == (level, len(tile.level_ends))
        assert (seen.known >= before.known).all()
        assert not (seen.known & ~known).any()
        assert_told_no_more(seen.log_odds, log_odds, known)
        assert (np.abs(seen.log_odds) >= np.abs(before.log_odds)).all()
        before = seen
    assert np.array_equal(before.known, known)
    assert np.array_equal(before.log_odds, log_odds_as_sent(log_odds, known))


@given(tiles(), st.data())
@few
def test_any_prefix_tells_its_last_whole_level(pair: tuple[Floats, Bools], data: st.DataObject):
    tile = encode_occupancy_tile(*pair)
    length = data.draw(st.integers(0, len(tile.data)))
    seen = decode_occupancy_tile(tile.data[:length])
    level = sum(end <= length for end in tile.level_ends) - 1
    assert seen.level == level
    if level >= 0:
        whole = decode_occupancy_tile(tile.data[: tile.level_ends[level]])
        assert np.array_equal(seen.log_odds, whole.log_odds)
        assert np.array_equal(seen.known, whole.known)
    else:
        assert not seen.known.any()


@given(tiles(), st.binary(max_size=9))
@few
def test_what_follows_a_payload_changes_nothing(pair: tuple[Floats, Bools], more_bytes: bytes):
    tile = encode_occupancy_tile(*pair)
    seen = decode_occupancy_tile(tile.data + more_bytes)
    assert seen.level == len(tile.level_ends) - 1
    assert np.array_equal(seen.known, pair[1])
    assert np.array_equal(seen.log_odds, log_odds_as_sent(*pair))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("shape", [(64, 64), (128, 128), (16, 32, 32)])
def test_levels_cost_at_most_a_tenth(shape: tuple[int, ...], seed: int):
    log_odds, known = patches(shape, seed, 12), patches(shape, seed + 9, 12) < 2
    tile = encode_occupancy_tile(log_odds, known)
    assert len(tile.level_ends) > 1
    assert len(tile.data) <= 1.1 * len(encode_occupancy(log_odds, known)) + 2


def test_an_unknown_tile_takes_two_bytes_at_most():
    tile = encode_occupancy_tile(np.zeros((64, 64)), np.zeros((64, 64), np.bool_))
    assert len(tile.data) <= 2
    seen = decode_occupancy_tile(tile.data)
    assert (seen.level, seen.levels, seen.known.shape) == (0, 1, (64, 64))
    assert not seen.known.any()


# ------------------------------------------------------------------ hostile bytes


@given(st.binary(max_size=300))
@settings(max_examples=200, deadline=None)
def test_any_bytes_are_decoded_or_refused(data: bytes):
    with contextlib.suppress(CodecError):
        told, known = decode_occupancy(data)
        assert np.isfinite(told).all()
        assert told.shape == known.shape
    with contextlib.suppress(CodecError):
        seen = decode_occupancy_tile(data)
        assert np.isfinite(seen.log_odds).all()
        assert seen.log_odds.shape == seen.known.shape
        assert not seen.log_odds[~seen.known].any()


@given(maps(side=20, block=8), st.data())
@more
def test_a_damaged_payload_is_decoded_or_refused(pair: tuple[Floats, Bools], data: st.DataObject):
    payload = bytearray(encode_occupancy(*pair))
    at = data.draw(st.integers(0, len(payload) - 1))
    payload[at] ^= data.draw(st.integers(1, 255))
    with contextlib.suppress(CodecError):
        decode_occupancy(bytes(payload))


@pytest.mark.parametrize("length", [1, 64, 300])
def test_few_bytes_cost_bounded_time_and_memory(length: int):
    rng = np.random.default_rng(length)
    payloads = [rng.bytes(length) for _ in range(5)]
    payloads += [byte * length for byte in (b"\x00", b"\x7f", b"\x80", b"\xff")]
    tracemalloc.start()
    started_s = time.process_time()
    for payload in payloads:
        with contextlib.suppress(CodecError):
            decode_occupancy(payload)
        with contextlib.suppress(CodecError):
            decode_occupancy_tile(payload)
    took_s, (_, peak_bytes) = time.process_time() - started_s, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert took_s < 2.0 * len(payloads)
    assert peak_bytes < 400e6


def test_a_payload_cut_short_is_refused():
    log_odds, known = patches((40, 40), 1), patches((40, 40), 2) < 1
    data = encode_occupancy(log_odds, known)
    for length in range(0, len(data) - 8, 7):
        with pytest.raises(CodecError, match="bytes are not what"):
            decode_occupancy(data[:length])


# ------------------------------------------------------------------ real maps


def real_map(name: str) -> tuple[Floats, Bools]:
    """A published map, by the thresholds of its yaml: free < 0.196, occupied > 0.65."""
    path = SHARED / "data" / "occupancy" / f"{name}.png"
    if not path.exists():
        pytest.skip(f"no real maps at {path.parent}")
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert grey is not None
    occupancy = (255 - grey.astype(np.float64)) / 255
    return np.where(occupancy > 0.5, 6.0, -6.0), (occupancy < 0.196) | (occupancy > 0.65)


@pytest.mark.parametrize(
    ("name", "most_bytes"),
    [
        ("tetam_lab_0p1", 150),
        ("ut_gdc_floor2_0p05", 11_300),
        ("willow_garage_0p05", 18_500),
    ],
)
def test_a_published_map_comes_back_from_few_bytes(name: str, most_bytes: int):
    log_odds, known = real_map(name)
    data = encode_occupancy(log_odds, known)
    assert len(data) <= most_bytes
    told, mask = decode_occupancy(data)
    assert np.array_equal(mask, known)
    assert np.array_equal(told > 0, known & (log_odds > 0))


def test_levels_of_a_real_map_cost_at_most_a_tenth():
    log_odds, known = real_map("willow_garage_0p05")
    whole, levels = 0, 0
    for i, j in itertools.product(range(300, 700, 64), repeat=2):
        cut = np.s_[i : i + 64, j : j + 64]
        tile = encode_occupancy_tile(log_odds[cut], known[cut])
        whole += len(encode_occupancy(log_odds[cut], known[cut]))
        levels += len(tile.data)
        assert np.array_equal(decode_occupancy_tile(tile.data).known, known[cut])
    assert levels <= 1.1 * whole
