"""What team-mates are believed to have, remembered once for all who have the same, is what slow
code keeps of each by itself."""

from dataclasses import dataclass, field

from hypothesis import given
from hypothesis import strategies as st

from agents.sharing.beliefs import (
    GUARD_S,
    KEPT_VERSIONS,
    Beliefs,
    Stretch,
    bits_of,
    members,
    prefix_of,
)
from agents.sharing.reports import Held, Holdings, Section
from agents.store import AnchorKey, TileKey, Version

PEERS = (0, 2, 3, 70)
SUBMAPS = [AnchorKey(0, 0, 0), AnchorKey(0, 0, 1), AnchorKey(2, 1, 0)]
TILES = 3
KEYS = [TileKey(*submap, tile) for submap in SUBMAPS for tile in range(TILES)]
TOTAL = 8


@dataclass
class Mate:
    """What one team-mate has, kept by itself: versions as [prefix (-1: whole), sent_s]."""

    tiles: dict[TileKey, dict[int, list[float]]] = field(
        default_factory=dict[TileKey, dict[int, list[float]]]
    )
    anchors: dict[AnchorKey, int] = field(default_factory=dict[AnchorKey, int])

    def has(self, stretch: Stretch, sent_s: float) -> None:
        known = self.tiles.setdefault(stretch.key, {})
        one = known.setdefault(stretch.version, [0, -1e9])
        if len(known) > KEPT_VERSIONS:
            whole = max((number for number, (prefix, _) in known.items() if prefix < 0), default=-1)
            floor = min(whole, sorted(known)[-KEPT_VERSIONS])
            self.tiles[stretch.key] = {n: known[n] for n in known if n >= floor}
        one[1] = max(one[1], sent_s)
        if one[0] >= 0 and one[0] >= stretch.start:
            one[0] = max(one[0], stretch.end)
        if one[0] == stretch.total:
            one[0] = -1

    def lacks(self, stretch: Stretch) -> bool:
        one = self.tiles.get(stretch.key, {}).get(stretch.version)
        if one is None or 0 <= one[0] <= stretch.start:
            return False
        one[0] = stretch.start
        return True

    def take(self, holdings: Holdings, now_s: float) -> set[TileKey]:
        told = {key: version - 1 for key, version in holdings.anchors if version > 0}
        kept = {k: v for k, v in self.anchors.items() if not holdings.speaks_of(k)}
        self.anchors = {**kept, **told}
        changed: set[TileKey] = set()
        for key in KEYS:
            submap = AnchorKey(*key[:3])
            if not holdings.speaks_of(submap):
                continue
            sections = [s for s in holdings.sections if s.key == submap]
            named = submap in [anchor for anchor, _ in holdings.anchors]
            if named and not any(s.first_tile <= key.tile <= s.last_tile for s in sections):
                continue
            held = [h for s in sections for h in s.held if h.tile == key.tile]
            whole = max((h.version for h in held if h.prefix_bytes < 0), default=-1)
            before = self.tiles.get(key, {})
            after: dict[int, list[float]] = {h.version: [h.prefix_bytes, -1e9] for h in held}
            for number, one in before.items():
                if now_s - one[1] < GUARD_S and number >= whole:
                    said = after.get(number)
                    if said is None or (said[0] >= 0 and (one[0] < 0 or one[0] > said[0])):
                        after[number] = one
            if {n: one[0] for n, one in after.items()} != {n: one[0] for n, one in before.items()}:
                self.tiles[key] = after
                changed.add(key)
        return changed


def stretches() -> st.SearchStrategy[Stretch]:
    spans = st.tuples(st.integers(0, TOTAL - 1), st.integers(1, TOTAL)).map(
        lambda span: (span[0], min(TOTAL, span[0] + span[1]))
    )
    return st.builds(
        lambda key, version, span: Stretch(key, version, TOTAL, *span),
        st.sampled_from(KEYS),
        st.integers(1, 6),
        spans,
    )


@st.composite
def reports(draw: st.DrawFn) -> Holdings:
    named = [submap for submap in SUBMAPS if draw(st.booleans())]
    anchors = tuple((submap, draw(st.integers(0, 3))) for submap in named)
    sections: list[Section] = []
    for submap in named:
        if draw(st.booleans()):
            first = draw(st.integers(0, TILES - 1))
            last = draw(st.integers(first, TILES - 1))
            prefixes = st.dictionaries(
                st.tuples(st.integers(first, last), st.integers(1, 6)),
                st.sampled_from((-1, 1, 5)),
                max_size=3,
            )
            held = tuple(Held(*at, prefix) for at, prefix in sorted(draw(prefixes).items()))
            sections.append(Section(submap, first, last, held))
    return Holdings(anchors, tuple(sections), draw(st.booleans()), draw(st.booleans()))


class Known:
    """Information that grows with every byte."""

    def bits_at(self, prefix_bytes: int) -> float:
        return float(min(prefix_bytes, TOTAL))


STEPS = {number: Known() for number in (1, 2, 4)}


def check(beliefs: Beliefs, mates: dict[int, Mate]) -> None:
    """Hold what is believed of each against what slow code kept."""
    for key in KEYS:
        parts = beliefs.parts_of(key, beliefs.everybody)
        assert sorted(peer for _, those in parts for peer in members(those)) == sorted(PEERS)
        for part, those in parts:
            for peer in members(those):
                kept = mates[peer].tiles.get(key, {})
                assert [had[:2] for had in part] == [(n, kept[n][0]) for n in sorted(kept)]
                assert bits_of(part, Version(4, TOTAL, bytearray()), STEPS) == max(
                    [
                        min(TOTAL, one[0]) if one[0] >= 0 else TOTAL
                        for n, one in kept.items()
                        if n in STEPS
                    ],
                    default=0.0,
                )
    for submap in SUBMAPS:
        for version in range(4):
            lacking = [p for p in PEERS if mates[p].anchors.get(submap, -1) < version]
            for peer in PEERS:
                assert beliefs.is_anchor_lacked(1 << peer, submap, version) == (peer in lacking)


@given(st.data())
def test_what_all_have_is_what_slow_code_keeps_of_each(data: st.DataObject) -> None:
    beliefs, mates = Beliefs(PEERS), {peer: Mate() for peer in PEERS}
    now_s = 0.0
    some = st.sets(st.sampled_from(PEERS))
    for _ in range(data.draw(st.integers(1, 14))):
        now_s += data.draw(st.sampled_from((0.0, 1.0, 4.0, 9.0)))
        who = data.draw(some)
        mask, one = sum(1 << peer for peer in who), data.draw(st.sampled_from(PEERS))
        match data.draw(
            st.sampled_from(("have", "have", "sent", "lacks", "forget", "take", "say"))
        ):
            case "have" | "sent" as what:
                stretch = data.draw(stretches())
                beliefs.have(mask, stretch, now_s, sent=what == "sent")
                for peer in who:
                    mates[peer].has(stretch, now_s if what == "sent" else -1e9)
            case "lacks":
                stretch = data.draw(stretches())
                assert beliefs.lacks(one, stretch) == mates[one].lacks(stretch)
            case "forget":
                beliefs.forget(one)
                mates[one] = Mate()
            case "take":
                report = data.draw(reports())
                assert set(beliefs.take(one, report, now_s)) == mates[one].take(report, now_s)
            case _:
                submap, version = data.draw(st.sampled_from(SUBMAPS)), data.draw(st.integers(0, 3))
                beliefs.have_anchor(mask, submap, version)
                for peer in who:
                    mates[peer].anchors[submap] = max(version, mates[peer].anchors.get(submap, -1))
    check(beliefs, mates)


def test_a_team_that_hears_the_same_is_remembered_once() -> None:
    beliefs = Beliefs(range(1, 1000))
    for tile in range(TILES):
        for start in range(0, TOTAL, 2):
            stretch = Stretch(TileKey(0, 0, 0, tile), 1, TOTAL, start, start + 2)
            beliefs.have(beliefs.everybody, stretch, float(start))
    assert beliefs.parts == TILES
    beliefs.lacks(7, Stretch(TileKey(0, 0, 0, 1), 1, TOTAL, 4, 6))
    assert beliefs.parts == TILES + 1
    lacking = [
        those for part, those in beliefs.parts_of(KEYS[1], 1 << 7 | 1 << 8) if those == 1 << 7
    ]
    assert lacking == [1 << 7]
    ((part, _),) = beliefs.parts_of(KEYS[1], 1 << 7)
    assert prefix_of(part, Version(1, TOTAL, bytearray(TOTAL))) == 4


def test_who_joins_has_nothing_and_who_leaves_is_forgotten() -> None:
    beliefs = Beliefs([1])
    beliefs.have(beliefs.everybody, Stretch(KEYS[0], 1, TOTAL, 0, TOTAL), 0.0)
    beliefs.join(5)
    assert beliefs.peers == [1, 5]
    assert len(beliefs.parts_of(KEYS[0], beliefs.everybody)) == 2
    beliefs.leave(1)
    assert (beliefs.peers, beliefs.parts) == ([5], 0)
