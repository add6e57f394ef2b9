"""What is worth its bytes: the choice that a robot makes whenever its link falls free.

Nothing is queued. When the link asks, the policy looks at what the robot has and at what it
believes its team-mates to have, and answers with one frame. What team-mates have is believed
without acknowledgement (a frame that was sent was heard), and put right by their digests; so one
frame serves all who hear it, and loss of a frame costs that frame and a line of a digest.

Policies, by name:

- `value`: the chunk of most worth per byte first. Worth is information (bits of Eq. 3's kind:
  log2 of sigma before over sigma after) that listeners lack, over all listeners, times the weight
  of the place for the team's task.
- `latest-first`: the tile that was published last goes first, whole.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from agents.digests import Believed, DigestClock, Teller, take_digest
from agents.layers import OwnLayer
from agents.messages import CHUNK_HEADER_BYTES, Digest, pack_anchor, pack_chunks
from agents.settings import MapSettings, SharingSettings
from agents.store import AnchorKey, Chunk, Origin, Store, TileKey, Version
from agents.teammap import UNIFORM, Estimate, TeamMap, readable
from comms.codec import EncodedTile, encode_tile
from comms.frames import Kind

MIN_BITS_PER_BYTE = 0.5
"""Less than this is not worth a byte of radio: the run has settled when nothing better is left."""
SMALLEST_CHUNK_BYTES = 16
"""No chunk of another tile is begun in less room than this at the end of a frame."""


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

    Version 0 is one that was not published yet.
    """

    density: float
    version: int
    start: int = 0


@dataclass
class Published:
    """What this robot published last of one of its tiles."""

    version: int
    information_bits: float
    size_bytes: int


class Sharing:
    """One robot's choice of what to send next. Pure but for the store it reads and publishes to."""

    def __init__(
        self,
        settings: SharingSettings,
        map_settings: MapSettings,
        me: Origin,
        team_size: int,
        team: TeamMap,
        journal: Callable[[Chunk], None],
    ) -> None:
        """Share what `team` (store and own layer) holds; `journal` makes a version durable."""
        self.settings = settings
        self.map = map_settings
        self.me = me
        self.team = team
        self.store: Store = team.store
        self.own: OwnLayer = team.own
        self.journal = journal
        self.peers = [robot for robot in range(team_size) if robot != me.robot]
        self.believed = {robot: Believed() for robot in self.peers}
        self.published: dict[TileKey, Published] = {}
        self.clock = DigestClock(settings)
        self.teller = Teller(self.store, team.grid.count)
        self.weight: Callable[[TileKey], float] = lambda key: 1.0
        self._steps: dict[tuple[TileKey, int], Steps] = {}
        self._offers: dict[TileKey, Offer] = {}
        self._stale: set[TileKey] = set()
        self._order: dict[TileKey, int] = {}
        self._news_count = 0

    # --- what changed ---------------------------------------------------------------------

    def own_tiles_changed(self, submap: int, tiles: list[int]) -> None:
        """Note that own tiles were measured again."""
        for tile in tiles:
            self._stale.add(TileKey(self.me.robot, self.me.incarnation, submap, tile))
        self.clock.changed()

    def recovered(self, key: TileKey) -> None:
        """Note that a tile of a former life is here, from disk; nobody may have heard of it."""
        self._stale.add(key)
        self._news_came(key)
        self.teller.changed(key)

    def heard_chunk(self, sender: int, chunk: Chunk, *, changed: bool) -> None:
        """Note that a team-mate sent a chunk: it has it, and all others heard it too."""
        del sender
        for peer in self.peers:
            self.believed[peer].has(chunk)
        self._stale.add(chunk.key)
        if changed:
            self._news_came(chunk.key)
            self.teller.changed(chunk.key)
            self.clock.changed()

    def heard_anchor(self, key: AnchorKey, version: int) -> None:
        """Note that an anchor was heard, by all."""
        for peer in self.peers:
            self.believed[peer].has_anchor(key, version)
        self.clock.changed()

    def heard_digest(self, sender: int, digest: Digest, now_s: float) -> None:
        """Believe what a team-mate says that it has, but for what was sent only just now."""
        changed = take_digest(self.believed[sender], digest, now_s)
        self._stale.update(changed)

    def _news_came(self, key: TileKey) -> None:
        self._news_count += 1
        self._order[key] = self._news_count

    # --- what to send ---------------------------------------------------------------------

    def choose(
        self, now_s: float, payload_bytes: int, rate_bps: float
    ) -> tuple[Kind, bytes] | None:
        """Return the next frame's kind and payload, or None when nothing is worth sending."""
        anchor = self._missing_anchor()
        if anchor is not None:
            for believed in self.believed.values():
                believed.has_anchor(anchor, self.store.anchors[anchor].version)
            return Kind.ANCHOR, pack_anchor(anchor, self.store.anchors[anchor])
        if self.clock.due(now_s):
            payload = self.teller.next_payload(payload_bytes)
            team_size, has_more = len(self.peers) + 1, self.teller.has_more
            self.clock.sent(now_s, len(payload), rate_bps, team_size, has_more=has_more)
            return Kind.DIGEST, payload
        chunks = self._choose_chunks(now_s, payload_bytes)
        if chunks:
            return Kind.MAP, pack_chunks(chunks, self.me)
        return None

    def settled(self) -> bool:
        """Say whether nothing is left that is worth its bytes, as far as this robot knows."""
        self._refresh()
        return self._missing_anchor() is None and self._best() is None

    def _missing_anchor(self) -> AnchorKey | None:
        """Return a submap whose anchor some peer lacks, once any of its tiles is published."""
        for key in sorted(self.store.anchors):
            version = self.store.anchors[key].version
            if any(b.lacks_anchor(key, version) for b in self.believed.values()):
                return key
        return None

    def _choose_chunks(self, now_s: float, payload_bytes: int) -> list[Chunk]:
        """Fill one frame with the chunks of most worth per byte."""
        chunks: list[Chunk] = []
        room = payload_bytes
        while room >= CHUNK_HEADER_BYTES + SMALLEST_CHUNK_BYTES:
            self._refresh()
            key = self._best()
            if key is None:
                break
            if self._offers[key].version == 0:
                self._publish(key)
                continue
            chunk = self._chunk(key, room - CHUNK_HEADER_BYTES)
            chunks.append(chunk)
            room -= CHUNK_HEADER_BYTES + len(chunk.data)
            for believed in self.believed.values():
                believed.has(chunk, sent_s=now_s)
            self._stale.add(key)
        return chunks

    def _best(self) -> TileKey | None:
        """Return the tile whose offer is worth most per byte, if any is worth a byte."""
        best, best_density = None, MIN_BITS_PER_BYTE
        for key in self._offers:
            density = self._offers[key].density
            if density > best_density or (density == best_density and best and key < best):
                best, best_density = key, density
        return best

    def _chunk(self, key: TileKey, room: int) -> Chunk:
        offer = self._offers[key]
        version = self.store.version(key, offer.version)
        assert version is not None
        # What fits beyond the wished level goes along: the next level begins where this one ends.
        end = min(offer.start + room, version.prefix_bytes)
        data = bytes(version.data[offer.start : end])
        return Chunk(key, version.number, version.total, offer.start, data)

    def _refresh(self) -> None:
        """Work out the offers of all tiles that changed."""
        for key in sorted(self._stale):
            offer = self._offer(key)
            if offer is None:
                self._offers.pop(key, None)
            else:
                self._offers[key] = offer
        self._stale.clear()

    def _offer(self, key: TileKey) -> Offer | None:
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
        starts = [b.prefix_of(key, version) for b in self.believed.values()]
        start = min(starts, default=version.prefix_bytes)
        if start >= version.prefix_bytes:
            return None
        steps = self._steps_of(key, version)
        have = [b.bits_of(key, version, self._steps) for b in self.believed.values()]
        best_density = 0.0
        for end, bits in zip(steps.ends, steps.bits, strict=True):
            if end <= start:
                continue
            gain = sum(max(0.0, bits - had) for had in have)
            density = self.weight(key) * gain / (end - start + CHUNK_HEADER_BYTES)
            best_density = max(best_density, density)
        # A payload that was begun is finished once nothing better is left: the last level alone
        # is exact, and what it adds to a mask counts for more than its bits say.
        floor = MIN_BITS_PER_BYTE * 1.01
        if self.settings.policy == "latest-first":
            return Offer(1e6 + self._order.get(key, 0), version.number, start)
        return Offer(max(best_density, floor), version.number, start)

    def _offer_to_publish(self, key: TileKey) -> Offer | None:
        """Return what a new version of an own tile would be worth, by an estimate of its size."""
        estimate = self._own_tile(key)
        bits = estimate.information_bits(self.map.prior_sigma_m)
        before = self.published.get(key)
        gain = bits - (before.information_bits if before else 0.0)
        if gain <= 0:
            return None
        known = int(np.count_nonzero(estimate.known))
        size = before.size_bytes if before else 24 + known // 5
        density = self.weight(key) * gain * len(self.peers) / (size + CHUNK_HEADER_BYTES)
        return Offer(density, 0)

    def _own_tile(self, key: TileKey) -> Estimate:
        submap = self.own.submaps[key.submap]
        window = self.team.grid.window(key.tile)
        elevation, variance = submap.estimate(window)
        return Estimate(
            elevation, variance + self.map.max_error_m**2 * UNIFORM, submap.looks[window]
        )

    def _publish(self, key: TileKey) -> None:
        """Freeze the next version of an own tile: encode it, make it durable, put it in store."""
        submap = self.own.submaps[key.submap]
        elevation, variance = submap.estimate(self.team.grid.window(key.tile))
        known = np.isfinite(variance)
        sigma = np.sqrt(np.where(known, variance, 0.0))
        encoded = encode_tile(elevation, known, sigma, self.map.max_error_m)
        before = self.published.get(key)
        number = before.version + 1 if before else 1
        chunk = Chunk(key, number, len(encoded.data), 0, encoded.data)
        self.journal(chunk)
        anchor = AnchorKey(key.robot, key.incarnation, key.submap)
        self.store.offer_anchor(anchor, submap.anchor)
        self.store.offer(chunk)
        self.team.tile_changed(key)
        self.teller.changed(key)
        self._learn_steps(key, number, encoded)
        # The gain is counted against what was published, not against what is worth sending of it.
        bits = self._own_tile(key).information_bits(self.map.prior_sigma_m)
        self.published[key] = Published(number, bits, len(encoded.data))
        self._news_came(key)
        self._stale.add(key)

    def _learn_steps(self, key: TileKey, number: int, encoded: EncodedTile) -> None:
        self._steps[(key, number)] = _steps(
            encoded.data, encoded.level_ends, self.map.prior_sigma_m
        )

    def _steps_of(self, key: TileKey, version: Version) -> Steps:
        """Return what a version is worth level by level; of one that was heard, all at once.

        Where its levels end only its origin knows; who relays it sends all that it has.
        """
        known = self._steps.get((key, version.number))
        if known is None or known.known_bytes < version.prefix_bytes:
            known = _steps(version.prefix, (version.prefix_bytes,), self.map.prior_sigma_m)
            self._steps[(key, version.number)] = known
        return known


def _steps(data: bytes, ends: tuple[int, ...], prior_sigma_m: float) -> Steps:
    """Decode a payload level by level and count the information of each."""
    bits: list[float] = []
    for end in ends:
        tile = readable(data[:end])
        if tile is None:
            bits.append(0.0)
            continue
        variance = tile.sigma_m[tile.known].astype(np.float64) ** 2 + tile.bound_m**2 * UNIFORM
        gains = np.maximum(0.0, 0.5 * np.log2(prior_sigma_m**2 / variance))
        bits.append(float(np.sum(gains)))
    return Steps(tuple(ends), tuple(bits), len(data))
