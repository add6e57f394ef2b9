"""What every way of sharing answers: the questions that a robot and its radio ask of it."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from agents.settings import SharingSettings
from agents.sharing.repair import Mark
from agents.sharing.reports import Report
from agents.store import AnchorKey, Chunk, Origin, Store, TileKey
from agents.teammap import TeamMap
from comms.codec import EncodedTile
from comms.frames import Kind


@dataclass(frozen=True)
class Desk:
    """What a policy works with."""

    settings: SharingSettings
    me: Origin
    team_size: int
    team: TeamMap[Any, Any]
    journal: Callable[[Chunk], None]
    """Makes a version durable; it must be before any of it is sent."""

    @property
    def store(self) -> Store:
        """The replicated store."""
        return self.team.store


@dataclass(frozen=True)
class Free:
    """The link is free: when, for how much, and which number the frame will bear."""

    now_s: float
    payload_bytes: int
    rate_bps: float
    seq: int


@dataclass(frozen=True)
class Heard:
    """A frame that was heard: whose, which and when."""

    sender: Origin
    seq: int
    now_s: float


class Policy(ABC):
    """Chooses what goes out whenever the link falls free. Pure but for the store."""

    def __init__(self, desk: Desk) -> None:
        """Begin with nothing sent and nothing heard."""
        self.desk = desk
        self.store = desk.store
        self.me = desk.me
        self.versions: dict[TileKey, int] = {}
        """The last version published of each own tile."""
        self.weight: Callable[[TileKey], float] = lambda key: 1.0
        """How much more a tile is worth to the team than any other, for what it is doing."""

    @abstractmethod
    def own_tiles_changed(self, submap: int, tiles: list[int]) -> None:
        """Note that own tiles were measured again."""

    @abstractmethod
    def choose(self, free: Free) -> tuple[Kind, bytes] | None:
        """Return the next frame's kind and payload, or None when nothing is worth sending."""

    @abstractmethod
    def settled(self) -> bool:
        """Say whether nothing is left to send, as far as this robot knows."""

    def recovered(self, key: TileKey) -> None:
        """Note that a tile of a former life is here, from disk; nobody may have heard of it."""
        del key

    def heard_frame(self, heard: Heard) -> None:
        """Note that a frame was heard, whatever is in it."""
        del heard

    def heard_chunks(self, heard: Heard, chunks: list[tuple[Chunk, bool]]) -> None:
        """Note the map chunks of a frame, and which of them were news to the store."""
        del heard, chunks

    def heard_anchor(self, heard: Heard, key: AnchorKey, version: int) -> None:
        """Note that an anchor was heard."""
        del heard, key, version

    def heard_report(self, heard: Heard, report: Report) -> None:
        """Note what a team-mate says that it heard and has."""
        del heard, report

    def heard_mark(self, heard: Heard, mark: Mark) -> None:
        """Note the mark of a team-mate's store."""
        del heard, mark

    def newcomer(self, robot: int) -> None:
        """Note that a team-mate has come, or has come back as another life."""
        del robot

    def look_again(self) -> None:
        """Note that the robot has moved so far that other tiles may be worth passing on."""
        return

    def publish(self, key: TileKey) -> tuple[Chunk, EncodedTile]:
        """Freeze the next version of an own tile: encode it, make it durable, put it in store."""
        submap = self.desk.team.own.submaps[key.submap]
        window = self.desk.team.grid.window(key.tile)
        encoded = self.desk.team.kind.encode(submap, window)
        number = self.versions.get(key, 0) + 1
        chunk = Chunk(key, number, len(encoded.data), 0, encoded.data)
        self.desk.journal(chunk)
        self.versions[key] = number
        anchor = AnchorKey(key.robot, key.incarnation, key.submap)
        self.store.offer_anchor(anchor, submap.anchor)
        self.store.offer(chunk)
        self.desk.team.tile_changed(key)
        return chunk, encoded
