"""A robot's notebook: rows for the runner's tables, and the robot's own MCAP log."""

import contextlib
import io
import json
import math
from collections.abc import Callable, Generator
from pathlib import Path

from mcap.writer import CompressionType, Writer

from comms.frames import Kind
from comms.timebase import to_s
from scenarios.records.tables import (
    EventRow,
    LookRow,
    MapRow,
    Row,
    RxRow,
    TxRow,
    named,
    to_wire,
)

TOPICS: dict[type[Row], str] = {
    LookRow: "looks",
    TxRow: "frames_sent",
    RxRow: "frames_heard",
    MapRow: "map",
    EventRow: "events",
}


class LogFile:
    """One robot's MCAP file; each row is written at once, so a killed robot leaves all but one."""

    def __init__(self, path: Path) -> None:
        """Create the file."""
        self._raw = path.open("wb", buffering=0)
        self._stream = io.BufferedWriter(self._raw, 1 << 16)
        self._writer = Writer(self._stream, compression=CompressionType.NONE, use_chunking=False)
        self._channels: dict[str, int] = {}
        self.refusal = ""
        """What the disk said when it took no more; the log ends there, and the robot goes on."""
        with self._trying():
            self._writer.start(profile="", library="ropeteam")

    @contextlib.contextmanager
    def _trying(self) -> Generator[None]:
        try:
            yield
        except OSError as error:
            self.refusal = error.strerror or str(error)
            self._raw.close()  # with what it could not take: nothing is tried again

    def add(self, row: Row, t_ns: int) -> None:
        """Write a row as JSON under its topic."""
        if self.refusal:
            return
        with self._trying():
            self._add(row, t_ns)

    def _add(self, row: Row, t_ns: int) -> None:
        topic = TOPICS[type(row)]
        if topic not in self._channels:
            schema = self._writer.register_schema(
                f"ropeteam.{type(row).__name__}", "jsonschema", b'{"type": "object"}'
            )
            self._channels[topic] = self._writer.register_channel(topic, "json", schema)
        data = json.dumps(_finite(named(row))).encode()
        self._writer.add_message(self._channels[topic], t_ns, data, t_ns)

    def keep(self, topic: str, data: bytes, t_ns: int) -> None:
        """Write MessagePack under a topic of its own."""
        if self.refusal:
            return
        with self._trying():
            if topic not in self._channels:
                self._channels[topic] = self._writer.register_channel(topic, "msgpack", 0)
            self._writer.add_message(self._channels[topic], t_ns, data, t_ns)

    def flush(self) -> None:
        """Hand what was written to the operating system."""
        if not self.refusal:
            with self._trying():
                self._stream.flush()

    def close(self) -> None:
        """End the file in order."""
        if not self.refusal:
            with self._trying():
                self._writer.finish()
                self._stream.close()

    def abandon(self) -> None:
        """Leave the file as a killed process leaves it, if it was not closed."""
        if not self.refusal:
            with self._trying():
                self._stream.close()


def _finite(row: dict[str, object]) -> dict[str, object]:
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in row.items()
    }


class Notebook:
    """Collects the rows of one robot until its next report."""

    def __init__(self, name: str, log: LogFile | None, now_ns: Callable[[], int]) -> None:
        """Begin the notebook of a robot whose clock is `now_ns`, with a log or without."""
        self.name = name
        self.log = log
        self.rows: list[object] = []
        self.cuts: list[tuple[int, float]] = []
        self._now_ns = now_ns

    def add(self, row: Row, t_ns: int) -> None:
        """Keep a row for the runner and write it to the robot's own log."""
        self.rows.append(to_wire(row))
        if self.log is not None:
            self.log.add(row, t_ns)
            if self.log.refusal:
                told = f"its log ends here: {self.log.refusal}"
                self.log = None
                self.rows.append(to_wire(EventRow(to_s(t_ns), self.name, "disk", told)))

    def on_tx(
        self,
        *,
        number: int,
        kind: Kind,
        charged_bytes: int,
        chosen_ns: int,
        start_ns: int,
        end_ns: int,
    ) -> None:
        """Note that a frame's transmission begins."""
        times = (to_s(chosen_ns), to_s(start_ns), to_s(end_ns))
        row = TxRow(self.name, number, kind.name.lower(), charged_bytes, *times)
        self.add(row, start_ns)

    def on_cut(self, number: int) -> None:
        """Note that a frame was cut short."""
        self.cuts.append((number, to_s(self._now_ns())))

    def on_rx(self, sender: str, number: int, arrive_ns: int, verdict: str) -> None:
        """Note what became of a frame."""
        self.add(RxRow(self.name, sender, number, to_s(arrive_ns), verdict), arrive_ns)

    def take(self) -> tuple[list[object], list[tuple[int, float]]]:
        """Return the rows and cuts since the last report."""
        rows, cuts = self.rows, self.cuts
        self.rows, self.cuts = [], []
        if self.log is not None:
            self.log.flush()
        return rows, cuts

    def close(self) -> None:
        """End the log in order."""
        if self.log is not None:
            self.log.close()

    def abandon(self) -> None:
        """Leave the log as a killed process leaves it."""
        if self.log is not None:
            self.log.abandon()
