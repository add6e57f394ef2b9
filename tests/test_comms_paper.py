"""The parts of the paper's codec: four compressors, the quadtree, and Eqs. 1 and 2."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from comms.errors import CodecError
from comms.paper import quadtree
from comms.paper.bits import put, reader, take, writer, written
from comms.paper.decimation import decimated
from comms.paper.entropy import PASSES, bits_after, histogram_bits, huffman_bits
from comms.paper.huffman import LONGEST, code_lengths
from comms.paper.lzw import LARGEST_DICTIONARY, lzw_codes, lzw_pack, lzw_unpack
from comms.paper.predictive import (
    LARGEST,
    cells_in_order,
    predictive_pack,
    predictive_unpack,
    residuals,
)
from comms.paper.runlength import run_length_pack, runs
from comms.paper.sections import (
    COMPRESSORS,
    Compressor,
    Cursor,
    folded,
    number_bytes,
    numbers_section,
    read_numbers,
    read_section,
    section,
    unfolded,
)

NAMES = sorted(COMPRESSORS)


@st.composite
def symbols(draw: st.DrawFn) -> tuple[NDArray[np.uint8], int]:
    """Return symbols with runs and repeated words, and their alphabet."""
    alphabet = draw(st.integers(1, 256))
    word = st.lists(st.integers(0, alphabet - 1), min_size=1, max_size=6)
    words = draw(st.lists(st.tuples(word, st.integers(1, 40)), max_size=12))
    flat = [symbol for word, times in words for symbol in word * times]
    return np.array(flat, np.uint8), alphabet


def packed(name: str) -> Compressor:
    return COMPRESSORS[name]


# --- laws of the three compressors of symbols ----------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=60, deadline=None)
@given(data=symbols())
def test_what_was_packed_comes_back(name: str, data: tuple[NDArray[np.uint8], int]) -> None:
    given_symbols, alphabet = data
    sent = packed(name).pack(given_symbols, alphabet)
    found = packed(name).unpack(sent, alphabet, given_symbols.size)
    assert found.tolist() == given_symbols.tolist()


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=60, deadline=None)
@given(data=st.binary(max_size=60), alphabet=st.integers(1, 256), count=st.integers(0, 500))
def test_any_bytes_are_symbols_of_the_alphabet_or_refused(
    name: str, data: bytes, alphabet: int, count: int
) -> None:
    try:
        found = packed(name).unpack(data, alphabet, count)
    except CodecError:
        return
    assert found.shape == (count,)
    assert int(found.max(initial=0)) < alphabet


@pytest.mark.parametrize("name", ["lzw", "rle"])
@settings(max_examples=30, deadline=None)
@given(data=symbols().filter(lambda data: data[0].size > 2 and data[1] > 1))
def test_bytes_that_are_cut_are_refused(name: str, data: tuple[NDArray[np.uint8], int]) -> None:
    given_symbols, alphabet = data
    sent = packed(name).pack(given_symbols, alphabet)
    with pytest.raises(CodecError):
        packed(name).unpack(sent[:-1], alphabet, given_symbols.size)


# --- each against what it is known to do ----------------------------------------------------------


def slow_lzw(data: list[int], alphabet: int) -> list[int]:
    """Return LZW's codes by the book, with words as keys."""
    book = {(symbol,): symbol for symbol in range(alphabet)}
    word: tuple[int, ...] = ()
    out: list[int] = []
    for symbol in data:
        if (*word, symbol) in book:
            word = (*word, symbol)
            continue
        out.append(book[word])
        book[(*word, symbol)] = len(book)
        word = (symbol,)
    return [*out, book[word]] if word else out


@settings(max_examples=60, deadline=None)
@given(data=symbols())
def test_lzw_codes_are_those_of_the_book(data: tuple[NDArray[np.uint8], int]) -> None:
    given_symbols, alphabet = data
    assert lzw_codes(given_symbols, alphabet).tolist() == slow_lzw(given_symbols.tolist(), alphabet)


def test_lzw_by_hand() -> None:
    # a, b, ab, aba (which is being made: KwKwK); codes of 1, 2, 2 and 3 bits.
    word = np.array([0, 1, 0, 1, 0, 1, 0], np.uint8)
    assert lzw_codes(word, 2).tolist() == [0, 1, 2, 4]
    assert lzw_pack(word, 2) == bytes([0b0_01_10_100])


def test_lzw_begins_anew_when_its_dictionary_is_full() -> None:
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 200, 3 * LARGEST_DICTIONARY).astype(np.uint8)
    sent = lzw_pack(noise, 200)
    assert np.array_equal(lzw_unpack(sent, 200, noise.size), noise)
    assert 60_000 < lzw_codes(noise, 200).max() < LARGEST_DICTIONARY


def test_lzw_makes_few_bytes_of_a_long_run() -> None:
    run = np.full(100_000, 7, np.uint8)
    codes = lzw_codes(run, 8)
    assert codes.size == math.ceil((math.sqrt(1 + 8 * run.size) - 1) / 2)  # 1 + 2 + 3 + ...
    assert len(lzw_pack(run, 8)) < 600


def test_huffman_lengths_by_hand() -> None:
    assert code_lengths(np.array([8, 4, 2, 1, 1, 0])).tolist() == [1, 2, 3, 4, 4, 0]
    assert code_lengths(np.array([0, 9])).tolist() == [0, 0]


@settings(max_examples=50, deadline=None)
@given(counts=st.lists(st.integers(0, 1000), min_size=2, max_size=60))
def test_huffman_lengths_are_a_whole_code_and_the_best_there_is(counts: list[int]) -> None:
    lengths = code_lengths(np.array(counts))
    used = lengths[lengths > 0]
    if used.size:
        assert sum(2.0**-used) == 1.0
    values = np.repeat(np.arange(len(counts)), counts)
    if values.size and used.size and used.max() < LONGEST:
        mean = float((lengths * np.array(counts)).sum()) / values.size
        assert mean == pytest.approx(huffman_bits(values))


def test_huffman_codes_stay_within_their_limit() -> None:
    fibonacci = [1, 1]
    while len(fibonacci) < 40:
        fibonacci.append(fibonacci[-1] + fibonacci[-2])
    lengths = code_lengths(np.array(fibonacci))
    assert lengths.max() == LONGEST
    assert sum(2.0**-lengths) == 1.0


def test_run_lengths_by_hand() -> None:
    word = np.array([5, 5, 5, 5, 1, 2, 3, 3, 9, 9, 9], np.uint8)
    assert run_length_pack(word, 10) == bytes([253, 5, 3, 1, 2, 3, 3, 254, 9])
    assert runs(np.array([4, 4, 7])).tolist() == [[4, 2], [7, 1]]
    assert runs(np.zeros(0, np.int64)).shape == (0, 2)


# --- the predictive coder -------------------------------------------------------------------------


@st.composite
def grids(draw: st.DrawFn) -> NDArray[np.int64]:
    rows, cols = draw(st.integers(1, 12)), draw(st.integers(1, 12))
    size = draw(st.sampled_from([0, 1, 4, 1000, LARGEST]))
    seed = draw(st.integers(0, 999))
    noise = np.random.default_rng(seed).integers(-size, size + 1, (rows, cols))
    return noise * (np.random.default_rng(seed + 1).random((rows, cols)) < draw(st.floats(0, 1)))


@settings(max_examples=60, deadline=None)
@given(grid=grids())
def test_the_predictive_coder_gives_grids_back(grid: NDArray[np.int64]) -> None:
    squares = cells_in_order(*grid.shape)
    sent = predictive_pack(grid.ravel(), squares, grid.shape)
    found = predictive_unpack(sent, squares, grid.shape)
    assert np.array_equal(found.reshape(grid.shape), grid)


@settings(max_examples=60, deadline=None)
@given(data=st.binary(max_size=40))
def test_the_predictive_coder_takes_any_bytes_or_refuses(data: bytes) -> None:
    squares = cells_in_order(6, 6)
    try:
        found = predictive_unpack(data, squares, (6, 6))
    except CodecError:
        return
    assert found.shape == (36,)


def test_the_predictive_coder_refuses_what_it_cannot_hold() -> None:
    with pytest.raises(CodecError, match="2\\^52"):
        predictive_pack(np.array([LARGEST + 1]), cells_in_order(1, 1), (1, 1))


def test_what_the_median_edge_detector_misses_by_hand() -> None:
    # A slope is foreseen but at its outer cells; a step is foreseen by the row above it.
    slope = np.add.outer(np.arange(4), 2 * np.arange(4))
    missed = residuals(slope.ravel(), cells_in_order(4, 4), (4, 4)).reshape(4, 4)
    assert missed[0].tolist() == [0, 2, 2, 2]
    assert missed[:, 0].tolist() == [0, 1, 1, 1]
    step = np.tile([0, 0, 9, 9], (3, 1))
    missed = residuals(step.ravel(), cells_in_order(3, 4), (3, 4)).reshape(3, 4)
    assert missed.tolist() == [[0, 0, 9, 0], [0] * 4, [0] * 4]


def test_a_constant_costs_the_predictive_coder_next_to_nothing() -> None:
    squares = cells_in_order(100, 100)
    sent = predictive_pack(np.full(10_000, 0), squares, (100, 100))
    assert len(sent) < 8


# --- sections -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=40, deadline=None)
@given(numbers=st.lists(st.integers(0, 2**62 - 1) | st.integers(0, 200), max_size=50))
def test_numbers_come_back_from_their_section(name: str, numbers: list[int]) -> None:
    cursor = Cursor(numbers_section(np.array(numbers, np.int64), name))
    assert read_numbers(cursor, name, len(numbers)).tolist() == numbers
    cursor.end()


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=40, deadline=None)
@given(data=st.binary(max_size=40))
def test_any_bytes_are_a_section_or_refused(name: str, data: bytes) -> None:
    try:
        assert read_section(Cursor(data), name, 1000).size <= 1000
    except CodecError:
        return


@settings(max_examples=40, deadline=None)
@given(data=symbols())
def test_a_section_is_never_much_more_than_plain(data: tuple[NDArray[np.uint8], int]) -> None:
    given_symbols, alphabet = data
    plain = (given_symbols.size * (alphabet - 1).bit_length() + 7) // 8
    assert all(len(section(given_symbols, name)) <= plain + 12 for name in NAMES)


def test_sections_refuse_what_is_torn() -> None:
    whole = section(np.arange(100, dtype=np.uint8), "lzw")
    for data, words in (
        (whole[:-1], "end in the middle"),
        (number_bytes(2000) + whole, "2000 symbols where 1000"),
        (b"\xff" * 12, "more than 9 bytes"),
    ):
        with pytest.raises(CodecError, match=words):
            read_section(Cursor(data), "lzw", 1000)
    with pytest.raises(CodecError, match="1 bytes too many"):
        Cursor(b"x").end()


@given(values=st.lists(st.integers(-(2**60), 2**60)))
def test_folding_is_undone(values: list[int]) -> None:
    array = np.array(values, np.int64)
    assert (folded(array) >= 0).all()
    assert unfolded(folded(array)).tolist() == values


def test_bits_beyond_the_end_are_zeros_and_nothing_is_overwritten() -> None:
    stream = writer(8)
    put(stream, 0b1011, 4)
    put(stream, 0b01, 2)
    assert written(stream) == bytes([0b101101_00])
    source = reader(b"\xff")
    assert (take(source, 6), take(source, 4)) == (63, 0b1100)


# --- the quadtree ---------------------------------------------------------------------------------


@st.composite
def masks(draw: st.DrawFn) -> NDArray[np.uint8]:
    rows, cols = draw(st.integers(1, 20)), draw(st.integers(1, 20))
    known = np.zeros((rows, cols), np.uint8)
    for _ in range(draw(st.integers(0, 4))):
        i, j = draw(st.integers(0, rows - 1)), draw(st.integers(0, cols - 1))
        known[i : i + draw(st.integers(1, 12)), j : j + draw(st.integers(1, 12))] ^= 1
    return known


@settings(max_examples=80, deadline=None)
@given(known=masks())
def test_a_mask_comes_back_from_its_tree(known: NDArray[np.uint8]) -> None:
    room = quadtree.most_nodes(known.shape)
    symbols, blocks = np.zeros(room, np.uint8), np.zeros(room, np.uint8)
    side = quadtree.root_side(known.shape)
    n, mixed = quadtree.mask_symbols(known, side, symbols, blocks)
    assert n + mixed <= room
    found = np.zeros_like(known)
    assert quadtree.paint_mask(symbols[:n], blocks[:mixed], side, found)
    assert np.array_equal(found, known)


@settings(max_examples=60, deadline=None)
@given(
    symbols=st.binary(min_size=0, max_size=12),
    blocks=st.binary(max_size=6),
    shape=st.tuples(st.integers(1, 9), st.integers(1, 9)),
)
def test_any_symbols_are_a_mask_or_none(
    symbols: bytes, blocks: bytes, shape: tuple[int, int]
) -> None:
    known = np.zeros(shape, np.uint8)
    streams = [np.frombuffer(data, np.uint8) for data in (symbols, blocks)]
    quadtree.paint_mask(*streams, quadtree.root_side(shape), known)
    assert known.max() <= 1


def test_a_constant_is_one_leaf_and_noise_is_cells() -> None:
    assert tree_of(np.zeros((16, 16)), 0.5)[:, 2].tolist() == [16]
    noise = np.random.default_rng(0).permutation(256).reshape(16, 16)
    assert (tree_of(noise, 0.5)[:, 2] == 1).all()
    assert (tree_of(noise, 0.5, critical=4)[:, 2] == 4).all()


def test_the_cut_off_is_in_bits_per_cell() -> None:
    # Of 16 cells two stand out: H = 0.5436 bits. A quarter with one of them has 0.8113.
    ground = np.zeros((4, 4))
    ground[0, 0] = ground[3, 3] = 1
    entropy = -(2 / 16 * math.log2(2 / 16) + 14 / 16 * math.log2(14 / 16))
    assert len(tree_of(ground, entropy + 1e-6)) == 1
    assert sorted(tree_of(ground, entropy - 1e-6)[:, 2].tolist()) == [1] * 8 + [2] * 2
    assert len(tree_of(ground, 0.812)) == 1


def tree_of(
    ground: NDArray[np.floating] | NDArray[np.integer], cutoff: float, critical: int = 1
) -> NDArray[np.int32]:
    bins = ground.astype(np.int64)
    known = np.ones(bins.shape, np.uint8)
    symbols = np.zeros(quadtree.most_nodes(bins.shape), np.uint8)
    leaves = np.zeros((bins.size, 3), np.int32)
    side = quadtree.root_side(bins.shape)
    counts = np.zeros(int(bins.max()) + 1, np.int64)
    n, found = quadtree.elevation_tree(
        bins,
        known,
        side,
        cutoff,
        critical,
        counts,
        quadtree.plogp_table(bins.size),
        symbols,
        leaves,
    )
    again = np.zeros_like(leaves)
    assert quadtree.leaves_of(symbols[:n], known, side, critical, again) == found
    assert np.array_equal(again, leaves)
    assert not counts.any()
    return leaves[:found]


# --- adaptive decimation --------------------------------------------------------------------------


def test_pebbles_go_and_rocks_slopes_and_edges_stay() -> None:
    slope = np.add.outer(np.arange(8.0), np.zeros(8))
    cliff = np.where(np.arange(8) < 4, 0.0, 5.0) + np.zeros((8, 1))
    everywhere = np.ones((8, 8), np.uint8)
    for ground in (slope, cliff):
        # (A slope's own border has neighbours on one side only.)
        assert np.array_equal(decimated(ground, everywhere, 0.1), ground)
    pebbled, rocky = np.zeros((8, 8)), np.zeros((8, 8))
    pebbled[3, 3], rocky[3, 3] = 0.08, 0.3
    assert not decimated(pebbled, everywhere, 0.1).any()
    assert np.array_equal(decimated(rocky, everywhere, 0.1), rocky)


@settings(max_examples=40, deadline=None)
@given(known=masks(), pebble_m=st.floats(0, 1), seed=st.integers(0, 99))
def test_decimation_moves_no_cell_by_more_than_a_pebble(
    known: NDArray[np.uint8], pebble_m: float, seed: int
) -> None:
    ground = np.random.default_rng(seed).normal(size=known.shape)
    moved = np.abs(decimated(ground, known, pebble_m) - ground)
    assert moved.max() <= pebble_m
    assert not moved[known == 0].any()


# --- Eqs. 1 and 2 ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name in PASSES if name != "lzw"])
def test_a_constant_has_no_information(name: str) -> None:
    assert bits_after(np.full((8, 9), 4), name) == 0.0


def test_a_constant_has_next_to_none_after_lzw() -> None:
    # 72 = 1 + 2 + ... + 11 + 6: eleven codes that differ, and one of them again.
    entropy = 10 / 12 * math.log2(12) + 2 / 12 * math.log2(6)
    assert bits_after(np.full((8, 9), 4), "lzw") == pytest.approx(12 * entropy / 72)


@pytest.mark.parametrize("n", [2, 4, 16, 64])
def test_equally_likely_values_have_log2_n(n: int) -> None:
    values = np.tile(np.arange(n), 64 // n * 4).reshape(16, -1)
    assert histogram_bits(values) == pytest.approx(math.log2(n))
    assert bits_after(values, "huffman") == pytest.approx(math.log2(n))


def test_the_equations_by_hand() -> None:
    values = np.array([[0, 0, 0, 1]])
    assert histogram_bits(values) == pytest.approx(0.8112781)
    assert bits_after(values, "none") == pytest.approx(0.8112781)
    assert bits_after(values, "huffman") == 1.0
    # Two runs, of 0 three times and of 1 once: a bit for the value and one for the length of each.
    assert bits_after(values, "rle") == pytest.approx(2 * (1 + 1) / 4)
    # Foreseen are 0, 0, 0, 0: three hits and a miss.
    assert bits_after(values, "jpeg-ls") == pytest.approx(0.8112781)
    # Codes 0, 2 (0 0), 1: three different ones.
    assert bits_after(values, "lzw") == pytest.approx(3 * math.log2(3) / 4)


@settings(max_examples=40, deadline=None)
@given(values=st.lists(st.integers(-5, 5), min_size=1, max_size=200))
def test_huffman_is_within_a_bit_of_the_entropy(values: list[int]) -> None:
    entropy = histogram_bits(np.array(values))
    assert entropy - 1e-9 <= huffman_bits(np.array(values)) < entropy + 1


def test_a_histogram_cannot_see_order_and_compression_can() -> None:
    slope = np.tile(np.arange(64), (64, 1))
    noise = np.random.default_rng(0).permutation(slope.ravel()).reshape(64, 64)
    for name in ("none", "huffman"):
        assert bits_after(noise, name) == pytest.approx(bits_after(slope, name))
    for name in ("lzw", "jpeg-ls"):
        assert bits_after(noise, name) > 3 * bits_after(slope, name)
    steps = slope // 16
    mixed = np.random.default_rng(0).permutation(steps.ravel()).reshape(64, 64)
    assert bits_after(mixed, "rle") > 3 * bits_after(steps, "rle")


def test_many_values_take_more_than_a_symbol_each() -> None:
    values = np.arange(1000).reshape(25, 40)
    assert bits_after(values, "lzw") > 8


def test_information_of_nothing_is_refused() -> None:
    with pytest.raises(CodecError, match="at least one value"):
        histogram_bits(np.zeros(0, np.int64))
    with pytest.raises(CodecError, match="shape \\(0, 3\\)"):
        bits_after(np.zeros((0, 3), np.int64), "none")
    with pytest.raises(CodecError, match="'zip' is none of"):
        bits_after(np.zeros((2, 3), np.int64), "zip")
