"""What a robot believes that a team-mate has: no acknowledgement says so, reports put it right."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from agents.sharing.reports import Held, Holdings
from agents.store import AnchorKey, Chunk, TileKey, Version

GUARD_S = 5.0
"""What was sent less than this before a report came may have crossed it on the air."""
KEPT_VERSIONS = 3
"""Versions of a tile that are remembered at least, and all since the newest whole one: that one may
turn out not to have been heard."""


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


@dataclass(slots=True)
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

    def forget(self) -> None:
        """Believe nothing: the team-mate begins anew."""
        self.tiles.clear()
        self.anchors.clear()

    def has(self, stretch: Stretch, sent_s: float = -1e9) -> None:
        """Believe that the team-mate got a stretch (if it had all before it)."""
        beliefs = self.tiles.setdefault(stretch.key, [])
        belief = _about(beliefs, stretch.version)
        belief.sent_s = max(belief.sent_s, sent_s)
        if belief.prefix_bytes >= 0 and belief.prefix_bytes >= stretch.start:
            belief.prefix_bytes = max(belief.prefix_bytes, stretch.end)
        if belief.prefix_bytes == stretch.total:
            belief.prefix_bytes = -1

    def lacks(self, stretch: Stretch) -> bool:
        """Believe that the team-mate did not get a stretch; return whether that is news."""
        for belief in self.tiles.get(stretch.key, []):
            whole = belief.prefix_bytes < 0
            if belief.version == stretch.version and (whole or belief.prefix_bytes > stretch.start):
                belief.prefix_bytes = stretch.start
                return True
        return False

    def prefix_of(self, key: TileKey, version: Version) -> int:
        """Return how much of a version the team-mate has."""
        for belief in self.tiles.get(key, []):
            if belief.version == version.number:
                return version.total if belief.prefix_bytes < 0 else belief.prefix_bytes
            if belief.version > version.number and belief.prefix_bytes < 0:
                return version.total  # it needs no older one any more
        return 0

    def bits_of(
        self, key: TileKey, version: Version, steps: Mapping[tuple[TileKey, int], HasBits]
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

    def take(self, holdings: Holdings, now_s: float) -> list[TileKey]:
        """Put right what is believed; return the tiles of which that changed."""
        said: dict[TileKey, list[Held]] = {}
        covered: dict[AnchorKey, list[tuple[int, int]]] = {key: [] for key, _ in holdings.anchors}
        for section in holdings.sections:
            covered[section.key].append((section.first_tile, section.last_tile))
            for held in section.held:
                said.setdefault(TileKey(*section.key, held.tile), []).append(held)
        elsewhere = {k: v for k, v in self.anchors.items() if not holdings.speaks_of(k)}
        told = {key: version - 1 for key, version in holdings.anchors if version > 0}
        self.anchors = {**elsewhere, **told}
        changed: list[TileKey] = []
        for key in sorted({*self.tiles, *said}):
            anchor = AnchorKey(key.robot, key.incarnation, key.submap)
            spans = covered.get(anchor, [(0, key.tile)] if holdings.speaks_of(anchor) else [])
            if not any(a <= key.tile <= b for a, b in spans):
                continue  # this frame of the report does not speak of that tile
            if self._correct(key, said.get(key, []), now_s):
                changed.append(key)
        return changed

    def _correct(self, key: TileKey, held: list[Held], now_s: float) -> bool:
        """Replace the belief about one tile by what was said; keep what was sent just now."""
        before = self.tiles.get(key, [])
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
        self.tiles[key] = result
        return True


def _reach(belief: _Belief) -> float:
    return float("inf") if belief.prefix_bytes < 0 else belief.prefix_bytes


def _about(beliefs: list[_Belief], version: int) -> _Belief:
    """Return the belief about a version, a new one if need be; the oldest of many is let go.

    Every stretch that is heard comes here once for each team-mate.
    """
    for belief in beliefs:
        if belief.version == version:
            return belief
    belief = _Belief(version, 0)
    beliefs.append(belief)
    if len(beliefs) > 1:
        beliefs.sort(key=lambda b: b.version)
        # As in a store, none goes that no whole one stands for: it would be sent anew for ever.
        whole = max((b.version for b in beliefs if b.prefix_bytes < 0), default=-1)
        floor = min(whole, beliefs[-KEPT_VERSIONS].version) if len(beliefs) > KEPT_VERSIONS else -1
        beliefs[:] = [b for b in beliefs if b.version >= floor]
    return belief
