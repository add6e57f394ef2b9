"""What robots say comes back as it was said; what they can't have said is refused."""

import contextlib
import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.geometry import Pose
from agents.layers import Anchor, rounded_pose, rounded_variance
from agents.messages import (
    Fix,
    Status,
    TetherCommand,
    pack_anchor,
    pack_chunks,
    pack_fix,
    pack_status,
    pack_tethers,
    unpack_anchor,
    unpack_chunks,
    unpack_fix,
    unpack_status,
    unpack_tethers,
)
from agents.sharing.reports import (
    Acks,
    Held,
    Holdings,
    Report,
    Section,
    pack_report,
    unpack_report,
)
from agents.store import MAX_PAYLOAD_BYTES, AnchorKey, Chunk, TileKey
from agents.wire import MessageError, Reader, Writer

quick = settings(max_examples=60, deadline=None)
bytes_ = st.integers(0, 255)
uints = st.integers(0, 2**35 - 1)
lengths = st.floats(-1e6, 1e6)
poses = st.builds(Pose, lengths, lengths, lengths, st.floats(-math.pi, math.pi)).map(rounded_pose)
variances = st.tuples(*[st.floats(0.0, 1e6)] * 4).map(rounded_variance)
SENDER = (7, 2)

UNPACK: dict[str, Callable[[bytes], Any]] = {
    "map": lambda data: unpack_chunks(data, SENDER),
    "anchor": unpack_anchor,
    "report": unpack_report,
    "status": unpack_status,
    "fix": unpack_fix,
    "tether": unpack_tethers,
}


@st.composite
def chunks(draw: st.DrawFn) -> Chunk:
    origin = draw(st.sampled_from([SENDER, (7, 1), (0, 0), (255, 255)]))
    data = draw(st.binary(min_size=1, max_size=40))
    before, after = draw(st.integers(0, 300)), draw(st.integers(0, 300))
    key = TileKey(*origin, draw(uints), draw(uints))
    return Chunk(key, draw(uints), before + len(data) + after, before, data)


anchor_keys = st.builds(AnchorKey, bytes_, bytes_, uints)


@st.composite
def anchors(draw: st.DrawFn) -> Anchor:
    anchor = Anchor.at(draw(poses), draw(variances))
    for _ in range(draw(st.integers(0, 2))):
        anchor = anchor.moved_to(draw(poses), draw(variances))
    return anchor


@st.composite
def holdings(draw: st.DrawFn) -> Holdings:
    keys = sorted(draw(st.lists(anchor_keys, max_size=4, unique=True)))
    told = tuple((key, draw(st.integers(0, 9))) for key in keys)
    sections: list[Section] = []
    for key in keys if draw(st.booleans()) else keys[1:]:
        tiles = sorted(draw(st.lists(st.integers(0, 200), max_size=5)))
        first = draw(st.integers(0, min(tiles, default=5)))
        last = draw(st.integers(max(tiles, default=first), 300))
        held = tuple(Held(t, draw(st.integers(0, 99)), draw(st.integers(-1, 999))) for t in tiles)
        sections.append(Section(key, first, last, held))
    return Holdings(told, tuple(sections), draw(st.booleans()), draw(st.booleans()))


@st.composite
def acks(draw: st.DrawFn) -> Acks:
    numbers = sorted(draw(st.lists(st.integers(0, 10**6), max_size=6, unique=True)))
    missed = tuple(zip(numbers[::2], numbers[1::2], strict=False))
    upto = draw(st.integers(numbers[-1] + 1 if numbers else 0, 2**21))
    return Acks(draw(bytes_), draw(bytes_), upto, missed)


@st.composite
def reports(draw: st.DrawFn) -> Report:
    return Report(tuple(draw(st.lists(acks(), max_size=3))), draw(st.none() | holdings()))


decimetres = st.integers(-10_000, 10_000).map(lambda n: n / 10)
statuses = st.builds(
    Status,
    poses,
    variances,
    st.integers(0, 127),
    st.none() | st.tuples(decimetres, decimetres, decimetres),
    st.integers(0, 10_000).map(lambda n: n / 100),
    st.integers(0, 2**24 - 1),
    st.booleans(),
)
fixes = st.builds(Fix, bytes_, st.integers(0, 10**9).map(lambda n: n / 100), poses, variances)
commands = st.lists(
    st.builds(
        TetherCommand,
        bytes_,
        st.integers(0, 10**6).map(lambda n: n / 100),
        st.integers(0, 10**4).map(lambda n: n / 1000),
    ),
    max_size=4,
)
messages = st.one_of(
    st.lists(chunks(), max_size=4).map(lambda m: ("map", pack_chunks(m, SENDER), m)),
    st.tuples(anchor_keys, anchors()).map(lambda m: ("anchor", pack_anchor(*m), m)),
    reports().map(lambda m: ("report", pack_report(m), m)),
    statuses.map(lambda m: ("status", pack_status(m), m)),
    fixes.map(lambda m: ("fix", pack_fix(m), m)),
    commands.map(lambda m: ("tether", pack_tethers(m), m)),
)


@given(messages)
@settings(max_examples=200, deadline=None)
def test_every_message_comes_back_as_it_was_said(message: tuple[str, bytes, Any]) -> None:
    kind, data, said = message
    assert UNPACK[kind](data) == said


@given(messages, st.sampled_from(sorted(UNPACK)))
@settings(max_examples=100, deadline=None)
def test_what_was_said_as_one_kind_and_read_as_another_does_no_harm(
    message: tuple[str, bytes, Any], kind: str
) -> None:
    understood_or_refused(kind, message[1])


def understood_or_refused(kind: str, data: bytes) -> None:
    with contextlib.suppress(MessageError):
        UNPACK[kind](data)


@pytest.mark.parametrize("kind", sorted(UNPACK))
@given(data=st.binary(max_size=80))
@settings(max_examples=100, deadline=None)
def test_arbitrary_bytes_are_understood_whole_or_refused(kind: str, data: bytes) -> None:
    understood_or_refused(kind, data)


@given(messages, st.data())
@settings(max_examples=100, deadline=None)
def test_a_message_that_is_cut_or_altered_is_understood_whole_or_refused(
    message: tuple[str, bytes, Any], data: st.DataObject
) -> None:
    kind, payload, _ = message
    if not payload:
        return
    at = data.draw(st.integers(0, len(payload) - 1))
    understood_or_refused(kind, payload[:at])
    altered = bytearray(payload)
    altered[at] ^= data.draw(st.integers(1, 255))
    understood_or_refused(kind, bytes(altered))


@given(st.tuples(anchor_keys, anchors()), st.binary(min_size=1, max_size=9))
@quick
def test_what_goes_on_after_its_end_is_refused(said: Any, more: bytes) -> None:
    with pytest.raises(MessageError, match="goes on"):
        unpack_anchor(pack_anchor(*said) + more)
    with pytest.raises(MessageError, match="goes on"):
        unpack_fix(pack_fix(Fix(1, 2.0, said[1].pose, said[1].variance)) + more)


# --- the field kinds ------------------------------------------------------------------------


@given(uints, st.integers(-(2**34) + 1, 2**34 - 1))
@quick
def test_numbers_come_back_and_take_seven_bits_a_byte(whole: int, signed: int) -> None:
    out = Writer()
    out.uint(whole)
    assert len(out.data) == max(1, -(-whole.bit_length() // 7))
    out.sint(signed)
    reader = Reader(bytes(out.data))
    assert (reader.uint(), reader.sint(), reader.at_end) == (whole, signed, True)


@pytest.mark.parametrize(
    ("signed", "wire"), [(0, "00"), (-1, "01"), (1, "02"), (-2, "03"), (64, "8001")]
)
def test_signed_numbers_are_zigzag(signed: int, wire: str) -> None:
    out = Writer()
    out.sint(signed)
    assert out.data.hex() == wire


def test_a_number_without_end_is_refused() -> None:
    with pytest.raises(MessageError, match="5 bytes"):
        Reader(b"\xff" * 9).uint()


@given(poses, variances)
@quick
def test_what_travels_of_a_pose_is_what_its_origin_keeps(pose: Pose, variance: Any) -> None:
    out = Writer()
    out.pose(pose)
    out.variance(variance)
    reader = Reader(bytes(out.data))
    # Digests are taken of the text of anchors: equal is not enough.
    assert repr(reader.pose()) == repr(pose)
    assert repr(reader.variance()) == repr(variance)


def test_an_own_chunk_names_no_origin_and_a_whole_one_no_place() -> None:
    key = TileKey(*SENDER, 1, 2)
    own = pack_chunks([Chunk(key, 3, 5, 0, b"hello")], SENDER)
    assert own == bytes([6, 1, 2, 3, 5]) + b"hello"
    relayed = pack_chunks([Chunk(key, 3, 5, 0, b"hello")], (0, 0))
    assert relayed == bytes([7, *SENDER, 1, 2, 3, 5]) + b"hello"
    part = pack_chunks([Chunk(key, 3, 9, 2, b"hello")], SENDER)
    assert part == bytes([0, 1, 2, 3, 5, 2, 2]) + b"hello"


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (bytes([8, 0, 0, 1, 1]) + b"a", "flags are 8"),
        (bytes([6, 0, 0, 1, 0]), "0 bytes of 0"),
        (bytes([6, 0, 0, 1, 9]) + b"short", "9 bytes"),
    ],
)
def test_a_bad_chunk_is_refused_with_its_values(data: bytes, why: str) -> None:
    with pytest.raises(MessageError, match=why):
        unpack_chunks(data, SENDER)


def test_a_payload_beyond_the_largest_is_refused_before_it_is_made() -> None:
    out = Writer()
    for value in (2, 0, 0, 1, 1, MAX_PAYLOAD_BYTES):  # one byte, so many more to come
        out.uint(value)
    with pytest.raises(MessageError, match=f"of {MAX_PAYLOAD_BYTES + 1}"):
        unpack_chunks(bytes(out.data) + b"a", SENDER)


def test_a_report_that_promises_billions_is_refused_at_once() -> None:
    out = Writer()
    out.uint(2**35 - 1)
    with pytest.raises(MessageError):
        unpack_report(bytes(out.data))
    with pytest.raises(MessageError, match="section of submap 5"):
        unpack_report(bytes([1, 3, 5, 0, 0, 0]))
    with pytest.raises(MessageError, match="33 ranges"):
        unpack_report(bytes([2, 0, 0, 100, 33, *[0] * 66]))
    with pytest.raises(MessageError, match="number -1"):
        unpack_report(bytes([2, 0, 0, 3, 1, 0, 3]))


def test_a_report_out_of_order_is_refused() -> None:
    keys = (AnchorKey(1, 0, 0), AnchorKey(0, 0, 0))
    for pair in (keys, keys[:1] * 2):
        with pytest.raises(MessageError, match="order"):
            unpack_report(pack_report(Report((), Holdings(tuple((key, 1) for key in pair), ()))))


def test_a_report_speaks_of_the_run_of_submaps_that_it_names() -> None:
    low, middle, high = (AnchorKey(robot, 0, 0) for robot in (1, 3, 5))
    told = ((low, 1), (high, 1))
    outside = (AnchorKey(0, 9, 9), AnchorKey(6, 0, 0))
    for opens in (False, True):
        for closes in (False, True):
            said = Holdings(told, (), opens, closes)
            assert all(said.speaks_of(key) for key in (low, middle, high))
            assert [said.speaks_of(key) for key in outside] == [opens, closes]
    assert Holdings((), ()).speaks_of(low), "it has nothing at all"
    assert not Holdings((), (), opens=True, closes=False).speaks_of(low)
