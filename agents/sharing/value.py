"""Worth per byte: the chunk that tells listeners most of what they lack, for the bytes it takes.

Worth is information (bits of Eq. 3's kind, as the kind of map counts them) that listeners lack,
over all listeners, times the weight of the place for the team's task. What is worth less than
`MapKind.least_bits_per_byte` is not sent: the run has settled when nothing better is left. One
frame serves all who hear it; loss of a frame costs that frame and a few bytes of a report
(`agents.sharing.repair`).
"""

import math
from bisect import bisect_left
from dataclasses import dataclass, replace

from agents.disk import DiskError
from agents.messages import CHUNK_HEADER_BYTES, pack_anchor, pack_chunks
from agents.sharing.beliefs import Part, bits_of, members, prefix_of, stretch_of
from agents.sharing.policy import Desk, Free, Heard, Policy
from agents.sharing.repair import Mark, Repair
from agents.sharing.reports import Report
from agents.store import AnchorKey, Chunk, TileKey, Version
from comms.frames import Kind

SMALLEST_CHUNK_BYTES = 16
"""No chunk of another tile is begun in less room than this at the end of a frame."""
ANOTHERS_TURN = 1 / 8
"""Times the worth of what a team-mate could send as well, and whose turn it is: first the own part.
"""
TURN_S = 5.0
"""So long nobody else sends what a team-mate could send as well, and whose turn it is."""
FRESH = -1
"""Stands for the version that is to be published next; those heard are numbered from 0."""


@dataclass(frozen=True)
class Steps:
    """What a version's payload is worth, level by level."""

    ends: tuple[int, ...]
    """Bytes at which each level is whole."""
    bits: tuple[float, ...]
    """Information of the tile at each level, against the prior."""
    known_bytes: int
    """Length of the prefix that this was worked out from."""

    def bits_at(self, prefix_bytes: int) -> float:
        """Return the information of a prefix: that of its last whole level."""
        done = [bits for end, bits in zip(self.ends, self.bits, strict=True) if end <= prefix_bytes]
        return done[-1] if done else 0.0


@dataclass
class Offer:
    """The best next stretch of one version of a tile: its worth per byte, and where it starts.

    `FRESH` is one that was not published yet.
    """

    density: float
    version: int
    start: int = 0
    end: int = 0
    """Where the level ends for which the density holds."""
    turn: int = 0
    """How many team-mates could send it as well, and have their turn before."""
    since_s: float = 0.0

    def may_go(self, now_s: float) -> bool:
        """Say whether whose turn it was has had the time to send it."""
        return now_s >= self.since_s + self.turn * TURN_S


@dataclass
class Published:
    """What this robot published last of one of its tiles."""

    information_bits: float
    size_bytes: int


class Value(Policy):
    """What lacks most, for the bytes it takes, goes first."""

    def __init__(self, desk: Desk) -> None:
        """Share what the desk's team map (store and own layer) holds."""
        super().__init__(desk)
        tiles = desk.team.grid.count
        self.least_density = desk.team.kind.least_bits_per_byte
        self.repair = Repair(desk.settings, desk.me, desk.team_size, desk.store, tiles)
        self.published: dict[TileKey, Published] = {}
        self._steps: dict[tuple[TileKey, int], Steps] = {}
        self._offers: dict[TileKey, Offer] = {}
        self._stale: set[TileKey] = set()
        self._now_s = 0.0
        self._has_horizon = desk.settings.horizon_m is not None
        self._beyond: dict[int, bool] = {}
        """By tile: whether it is too far off to be passed on."""

    # --- what changed ---------------------------------------------------------------------

    def own_tiles_changed(self, submap: int, tiles: list[int]) -> None:
        """Note that own tiles were measured again."""
        for tile in tiles:
            self._stale.add(TileKey(*self.me, submap, tile))

    def recovered(self, key: TileKey) -> None:
        """Note that a tile of a former life is here, from disk; nobody may have heard of it."""
        self._stale.add(key)
        self.repair.changed(key, -1.0)

    def heard_frame(self, heard: Heard) -> None:
        """Note that a frame was heard, whatever is in it."""
        self._now_s = heard.now_s
        if self.repair.heard(heard.sender, heard.seq, heard.now_s):
            self._stale.update(self.store.keys())

    def heard_chunks(self, heard: Heard, chunks: list[tuple[Chunk, bool]]) -> None:
        """Note the map chunks of a frame, and which of them were news to the store."""
        stretches = tuple(stretch_of(chunk) for chunk, _ in chunks)
        self.repair.heard_stretches(heard.sender, heard.seq, heard.now_s, stretches)
        for chunk, changed in chunks:
            self._stale.add(chunk.key)
            if changed:
                self.repair.changed(chunk.key, heard.now_s)

    def heard_anchor(self, heard: Heard, key: AnchorKey, version: int) -> None:
        """Note that an anchor was heard."""
        self.repair.heard_anchor(heard.sender, heard.seq, heard.now_s, key, version)

    def heard_report(self, heard: Heard, report: Report) -> None:
        """Believe what a team-mate says, but for what was sent only just now."""
        changed = self.repair.heard_report(heard.sender.robot, report, heard.now_s)
        # Of what is not here nothing can be sent, and hostile reports tell of much that is nowhere.
        self._stale.update(key for key in changed if self.store.versions(key))

    def heard_mark(self, heard: Heard, mark: Mark) -> None:
        """Compare a team-mate's store with this robot's."""
        mine = Mark(self.store.mark, self.settled())
        self.repair.heard_mark(heard.sender.robot, mark, mine, heard.now_s)

    # --- what to send ---------------------------------------------------------------------

    def choose(self, free: Free) -> tuple[Kind, bytes] | None:
        """Return the next frame's kind and payload, or None when nothing is worth sending.

        Raises:
            DiskError: all that is worth sending waits for a disk that takes nothing.

        """
        self._now_s = free.now_s
        anchor = self._missing_anchor()
        if anchor is not None:
            known = self.store.anchors[anchor]
            self.repair.sent_anchor(free.seq, free.now_s, anchor, known.version)
            return Kind.ANCHOR, pack_anchor(anchor, known)
        report = self.repair.next_report(free.now_s, free.payload_bytes, free.rate_bps)
        if report is not None:
            return Kind.DIGEST, report
        chunks = self._choose_chunks(free)
        return (Kind.MAP, pack_chunks(chunks, self.me)) if chunks else None

    def settled(self) -> bool:
        """Say whether nothing is left that is worth its bytes, as far as this robot knows."""
        self._refresh()
        return self._missing_anchor() is None and self._best() is None

    def _missing_anchor(self) -> AnchorKey | None:
        """Return a submap whose anchor some peer lacks, once any of its tiles is published."""
        listeners = self.repair.listeners
        for key in self._anchors_to_tell():
            version = self.store.anchors[key].version
            if self.repair.beliefs.is_anchor_lacked(listeners, key, version):
                return key
        return None

    def _anchors_to_tell(self) -> list[AnchorKey]:
        """Return all anchors, or those of which this robot passes on tiles, and its own."""
        if not self._has_horizon:
            return sorted(self.store.anchors)
        passed_on = {AnchorKey(*key[:3]) for key in self.store if not self._is_beyond(key)}
        return [k for k in sorted(self.store.anchors) if k in passed_on or k[:2] == self.me]

    def _choose_chunks(self, free: Free) -> list[Chunk]:
        """Fill one frame with the chunks of most worth per byte.

        What the disk does not take is not published, and left for later; the rest goes out.
        """
        chunks: list[Chunk] = []
        refused: dict[TileKey, DiskError] = {}
        room = free.payload_bytes
        while room >= CHUNK_HEADER_BYTES + SMALLEST_CHUNK_BYTES:
            self._refresh()
            key = self._best(free.now_s)
            if key is None or (chunks and self._offers[key].turn):
                break  # whose turn it is may be sending it right now
            if self._offers[key].version == FRESH:
                try:
                    self._publish(key)
                except DiskError as error:
                    refused[key] = error
                    del self._offers[key]
                continue
            chunk = self._chunk(key, room - CHUNK_HEADER_BYTES)
            room -= len(chunk.data)
            begun = next((i for i, c in enumerate(chunks) if _goes_on(c, chunk)), None)
            if begun is None:
                chunks.append(chunk)
                room -= CHUNK_HEADER_BYTES
            else:
                chunks[begun] = replace(chunks[begun], data=chunks[begun].data + chunk.data)
            self.repair.goes_out(stretch_of(chunk), free.now_s)
            self._stale.add(key)
        self._stale.update(refused)
        if refused and not chunks:
            raise next(iter(refused.values()))
        if chunks:
            self.repair.sent(free.seq, free.now_s, tuple(stretch_of(c) for c in chunks))
        return chunks

    def _best(self, now_s: float = math.inf) -> TileKey | None:
        """Return the tile whose offer is worth most per byte, if any is worth a byte by then."""
        best, best_density = None, self.least_density
        for key, offer in self._offers.items():
            density = offer.density
            if offer.turn and not offer.may_go(now_s):
                continue
            if density > best_density or (density == best_density and best and key < best):
                best, best_density = key, density
        return best

    def _chunk(self, key: TileKey, room: int) -> Chunk:
        offer = self._offers[key]
        version = self.store.version(key, offer.version)
        assert version is not None
        end = min(offer.start + room, offer.end)
        data = bytes(version.data[offer.start : end])
        return Chunk(key, version.number, version.total, offer.start, data)

    def _refresh(self) -> None:
        """Work out the offers of all tiles that changed."""
        for key in sorted(self._stale):
            before, offer = self._offers.pop(key, None), self._offer(key)
            if offer is not None:
                has_waited = before is not None and (before.turn, before.version) == (
                    offer.turn,
                    offer.version,
                )
                offer.since_s = before.since_s if before and has_waited else self._now_s
                self._offers[key] = offer
        self._stale.clear()

    def look_again(self) -> None:
        """Weigh all tiles anew: the robot has moved, and others lie within its horizon."""
        self._beyond.clear()
        self._stale.update(self.store.keys())

    def _is_beyond(self, key: TileKey) -> bool:
        """Say whether a tile is another's and too far off to be passed on."""
        if not self._has_horizon or key[:2] == self.me:
            return False
        if key.tile not in self._beyond:
            self._beyond[key.tile] = self.weight(key) <= 0.0
        return self._beyond[key.tile]

    def _offer(self, key: TileKey) -> Offer | None:
        if self._is_beyond(key):
            return None
        known = self._offer_of_published(key)
        fresh = self._offer_to_publish(key) if key.origin == self.me else None
        if fresh is not None and (known is None or fresh.density > known.density):
            return fresh
        return known

    def _offer_of_published(self, key: TileKey) -> Offer | None:
        """Return the best next stretch of a tile, for all who lack it.

        What was heard of a newer version may be less than the whole of an older one: then both
        count, and the origin may be no more to send the rest.
        """
        offers = [self._offer_of_version(key, version) for version in self.store.versions(key)]
        known = [offer for offer in offers if offer is not None]
        return max(known, key=lambda offer: (offer.density, offer.version), default=None)

    def _offer_of_version(self, key: TileKey, version: Version) -> Offer | None:
        if version.prefix_bytes == 0:
            return None
        heard = self.repair.heard_of(key)
        start = min((prefix_of(part, version) for part, _ in heard), default=version.prefix_bytes)
        if start >= version.prefix_bytes:
            return None
        steps = self._steps_of(key, version)
        have = self._bits_had(heard, key, version)
        best_density, best_end = 0.0, version.prefix_bytes
        for end, bits in zip(steps.ends, steps.bits, strict=True):
            if end <= start:
                continue
            gain = sum([max(0.0, bits - had) for had in have])
            density = self.weight(key) * gain / (end - start + CHUNK_HEADER_BYTES)
            if density > best_density:
                best_density, best_end = density, end
        turn = self.repair.before_me(key, version)
        best_density *= ANOTHERS_TURN**turn
        # A payload that was begun is finished once nothing better is left: the last level alone
        # is exact, and what it adds to a mask counts for more than its bits say.
        density = max(best_density, self.least_density * 1.01)
        return Offer(density, version.number, start, best_end, turn)

    def _bits_had(
        self, heard: list[tuple[Part, int]], key: TileKey, version: Version
    ) -> list[float]:
        """Return the information that each listener has of a tile, in their order.

        Sums of floats depend on it, and so would what is sent.
        """
        bits = [bits_of(part, key, version, self._steps) for part, _ in heard]
        if len(heard) == 1:
            return bits * heard[0][1].bit_count()
        each = zip(bits, heard, strict=True)
        had = {peer: one for one, (_, those) in each for peer in members(those)}
        return [had[peer] for peer in sorted(had)]

    def _offer_to_publish(self, key: TileKey) -> Offer | None:
        """Return what a new version of an own tile would be worth, by an estimate of its size."""
        bits, guessed_bytes = self._own_offer(key)
        before = self.published.get(key)
        gain = bits - (before.information_bits if before else 0.0)
        if gain <= 0:
            return None
        size = before.size_bytes if before else guessed_bytes
        listeners = self.repair.listeners.bit_count()
        density = self.weight(key) * gain * listeners / (size + CHUNK_HEADER_BYTES)
        return Offer(density, FRESH)

    def _own_offer(self, key: TileKey) -> tuple[float, int]:
        """Return what an own tile would be worth once sent, and about how many bytes."""
        team = self.desk.team
        return team.kind.offer(team.own.submaps[key.submap], team.grid.window(key.tile))

    def _publish(self, key: TileKey) -> None:
        chunk, encoded = self.publish(key)
        self.repair.changed(key, -1e9)
        self._steps[key, chunk.version] = self._worth(key, encoded.data, encoded.level_ends)
        # The gain is counted against what was published, not against what is worth sending of it.
        bits, _ = self._own_offer(key)
        self.published[key] = Published(bits, len(encoded.data))
        self._stale.add(key)

    def _steps_of(self, key: TileKey, version: Version) -> Steps:
        """Return what a version is worth level by level."""
        known = self._steps.get((key, version.number))
        if known is None or known.known_bytes < version.prefix_bytes:
            known = self._worth(key, version.prefix, self._level_ends(key, version.prefix))
            self._steps[key, version.number] = known
        return known

    def _level_ends(self, key: TileKey, data: bytes) -> tuple[int, ...]:
        """Return where the levels of a payload end that another robot wrote, by trying prefixes."""
        team = self.desk.team
        shape = team.grid.shape(key.tile)

        def level_at(end: int) -> int:
            return team.kind.level(data[:end], shape)

        ends: list[int] = []
        last = level_at(len(data))
        for level in range(last):
            low = ends[-1] if ends else 0
            ends.append(bisect_left(range(len(data)), level, lo=low, key=level_at))
        return (*ends, len(data))

    def _worth(self, key: TileKey, data: bytes, ends: tuple[int, ...]) -> Steps:
        """Decode a payload level by level and count the information of each."""
        team = self.desk.team
        shape = team.grid.shape(key.tile)
        tiles = [team.kind.decode(data[:end], shape) for end in ends]
        bits = [0.0 if tile is None else team.kind.bits(tile) for tile in tiles]
        return Steps(tuple(ends), tuple(bits), len(data))


def _goes_on(begun: Chunk, chunk: Chunk) -> bool:
    """Say whether a chunk begins where another ends."""
    end = begun.offset + len(begun.data)
    return (begun.key, begun.version, end) == (chunk.key, chunk.version, chunk.offset)


class LatestFirst(Value):
    """The tile that was published last goes first, whole; for comparison."""

    def __init__(self, desk: Desk) -> None:
        """Begin like `Value`."""
        super().__init__(desk)
        self._news_count = 0
        self._order: dict[TileKey, int] = {}

    def recovered(self, key: TileKey) -> None:
        """Note when it came."""
        self._came(key)
        super().recovered(key)

    def heard_chunks(self, heard: Heard, chunks: list[tuple[Chunk, bool]]) -> None:
        """Note when they came."""
        for chunk, changed in chunks:
            if changed:
                self._came(chunk.key)
        super().heard_chunks(heard, chunks)

    def _publish(self, key: TileKey) -> None:
        super()._publish(key)
        self._came(key)

    def _came(self, key: TileKey) -> None:
        self._news_count += 1
        self._order[key] = self._news_count

    def _offer_of_version(self, key: TileKey, version: Version) -> Offer | None:
        offer = super()._offer_of_version(key, version)
        if offer is not None:
            offer.density = 1e6 + self._order.get(key, 0)
        return offer
