"""What robots report while they run, and the tables that are kept of it.

Rows travel as plain tuples whose first entry names the table, and are kept in whatever order they
came; the files are sorted by content, so that they don't depend on which process spoke first.
"""

import csv
import io
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from comms.faults import Verdict

DELIVERED = Verdict.DELIVERED.value
"""Verdict on a frame that its receiver got and believed."""
SENDER_DIED = "sender died"
"""Verdict on a frame that was in the air when its sender died: it was never heard."""
RECEIVER_DOWN = "receiver down"
"""Verdict on a frame whose receiver did not run when it would have arrived."""
NOT_YET_ARRIVED = "not yet arrived"
"""Verdict on a frame that was still under way when the run ended."""
_NEVER_THERE = frozenset(v.value for v in Verdict if v is not Verdict.DELIVERED)
"""The link's verdicts on frames that did not reach their receiver at all."""


@dataclass(frozen=True, slots=True)
class LookRow:
    """One exposure at one heading; positions are true, in the world's frame."""

    robot: str
    t_s: float
    x_m: float
    y_m: float
    z_m: float
    pan_rad: float
    tilt_rad: float
    expected_cells: float
    obtained_cells: int
    new_cells: int
    distance_m: float
    coverage: float
    """Share of the observable cells that its team map has after this look."""


@dataclass(frozen=True, slots=True)
class TxRow:
    """One frame that a robot began to send; `bytes` are the charged ones, overhead included."""

    sender: str
    seq: int
    kind: str
    bytes: int
    chosen_s: float
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class RxRow:
    """What became of one frame at one receiver: the link's `Verdict`, or why it was not believed.

    `arrive_s` is when it arrived or would have.
    """

    receiver: str
    sender: str
    seq: int
    arrive_s: float
    verdict: str


@dataclass(frozen=True, slots=True)
class MapRow:
    """How much a robot knew at a moment; `elevation_rmse_m` is None where it knew nothing."""

    t_s: float
    robot: str
    own_cells: int
    team_cells: int
    information_bits: float
    elevation_rmse_m: float | None
    map_cells: int
    """Cells of its team map that are known, whoever measured them."""
    own_bits: float
    """Information of its own layer, as team-mates could have it."""
    heard_bits: float
    """Information of the others' layers, each by itself, that is here."""


@dataclass(frozen=True, slots=True)
class EventRow:
    """Something that happened to a robot or that it did, in words."""

    t_s: float
    robot: str
    what: str
    detail: str


Row = LookRow | TxRow | RxRow | MapRow | EventRow
Wire = tuple[str | int | float | None, ...]

_TABLES: dict[str, type[LookRow] | type[TxRow] | type[RxRow] | type[MapRow] | type[EventRow]] = {
    "look": LookRow,
    "tx": TxRow,
    "rx": RxRow,
    "map": MapRow,
    "event": EventRow,
}
_TAGS = {table: tag for tag, table in _TABLES.items()}

_COLUMNS = {table: tuple(field.name for field in fields(table)) for table in _TAGS}

LOOK_COLUMNS = tuple(field.name for field in fields(LookRow))
FRAME_COLUMNS = (
    "from",
    "to",
    "kind",
    "bytes",
    "chosen_s",
    "start_s",
    "end_s",
    "arrive_s",
    "verdict",
)
MAP_COLUMNS = tuple(field.name for field in fields(MapRow))
EVENT_COLUMNS = tuple(field.name for field in fields(EventRow))


def to_wire(row: Row) -> Wire:
    """Return a row as a flat tuple of plain values, its table's name first."""
    table = type(row)
    return (_TAGS[table], *[getattr(row, key) for key in _COLUMNS[table]])


def named(row: Row) -> dict[str, object]:
    """Return a row's values by their names."""
    return {key: getattr(row, key) for key in _COLUMNS[type(row)]}


def from_wire(wire: Sequence[object]) -> Row:
    """Return the row that `to_wire` made a tuple (or, after msgpack, a list) of.

    The other end is this program's own process: what is no row there is a bug, and raises
    KeyError or TypeError.
    """
    tag, *values = wire
    return _TABLES[str(tag)](*values)  # pyright: ignore[reportArgumentType]  (checked by its sender)


@dataclass(frozen=True, slots=True)
class Downtime:
    """A span in which a robot did not run: not yet joined, stopped, killed or gone."""

    robot: str
    start_s: float
    end_s: float


class Records:
    """All rows of one run.

    A frame is known by (sender, seq): a robot that restarts goes on counting where it was.
    """

    def __init__(self, robots: Sequence[str]) -> None:
        """Start empty for a team; `robots` are all that ever take part."""
        self.robots = tuple(sorted(robots))
        self.looks: list[LookRow] = []
        self.maps: list[MapRow] = []
        self.events: list[EventRow] = []
        self._sent: dict[tuple[str, int], TxRow] = {}
        self._heard: dict[tuple[str, str, int], RxRow] = {}
        self._cut_s: dict[tuple[str, int], float] = {}
        self._down: list[Downtime] = []

    def add(self, row: Row) -> None:
        """Keep a row. The first report on a frame (or on its arrival at one robot) counts."""
        match row:
            case LookRow():
                self.looks.append(row)
            case MapRow():
                self.maps.append(row)
            case EventRow():
                self.events.append(row)
            case TxRow():
                self._sent.setdefault((row.sender, row.seq), row)
            case RxRow():
                self._heard.setdefault((row.receiver, row.sender, row.seq), row)

    def add_cut(self, sender: str, seq: int, at_s: float) -> None:
        """Note that a frame was cut short at a moment: its sender died or hung while sending."""
        self._cut_s[(sender, seq)] = at_s

    def add_downtime(self, robot: str, start_s: float, end_s: float = math.inf) -> None:
        """Note that a robot did not run from one moment to another (or to the end)."""
        self._down.append(Downtime(robot, start_s, end_s))

    @property
    def downtimes(self) -> list[Downtime]:
        """All spans in which a robot did not run, in the order in which they ended."""
        return list(self._down)

    @property
    def frames(self) -> list[TxRow]:
        """All frames that were begun, by start, sender and sequence."""
        return sorted(self._sent.values(), key=lambda tx: (tx.start_s, tx.sender, tx.seq))

    def deliveries(self) -> list[tuple[TxRow, RxRow]]:
        """Return all frames that were heard and believed, each with its arrival, by frame."""
        pairs = (
            (tx, self._heard.get((receiver, tx.sender, tx.seq)))
            for tx in self.frames
            for receiver in self.robots
        )
        return [(tx, rx) for tx, rx in pairs if rx is not None and rx.verdict == DELIVERED]

    def busy_s(self, sender: str, until_s: float) -> float:
        """Return how long a robot's transmitter was on the air before a moment."""
        mine = (tx for tx in self.frames if tx.sender == sender)
        ends = ((tx.start_s, min(tx.end_s, until_s, self._cut_at(tx))) for tx in mine)
        return sum(max(0.0, end - start) for start, end in ends)

    def _cut_at(self, tx: TxRow) -> float:
        return self._cut_s.get((tx.sender, tx.seq), math.inf)

    def _silence(self, tx: TxRow, receiver: str) -> str:
        """Say why a team-mate reported nothing of a frame."""
        if (tx.sender, tx.seq) in self._cut_s:
            return SENDER_DIED
        # A robot that ran on from the end of a transmission would have reported its arrival: one
        # that went down later went down before it.
        down = any(span.robot == receiver and span.end_s > tx.end_s for span in self._down)
        return RECEIVER_DOWN if down else NOT_YET_ARRIVED

    def _frame_row(self, tx: TxRow, receiver: str) -> tuple[object, ...]:
        rx = self._heard.get((receiver, tx.sender, tx.seq))
        arrive_s = None if rx is None or rx.verdict in _NEVER_THERE else rx.arrive_s
        verdict = self._silence(tx, receiver) if rx is None else rx.verdict
        when = (tx.chosen_s, tx.start_s, tx.end_s, arrive_s)
        return (tx.sender, receiver, tx.kind, tx.bytes, *when, verdict)

    def frame_rows(self) -> list[tuple[object, ...]]:
        """Return the rows of `frames.csv` (see `FRAME_COLUMNS`): one per frame and team-mate."""
        return [
            self._frame_row(tx, receiver)
            for tx in self.frames
            for receiver in self.robots
            if receiver != tx.sender
        ]

    def write(self, folder: Path) -> None:
        """Write `looks.csv`, `frames.csv`, `maps.csv` and `events.csv`, each at once and whole."""
        looks = sorted(map(_fields, self.looks), key=lambda row: (row[1], row[0]))
        maps = sorted(map(_fields, self.maps), key=lambda row: (row[0], row[1]))
        events = sorted(map(_fields, self.events))
        write_table(folder / "looks.csv", LOOK_COLUMNS, looks)
        write_table(folder / "frames.csv", FRAME_COLUMNS, self.frame_rows())
        write_table(folder / "maps.csv", MAP_COLUMNS, maps)
        write_table(folder / "events.csv", EVENT_COLUMNS, events)


def _fields(row: Row) -> tuple[object, ...]:
    return astuple(row)


def _text(value: object) -> str:
    """Write a float in full (so that it reads back equal), what is not there as nothing."""
    if value is None:
        return ""
    if isinstance(value, float):
        return repr(float(value)) if math.isfinite(value) else ""
    return str(value)


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV file, whole or not at all."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_text(value) for value in row] for row in rows)
    write_atomic(path, text.getvalue())


def write_atomic(path: Path, text: str) -> None:
    """Write a text file, whole or not at all: a reader never sees half of it."""
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8", newline="")
    os.replace(part, path)
