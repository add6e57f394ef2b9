import hashlib
from itertools import pairwise

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from comms.errors import CommsError
from comms.frames import (
    ENVELOPE_BYTES,
    MAC_BYTES,
    MAX_FRAME_BYTES,
    MAX_SEQ,
    WIDEST_ENVELOPE_BYTES,
    WINDOW,
    BadVersionError,
    DamagedError,
    Frame,
    FrameError,
    Kind,
    OldIncarnationError,
    Opener,
    OversizedError,
    ReplayedError,
    Sealer,
    SealError,
    StrangerError,
)

KEY = b"a key of a team!"
TEAM = 4
quick = settings(max_examples=100, deadline=None)


def sealed_by_hand(body: bytes, key: bytes = KEY) -> bytes:
    return body + hashlib.blake2s(body, key=key, digest_size=6, person=b"ropeteam").digest()


def sealed_at(seq: int, sender: int = 1, incarnation: int = 0, payload: bytes = b"") -> bytes:
    sealer = Sealer(KEY, sender, incarnation)
    sealer._next_seq = seq
    return sealer.seal(Kind.MAP, payload)


@quick
@given(
    st.sampled_from(Kind),
    st.binary(max_size=600),
    st.integers(0, TEAM - 1),
    st.integers(0, 255),
    st.integers(0, MAX_SEQ),
)
def test_what_is_sealed_opens_the_same(kind, payload, sender, incarnation, seq):
    sealer = Sealer(KEY, sender, incarnation)
    sealer._next_seq = seq
    data = sealer.seal(kind, payload)
    assert Opener(KEY, TEAM).open(data) == Frame(sender, incarnation, seq, kind, payload)
    assert len(data) - len(payload) <= ENVELOPE_BYTES


def test_layout_is_the_documented_one():
    data = sealed_at(300, sender=2, incarnation=7, payload=b"xyz")
    assert data == sealed_by_hand(bytes((0xB1, 2, 7, 0x80 | 300 & 0x7F, 300 >> 7)) + b"xyz")


@pytest.mark.parametrize("sender", [127, 128, 999, (1 << 14) - 1])
def test_a_robot_beyond_the_first_128_costs_one_byte_more(sender):
    sealer = Sealer(KEY, sender, 3)
    data = sealer.seal(Kind.MAP, b"xyz")
    assert len(data) == 3 + 10 + (sender > 127)
    assert sealer.envelope_bytes == ENVELOPE_BYTES + (sender > 127) <= WIDEST_ENVELOPE_BYTES
    assert Opener(KEY, 1 << 14).open(data) == Frame(sender, 3, 0, Kind.MAP, b"xyz")


@pytest.mark.parametrize(
    ("seq", "envelope_bytes"), [(0, 10), (127, 10), (128, 11), (16383, 11), (16384, 12)]
)
def test_envelope_is_short(seq, envelope_bytes):
    assert len(sealed_at(seq)) == envelope_bytes <= ENVELOPE_BYTES


@quick
@given(st.binary(max_size=200))
def test_noise_never_opens_and_always_says_why(data):
    with pytest.raises(FrameError) as caught:
        Opener(KEY, TEAM).open(data)
    assert caught.value.reason in {"damaged", "bad-version"}


@quick
@given(st.binary(max_size=60), st.data())
def test_a_flipped_bit_never_opens(payload, data):
    frame = bytearray(sealed_at(5, payload=payload))
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[bit // 8] ^= 1 << bit % 8
    opener = Opener(KEY, TEAM)
    with pytest.raises((DamagedError, BadVersionError)):
        opener.open(bytes(frame))
    assert opener.open(sealed_at(5, payload=payload)).payload == payload


@quick
@given(st.binary(max_size=60), st.data())
def test_a_cut_frame_never_opens(payload, data):
    frame = sealed_at(5, payload=payload)
    end = data.draw(st.integers(0, len(frame) - 1))
    with pytest.raises(DamagedError):
        Opener(KEY, TEAM).open(frame[:end])


def test_another_key_is_damage():
    with pytest.raises(DamagedError):
        Opener(b"the key of others", TEAM).open(sealed_at(0))


def test_a_damaged_frame_changes_nothing():
    # Its number and incarnation must not be believed: both would shut its sender out.
    opener = Opener(KEY, TEAM)
    forged = bytearray(sealed_at(100, incarnation=9))
    forged[-1] ^= 1
    with pytest.raises(DamagedError):
        opener.open(bytes(forged))
    assert opener.open(sealed_at(0)).seq == 0


@quick
@given(st.permutations(range(40)), st.lists(st.integers(0, 39), max_size=20))
def test_reordered_frames_pass_once_each(order, again):
    opener = Opener(KEY, TEAM)
    frames = [sealed_at(seq) for seq in range(40)]
    assert [opener.open(frames[seq]).seq for seq in order] == list(order)
    for seq in again:
        with pytest.raises(ReplayedError):
            opener.open(frames[seq])


@quick
@given(st.lists(st.integers(0, 3 * WINDOW) | st.integers(0, MAX_SEQ), max_size=60))
@example([10, 10 + WINDOW + 1, 10 + WINDOW, 10, 11, 12])
def test_window_agrees_with_a_remembered_set(numbers):
    opener, newest, seen = Opener(KEY, TEAM), -1, set()
    for seq in numbers:
        fresh = seq not in seen and (newest < 0 or seq > newest - WINDOW)
        if fresh:
            assert opener.open(sealed_at(seq)).seq == seq
            newest = max(newest, seq)
            seen.add(seq)
        else:
            with pytest.raises(ReplayedError):
                opener.open(sealed_at(seq))


def test_a_new_incarnation_ends_the_old_one():
    opener = Opener(KEY, TEAM)
    opener.open(sealed_at(50, incarnation=3))
    assert opener.open(sealed_at(0, incarnation=4)).incarnation == 4
    with pytest.raises(OldIncarnationError):
        opener.open(sealed_at(51, incarnation=3))
    assert opener.open(sealed_at(0, sender=2, incarnation=1)).sender == 2


def test_strangers_own_frames_versions_kinds_and_giants_are_refused():
    opener = Opener(KEY, TEAM, own=0)
    with pytest.raises(StrangerError, match=r"sender index is 4; the roster has 4"):
        opener.open(sealed_at(0, sender=TEAM))
    with pytest.raises(ReplayedError):
        opener.open(sealed_at(0, sender=0))
    with pytest.raises(BadVersionError, match="version is 12"):
        opener.open(sealed_by_hand(b"\xc1\x01\x00\x00"))
    with pytest.raises(BadVersionError, match="kind is 15"):
        opener.open(sealed_by_hand(b"\xbf\x01\x00\x00"))
    with pytest.raises(OversizedError):
        opener.open(sealed_by_hand(b"\xb1\x01\x00\x00" + bytes(MAX_FRAME_BYTES)))
    with pytest.raises(DamagedError, match="sequence"):
        opener.open(sealed_by_hand(b"\xb1\x01\x00\x80\x80\x80"))
    with pytest.raises(DamagedError, match="sequence"):
        opener.open(sealed_by_hand(b"\xb1\x01\x00\x80"))


def test_reasons_are_a_fixed_vocabulary():
    reasons = {cls.reason for cls in FrameError.__subclasses__()}
    assert reasons == {
        "damaged",
        "stranger",
        "replayed",
        "old-incarnation",
        "bad-version",
        "oversized",
    }
    assert issubclass(FrameError, CommsError)


def test_sealer_numbers_frames_and_refuses_what_cannot_be_sent():
    sealer, opener = Sealer(KEY, 3, 0), Opener(KEY, TEAM)
    numbers = [opener.open(sealer.seal(Kind.STATUS, b"")).seq for _ in range(200)]
    assert all(b == a + 1 for a, b in pairwise(numbers))
    with pytest.raises(SealError, match="payload has"):
        sealer.seal(Kind.MAP, bytes(MAX_FRAME_BYTES))
    sealer._next_seq = MAX_SEQ + 1
    with pytest.raises(SealError, match="sequence number is"):
        sealer.seal(Kind.MAP, b"")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Sealer(b"short", 0, 0), "key has 5 bytes; 16 to 32"),
        (lambda: Sealer(KEY, 1 << 14, 0), "sender index is 16384; 0 to 16383"),
        (lambda: Sealer(KEY, 0, 256), "incarnation is 256; 0 to 255"),
        (lambda: Opener(KEY, 0), "team size is 0; 1 to 16384"),
        (lambda: Opener(bytes(33), 2), "key has 33 bytes; 16 to 32"),
    ],
)
def test_bad_identity_is_refused(make, words):
    with pytest.raises(SealError, match=words):
        make()


def test_code_is_six_bytes_of_a_keyed_hash():
    assert sealed_at(0)[-MAC_BYTES:] == sealed_by_hand(sealed_at(0)[:-MAC_BYTES])[-MAC_BYTES:]


def test_memory_of_a_sender_stays_within_the_window():
    opener = Opener(KEY, TEAM)
    for seq in range(3 * WINDOW):
        opener.open(sealed_at(seq))
    assert opener._heard[1].seen.bit_length() <= WINDOW
