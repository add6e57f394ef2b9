"""The store is a join semilattice: what was heard is the same everywhere, whatever the order."""

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.geometry import Pose
from agents.layers import Anchor
from agents.store import MAX_PAYLOAD_BYTES, AnchorKey, Chunk, Origin, Store, StoreError, TileKey

quick = settings(max_examples=60, deadline=None)
KEYS = (TileKey(0, 0, 0, 3), TileKey(0, 1, 0, 3), TileKey(2, 0, 1, 0))
SUBMAPS = (AnchorKey(0, 0, 0), AnchorKey(2, 0, 1))
MAX_VERSION = 4


def payload_of(key: TileKey, version: int) -> bytes:
    """Return the one payload that this version has: an origin freezes what it publishes."""
    rng = np.random.default_rng([*key, version])
    return rng.bytes(int(rng.integers(1, 24)))


def anchor_of(key: AnchorKey, version: int) -> Anchor:
    anchor = Anchor.at(Pose(*key, 0.25), (1e-4, 1e-4, 1e-4, 1e-6))
    for step in range(version):
        anchor = anchor.moved_to(Pose(*key, 0.25 + 0.1 * step), (1e-5, 1e-5, 1e-5, 1e-7))
    return anchor


@st.composite
def chunks(draw: st.DrawFn) -> Chunk:
    key = draw(st.sampled_from(KEYS))
    version = draw(st.integers(1, MAX_VERSION))
    payload = payload_of(key, version)
    start = draw(st.integers(0, len(payload) - 1))
    end = draw(st.integers(start + 1, len(payload)))
    return Chunk(key, version, len(payload), start, payload[start:end])


anchors = st.tuples(st.sampled_from(SUBMAPS), st.integers(0, 3))
News = tuple[list[Chunk], list[tuple[AnchorKey, int]]]
news = st.tuples(st.lists(chunks(), max_size=25), st.lists(anchors, max_size=4))


def store_of(heard: Iterable[Chunk], anchored: Iterable[tuple[AnchorKey, int]] = ()) -> Store:
    store = Store()
    for chunk in heard:
        store.offer(chunk)
    for key, version in anchored:
        store.offer_anchor(key, anchor_of(key, version))
    return store


def merged(*stores: Store) -> Store:
    result = Store()
    for store in stores:
        result.merge(store)
    return result


def contents(store: Store) -> object:
    held = [(k, v.number, v.total, bytes(v.data), v.ranges) for k, v in store.all_versions()]
    return held, store.anchors


def decodable(store: Store) -> object:
    held = [(k, v.number, v.total, v.prefix) for k, v in store.all_versions() if v.prefix_bytes]
    return held, store.anchors


def whole(key: TileKey, version: int) -> Chunk:
    payload = payload_of(key, version)
    return Chunk(key, version, len(payload), 0, payload)


# --- the merge ------------------------------------------------------------------------------


@given(news, news)
@quick
def test_merge_is_commutative(one: News, other: News) -> None:
    a, b = store_of(*one), store_of(*other)
    assert merged(a, b).digest() == merged(b, a).digest()


@given(news, news, news)
@quick
def test_merge_is_associative(one: News, two: News, three: News) -> None:
    a, b, c = store_of(*one), store_of(*two), store_of(*three)
    assert merged(merged(a, b), c).digest() == merged(a, merged(b, c)).digest()


@given(news)
@quick
def test_merge_is_idempotent(one: News) -> None:
    store = store_of(*one)
    before = contents(store)
    store.merge(store.copy())
    assert contents(store) == before
    assert merged(store).digest() == store.digest()


@given(news, news)
@quick
def test_merging_stores_is_hearing_all_that_either_heard(one: News, other: News) -> None:
    heard_all = store_of([*one[0], *other[0]], [*one[1], *other[1]])
    assert contents(merged(store_of(*one), store_of(*other))) == contents(heard_all)


@given(news, st.randoms(use_true_random=False))
@quick
def test_offers_end_in_the_same_store_in_any_order_and_repeated(one: News, luck) -> None:
    heard = [*one[0], *luck.choices(one[0], k=len(one[0]) // 2)] if one[0] else []
    anchored = [*one[1], *one[1]]
    luck.shuffle(heard)
    luck.shuffle(anchored)
    shuffled = store_of(heard, anchored)
    assert contents(shuffled) == contents(store_of(*one))
    assert shuffled.digest() == store_of(*one).digest()


@given(news)
@quick
def test_a_digest_is_equal_for_equal_stores_only(one: News) -> None:
    store = store_of(*one)
    digest = store.digest()
    for chunk in (whole(key, version) for key in KEYS for version in (1, MAX_VERSION)):
        other = store.copy()
        changed = other.offer(chunk)
        assert changed == (contents(other) != contents(store))
        assert (other.digest() != digest) == (decodable(other) != decodable(store))
    assert store.digest() == digest, "what happens to a copy must not reach the original"


def test_a_digest_is_of_the_bytes_too() -> None:
    digests = set[str]()
    for data in (b"one", b"two"):
        store = Store()
        store.offer(Chunk(KEYS[0], 1, 3, 0, data))
        digests.add(store.digest())
    assert len(digests) == 2


@given(st.lists(chunks(), max_size=30))
@quick
def test_offer_says_whether_the_store_changed(heard: list[Chunk]) -> None:
    store = Store()
    for chunk in heard:
        before = contents(store.copy())
        assert store.offer(chunk) == (contents(store) != before)
        assert not store.offer(chunk), "heard twice"


# --- what is kept ---------------------------------------------------------------------------


@given(st.lists(chunks(), max_size=40))
@quick
def test_what_can_be_decoded_is_given_up_only_for_something_newer_and_whole(
    heard: list[Chunk],
) -> None:
    store = Store()
    for chunk in heard:
        before = {(k, v.number): v.prefix_bytes for k, v in store.all_versions()}
        store.offer(chunk)
        after = {(k, v.number): v for k, v in store.all_versions()}
        for (key, number), prefix_bytes in before.items():
            if (key, number) in after:
                assert after[key, number].prefix_bytes >= prefix_bytes
            else:
                assert any(k == key and n > number and v.complete for (k, n), v in after.items())


@given(st.lists(chunks(), max_size=40))
@quick
def test_every_byte_that_is_kept_is_the_origins(heard: list[Chunk]) -> None:
    for key, version in store_of(heard).all_versions():
        payload = payload_of(key, version.number)
        assert version.total == len(payload)
        for start, end in version.ranges:
            assert version.data[start:end] == payload[start:end]
        assert version.prefix == payload[: version.prefix_bytes]
        gaps = [b[0] - a[1] for a, b in zip(version.ranges, version.ranges[1:], strict=False)]
        assert all(gap > 0 for gap in gaps), "ranges are apart and ascending"


def test_versions_below_the_newest_whole_one_go_and_those_above_stay() -> None:
    key = next(k for k in KEYS if all(len(payload_of(k, v)) > 1 for v in range(1, 5)))
    store = store_of([whole(key, 1), whole(key, 2)])
    assert [v.number for v in store.versions(key)] == [2]
    payload = payload_of(key, 4)
    store.offer(Chunk(key, 4, len(payload), 0, payload[:1]))
    assert [v.number for v in store.versions(key)] == [4, 2]
    assert not store.offer(whole(key, 1)), "older than what is whole: of no use"
    store.offer(whole(key, 3))
    assert [v.number for v in store.versions(key)] == [4, 3]
    newest = store.newest(key)
    assert newest is not None
    assert (newest.number, newest.prefix_bytes, newest.complete) == (4, 1, False)
    store.offer(Chunk(key, 4, len(payload), 1, payload[1:]))
    assert [(v.number, v.complete) for v in store.versions(key)] == [(4, True)]


def test_a_gap_hides_what_lies_behind_it_until_it_is_filled() -> None:
    key, payload = KEYS[0], bytes(range(10))
    store = Store()
    for start, end, prefix in ((6, 10, 0), (0, 2, 2), (3, 6, 2), (1, 4, 10)):
        assert store.offer(Chunk(key, 1, 10, start, payload[start:end]))
        newest = store.newest(key)
        assert newest is not None
        assert newest.prefix_bytes == prefix
        assert newest.prefix == payload[:prefix]
    assert newest.complete


def test_a_key_names_its_origin() -> None:
    assert TileKey(3, 2, 1, 0).origin == Origin(3, 2)


# --- what is refused ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("total", "offset", "data"),
    [
        (10, 0, b""),
        (10, 10, b"a"),
        (10, 9, b"ab"),
        (10, -1, b"ab"),
        (0, 0, b"a"),
        (-1, 0, b"a"),
        (MAX_PAYLOAD_BYTES + 1, 0, b"a"),
    ],
)
def test_a_chunk_outside_its_payload_is_refused_and_nothing_changes(
    total: int, offset: int, data: bytes
) -> None:
    store = store_of([whole(KEYS[0], 1)], [(SUBMAPS[0], 1)])
    before, digest = contents(store.copy()), store.digest()
    with pytest.raises(StoreError, match=str(total)):
        store.offer(Chunk(KEYS[0], 2, total, offset, data))
    assert contents(store) == before
    assert store.digest() == digest


@given(news, chunks(), st.integers(1, 40))
@quick
def test_a_chunk_of_another_length_than_its_version_is_refused_and_nothing_changes(
    one: News, chunk: Chunk, longer: int
) -> None:
    store = store_of([*one[0], chunk])
    held = {version.number for version in store.versions(chunk.key)}
    before, digest = contents(store.copy()), store.digest()
    wrong = Chunk(chunk.key, chunk.version, chunk.total + longer, chunk.offset, chunk.data)
    if chunk.version in held:
        with pytest.raises(StoreError, match=f"{chunk.total + longer} bytes in all"):
            store.offer(wrong)
        assert contents(store) == before
        assert store.digest() == digest


@given(st.permutations([0, 0, 1, 2, 2, 3, 3]))
@quick
def test_the_newest_anchor_wins_in_any_order(order: list[int]) -> None:
    key, store = SUBMAPS[0], Store()
    for place, version in enumerate(order):
        changed = store.offer_anchor(key, anchor_of(key, version))
        assert changed == all(version > earlier for earlier in order[:place])
    assert store.anchors[key] == anchor_of(key, 3)
