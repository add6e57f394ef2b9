"""What robots tell each other ends in equal stores, whatever the links do; then they are quiet."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import count, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from team_helpers import (
    FRAME,
    GRID,
    GRIDS,
    KINDS,
    LOOKS,
    SURE,
    chunks_of,
    cut,
    laid_out,
    layer,
    look,
    sharing,
    team_map,
)

from agents.geometry import Pose
from agents.layers import OwnLayer
from agents.maps.elevation import Submap
from agents.maps.elevationlook import LookCells
from agents.messages import (
    CHUNK_HEADER_BYTES,
    pack_anchor,
    pack_chunks,
    unpack_anchor,
    unpack_chunks,
)
from agents.settings import SharingSettings
from agents.sharing import Free, Heard, Mark
from agents.sharing.beliefs import GUARD_S, KEPT_VERSIONS, Beliefs, Stretch, prefix_of
from agents.sharing.repair import DEAF_FRAMES, Repair
from agents.sharing.reports import Acks, Report, unpack_report
from agents.store import AnchorKey, Chunk, Origin, Store, TileKey, Version
from comms.frames import Kind

quick = settings(max_examples=12, deadline=None)
seeds = st.integers(0, 2**32 - 1)
RATE_BPS = 9600.0
PAYLOAD_BYTES = 200
STATUS_S = 60.0
Hears = Callable[[int, int, float], bool]
"""Whether (sender, receiver) works at a time in seconds."""


def always(sender: int, receiver: int, now_s: float) -> bool:
    del sender, receiver, now_s
    return True


class Mind:
    """A robot's store, layer and sharing, as `agents.robot` joins them; no body, radio or clock."""

    def __init__(self, index: int, team_size: int, own: OwnLayer | None = None, **options) -> None:
        self.me = Origin(index, 0)
        policy = options.get("settings", SharingSettings()).policy
        self.team = team_map(self.me, own, policy=policy, kind=options.pop("kind", "elevation"))
        self.journal: list[Chunk] = []
        self.sharing = sharing(self.team, team_size, self.journal, **options)
        self.seq = 0
        self.known: set[int] = set()
        self.told_s = -1e9
        self.measured(range(len(self.team.own.submaps)))

    @property
    def store(self) -> Store:
        return self.team.store

    def measured(self, submaps) -> None:
        for index in submaps:
            known = self.team.own.submaps[index].known
            self.sharing.own_tiles_changed(index, self.team.grid.touched(known))
        self.team.own_changed()

    def choose(self, now_s: float, payload_bytes: int) -> tuple[Kind, bytes] | None:
        chosen = self.sharing.choose(Free(now_s, payload_bytes, RATE_BPS, self.seq))
        self.seq += chosen is not None
        return chosen

    def mark(self) -> Mark:
        return Mark(self.store.mark, self.sharing.settled())

    def take(self, frame: "Sent", now_s: float) -> None:
        heard = Heard(Origin(frame.sender, 0), frame.seq, now_s)
        if frame.sender not in self.known:
            self.known.add(frame.sender)
            self.sharing.newcomer(frame.sender)
        self.sharing.heard_frame(heard)
        if frame.kind == Kind.ANCHOR:
            key, anchor = unpack_anchor(frame.payload)
            self.store.offer_anchor(key, anchor)
            self.team.own_changed()
            self.sharing.heard_anchor(heard, key, anchor.version)
        elif frame.kind == Kind.DIGEST:
            self.sharing.heard_report(heard, unpack_report(frame.payload))
        elif frame.kind == Kind.STATUS:
            assert frame.mark is not None
            self.sharing.heard_mark(heard, frame.mark)
        else:
            taken = []
            for chunk in unpack_chunks(frame.payload, (frame.sender, 0)):
                changed = self.store.offer(chunk)
                if changed:
                    self.team.tile_changed(chunk.key)
                taken.append((chunk, changed))
            self.sharing.heard_chunks(heard, taken)


@dataclass
class Sent:
    t_s: float
    sender: int
    kind: Kind
    payload: bytes
    seq: int
    mark: Mark | None = None


@dataclass
class Gossip:
    """A team on lossy links, told step by step; nothing else connects its minds."""

    minds: dict[int, Mind]
    hears: Hears = always
    loss: float = 0.0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    payload_bytes: int = PAYLOAD_BYTES
    now_s: float = 0.0
    sent: list[Sent] = field(default_factory=list)

    def step(self) -> bool:
        """Let everybody say one thing; return whether anybody did."""
        said: list[Sent] = []
        for index, mind in sorted(self.minds.items()):
            if self.now_s - mind.told_s >= STATUS_S:
                mind.told_s = self.now_s
                said.append(Sent(self.now_s, index, Kind.STATUS, b"", mind.seq, mind.mark()))
                mind.seq += 1
                continue
            chosen = mind.choose(self.now_s, self.payload_bytes)
            if chosen is not None:
                assert len(chosen[1]) <= self.payload_bytes
                said.append(Sent(self.now_s, index, *chosen, mind.seq - 1))
        for frame in said:
            for index in sorted(self.minds):
                if index == frame.sender or not self.hears(frame.sender, index, self.now_s):
                    continue
                if self.rng.random() >= self.loss:
                    self.minds[index].take(frame, self.now_s)
        self.sent += said
        self.now_s += 8 * self.payload_bytes / RATE_BPS if said else 2 * GUARD_S
        return bool(said)

    def run(self, until_s: float) -> None:
        while self.now_s < until_s:
            self.step()

    def run_until_equal(self, limit_s: float = 40_000.0) -> None:
        """Go on until all have settled on the same."""
        while self.now_s < limit_s:
            if not self.step() and self.equal and all(m.sharing.settled() for m in self.all):
                return
        raise AssertionError(f"not equal: {[len(m.store.keys()) for m in self.all]}")

    @property
    def all(self) -> list[Mind]:
        return [self.minds[index] for index in sorted(self.minds)]

    @property
    def equal(self) -> bool:
        return len({mind.store.digest() for mind in self.all}) == 1

    def kinds(self, after_s: float = -1.0) -> list[Kind]:
        """Return what was sent; statuses go without saying."""
        said = [frame.kind for frame in self.sent if frame.t_s > after_s]
        return [kind for kind in said if kind != Kind.STATUS]

    def chunks(self, sender: int | None = None) -> list[Chunk]:
        return [
            chunk
            for frame in self.sent
            if frame.kind == Kind.MAP and sender in (None, frame.sender)
            for chunk in unpack_chunks(frame.payload, (frame.sender, 0))
        ]


def team(seed: int, mappers: int, size: int, **options) -> Gossip:
    rng = np.random.default_rng(seed)
    minds = {
        index: Mind(
            index,
            size,
            layer(rng, kind=options.get("kind", "elevation")) if index < mappers else None,
            **options,
        )
        for index in range(size)
    }
    return Gossip(minds, rng=rng)


def has_all_of(mind: Mind, origin: Mind) -> bool:
    keys = [key for key in origin.store if key.origin == origin.me]
    return bool(keys) and all(
        (mine := mind.store.newest(key)) is not None
        and (theirs := origin.store.newest(key)) is not None
        and (mine.number, mine.prefix) == (theirs.number, theirs.prefix)
        for key in keys
    )


# --- all in all -----------------------------------------------------------------------------


@given(seed=seeds, payload_bytes=st.sampled_from([52, 120, 200, 1000]))
@quick
@pytest.mark.parametrize("kind", KINDS)
def test_when_everything_is_heard_two_robots_end_equal(
    kind: str, seed: int, payload_bytes: int
) -> None:
    gossip = team(seed, 2, 2, kind=kind)
    gossip.payload_bytes = payload_bytes
    gossip.run_until_equal(3000.0)
    for mind, other in (gossip.all, gossip.all[::-1]):
        own, heard = other.team.own.submaps[0], mind.team.published_mask(other.me, 0)
        assert not (heard & ~own.known).any()
        for tile in map(GRIDS[kind].window, range(GRIDS[kind].count)):
            # A few cells in the corner of a tile are not worth a frame's bytes.
            bits, size_bytes = other.team.kind.offer(own, tile)
            worth_bytes = bits / other.team.kind.least_bits_per_byte
            is_little = worth_bytes <= size_bytes + CHUNK_HEADER_BYTES
            assert is_little or np.array_equal(laid_out(heard)[tile], laid_out(own.known)[tile])


@given(seeds)
@quick
def test_no_byte_of_a_map_is_sent_twice_where_nothing_is_lost(seed: int) -> None:
    gossip = team(seed, 2, 3)
    gossip.run_until_equal(3000.0)
    sent: dict[tuple[TileKey, int], list[tuple[int, int]]] = {}
    for chunk in gossip.chunks():
        stretch = (chunk.offset, chunk.offset + len(chunk.data))
        sent.setdefault((chunk.key, chunk.version), []).append(stretch)
    for stretches in sent.values():
        ordered = sorted(stretches)
        assert all(a[1] <= b[0] for a, b in pairwise(ordered))


@given(seed=seeds, loss=st.floats(0.05, 0.5))
@quick
@pytest.mark.parametrize("kind", KINDS)
def test_with_frames_lost_at_random_all_end_equal(kind: str, seed: int, loss: float) -> None:
    gossip = team(seed, 2, 3, kind=kind)
    gossip.loss = loss
    gossip.run_until_equal()


@given(seed=seeds)
@quick
@pytest.mark.parametrize("kind", KINDS)
def test_while_robots_go_on_measuring_all_end_equal(kind: str, seed: int) -> None:
    gossip = team(seed, 2, 3, kind=kind)
    gossip.loss = 0.2
    for _ in range(6):
        gossip.run(gossip.now_s + float(gossip.rng.uniform(1, 60)))
        mind = gossip.minds[int(gossip.rng.integers(2))]
        if gossip.rng.random() < 0.3:
            mind.team.own.begin_submap(Pose(16.0, 2.0, 0.0, 0.0), SURE)
        mind.team.own.submaps[-1].observe(LOOKS[kind](gossip.rng))
        mind.measured([len(mind.team.own.submaps) - 1])
    gossip.run_until_equal()
    for mind in gossip.all[:2]:
        for index, submap in enumerate(mind.team.own.submaps):
            # What is left unpublished was not worth its bytes; what was heard is never more.
            assert not (gossip.all[2].team.published_mask(mind.me, index) & ~submap.known).any()


def test_a_team_that_has_settled_says_nothing_but_that_it_is_there() -> None:
    gossip = team(1, 2, 3)
    gossip.run_until_equal()
    quiet_s = gossip.now_s
    gossip.run(quiet_s + 3600.0)
    assert gossip.kinds(quiet_s) == []


def test_where_nothing_is_lost_reports_are_a_first_word_and_no_more() -> None:
    gossip = team(1, 2, 3)
    gossip.run_until_equal()
    reports = [frame for frame in gossip.sent if frame.kind == Kind.DIGEST]
    assert len(reports) == 3
    assert all(len(frame.payload) < 24 for frame in reports)


def test_a_lost_frame_is_named_by_its_number_and_sent_again() -> None:
    gossip = team(3, 1, 3)
    gossip.payload_bytes = 60
    gossip.hears = lambda sender, receiver, now_s: not (receiver == 2 and 0.08 < now_s < 0.17)
    gossip.run_until_equal(600.0)
    reports = [f for f in gossip.sent if f.kind == Kind.DIGEST and f.t_s > 0.2]
    assert {frame.sender for frame in reports} == {2}
    assert all(len(frame.payload) < 12 for frame in reports)


def test_a_robot_with_nothing_to_tell_says_what_it_has_first_of_all() -> None:
    gossip = team(2, 1, 2)
    gossip.run(1.0)
    first = [(f.sender, f.kind) for f in gossip.sent if f.kind != Kind.STATUS][:2]
    assert first == [(0, Kind.DIGEST), (1, Kind.DIGEST)] or first[0] == (0, Kind.ANCHOR)


# --- relays ---------------------------------------------------------------------------------


@given(seeds, st.sampled_from([0.0, 0.2]))
@quick
def test_who_hears_only_a_neighbour_gets_the_layer_of_the_one_behind(
    seed: int, loss: float
) -> None:
    gossip = team(seed, 2, 3)
    gossip.hears = lambda sender, receiver, now_s: abs(sender - receiver) == 1
    gossip.loss = loss
    gossip.run_until_equal()
    assert has_all_of(gossip.minds[2], gossip.minds[0])
    assert any(chunk.key.robot == 0 for chunk in gossip.chunks(sender=1))


def test_a_dead_robots_layer_lives_on_and_reaches_a_latecomer() -> None:
    gossip = team(4, 1, 3)
    late = gossip.minds.pop(2)
    gossip.run_until_equal()
    dead = gossip.minds.pop(0)
    gossip.minds[2] = late
    gossip.run_until_equal()
    assert has_all_of(late, dead)
    assert late.store.anchors == dead.store.anchors


def test_all_who_have_a_map_tell_a_newcomer_their_part_of_it() -> None:
    told, all_bytes = dict.fromkeys(range(4), 0), 0
    for seed in range(8):
        gossip = team(seed, 1, 4)
        late = gossip.minds.pop(3)
        gossip.run_until_equal()
        gossip.minds[3], joined_s = late, gossip.now_s
        gossip.payload_bytes = 52
        gossip.run_until_equal()
        all_bytes += late.store.payload_bytes
        for frame in gossip.sent:
            if frame.kind == Kind.MAP and frame.t_s >= joined_s:
                told[frame.sender] += len(frame.payload)
    assert told[3] == 0, "it heard all of it from those who have it"
    assert min(told[sender] for sender in range(3)) > 0.12 * all_bytes
    assert sum(told.values()) < 1.35 * all_bytes


def test_who_has_its_turn_and_says_nothing_is_not_waited_for() -> None:
    """One of two that have the map cannot be heard by the newcomer, which nobody knows yet."""
    gossip = team(2, 1, 3)
    late = gossip.minds.pop(2)
    gossip.run_until_equal()
    gossip.minds[2], joined_s = late, gossip.now_s
    gossip.hears = lambda sender, receiver, now_s: (sender, receiver) != (0, 2)
    gossip.run_until_equal()
    assert has_all_of(late, gossip.minds[0])
    last_s = max(f.t_s for f in gossip.sent if f.kind == Kind.MAP)
    assert last_s - joined_s < 120.0


@given(seeds, st.floats(0.0, 0.4))
@quick
def test_survivors_of_a_robot_that_dies_in_mid_word_end_equal(seed: int, loss: float) -> None:
    """What one of them heard in part, and the version before it, count too."""
    gossip = team(seed, 1, 3)
    gossip.loss = loss
    gossip.payload_bytes = 52
    gossip.run(float(gossip.rng.uniform(1, 40)))
    teller = gossip.minds[0]
    for _ in range(3):
        teller.team.own.submaps[0].observe(look(gossip.rng))
    teller.measured([0])
    gossip.run(gossip.now_s + float(gossip.rng.uniform(0, 3)))
    gossip.minds.pop(0)
    known = [mind.team.known_entries() for mind in gossip.all]
    gossip.run_until_equal()
    for mind, before in zip(gossip.all, known, strict=True):
        assert mind.team.known_entries() >= before
    one, other = (mind.team.fused() for mind in gossip.all)
    assert np.array_equal(one.variance_m2, other.variance_m2)


def test_an_older_version_is_told_as_long_as_the_newer_one_is_here_in_part() -> None:
    """Its origin died while it sent the newer one: what is left is told to a latecomer, once."""
    own = layer(np.random.default_rng(12), looks=6)
    older = chunks_of(own, Origin(0, 0), version=1)
    own.submaps[0].observe(look(np.random.default_rng(13)))
    newer = chunks_of(own, Origin(0, 0), version=2)
    witness, late = Mind(1, 3), Mind(2, 3)
    numbers = count()
    anchor = pack_anchor(AnchorKey(0, 0, 0), own.submaps[0].anchor)
    witness.take(Sent(0.0, 0, Kind.ANCHOR, anchor, next(numbers)), 0.0)
    heard = [*older, *(cut(chunk, 2 * chunk.total // 3)[0] for chunk in newer)]
    for chunk in heard:
        witness.take(Sent(0.0, 0, Kind.MAP, pack_chunks([chunk], (0, 0)), next(numbers)), 0.0)
    assert any(len(witness.store.versions(chunk.key)) == 2 for chunk in older)
    gossip = Gossip({1: witness, 2: late}, loss=0.2)
    gossip.run_until_equal()
    one, other = witness.team.fused(), late.team.fused()
    assert np.array_equal(one.variance_m2, other.variance_m2)
    quiet_s = gossip.now_s
    gossip.run(quiet_s + 3000.0)
    assert Kind.MAP not in gossip.kinds(quiet_s), "it is not told again and again"


@given(seeds)
@quick
def test_a_team_that_was_parted_ends_equal_once_it_hears_again(seed: int) -> None:
    gossip = team(seed, 4, 4)
    gossip.hears = lambda sender, receiver, now_s: now_s > 500 or sender % 2 == receiver % 2
    gossip.run(500.0)
    assert gossip.minds[0].store.digest() == gossip.minds[2].store.digest()
    assert gossip.minds[0].store.digest() != gossip.minds[1].store.digest()
    gossip.run_until_equal()


# --- what goes first ------------------------------------------------------------------------


def test_what_weighs_more_for_the_task_goes_first() -> None:
    for heavy in range(GRID.count):
        mind = Mind(0, 2, layer(np.random.default_rng(8), looks=12))
        mind.sharing.weight = lambda key, heavy=heavy: 100.0 if key.tile == heavy else 1.0
        mind.measured([0])
        gossip = Gossip({0: mind, 1: Mind(1, 2)})
        gossip.run(60.0)
        assert gossip.chunks()[0].key.tile == heavy


def test_latest_first_sends_what_was_published_last_first() -> None:
    """Where a team-mate missed several tiles, the newest goes out again before older ones."""
    options = {"settings": SharingSettings(policy="latest-first")}
    mind = Mind(0, 2, OwnLayer(FRAME, Submap), **options)
    mind.team.own.begin_submap(Pose(16.0, 1.0, 0.0, 0.0), SURE)
    gossip = Gossip({0: mind, 1: Mind(1, 2, **options)}, payload_bytes=60)
    gossip.hears = lambda sender, receiver, now_s: now_s > 300.0
    rng = np.random.default_rng(3)
    order = (2, 0, 3, 1, 0, 2)
    for place, tile in enumerate(order):
        mind.team.own.submaps[0].observe(_look_in(rng, tile, 0.2 if place < 4 else 1e-3))
        mind.sharing.own_tiles_changed(0, [tile])
        gossip.run(gossip.now_s + 5.0)
    assert [chunk.key.tile for chunk in mind.journal] == list(order)
    gossip.run(300.0)
    sent_in_vain = len(gossip.chunks())
    gossip.run_until_equal()
    again = [c.key.tile for c in gossip.chunks()[sent_in_vain:] if c.offset == 0]
    assert again == [2, 0, 1, 3]


def _look_in(rng: np.random.Generator, tile: int, variance_m2: float) -> LookCells:
    rows, cols = (a.ravel() for a in np.mgrid[GRID.window(tile)])
    some = rng.random(rows.size) < 0.7
    count = int(some.sum())
    return LookCells(rows[some], cols[some], rng.normal(size=count), np.full(count, variance_m2))


# --- publishing -----------------------------------------------------------------------------


def test_a_version_is_on_disk_before_any_of_it_is_sent_and_never_changes() -> None:
    gossip = team(5, 1, 2)
    mind = gossip.minds[0]
    for _ in range(5):
        while gossip.step():
            journalled = {(c.key, c.version): c.data for c in mind.journal}
            assert len(journalled) == len(mind.journal), "each version once"
            for chunk in gossip.chunks(sender=0):
                data = journalled[chunk.key, chunk.version]
                assert data[chunk.offset : chunk.offset + len(chunk.data)] == chunk.data
                assert len(data) == chunk.total
        mind.team.own.submaps[0].observe(look(gossip.rng))
        mind.measured([0])
    assert max(chunk.version for chunk in mind.journal) > 1


def test_what_can_not_be_made_durable_is_not_published() -> None:
    class FullDiskError(Exception):
        pass

    def fail(chunk: Chunk) -> None:
        raise FullDiskError

    mind = Mind(0, 2, layer(np.random.default_rng(6)))
    replace_journal(mind, fail)
    assert mind.choose(0.0, PAYLOAD_BYTES) is not None, "the first digest"
    with pytest.raises(FullDiskError):
        mind.choose(1.0, PAYLOAD_BYTES)
    assert (mind.store.keys(), mind.store.anchors) == ([], {})
    replace_journal(mind, mind.journal.append)
    assert mind.choose(2.0, PAYLOAD_BYTES) is not None


def replace_journal(mind: Mind, journal: Callable[[Chunk], None]) -> None:
    mind.sharing.desk = replace(mind.sharing.desk, journal=journal)


def test_a_robot_without_team_mates_publishes_nothing() -> None:
    mind = Mind(0, 1, layer(np.random.default_rng(7)))
    gossip = Gossip({0: mind})
    gossip.run(600.0)
    assert (gossip.kinds().count(Kind.MAP), mind.journal, mind.sharing.settled()) == (0, [], True)


def test_a_team_of_many_submaps_fits_its_digest_into_the_smallest_frame() -> None:
    """One by one where they do not fit together: see `comms.profiles.MIN_FRAME_BYTES`."""
    rng = np.random.default_rng(9)
    gossip = Gossip({i: Mind(i, 2, layer(rng, 1, submaps=9)) for i in range(2)}, payload_bytes=52)
    gossip.loss, gossip.rng = 0.1, rng
    gossip.run_until_equal()
    assert len(gossip.minds[0].store.anchors) == 18


def test_an_anchor_that_was_corrected_travels_alone() -> None:
    gossip = team(10, 1, 2)
    gossip.run_until_equal()
    quiet_s, key = gossip.now_s, AnchorKey(0, 0, 0)
    teller = gossip.minds[0]
    moved = teller.store.anchors[key].moved_to(Pose(16.5, 1.0, 0.1, 0.3), (1e-6,) * 4)
    teller.store.offer_anchor(key, moved)
    gossip.run(quiet_s + 30.0)
    assert gossip.minds[1].store.anchors[key] == moved
    assert Kind.MAP not in gossip.kinds(quiet_s - 1.0)
    assert gossip.equal


# --- plain ways, for comparison ---------------------------------------------------------------


@pytest.mark.parametrize("policy", ["raw", "paper"])
def test_plain_ways_bring_the_map_over_where_nothing_is_lost(policy: str) -> None:
    options = {"settings": SharingSettings(policy=policy)}
    rng = np.random.default_rng(14)
    gossip = Gossip({0: Mind(0, 2, layer(rng), **options), 1: Mind(1, 2, **options)})
    gossip.run(200.0)
    teller, listener = gossip.all
    assert teller.sharing.settled()
    submap = teller.team.own.submaps[0]
    heard = listener.team.fused()
    assert np.array_equal(heard.known, submap.known)
    elevation, variance = submap.estimate((slice(None), slice(None)))
    # What is heard is never surer than what was measured; for `raw` no less exact either.
    assert np.all(heard.variance_m2[heard.known] >= variance[heard.known] * (1 - 1e-6))
    if policy == "raw":
        assert np.allclose(heard.elevation_m[heard.known], elevation[heard.known], atol=1e-5)


@pytest.mark.parametrize("policy", ["raw", "paper"])
def test_plain_ways_tell_a_newcomer_everything_once_more(policy: str) -> None:
    options = {"settings": SharingSettings(policy=policy)}
    rng = np.random.default_rng(15)
    gossip = Gossip({0: Mind(0, 3, layer(rng), **options), 1: Mind(1, 3, **options)})
    gossip.run(200.0)
    gossip.minds[2] = Mind(2, 3, **options)
    gossip.run(500.0)
    assert has_all_of(gossip.minds[2], gossip.minds[0])


def test_who_relays_a_map_knows_its_levels_and_tells_coarse_things_first() -> None:
    rng = np.random.default_rng(16)
    frame_cells = layer(rng, looks=30)
    origin, relay = Mind(0, 3, frame_cells), Mind(1, 3)
    gossip = Gossip({0: origin, 1: relay})
    gossip.run_until_equal()
    gossip = Gossip({1: relay, 2: Mind(2, 3)}, payload_bytes=52)
    gossip.run_until_equal()
    told = [(chunk.key, chunk.version) for chunk in gossip.chunks(sender=1)]
    levels = {len(relay.sharing._steps[key].ends) for key in told}
    assert max(levels) > 1, "the payloads of this test have levels"
    for key in told:
        assert relay.sharing._steps[key].ends == origin.sharing._steps[key].ends


def test_many_versions_begun_do_not_make_one_forget_what_was_told_whole() -> None:
    beliefs, key, mate = Beliefs([1]), TileKey(0, 0, 0, 1), 1 << 1
    beliefs.have(mate, Stretch(key, 1, 26, 0, 26), 0.0)
    for number in range(2, 9):
        beliefs.have(mate, Stretch(key, number, 90, 0, 40), 0.0)
    whole = Version(1, 26, bytearray(26), [(0, 26)])
    ((part, _),) = beliefs.parts_of(key, mate)
    assert prefix_of(part, whole) == 26
    assert all(prefix_of(part, Version(n, 90, bytearray(90))) == 40 for n in range(2, 9))
    beliefs.have(mate, Stretch(key, 8, 90, 40, 90), 0.0)
    beliefs.have(mate, Stretch(key, 9, 90, 0, 40), 0.0)
    ((part, _),) = beliefs.parts_of(key, mate)
    assert len(part) <= KEPT_VERSIONS + 1, "older ones are of no use any more"


# --- who does not hear ----------------------------------------------------------------------


def speaker(store: Store) -> Repair:
    """Return robot 0's part, of a team of two, after it has spoken into the void for a while."""
    repair = Repair(SharingSettings(), Origin(0, 0), 2, store, GRID.count)
    repair.heard(Origin(1, 0), 0, 1.0)
    repair.heard_report(1, NOTHING_HEARD, 1.0)
    for seq in range(DEAF_FRAMES):
        repair.sent(seq, 10.0 + seq, ())
    return repair


NOTHING_HEARD = Report((Acks(0, 0, 0),))


def test_who_goes_on_hearing_nothing_is_deaf_but_not_who_has_only_come_back() -> None:
    repair = speaker(Store())
    repair.heard_report(1, NOTHING_HEARD, 60.0)
    assert repair.listeners == 0
    repair.heard(Origin(1, 1), 0, 70.0)
    assert repair.listeners == 1 << 1, "a new life has new ears"
    repair = speaker(Store())
    repair.heard(Origin(1, 1), 0, 60.0)
    repair.heard_report(1, NOTHING_HEARD, 60.0)
    assert repair.listeners == 1 << 1, "it has only come, and says so as its former life did"


def test_who_hears_again_is_offered_also_what_it_was_never_believed_to_have() -> None:
    store = Store()
    key = TileKey(0, 0, 0, 1)
    store.offer(Chunk(key, 1, 4, 0, b"tile"))
    repair = speaker(store)
    assert repair.heard_report(1, NOTHING_HEARD, 60.0) == [key]
    assert repair.heard_report(1, Report((Acks(0, 0, DEAF_FRAMES),)), 70.0) == [key]
