"""Digests: what a robot says that it has, and what is believed of team-mates between them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from agents.messages import Digest, Held, Section, pack_digest
from agents.settings import SharingSettings
from agents.store import AnchorKey, Chunk, Store, TileKey, Version

GUARD_S = 5.0
"""What was sent less than this before a digest came may have crossed it on the air."""
FIRST_WAIT_S = 45.0
LONGEST_WAIT_S = 480.0


class _HasBits(Protocol):
    def bits_at(self, prefix_bytes: int) -> float: ...


@dataclass
class _Belief:
    version: int
    prefix_bytes: int
    """-1: the whole payload."""
    sent_s: float = -1e9


@dataclass
class Believed:
    """What one team-mate is believed to have."""

    tiles: dict[TileKey, list[_Belief]] = field(default_factory=dict[TileKey, list[_Belief]])
    """Newest version last."""
    anchors: dict[AnchorKey, int] = field(default_factory=dict[AnchorKey, int])

    def has(self, chunk: Chunk, sent_s: float = -1e9) -> None:
        """Believe that the team-mate got a chunk (if it had all before it)."""
        beliefs = self.tiles.setdefault(chunk.key, [])
        belief = next((b for b in beliefs if b.version == chunk.version), None)
        if belief is None:
            belief = _Belief(chunk.version, 0)
            beliefs.append(belief)
            beliefs.sort(key=lambda b: b.version)
        belief.sent_s = max(belief.sent_s, sent_s)
        end = chunk.offset + len(chunk.data)
        if belief.prefix_bytes >= chunk.offset:
            belief.prefix_bytes = max(belief.prefix_bytes, end)
        if belief.prefix_bytes == chunk.total:
            belief.prefix_bytes = -1
            self.tiles[chunk.key] = [b for b in beliefs if b.version >= chunk.version]

    def prefix_of(self, key: TileKey, version: Version) -> int:
        """Return how much of a version the team-mate has."""
        for belief in self.tiles.get(key, []):
            if belief.version == version.number:
                return version.total if belief.prefix_bytes < 0 else belief.prefix_bytes
            if belief.version > version.number and belief.prefix_bytes < 0:
                return version.total  # it needs no older one any more
        return 0

    def bits_of(
        self, key: TileKey, version: Version, steps: Mapping[tuple[TileKey, int], _HasBits]
    ) -> float:
        """Return the information that the team-mate has of a tile, by its best version."""
        best = 0.0
        for belief in self.tiles.get(key, []):
            known = steps.get((key, belief.version))
            if known is not None and belief.version <= version.number:
                prefix = 1 << 30 if belief.prefix_bytes < 0 else belief.prefix_bytes
                best = max(best, known.bits_at(prefix))
        return best

    def has_anchor(self, key: AnchorKey, version: int) -> None:
        """Believe that the team-mate got an anchor."""
        self.anchors[key] = max(version, self.anchors.get(key, -1))

    def lacks_anchor(self, key: AnchorKey, version: int) -> bool:
        """Say whether the team-mate is not believed to have this version of an anchor."""
        return self.anchors.get(key, -1) < version


def take_digest(believed: Believed, digest: Digest, now_s: float) -> list[TileKey]:
    """Put right what is believed of a team-mate; return the tiles of which that changed."""
    said: dict[TileKey, list[Held]] = {}
    covered: dict[AnchorKey, list[tuple[int, int]]] = {key: [] for key, _ in digest.anchors}
    for section in digest.sections:
        covered[section.key].append((section.first_tile, section.last_tile))
        for held in section.held:
            said.setdefault(TileKey(*section.key, held.tile), []).append(held)
    elsewhere = {k: v for k, v in believed.anchors.items() if not digest.speaks_of(k)}
    told = {key: version - 1 for key, version in digest.anchors if version > 0}
    believed.anchors = {**elsewhere, **told}
    changed: list[TileKey] = []
    for key in sorted({*believed.tiles, *said}):
        anchor = AnchorKey(key.robot, key.incarnation, key.submap)
        spans = covered.get(anchor, [(0, key.tile)] if digest.speaks_of(anchor) else [])
        if not any(a <= key.tile <= b for a, b in spans):
            continue  # this frame of the digest does not speak of that tile
        if _correct(believed, key, said.get(key, []), now_s):
            changed.append(key)
    return changed


def _correct(believed: Believed, key: TileKey, held: list[Held], now_s: float) -> bool:
    """Replace the belief about one tile by what was said; keep what was sent just now."""
    before = believed.tiles.get(key, [])
    whole = max((h.version for h in held if h.prefix_bytes < 0), default=-1)
    after = [_Belief(h.version, h.prefix_bytes) for h in held]
    after += [b for b in before if now_s - b.sent_s < GUARD_S and b.version >= whole]
    merged: dict[int, _Belief] = {}
    for belief in after:
        known = merged.get(belief.version)
        if known is None or _reach(belief) > _reach(known):
            merged[belief.version] = belief
    result = [merged[version] for version in sorted(merged)]
    if [(b.version, b.prefix_bytes) for b in result] == [
        (b.version, b.prefix_bytes) for b in before
    ]:
        return False
    believed.tiles[key] = result
    return True


def _reach(belief: _Belief) -> float:
    return float("inf") if belief.prefix_bytes < 0 else belief.prefix_bytes


REFRESHED = 12
"""Tiles told again with each digest though nothing changed: a digest that was lost is made good."""
TILE_SHARE = 1 / 3
"""So much of a digest is kept for tiles, however many submaps there are to name."""


class Teller:
    """Says what a robot has, a frame at a time: first what is news, and a few old things in turn.

    A frame names all submaps, or, where they are too many for it, a run of them; of these it tells
    tiles. What a frame speaks of and does not name is not held, so each frame is of use alone.
    """

    def __init__(self, store: Store, tile_count: int) -> None:
        """Tell of a store whose submaps have so many tiles."""
        self._store = store
        self._tile_count = tile_count
        self._news: set[TileKey] = set(store)
        self._cursor = 0
        self._submap_cursor = 0

    @property
    def has_more(self) -> bool:
        """Whether news did not fit into the last frame."""
        return bool(self._news)

    def changed(self, key: TileKey) -> None:
        """Note that more of a tile is here than was told."""
        self._news.add(key)

    def next_payload(self, payload_bytes: int) -> bytes:
        """Return one digest frame's payload; it is of use alone, and says what it speaks of."""
        all_keys = self._store.keys()
        submaps = sorted({_submap_of(key) for key in all_keys} | set(self._store.anchors))
        low, high = self._run_of(submaps, payload_bytes)
        named, whole = submaps[low:high], (low == 0, high == len(submaps))
        keys = [key for key in all_keys if _submap_of(key) in named]
        news = [i for i, key in enumerate(keys) if key in self._news]
        turn = [(self._cursor + i) % len(keys) for i in range(min(REFRESHED, len(keys)))]
        places = [*news, *(i for i in turn if keys[i] not in self._news)]
        payload = self._packed(named, whole, keys, places)
        while len(payload) > payload_bytes and places:
            places = places[: len(places) * 7 // 8]
            payload = self._packed(named, whole, keys, places)
        self._news.difference_update(keys[i] for i in places)
        self._cursor = (self._cursor + REFRESHED) % max(1, len(keys))
        return payload

    def _packed(
        self, named: list[AnchorKey], whole: tuple[bool, bool], keys: list[TileKey], told: list[int]
    ) -> bytes:
        drawn = {_submap_of(key) for key in keys}
        bare = self._bare([key for key in named if key not in drawn])
        sections = (*bare, *self._sections(keys, sorted(told)))
        return pack_digest(Digest(self._versions(named), sections, *whole))

    def _run_of(self, submaps: list[AnchorKey], payload_bytes: int) -> tuple[int, int]:
        """Return which submaps the next frame names: all, if they fit; else some in turn."""
        room_bytes = (1 - TILE_SHARE) * payload_bytes

        def fits(low: int, high: int) -> bool:
            run = submaps[low:high]
            return len(pack_digest(Digest(self._versions(run), self._bare(run)))) <= room_bytes

        if fits(0, len(submaps)):
            return 0, len(submaps)
        low = self._submap_cursor if self._submap_cursor < len(submaps) else 0
        high = low + 1
        while high < len(submaps) and fits(low, high + 1):
            high += 1
        self._submap_cursor = high
        return low, high

    def _versions(self, named: list[AnchorKey]) -> tuple[tuple[AnchorKey, int], ...]:
        anchors = self._store.anchors
        return tuple((key, anchors[key].version + 1 if key in anchors else 0) for key in named)

    def _bare(self, submaps: list[AnchorKey]) -> tuple[Section, ...]:
        """Return sections for submaps of which there is an anchor and no tile."""
        return tuple(Section(key, 0, self._tile_count - 1, ()) for key in submaps)

    def _sections(self, keys: list[TileKey], places: list[int]) -> tuple[Section, ...]:
        """Return sections for runs of neighbours among the tiles held; gaps say "not held"."""
        runs: list[list[int]] = []
        for i in places:
            if runs and i == runs[-1][-1] + 1 and keys[i][:3] == keys[i - 1][:3]:
                runs[-1].append(i)
            else:
                runs.append([i])
        return tuple(self._section(keys, run) for run in runs)

    def _section(self, keys: list[TileKey], run: list[int]) -> Section:
        first, last = run[0], run[-1]
        anchor = _submap_of(keys[first])
        opens = first == 0 or _submap_of(keys[first - 1]) != anchor
        closes = last + 1 == len(keys) or _submap_of(keys[last + 1]) != anchor
        start = 0 if opens else keys[first].tile
        end = self._tile_count - 1 if closes else keys[last + 1].tile - 1
        held = tuple(held for i in run for held in _held(self._store, keys[i]))
        return Section(anchor, start, end, held)


def _submap_of(key: TileKey) -> AnchorKey:
    return AnchorKey(key.robot, key.incarnation, key.submap)


def _held(store: Store, key: TileKey) -> list[Held]:
    """Return what can be decoded of a tile, oldest version first."""
    return [
        Held(key.tile, version.number, -1 if version.complete else version.prefix_bytes)
        for version in reversed(store.versions(key))
        if version.prefix_bytes
    ]


class DigestClock:
    """When the next digest is due: often while maps change, ever less often afterwards."""

    def __init__(self, settings: SharingSettings) -> None:
        """Start with a digest at once: a newcomer says what it lacks."""
        self.settings = settings
        self._due_s = -1.0
        self._sent_s = 0.0
        self._pause_s = 0.0
        self._wait_s = FIRST_WAIT_S

    def changed(self) -> None:
        """Note news: the next digest need not wait for the long pause of quiet times."""
        self._wait_s = FIRST_WAIT_S
        self._due_s = min(self._due_s, self._sent_s + max(self._pause_s, FIRST_WAIT_S))

    def newcomer(self) -> None:
        """Note that a team-mate has come (back): it must hear soon what need not be sent to all."""
        self._wait_s = FIRST_WAIT_S
        self._due_s = min(self._due_s, self._sent_s + self._pause_s)

    def due(self, now_s: float) -> bool:
        """Say whether a digest is due."""
        return now_s >= self._due_s

    def sent(
        self, now_s: float, size_bytes: int, rate_bps: float, team_size: int, *, has_more: bool
    ) -> None:
        """Note that a digest was sent.

        The next comes no sooner than the share of the link allows that all robots' digests may
        take together.
        """
        share = max(self.settings.digest_share, 1e-6) / team_size
        self._sent_s = now_s
        self._pause_s = max(1.0, 8 * size_bytes / rate_bps / share)
        self._due_s = now_s + (self._pause_s if has_more else max(self._pause_s, self._wait_s))
        if not has_more:
            self._wait_s = min(2 * self._wait_s, LONGEST_WAIT_S)
