"""Names what a robot has, a frame at a time, where frame numbers do not help."""

from agents.sharing.reports import Acks, Held, Holdings, Report, Section, pack_report
from agents.store import AnchorKey, Store, TileKey

REFRESHED = 12
"""Tiles told again with each report though nothing changed: one that was lost is made good."""
TILE_SHARE = 1 / 3
"""So much of a report is kept for tiles, however many submaps there are to name."""


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

    def next_payload(self, acks: tuple[Acks, ...], payload_bytes: int) -> bytes:
        """Return one report's payload; it is of use alone, and says what it speaks of."""
        all_keys = self._store.keys()
        submaps = sorted({_submap_of(key) for key in all_keys} | set(self._store.anchors))
        room_bytes = payload_bytes - len(pack_report(Report(acks)))
        low, high = self._run_of(submaps, room_bytes)
        named, whole = submaps[low:high], (low == 0, high == len(submaps))
        keys = [key for key in all_keys if _submap_of(key) in named]
        news = [i for i, key in enumerate(keys) if key in self._news]
        turn = [(self._cursor + i) % len(keys) for i in range(min(REFRESHED, len(keys)))]
        places = [*news, *(i for i in turn if keys[i] not in self._news)]
        payload = self._packed(acks, named, whole, keys, places)
        while len(payload) > payload_bytes and places:
            places = places[: len(places) * 7 // 8]
            payload = self._packed(acks, named, whole, keys, places)
        self._news.difference_update(keys[i] for i in places)
        self._cursor = (self._cursor + REFRESHED) % max(1, len(keys))
        return payload

    def _packed(
        self,
        acks: tuple[Acks, ...],
        named: list[AnchorKey],
        whole: tuple[bool, bool],
        keys: list[TileKey],
        told: list[int],
    ) -> bytes:
        drawn = {_submap_of(key) for key in keys}
        bare = self._bare([key for key in named if key not in drawn])
        sections = (*bare, *self._sections(keys, sorted(told)))
        return pack_report(Report(acks, Holdings(self._versions(named), sections, *whole)))

    def _run_of(self, submaps: list[AnchorKey], all_room_bytes: int) -> tuple[int, int]:
        """Return which submaps the next frame names: all, if they fit; else some in turn."""
        room_bytes = (1 - TILE_SHARE) * all_room_bytes

        def fits(low: int, high: int) -> bool:
            run = submaps[low:high]
            report = Report((), Holdings(self._versions(run), self._bare(run)))
            return len(pack_report(report)) <= room_bytes

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
