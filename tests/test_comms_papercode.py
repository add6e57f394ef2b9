"""The paper's map codec as a whole: what comes back, what is measured, what is refused."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from comms.codec import CodecError
from comms.papercode import COMPRESSORS, decode_paper_map, encode_paper_map

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def ground(side: int, seed: int = 1) -> Floats:
    """Return rough ground with a step and boulders."""
    rng = np.random.default_rng(seed)
    z = np.cumsum(np.cumsum(rng.normal(size=(side, side)), 0), 1)
    z = z / z.std() + 2.0 * (np.arange(side) > side // 2)[:, None]
    z[rng.integers(0, side, 8), rng.integers(0, side, 8)] += 0.7
    return z


@st.composite
def maps(draw: st.DrawFn) -> tuple[Floats, Bools]:
    rows, cols = draw(st.integers(1, 24)), draw(st.integers(1, 24))
    rng = np.random.default_rng(draw(st.integers(0, 999)))
    z = draw(st.sampled_from([0.0, -4500.0, 1e6])) + rng.normal(size=(rows, cols)).cumsum(1)
    known = rng.random((rows, cols)) < draw(st.sampled_from([0.0, 0.05, 0.7, 1.0]))
    z[~known] = draw(st.sampled_from([0.0, np.nan, np.inf]))
    return z, known


@settings(max_examples=100, deadline=None)
@given(
    given_map=maps(),
    max_error_m=st.sampled_from([0.01, 0.3, 20.0]),
    cutoff_bits=st.sampled_from([0.0, 0.5, 2.0]),
    compressor=st.sampled_from(COMPRESSORS),
    critical=st.sampled_from([1.0, 3.0, 9000.0]),
    with_sigma=st.booleans(),
)
def test_the_receiver_gets_what_the_sender_measured(
    given_map: tuple[Floats, Bools],
    max_error_m: float,
    cutoff_bits: float,
    compressor: str,
    critical: float,
    with_sigma: bool,
) -> None:
    z, known = given_map
    sigma_m = np.full(z.shape, 0.1) if with_sigma else None
    sent = encode_paper_map(
        z,
        known,
        max_error_m,
        sigma_m=sigma_m,
        cutoff_bits=cutoff_bits,
        compressor=compressor,
        critical_cells=critical,
    )
    found = decode_paper_map(sent.data)
    assert np.array_equal(found.known, known)
    assert np.isnan(found.elevation_m[~known]).all()
    errors_m = np.abs(found.elevation_m.astype(np.float64) - z)[known]
    assert errors_m.max(initial=0.0) == sent.max_error_m
    assert np.sqrt(np.mean(errors_m**2)) == pytest.approx(sent.rmse_m) if errors_m.size else True
    assert (found.sigma_m is not None) == with_sigma
    if found.sigma_m is not None:
        assert np.array_equal(np.isfinite(found.sigma_m), known)
        assert (found.sigma_m[known] >= np.hypot(0.1, max_error_m / 3**0.5) - 1e-6).all()


@settings(max_examples=40, deadline=None)
@given(given_map=maps(), max_error_m=st.sampled_from([0.01, 0.3, 20.0]))
def test_at_a_cut_off_of_0_bits_and_no_decimation_the_error_is_half_a_bin(
    given_map: tuple[Floats, Bools], max_error_m: float
) -> None:
    z, known = given_map
    sent = encode_paper_map(z, known, max_error_m, cutoff_bits=0.0, pebble_m=0.0)
    float32_m = float(np.spacing(np.float32(np.abs(z[known]).max(initial=0.0))))
    assert sent.max_error_m <= max_error_m * (1 + 1e-6) + float32_m


def test_the_cut_off_bounds_no_error() -> None:
    # One boulder among 4096 cells: 0.0033 bits per cell, so its quadrant is one leaf.
    z = np.zeros((64, 64))
    z[20:22, 20:22] = 3.0
    sent = encode_paper_map(z, np.ones(z.shape, np.bool_), 0.05)
    assert sent.leaves == 1
    assert sent.max_error_m > 50 * 0.05


def test_leaves_have_the_mean_of_their_known_cells() -> None:
    z = np.array([[1.0, 3.0], [5.0, 100.0]])
    known = np.array([[True, True], [True, False]])
    sent = encode_paper_map(z, known, 0.05, cutoff_bits=2.0, pebble_m=0.0)
    found = decode_paper_map(sent.data).elevation_m
    assert found[known] == pytest.approx([3.0] * 3, abs=0.05)
    assert sent.max_error_m == pytest.approx(2.0, abs=0.05)


def test_a_higher_cut_off_and_a_larger_critical_size_take_fewer_leaves() -> None:
    z, known = ground(64), np.ones((64, 64), np.bool_)
    leaves = [encode_paper_map(z, known, 0.05, cutoff_bits=bits).leaves for bits in (0, 0.5, 1, 2)]
    assert leaves == sorted(leaves, reverse=True)
    assert leaves[0] > 2 * leaves[-1]
    coarse = encode_paper_map(z, known, 0.05, critical_cells=4.0)
    assert coarse.leaves <= 64 * 64 / 16


def test_sigma_tells_of_the_spread_in_a_leaf() -> None:
    z = np.zeros((32, 32))
    z[3, 3] = 4.0
    known = np.ones(z.shape, np.bool_)
    sent = encode_paper_map(z, known, 0.05, sigma_m=np.full(z.shape, 0.02))
    found = decode_paper_map(sent.data)
    assert sent.leaves == 1
    assert found.sigma_m is not None
    expected_m = np.sqrt(z.std() ** 2 + 0.02**2 + 0.1**2 / 12)
    assert expected_m <= found.sigma_m[0, 0] <= 1.42 * expected_m
    assert 0 < sent.sigma_bytes < len(sent.data)


def test_compressors_stand_in_the_order_that_their_means_give_them() -> None:
    z, known = ground(256), np.ones((256, 256), np.bool_)
    sizes = {
        name: len(encode_paper_map(z, known, 0.02, compressor=name).data) for name in COMPRESSORS
    }
    assert sizes["lzw"] < 1.15 * sizes["huffman"]
    assert sizes["lzw"] < sizes["rle"]
    assert sizes["jpeg-ls"] < sizes["lzw"]


def test_a_map_of_320_x_320_is_sent_in_less_than_300_ms() -> None:
    z, known = ground(320), np.ones((320, 320), np.bool_)
    sigma_m = np.full(z.shape, 0.03)
    encode_paper_map(z[:8, :8], known[:8, :8], 0.05, sigma_m=sigma_m[:8, :8])
    start = time.process_time()
    sent = encode_paper_map(z, known, 0.05, sigma_m=sigma_m)
    decode_paper_map(sent.data)
    assert time.process_time() - start < 0.3


# --- what is refused ------------------------------------------------------------------------------


@settings(max_examples=100, deadline=None)
@given(data=st.binary(max_size=80))
def test_any_bytes_are_a_map_or_refused(data: bytes) -> None:
    try:
        found = decode_paper_map(data, max_cells=10_000)
    except CodecError:
        return
    assert found.elevation_m.size <= 10_000


@settings(max_examples=100, deadline=None)
@given(
    compressor=st.sampled_from(COMPRESSORS),
    cut=st.integers(0, 400),
    flips=st.lists(st.tuples(st.integers(0, 10_000), st.integers(1, 255)), max_size=3),
)
def test_damaged_maps_are_maps_or_refused(
    compressor: str, cut: int, flips: list[tuple[int, int]]
) -> None:
    z, known = ground(24), np.random.default_rng(0).random((24, 24)) < 0.8
    sigma_m = np.abs(z) + 0.01
    sent = encode_paper_map(z, known, 0.1, sigma_m=sigma_m, compressor=compressor)
    data = bytearray(sent.data[: len(sent.data) - cut])
    for at, flip in flips:
        if data:
            data[at % len(data)] ^= flip
    try:
        found = decode_paper_map(bytes(data), max_cells=100_000)
    except CodecError:
        return
    assert np.isfinite(found.elevation_m[found.known]).all()


def test_bytes_too_many_or_too_few_are_refused() -> None:
    z, known = ground(16), np.ones((16, 16), np.bool_)
    data = encode_paper_map(z, known, 0.1).data
    for wrong in (b"", data[:-1], data + b"\0", data[:7]):
        with pytest.raises(CodecError):
            decode_paper_map(wrong)


def test_a_few_bytes_cannot_ask_for_a_large_grid() -> None:
    data = encode_paper_map(np.zeros((500, 500)), np.ones((500, 500), np.bool_), 0.1).data
    assert len(data) < 30
    with pytest.raises(CodecError, match="500 x 500 cells is above 4096"):
        decode_paper_map(data, max_cells=4096)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"max_error_m": 0.0}, "bound of 0.0 m"),
        ({"cutoff_bits": -1.0}, "cut-off of -1.0 bits"),
        ({"cutoff_bits": float("nan")}, "cut-off of nan bits"),
        ({"compressor": "zip"}, "'zip' is none of lzw"),
        ({"critical_cells": 0.5}, "critical size of 0.5 cells"),
        ({"pebble_m": -0.1}, "pebbles of -0.1 m"),
        ({"max_error_m": 1e-20}, "too fine for"),
        ({"sigma_m": np.zeros((2, 2))}, "must be one grid"),
        ({"sigma_m": np.full((4, 4), -1.0)}, "standard deviation of -1.0 m"),
    ],
)
def test_choices_that_make_no_sense_are_refused(changes: dict[str, object], words: str) -> None:
    choices: dict[str, object] = {"max_error_m": 0.1} | changes
    with pytest.raises(CodecError, match=words):
        encode_paper_map(ground(4), np.ones((4, 4), np.bool_), **choices)  # type: ignore[arg-type]
