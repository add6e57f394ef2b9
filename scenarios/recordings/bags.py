"""Messages of MCAP files and ROS 2 bags, whatever wrote them."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from scenarios.ros2.cdrreading import CdrError, decode
from sim.errors import WorldError

SUFFIXES = (".mcap", ".db3")


@dataclass(frozen=True)
class Message:
    """One message of a recording."""

    topic: str
    kind: str
    """Its type, pkg/msg/Name."""
    told: dict[str, Any]
    """Its fields (`scenarios.ros2.cdrreading`)."""
    t_ns: int
    """Its header's stamp; when it was logged, where it has none."""


class Bag:
    """A recording on disk: one file, or a bag's folder of several."""

    def __init__(self, place: Path) -> None:
        """Look what is in it.

        Raises:
            WorldError: it is none, or can't be read.

        """
        self.place = place
        self.files = _files(place)
        self.topics: dict[str, str] = {}
        """Type by topic."""
        for file in self.files:
            self.topics |= self._guarded(file, _topics)

    def of_kinds(self, *kinds: str) -> list[str]:
        """Return the topics of any of some types, by alphabet."""
        return sorted(topic for topic, kind in self.topics.items() if kind in kinds)

    def read(self, *topics: str) -> Iterator[Message]:
        """Yield the messages of topics, file by file.

        Raises:
            WorldError: one can't be read.

        """
        for file in self.files:
            for topic, logged_ns, data in self._guarded(file, partial(_messages, topics=topics)):
                yield self._message(topic, logged_ns, data)

    def _message(self, topic: str, logged_ns: int, data: bytes) -> Message:
        kind = self.topics[topic]
        try:
            told = decode(kind, data)
        except CdrError as error:
            raise WorldError(f"{self.place}: a {kind} of {topic} is damaged: {error}") from error
        stamp = told.get("header", {}).get("stamp", {"sec": 0, "nanosec": 0})
        return Message(
            topic, kind, told, stamp["sec"] * 1_000_000_000 + stamp["nanosec"] or logged_ns
        )

    def _guarded(self, file: Path, look: Any) -> Any:
        try:
            return look(file)
        except OSError as error:
            raise WorldError(f"{file}: can't be read: {error.strerror or error}") from error
        except Exception as error:  # whatever damage does to those who read it
            said = str(error) or type(error).__name__
            raise WorldError(f"{file}: is no recording, or a damaged one: {said}") from error


def _files(place: Path) -> list[Path]:
    if not place.is_dir():
        if place.suffix not in SUFFIXES:
            raise WorldError(f"{place}: {_no_bag(place.suffix)}")
        return [place]
    found = sorted(file for file in place.iterdir() if file.suffix in SUFFIXES)
    if not found:
        packed = any(file.suffix == ".zstd" for file in place.iterdir())
        raise WorldError(f"{place}: {_no_bag('.zstd' if packed else '')}")
    return found


def _no_bag(suffix: str) -> str:
    match suffix:
        case ".bag":
            return "is a bag of ROS 1; convert it to one of ROS 2 (rosbags-convert) first"
        case ".zstd":
            return "is a packed bag; unpack its files (zstd -d) first"
        case _:
            return "is no recording; needed is an .mcap or .db3 file, or a folder that holds some"


def _topics(file: Path) -> dict[str, str]:
    if file.suffix == ".db3":
        with closing(_opened(file)) as bag:
            return dict(bag.execute("SELECT name, type FROM topics"))
    with file.open("rb") as stream:
        found: dict[str, str] = {}
        reader = make_reader(stream)
        summary = reader.get_summary()
        if summary is not None and summary.channels:
            for channel in summary.channels.values():
                schema = summary.schemas.get(channel.schema_id)
                found[channel.topic] = _kind(channel.message_encoding, schema)
            return found
        for schema, channel, _ in reader.iter_messages(log_time_order=False):
            found[channel.topic] = _kind(channel.message_encoding, schema)
        return found


def _kind(encoding: str, schema: Any) -> str:
    """Return a type's name; with the encoding before it where that is none of ROS 2's."""
    name = "" if schema is None else str(schema.name)
    return name if encoding == "cdr" else f"{encoding} {name}"


def _messages(file: Path, topics: tuple[str, ...]) -> list[tuple[str, int, bytes]]:
    if file.suffix == ".db3":
        with closing(_opened(file)) as bag:
            marks = ", ".join("?" * len(topics))
            rows = bag.execute(
                "SELECT topics.name, messages.timestamp, messages.data FROM messages"
                " JOIN topics ON topics.id = messages.topic_id"
                f" WHERE topics.name IN ({marks}) ORDER BY messages.timestamp, messages.id",
                topics,
            )
            return [(str(name), int(t_ns), bytes(data)) for name, t_ns, data in rows]
    with file.open("rb") as stream:
        found = make_reader(stream).iter_messages(topics=topics)
        return [(channel.topic, message.log_time, message.data) for _, channel, message in found]


def _opened(file: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)
