"""What a robot believes that its team-mates have: no acknowledgement says so, reports put it right.

Nearly always all team-mates are believed to have the same of a tile, since all hear the same
frames. So what is remembered of a tile is remembered once, with the set of those who have it: a
frame that is heard costs the same in a team of four and of a thousand. Sets of team-mates are bits
of a whole number, bit n for robot n.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple, Protocol, TypeVar

from agents.sharing.reports import Held, Holdings
from agents.store import AnchorKey, Chunk, TileKey, Version

GUARD_S = 5.0
"""What was sent less than this before a report came may have crossed it on the air."""
KEPT_VERSIONS = 3
"""Versions of a tile that are remembered at least, and all since the newest whole one: that one may
turn out not to have been heard."""
WHOLE = -1
NEVER_S = -1e9

K = TypeVar("K")
T = TypeVar("T")


class HasBits(Protocol):
    """What a payload is worth, by its length."""

    def bits_at(self, prefix_bytes: int) -> float:
        """Return the information of a prefix."""
        ...


class Stretch(NamedTuple):
    """Which bytes of which payload a frame carried."""

    key: TileKey
    version: int
    total: int
    start: int
    end: int


def stretch_of(chunk: Chunk) -> Stretch:
    """Return a chunk without its data."""
    end = chunk.offset + len(chunk.data)
    return Stretch(chunk.key, chunk.version, chunk.total, chunk.offset, end)


class Had(NamedTuple):
    """How much a team-mate is believed to have of one version of a tile."""

    version: int
    prefix_bytes: int
    """`WHOLE`: the whole payload."""
    sent_s: float = NEVER_S
    """When this robot sent of it last, as far as a report may not know of it."""

    @property
    def reach(self) -> float:
        """Return what can be compared of a version."""
        return float("inf") if self.prefix_bytes == WHOLE else self.prefix_bytes


Part = tuple[Had, ...]
"""What a team-mate is believed to have of a tile, the newest version last."""
NOTHING: Part = ()


def members(mask: int) -> Iterator[int]:
    """Yield the robots of a set, ascending."""
    while mask:
        lowest = mask & -mask
        yield lowest.bit_length() - 1
        mask ^= lowest


def prefix_of(part: Part, version: Version) -> int:
    """Return how much of a version one has who has a part."""
    for had in part:
        if had.version == version.number:
            return version.total if had.prefix_bytes == WHOLE else had.prefix_bytes
        if had.version > version.number and had.prefix_bytes == WHOLE:
            return version.total  # it needs no older one any more
    return 0


def bits_of(
    part: Part, key: TileKey, version: Version, steps: Mapping[tuple[TileKey, int], HasBits]
) -> float:
    """Return the information that one has of a tile, by its best version up to this one."""
    best = 0.0
    for had in part:
        known = steps.get((key, had.version))
        if known is not None and had.version <= version.number:
            prefix = 1 << 30 if had.prefix_bytes == WHOLE else had.prefix_bytes
            best = max(best, known.bits_at(prefix))
    return best


class Beliefs:
    """What each team-mate is believed to have of the store."""

    def __init__(self, peers: Iterable[int]) -> None:
        """Believe that nobody has anything."""
        self.everybody = sum(1 << peer for peer in peers)
        """The team-mates that count."""
        self._tiles: dict[AnchorKey, dict[TileKey, dict[Part, int]]] = {}
        """By submap and tile, who has which part; those who have nothing stand nowhere."""
        self._anchors: dict[AnchorKey, dict[int, int]] = {}
        """By submap, who has which version of its anchor."""

    @property
    def peers(self) -> list[int]:
        """The team-mates that count, ascending."""
        return list(members(self.everybody))

    @property
    def parts(self) -> int:
        """How many different parts of tiles are remembered."""
        return sum(len(parts) for tiles in self._tiles.values() for parts in tiles.values())

    # --- who counts -------------------------------------------------------------------------

    def join(self, robot: int) -> None:
        """Count one more, who has nothing."""
        self.everybody |= 1 << robot

    def leave(self, robot: int) -> None:
        """Count one less."""
        self.forget(robot)
        self.everybody &= ~(1 << robot)

    def forget(self, robot: int) -> None:
        """Believe that a team-mate has nothing: it begins anew."""
        for tiles in self._tiles.values():
            for key in list(tiles):
                _drop(tiles, key, 1 << robot)
        for key in list(self._anchors):
            _drop(self._anchors, key, 1 << robot)

    # --- tiles ------------------------------------------------------------------------------

    def have(self, who: int, stretch: Stretch, now_s: float, *, sent: bool = False) -> None:
        """Believe that some got a stretch (if they had all before it), which this robot `sent`."""
        if not who:
            return
        tiles = self._tiles.setdefault(_submap_of(stretch.key), {})
        parts = tiles.get(stretch.key, {})
        after: dict[Part, int] = {}
        left = who
        for part, those in parts.items():
            left &= ~those
            if those & ~who:
                _add(after, part, those & ~who)
            if those & who:
                _add(after, _with(part, stretch, now_s, sent), those & who)
        if left:
            _add(after, _with(NOTHING, stretch, now_s, sent), left)
        tiles[stretch.key] = after

    def lacks(self, robot: int, stretch: Stretch) -> bool:
        """Believe that a team-mate did not get a stretch; return whether that is news."""
        part = self._part(robot, stretch.key)
        for place, had in enumerate(part):
            whole = had.prefix_bytes == WHOLE
            if had.version == stretch.version and (whole or had.prefix_bytes > stretch.start):
                less = had._replace(prefix_bytes=stretch.start)
                self._set(robot, stretch.key, (*part[:place], less, *part[place + 1 :]))
                return True
        return False

    def parts_of(self, key: TileKey, who: int) -> list[tuple[Part, int]]:
        """Return which part of a tile is had by whom of some; together these are all of them."""
        found: list[tuple[Part, int]] = []
        for part, those in self._tiles.get(_submap_of(key), {}).get(key, {}).items():
            if those & who:
                found.append((part, those & who))
                who &= ~those
        if who:
            found.append((NOTHING, who))
        return found

    def _part(self, robot: int, key: TileKey) -> Part:
        return self.parts_of(key, 1 << robot)[0][0]

    def _set(self, robot: int, key: TileKey, part: Part) -> None:
        tiles = self._tiles.setdefault(_submap_of(key), {})
        _drop(tiles, key, 1 << robot)
        if part:
            _add(tiles.setdefault(key, {}), part, 1 << robot)

    # --- anchors ----------------------------------------------------------------------------

    def have_anchor(self, who: int, key: AnchorKey, version: int) -> None:
        """Believe that some got an anchor, in this version at least."""
        versions = self._anchors.setdefault(key, {})
        newer = sum(those for known, those in versions.items() if known > version)
        self._set_anchor(who & ~newer, key, version)

    def lacks_anchor(self, robot: int, key: AnchorKey, version: int) -> None:
        """Believe that a team-mate did not get an anchor in this version, if it had any at all."""
        if any(those >> robot & 1 for those in self._anchors.get(key, {}).values()):
            self._set_anchor(1 << robot, key, version - 1)

    def is_anchor_lacked(self, who: int, key: AnchorKey, version: int) -> bool:
        """Say whether any of some is not believed to have this version of an anchor."""
        for known, those in self._anchors.get(key, {}).items():
            if known >= version:
                who &= ~those
        return who != 0

    def _set_anchor(self, who: int, key: AnchorKey, version: int) -> None:
        if who:
            _drop(self._anchors, key, who)
            _add(self._anchors.setdefault(key, {}), version, who)

    # --- reports ----------------------------------------------------------------------------

    def take(self, robot: int, holdings: Holdings, now_s: float) -> list[TileKey]:
        """Put right what is believed of one; return the tiles of which that changed."""
        said: dict[AnchorKey, dict[TileKey, list[Held]]] = {}
        covered: dict[AnchorKey, list[tuple[int, int]]] = {key: [] for key, _ in holdings.anchors}
        for section in holdings.sections:
            covered[section.key].append((section.first_tile, section.last_tile))
            for held in section.held:
                tiles = said.setdefault(section.key, {})
                tiles.setdefault(TileKey(*section.key, held.tile), []).append(held)
        for key in [key for key in self._anchors if holdings.speaks_of(key)]:
            _drop(self._anchors, key, 1 << robot)
        for key, version in holdings.anchors:
            if version > 0:
                self._set_anchor(1 << robot, key, version - 1)
        changed: list[TileKey] = []
        for anchor in sorted({*self._tiles, *covered}):
            if anchor not in covered and not holdings.speaks_of(anchor):
                continue
            told = said.get(anchor, {})
            for key in sorted({*self._tiles.get(anchor, {}), *told}):
                spans = covered.get(anchor, [(0, key.tile)])
                if not any(a <= key.tile <= b for a, b in spans):
                    continue  # this frame of the report does not speak of that tile
                if self._correct(robot, key, told.get(key, []), now_s):
                    changed.append(key)
        return changed

    def _correct(self, robot: int, key: TileKey, held: list[Held], now_s: float) -> bool:
        """Replace the belief about one tile by what was said; keep what was sent just now."""
        before = self._part(robot, key)
        whole = max((h.version for h in held if h.prefix_bytes == WHOLE), default=-1)
        after = [Had(h.version, h.prefix_bytes) for h in held]
        after += [had for had in before if now_s - had.sent_s < GUARD_S and had.version >= whole]
        merged: dict[int, Had] = {}
        for had in after:
            known = merged.get(had.version)
            if known is None or had.reach > known.reach:
                merged[had.version] = had
        result = tuple(merged[version] for version in sorted(merged))
        if [had[:2] for had in result] == [had[:2] for had in before]:
            return False
        self._set(robot, key, result)
        return True


def _submap_of(key: TileKey) -> AnchorKey:
    return AnchorKey(key.robot, key.incarnation, key.submap)


def _add(sets: dict[T, int], what: T, who: int) -> None:
    """Let some stand under something, with those who do already."""
    sets[what] = sets.get(what, 0) | who


def _drop(table: dict[K, dict[T, int]], key: K, who: int) -> None:
    """Let some stand nowhere under a key any more."""
    sets = table.get(key)
    if sets is None or not any(those & who for those in sets.values()):
        return
    kept = {what: those & ~who for what, those in sets.items() if those & ~who}
    if kept:
        table[key] = kept
    else:
        del table[key]


def _with(part: Part, stretch: Stretch, now_s: float, sent: bool) -> Part:
    """Return a part with a stretch more.

    The oldest of many versions are let go, but, as in a store, none that no whole one stands for:
    it would be sent anew for ever. When what crosses no report any more was sent is forgotten, so
    that those who have the same are one set.
    """
    known = [
        had if had.sent_s == NEVER_S or now_s - had.sent_s < GUARD_S else Had(*had[:2])
        for had in part
    ]
    had = next((had for had in known if had.version == stretch.version), None)
    if had is None:
        had = Had(stretch.version, 0)
        known = _kept(sorted([*known, had]))
    prefix = had.prefix_bytes
    if prefix != WHOLE and prefix >= stretch.start:
        prefix = max(prefix, stretch.end)
    if prefix == stretch.total:
        prefix = WHOLE
    more = Had(had.version, prefix, max(had.sent_s, now_s if sent else NEVER_S))
    return tuple(more if had.version == stretch.version else had for had in known)


def _kept(known: list[Had]) -> list[Had]:
    if len(known) <= KEPT_VERSIONS:
        return known
    whole = max((had.version for had in known if had.prefix_bytes == WHOLE), default=-1)
    floor = min(whole, known[-KEPT_VERSIONS].version)
    return [had for had in known if had.version >= floor]
