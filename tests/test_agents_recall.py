"""What many hear is decoded once, and is what each would have decoded."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.geometry import Floats
from agents.payloads import Pyramid
from agents.recall import RECALL, Recall
from comms.codec import CodecError


@dataclass
class Told:
    cells: Floats


class Decoder:
    def __init__(self) -> None:
        self.asked: list[bytes] = []

    def __call__(self, prefix: bytes) -> Told:
        self.asked.append(prefix)
        if not prefix:
            raise CodecError("nothing")
        return Told(np.full(3, float(prefix[0])))


@given(st.integers(0, 4), st.lists(st.binary(min_size=1, max_size=1), max_size=40))
def test_it_tells_what_the_decoder_tells_and_keeps_no_more_than_it_may(
    most: int, prefixes: list[bytes]
) -> None:
    recall, decoder = Recall(), Decoder()
    recall.keep(most)
    for at, prefix in enumerate(prefixes):
        before = len(decoder.asked)
        assert recall.of(decoder, prefix).cells.tolist() == [prefix[0]] * 3
        lately = list(dict.fromkeys(reversed(prefixes[:at])))[:most]
        assert (len(decoder.asked) == before) == (prefix in lately)


def test_what_is_kept_cant_be_written_to_and_is_forgotten_when_told_so() -> None:
    recall, decoder = Recall(), Decoder()
    recall.keep(8)
    with pytest.raises(ValueError, match="read-only"):
        recall.of(decoder, b"a").cells[0] = 7.0
    with pytest.raises(CodecError):
        recall.of(decoder, b"")
    with pytest.raises(CodecError):
        recall.of(decoder, b"")
    recall.keep(0)
    recall.keep(8)
    recall.of(decoder, b"a")
    assert decoder.asked == [b"a", b"", b"", b"a"]


def test_a_tile_is_read_the_same_from_bytes_and_from_memory() -> None:
    rng = np.random.default_rng(5)
    known = rng.random((16, 16)) < 0.8
    payload = Pyramid().encode(rng.normal(size=(16, 16)), known, np.full((16, 16), 0.05), 0.02)
    alone = Pyramid().decode(payload.data, (16, 16))
    RECALL.keep(4)
    try:
        first, again = (Pyramid().decode(payload.data, (16, 16)) for _ in range(2))
        other_shape = Pyramid().decode(payload.data, (8, 32))
    finally:
        RECALL.keep(0)
    assert alone is not None
    assert first is again
    assert again is not None
    assert other_shape is None
    np.testing.assert_array_equal(alone.elevation_m, again.elevation_m)
    np.testing.assert_array_equal(alone.sigma_m, again.sigma_m)


def test_processes_of_one_computer_share_a_folder_and_what_is_damaged_there_is_decoded_again(
    tmp_path: Path,
) -> None:
    first, other = Recall(), Recall()
    first.share(tmp_path)
    other.share(tmp_path)
    asked: list[bytes] = []

    def decode(prefix: bytes) -> Told:
        asked.append(prefix)
        return Told(np.frombuffer(prefix, np.uint8) + 1.0)

    assert first.of(decode, b"abc").cells.tolist() == other.of(decode, b"abc").cells.tolist()
    assert asked == [b"abc"]
    (kept,) = tmp_path.iterdir()
    kept.write_bytes(b"x" * 40)
    assert other.of(decode, b"abc").cells.tolist() == [98.0, 99.0, 100.0]
    assert asked == [b"abc", b"abc"]
    first.share(tmp_path / "gone")
    assert first.of(decode, b"abc").cells.tolist() == [98.0, 99.0, 100.0]
