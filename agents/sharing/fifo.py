"""Plain ways of sharing, to be compared against: first in, first out, and nothing is said twice.

Each sends its own layer only; what was lost is lost until it is sent again for another reason.
"""

from collections import deque

from agents.messages import CHUNK_HEADER_BYTES, pack_anchor, pack_chunks
from agents.sharing.policy import Desk, Free, Policy
from agents.store import AnchorKey, Chunk, TileKey
from comms.frames import Kind


class Fifo(Policy):
    """Payloads in a queue, cut into frames in their order."""

    def __init__(self, desk: Desk) -> None:
        """Begin with an empty queue."""
        super().__init__(desk)
        self._queue: deque[Chunk] = deque()
        self._anchors: deque[AnchorKey] = deque()
        self._named: set[AnchorKey] = set()

    def next_tile(self) -> TileKey | None:
        """Return the own tile that is to be queued now that the queue is empty."""
        return None

    def queue(self, key: TileKey) -> None:
        """Publish a tile as it is now, and put it at the end."""
        chunk, _ = self.publish(key)
        self._queue.append(chunk)

    def choose(self, free: Free) -> tuple[Kind, bytes] | None:
        """Return the next frame: the rest of what is under way, then what comes next."""
        if not self._queue:
            key = self.next_tile()
            if key is not None:
                self.queue(key)
        unnamed = [key for key in sorted(self.store.anchors) if key not in self._named]
        if unnamed:
            self._named.add(unnamed[0])
            return Kind.ANCHOR, pack_anchor(unnamed[0], self.store.anchors[unnamed[0]])
        chunks: list[Chunk] = []
        room = free.payload_bytes
        while self._queue and room > CHUNK_HEADER_BYTES:
            chunk = self._queue.popleft()
            cut = room - CHUNK_HEADER_BYTES
            head, rest = chunk.data[:cut], chunk.data[cut:]
            chunks.append(Chunk(chunk.key, chunk.version, chunk.total, chunk.offset, head))
            room -= CHUNK_HEADER_BYTES + len(head)
            if rest:
                later = chunk.offset + len(head)
                self._queue.appendleft(Chunk(chunk.key, chunk.version, chunk.total, later, rest))
        return (Kind.MAP, pack_chunks(chunks, self.me)) if chunks else None

    def settled(self) -> bool:
        """Say whether the queue is empty."""
        return not self._queue

    def newcomer(self, robot: int) -> None:
        """Tell where the submaps lie once more."""
        del robot
        self._named.clear()


class RawGrid(Fifo):
    """The grid in order, cell by cell: round and round over the tiles that changed."""

    def __init__(self, desk: Desk) -> None:
        """Begin at the first tile."""
        super().__init__(desk)
        self._changed: set[TileKey] = set()
        self._after: TileKey | None = None

    def own_tiles_changed(self, submap: int, tiles: list[int]) -> None:
        """Note what is to be sent when its turn comes."""
        self._changed.update(TileKey(*self.me, submap, tile) for tile in tiles)

    def newcomer(self, robot: int) -> None:
        """Have everything sent once more."""
        super().newcomer(robot)
        self._changed.update(self.versions)

    def next_tile(self) -> TileKey | None:
        """Return the next changed tile after the last one sent, in the order of the grid."""
        if not self._changed:
            return None
        later = [k for k in self._changed if self._after is not None and k > self._after]
        self._after = min(later or self._changed)
        self._changed.discard(self._after)
        return self._after

    def settled(self) -> bool:
        """Say whether nothing is under way, and nothing changed."""
        return super().settled() and not self._changed


class WholeMap(Fifo):
    """The paper's way: the whole map after each look, and when somebody joins (section 2.4).

    Its maps are one tile each, so that the quadtree may take in all of them.
    """

    def own_tiles_changed(self, submap: int, tiles: list[int]) -> None:
        """Queue the map as it is after this look."""
        for tile in tiles:
            self.queue(TileKey(*self.me, submap, tile))

    def newcomer(self, robot: int) -> None:
        """Queue all maps once more."""
        super().newcomer(robot)
        for key in sorted(self.versions):
            self.queue(key)
