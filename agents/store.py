"""The replicated store: what has been published and heard, and nothing derived from it.

A key names one tile of one submap of one origin; under it lie versions, each a payload of which
some byte ranges are here. The whole store is a join semilattice: merging is the union of ranges,
version by version, after which all versions older than the newest complete one are dropped. So
merge is commutative, associative and idempotent, and frames that are lost, repeated, late,
reordered or relayed end in the same store everywhere (a state-based CRDT; Shapiro et al., 2011).
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from agents.errors import AgentError
from agents.layers import Anchor

MAX_PAYLOAD_BYTES = 1 << 18
"""No tile's payload is longer; a chunk that says otherwise is refused."""
MARK_BITS = 24


class StoreError(AgentError):
    """A chunk contradicts what is already known of its version."""


class Origin(NamedTuple):
    """Who measured: a robot (index in the roster) in one incarnation."""

    robot: int
    incarnation: int


class TileKey(NamedTuple):
    """Which tile of which submap of which origin."""

    robot: int
    incarnation: int
    submap: int
    tile: int

    @property
    def origin(self) -> Origin:
        """The origin that alone writes this tile."""
        return Origin(self.robot, self.incarnation)


class AnchorKey(NamedTuple):
    """Which submap's anchor."""

    robot: int
    incarnation: int
    submap: int


@dataclass(frozen=True)
class Chunk:
    """A stretch of one version's payload."""

    key: TileKey
    version: int
    total: int
    offset: int
    data: bytes


@dataclass
class Version:
    """One version of a tile, as far as it is here."""

    number: int
    total: int
    data: bytearray
    ranges: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])
    """Disjoint half-open byte ranges that are here, ascending."""

    @property
    def prefix_bytes(self) -> int:
        """Length of the unbroken stretch from the start: what can be decoded."""
        return self.ranges[0][1] if self.ranges and self.ranges[0][0] == 0 else 0

    @property
    def complete(self) -> bool:
        """Whether the whole payload is here."""
        return self.prefix_bytes == self.total

    @property
    def prefix(self) -> bytes:
        """The bytes that can be decoded."""
        return bytes(self.data[: self.prefix_bytes])

    def add(self, offset: int, data: bytes) -> bool:
        """Add a stretch; return whether it held anything new."""
        start, end = offset, offset + len(data)
        self.data.extend(bytes(max(0, end - len(self.data))))
        if any(a <= start and end <= b for a, b in self.ranges):
            return False
        self.data[start:end] = data
        apart = [(a, b) for a, b in self.ranges if b < start or a > end]
        touching = [(a, b) for a, b in self.ranges if not (b < start or a > end)]
        merged = (
            min([start, *(a for a, _ in touching)]),
            max([end, *(b for _, b in touching)]),
        )
        self.ranges = sorted([*apart, merged])
        return True

    def copy(self) -> "Version":
        """Return an independent copy."""
        return Version(self.number, self.total, bytearray(self.data), list(self.ranges))


class Store:
    """All published tiles and anchors that a robot has, of every origin."""

    def __init__(self) -> None:
        """Make an empty store."""
        self._tiles: dict[TileKey, dict[int, Version]] = {}
        self._marks: dict[TileKey, int] = {}
        """What each tile adds to the whole's mark."""
        self.anchors: dict[AnchorKey, Anchor] = {}
        self._digest = ""
        self._mark = 0

    @property
    def mark(self) -> int:
        """Return 24 bits that equal stores share, and others but once in 16 million.

        A sum over all entries, whatever their order, so that a change costs no walk over them.
        """
        return self._mark

    def offer(self, chunk: Chunk) -> bool:
        """Take a chunk; return whether the store changed.

        Raises:
            StoreError: the chunk does not fit its version; the store is unchanged.

        """
        end = chunk.offset + len(chunk.data)
        if not (0 <= chunk.offset < end <= chunk.total <= MAX_PAYLOAD_BYTES):
            raise StoreError(
                f"chunk [{chunk.offset}, {end}) of a payload of {chunk.total} bytes: it must lie "
                f"inside, and payloads have at most {MAX_PAYLOAD_BYTES} bytes"
            )
        versions = self._tiles.get(chunk.key, {})
        version = versions.get(chunk.version)
        if version is None:
            version = Version(chunk.version, chunk.total, bytearray())
        elif version.total != chunk.total:
            raise StoreError(
                f"tile {tuple(chunk.key)} version {chunk.version}: a chunk says {chunk.total} "
                f"bytes in all, an earlier one {version.total}"
            )
        if not version.add(chunk.offset, chunk.data):
            return False
        kept = _pruned({**versions, chunk.version: version})
        if chunk.version not in kept:
            return False
        self._tiles[chunk.key] = kept
        mark = _mark_of_tile(chunk.key, kept)
        self._mark ^= self._marks.get(chunk.key, 0) ^ mark
        self._marks[chunk.key] = mark
        self._digest = ""
        return True

    def offer_anchor(self, key: AnchorKey, anchor: Anchor) -> bool:
        """Take an anchor; the highest version wins. Return whether the store changed."""
        mine = self.anchors.get(key)
        if mine is not None and mine.version >= anchor.version:
            return False
        self._mark ^= _mark_of_anchor(key, mine) ^ _mark_of_anchor(key, anchor)
        self.anchors[key] = anchor
        self._digest = ""
        return True

    @property
    def payload_bytes(self) -> int:
        """Length of all that can be decoded of the newest versions."""
        return sum(held[max(held)].prefix_bytes for held in self._tiles.values())

    def merge(self, other: "Store") -> None:
        """Take all that another store has."""
        for key, version in other.all_versions():
            for start, end in version.ranges:
                data = bytes(version.data[start:end])
                self.offer(Chunk(key, version.number, version.total, start, data))
        for key, anchor in other.anchors.items():
            self.offer_anchor(key, anchor)

    def versions(self, key: TileKey) -> list[Version]:
        """Return the versions kept of a tile, newest first."""
        held = self._tiles.get(key, {})
        return [held[number] for number in sorted(held, reverse=True)]

    def version(self, key: TileKey, number: int) -> Version | None:
        """Return one version of a tile, if it is kept."""
        return self._tiles.get(key, {}).get(number)

    def newest(self, key: TileKey) -> Version | None:
        """Return the newest version of a tile of which anything is here."""
        held = self._tiles.get(key)
        return held[max(held)] if held else None

    def keys(self) -> list[TileKey]:
        """Return all tile keys in order."""
        return sorted(self._tiles)

    def __iter__(self) -> Iterator[TileKey]:
        """Iterate over all tile keys in order."""
        return iter(self.keys())

    def all_versions(self) -> Iterator[tuple[TileKey, Version]]:
        """Yield every version kept, in order of key and number."""
        for key in self.keys():
            for number in sorted(self._tiles[key]):
                yield key, self._tiles[key][number]

    def digest(self) -> str:
        """Return a hash of keys and payloads: equal for equal stores, whatever the history.

        It is taken of all that can be decoded. What lies behind a gap counts once the gap is
        filled: where the origin has died, nobody may be left to fill it.
        """
        if self._digest:
            return self._digest
        digest = hashlib.sha256()
        for key, version in self.all_versions():
            if version.prefix_bytes:
                known = (tuple(key), version.number, version.total, version.prefix_bytes)
                digest.update(repr(known).encode())
                digest.update(version.prefix)
        for key in sorted(self.anchors):
            digest.update(repr((tuple(key), self.anchors[key])).encode())
        self._digest = digest.hexdigest()
        return self._digest

    def copy(self) -> "Store":
        """Return an independent copy."""
        twin = Store()
        twin._tiles = {
            key: {number: version.copy() for number, version in held.items()}
            for key, held in self._tiles.items()
        }
        twin.anchors = {key: replace(anchor) for key, anchor in self.anchors.items()}
        twin._mark, twin._marks = self._mark, dict(self._marks)
        return twin


def _mark_of_tile(key: TileKey, versions: dict[int, Version]) -> int:
    mark = 0
    for version in versions.values():
        if version.prefix_bytes:
            mark ^= _hash((*key, version.number, version.prefix_bytes))
    return mark


def _mark_of_anchor(key: AnchorKey, anchor: Anchor | None) -> int:
    return 0 if anchor is None else _hash((*key, -1 - anchor.version))


def _hash(entry: tuple[int, ...]) -> int:
    digest = hashlib.blake2s(repr(entry).encode(), digest_size=MARK_BITS // 8).digest()
    return int.from_bytes(digest, "little")


def _pruned(versions: dict[int, Version]) -> dict[int, Version]:
    """Drop what is older than the newest complete version.

    All open versions above it stay, however many: a bound on their number would make the outcome
    depend on the order of arrival.
    """
    complete = [number for number, version in versions.items() if version.complete]
    floor = max(complete) if complete else -1
    return {number: versions[number] for number in sorted(versions) if number >= floor}
