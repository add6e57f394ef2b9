"""What a robot says of what it heard and has: the payload of a DIGEST frame.

Where frames were lost it names them by number, which takes a few bytes: whoever sent or heard them
knows what was in them. Only where that is of no use (a newcomer, stores that differ for reasons
unknown) it names tiles.
"""

from dataclasses import dataclass
from itertools import pairwise

from agents.store import AnchorKey
from agents.wire import MessageError, Reader, Writer

MAX_MISSED_RANGES = 32
"""Ranges of lost frames that one report names of one sender."""


@dataclass(frozen=True)
class Acks:
    """Which frames of one sender's life were heard: all below `upto`, but for those missed."""

    robot: int
    incarnation: int
    upto: int
    missed: tuple[tuple[int, int], ...] = ()
    """(first, last) sequence numbers, both missed, ascending."""


@dataclass(frozen=True)
class Held:
    """What is said of one version of a tile: how much of it is there from the start."""

    tile: int
    version: int
    prefix_bytes: int
    """-1 when the whole payload is there."""


@dataclass(frozen=True)
class Section:
    """What is said of a run of tiles of one submap: those not listed are not held.

    A tile is listed once for each version that is held, the oldest first.
    """

    key: AnchorKey
    first_tile: int
    last_tile: int
    held: tuple[Held, ...]


@dataclass(frozen=True)
class Holdings:
    """What a robot has: a run of its submaps with their anchors' versions, and some tiles of them.

    The run goes from the first submap that is named to the last, or, where it `opens` or `closes`
    the list, from the first or to the last that there could be.
    """

    anchors: tuple[tuple[AnchorKey, int], ...]
    """(submap, version of its anchor + 1, or 0 without anchor), ascending; a submap that is in the
    run and not here is not held."""
    sections: tuple[Section, ...]
    opens: bool = True
    closes: bool = True

    def speaks_of(self, key: AnchorKey) -> bool:
        """Say whether a submap lies in the run, held or not."""
        if not self.anchors:
            return self.opens and self.closes
        after_first = self.opens or key >= self.anchors[0][0]
        return after_first and (self.closes or key <= self.anchors[-1][0])


@dataclass(frozen=True)
class Report:
    """What a robot heard of others' frames, and, where that is not enough, what it has."""

    acks: tuple[Acks, ...] = ()
    holdings: Holdings | None = None


def pack_report(report: Report) -> bytes:
    """Return the payload of a DIGEST frame."""
    out = Writer()
    out.uint(len(report.acks) * 2 + (report.holdings is not None))
    for acks in report.acks:
        _write_acks(out, acks)
    if report.holdings is not None:
        _write_holdings(out, report.holdings)
    return bytes(out.data)


def unpack_report(data: bytes) -> Report:
    """Take the payload of a DIGEST frame apart; raise MessageError where it is none."""
    reader = Reader(data)
    count, has_holdings = divmod(reader.uint(), 2)
    acks = tuple(_read_acks(reader) for _ in range(count))
    if has_holdings:
        return Report(acks, _read_holdings(reader))
    if not reader.at_end:
        raise MessageError("payload goes on after its message")
    return Report(acks)


def _write_acks(out: Writer, acks: Acks) -> None:
    out.uint(acks.robot)
    out.byte(acks.incarnation)
    out.uint(acks.upto)
    out.uint(len(acks.missed))
    below = acks.upto
    for first, last in reversed(acks.missed):  # the latest first: their numbers are short
        out.uint(below - 1 - last)
        out.uint(last - first)
        below = first


def _read_acks(reader: Reader) -> Acks:
    robot, incarnation, upto = reader.uint(), reader.byte(), reader.uint()
    count = reader.uint()
    if count > MAX_MISSED_RANGES:
        raise MessageError(f"{count} ranges of lost frames; {MAX_MISSED_RANGES} are allowed")
    missed: list[tuple[int, int]] = []
    below = upto
    for _ in range(count):
        last = below - 1 - reader.uint()
        first = last - reader.uint()
        if first < 0:
            raise MessageError(f"lost frames begin at number {first}; numbers begin at 0")
        missed.append((first, last))
        below = first
    return Acks(robot, incarnation, upto, tuple(reversed(missed)))


def _write_holdings(out: Writer, holdings: Holdings) -> None:
    out.uint(len(holdings.anchors) * 4 + holdings.opens * 2 + holdings.closes)
    for key, version in holdings.anchors:
        out.uint(key.robot)
        out.byte(key.incarnation)
        out.uint(key.submap)
        out.uint(version)
    order = [key for key, _ in holdings.anchors]
    for section in holdings.sections:
        out.uint(order.index(section.key))
        out.uint(section.first_tile)
        out.uint(section.last_tile - section.first_tile)
        out.uint(len(section.held))
        before = section.first_tile
        for held in section.held:
            out.uint(held.tile - before)
            out.uint(held.version)
            out.uint(held.prefix_bytes + 1)
            before = held.tile


def _read_holdings(reader: Reader) -> Holdings:
    count, flags = divmod(reader.uint(), 4)
    anchors = tuple(
        (AnchorKey(reader.uint(), reader.byte(), reader.uint()), reader.uint())
        for _ in range(count)
    )
    if any(a[0] >= b[0] for a, b in pairwise(anchors)):
        raise MessageError("the submaps of a report are not in ascending order")
    sections: list[Section] = []
    while not reader.at_end:
        index = reader.uint()
        if index >= len(anchors):
            raise MessageError(f"section of submap {index}; the report lists {len(anchors)}")
        first = reader.uint()
        last = first + reader.uint()
        held: list[Held] = []
        tile = first
        for _ in range(reader.uint()):
            tile += reader.uint()
            held.append(Held(tile, reader.uint(), reader.uint() - 1))
        sections.append(Section(anchors[index][0], first, last, tuple(held)))
    return Holdings(anchors, tuple(sections), flags >= 2, flags % 2 == 1)
