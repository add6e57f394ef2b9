"""What robots say to each other, byte by byte: the payloads inside the frames.

Small whole numbers are varints (seven bits a byte), signed ones zigzag; lengths are millimetres,
yaw tenths of milliradians, variances quarter octaves (`agents.layers`). Whatever a peer may send
is checked while it is read: a payload is understood whole or refused with a MessageError.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

from agents.errors import AgentError
from agents.geometry import Pose
from agents.layers import YAW_STEP_RAD, Anchor, variance_of_step, variance_step
from agents.store import MAX_PAYLOAD_BYTES, AnchorKey, Chunk, TileKey

T = TypeVar("T")
Variance = tuple[float, float, float, float]
VARINT_BYTES = 5


class MessageError(AgentError):
    """A payload is no message of its kind."""


class Writer:
    """Builds a payload."""

    def __init__(self) -> None:
        """Start empty."""
        self.data = bytearray()

    def byte(self, value: int) -> None:
        """Add one byte."""
        self.data.append(value)

    def uint(self, value: int) -> None:
        """Add a whole number from 0."""
        while value > 0x7F:
            self.data.append(0x80 | value & 0x7F)
            value >>= 7
        self.data.append(value)

    def sint(self, value: int) -> None:
        """Add a whole number of either sign."""
        self.uint(value * 2 if value >= 0 else -value * 2 - 1)

    def pose(self, pose: Pose) -> None:
        """Add a pose, to the millimetre."""
        for length_m in (pose.x_m, pose.y_m, pose.z_m):
            self.sint(round(length_m * 1000))
        self.sint(round(pose.yaw_rad / YAW_STEP_RAD))

    def variance(self, variance: Variance) -> None:
        """Add four variances, rounded up."""
        self.data.extend(variance_step(v) for v in variance)


class Reader:
    """Takes a payload apart; raises MessageError where it ends too soon."""

    def __init__(self, data: bytes) -> None:
        """Start at the first byte."""
        self._data = data
        self._at = 0

    @property
    def at_end(self) -> bool:
        """Whether everything was read."""
        return self._at >= len(self._data)

    def bytes(self, count: int) -> bytes:
        """Take so many bytes."""
        if count > len(self._data) - self._at:
            raise MessageError(
                f"payload of {len(self._data)} bytes ends inside a field of {count} bytes"
            )
        self._at += count
        return self._data[self._at - count : self._at]

    def byte(self) -> int:
        """Take one byte."""
        return self.bytes(1)[0]

    def uint(self) -> int:
        """Take a whole number from 0, below 2^35."""
        value = 0
        for place in range(VARINT_BYTES):
            byte = self.byte()
            value |= (byte & 0x7F) << (7 * place)
            if byte < 0x80:
                return value
        raise MessageError(f"a number does not end within {VARINT_BYTES} bytes")

    def sint(self) -> int:
        """Take a whole number of either sign."""
        value = self.uint()
        return value >> 1 if value % 2 == 0 else -(value + 1 >> 1)

    def pose(self) -> Pose:
        """Take a pose."""
        x_mm, y_mm, z_mm, yaw = self.sint(), self.sint(), self.sint(), self.sint()
        return Pose(x_mm / 1000, y_mm / 1000, z_mm / 1000, yaw * YAW_STEP_RAD)

    def variance(self) -> Variance:
        """Take four variances."""
        x, y, z, yaw = (variance_of_step(step) for step in self.bytes(4))
        return (x, y, z, yaw)


def whole(data: bytes, read: Callable[[Reader], T]) -> T:
    """Read one message that fills its payload."""
    reader = Reader(data)
    message = read(reader)
    if not reader.at_end:
        raise MessageError("payload goes on after its message")
    return message


# --- map chunks -----------------------------------------------------------------------------

RELAYED, FROM_START, TO_END = 1, 2, 4


def write_chunk(out: Writer, chunk: Chunk, sender: tuple[int, int]) -> None:
    """Add a map chunk; what the frame's sender measured itself names no origin."""
    relayed = (chunk.key.robot, chunk.key.incarnation) != sender
    to_end = chunk.offset + len(chunk.data) == chunk.total
    flags = RELAYED * relayed | FROM_START * (chunk.offset == 0) | TO_END * to_end
    out.byte(flags)
    if relayed:
        out.byte(chunk.key.robot)
        out.byte(chunk.key.incarnation)
    out.uint(chunk.key.submap)
    out.uint(chunk.key.tile)
    out.uint(chunk.version)
    out.uint(len(chunk.data))
    if not flags & FROM_START:
        out.uint(chunk.offset)
    if not to_end:
        out.uint(chunk.total - chunk.offset - len(chunk.data))
    out.data.extend(chunk.data)


CHUNK_HEADER_BYTES = 12
"""Room that a chunk's header needs at most in a map of ordinary size."""


def read_chunk(reader: Reader, sender: tuple[int, int]) -> Chunk:
    """Take a map chunk of a frame whose sender is (robot, incarnation)."""
    flags = reader.byte()
    if flags & ~(RELAYED | FROM_START | TO_END):
        raise MessageError(f"chunk flags are {flags}; 0 to 7 are allowed")
    robot, incarnation = (reader.byte(), reader.byte()) if flags & RELAYED else sender
    submap, tile, version, length = reader.uint(), reader.uint(), reader.uint(), reader.uint()
    offset = 0 if flags & FROM_START else reader.uint()
    rest = 0 if flags & TO_END else reader.uint()
    total = offset + length + rest
    if not 0 < length <= total <= MAX_PAYLOAD_BYTES:
        raise MessageError(
            f"chunk of {length} bytes of {total}; 1 to {MAX_PAYLOAD_BYTES} are allowed"
        )
    key = TileKey(robot, incarnation, submap, tile)
    return Chunk(key, version, total, offset, reader.bytes(length))


def pack_chunks(chunks: Sequence[Chunk], sender: tuple[int, int]) -> bytes:
    """Return the payload of a MAP frame."""
    out = Writer()
    for chunk in chunks:
        write_chunk(out, chunk, sender)
    return bytes(out.data)


def unpack_chunks(data: bytes, sender: tuple[int, int]) -> list[Chunk]:
    """Take the payload of a MAP frame apart."""
    reader = Reader(data)
    chunks: list[Chunk] = []
    while not reader.at_end:
        chunks.append(read_chunk(reader, sender))
    return chunks


# --- anchors --------------------------------------------------------------------------------


def pack_anchor(key: AnchorKey, anchor: Anchor) -> bytes:
    """Return the payload of an ANCHOR frame."""
    out = Writer()
    out.byte(key.robot)
    out.byte(key.incarnation)
    out.uint(key.submap)
    out.uint(anchor.version * 2 + anchor.is_moved)
    out.pose(anchor.pose)
    if anchor.is_moved:
        out.pose(anchor.corrected)
    out.variance(anchor.variance)
    return bytes(out.data)


def unpack_anchor(data: bytes) -> tuple[AnchorKey, Anchor]:
    """Take the payload of an ANCHOR frame apart."""

    def read(reader: Reader) -> tuple[AnchorKey, Anchor]:
        key = AnchorKey(reader.byte(), reader.byte(), reader.uint())
        version, is_moved = divmod(reader.uint(), 2)
        pose = reader.pose()
        corrected = reader.pose() if is_moved else pose
        return key, Anchor(version, pose, corrected, reader.variance())

    return whole(data, read)


# --- digests --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Held:
    """What a digest says of one version of a tile: how much of it is there from the start."""

    tile: int
    version: int
    prefix_bytes: int
    """-1 when the whole payload is there."""


@dataclass(frozen=True)
class Section:
    """What a digest says of a run of tiles of one submap: those not listed are not held.

    A tile is listed once for each version that is held, the oldest first.
    """

    key: AnchorKey
    first_tile: int
    last_tile: int
    held: tuple[Held, ...]


@dataclass(frozen=True)
class Digest:
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


def pack_digest(digest: Digest) -> bytes:
    """Return the payload of a DIGEST frame."""
    out = Writer()
    out.uint(len(digest.anchors) * 4 + digest.opens * 2 + digest.closes)
    for key, version in digest.anchors:
        out.byte(key.robot)
        out.byte(key.incarnation)
        out.uint(key.submap)
        out.uint(version)
    order = [key for key, _ in digest.anchors]
    for section in digest.sections:
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
    return bytes(out.data)


def unpack_digest(data: bytes) -> Digest:
    """Take the payload of a DIGEST frame apart."""
    reader = Reader(data)
    count, flags = divmod(reader.uint(), 4)
    anchors = tuple(
        (AnchorKey(reader.byte(), reader.byte(), reader.uint()), reader.uint())
        for _ in range(count)
    )
    if any(a[0] >= b[0] for a, b in pairwise(anchors)):
        raise MessageError("the submaps of a digest are not in ascending order")
    sections: list[Section] = []
    while not reader.at_end:
        index = reader.uint()
        if index >= len(anchors):
            raise MessageError(f"digest section {index}; the digest lists {len(anchors)} submaps")
        first = reader.uint()
        last = first + reader.uint()
        held: list[Held] = []
        tile = first
        for _ in range(reader.uint()):
            tile += reader.uint()
            held.append(Held(tile, reader.uint(), reader.uint() - 1))
        sections.append(Section(anchors[index][0], first, last, tuple(held)))
    return Digest(anchors, tuple(sections), flags >= 2, flags % 2 == 1)


# --- status, fixes, commands ----------------------------------------------------------------


@dataclass(frozen=True)
class Status:
    """What a robot tells of itself now and then."""

    pose: Pose
    variance: Variance
    activity: int
    """Index into `agents.briefing.ACTIVITIES`."""
    claim: tuple[float, float, float] | None = None
    """Where it is going to look: centre x, y and radius, metres."""
    tether_m: float = 0.0


def pack_status(status: Status) -> bytes:
    """Return the payload of a STATUS frame."""
    out = Writer()
    out.byte(status.activity)
    out.pose(status.pose)
    out.variance(status.variance)
    out.uint(round(status.tether_m * 100))
    if status.claim is not None:
        for length_m in status.claim:
            out.sint(round(length_m * 10))
    return bytes(out.data)


def unpack_status(data: bytes) -> Status:
    """Take the payload of a STATUS frame apart."""

    def read(reader: Reader) -> Status:
        activity, pose, variance = reader.byte(), reader.pose(), reader.variance()
        tether_m = reader.uint() / 100
        if reader.at_end:
            return Status(pose, variance, activity, None, tether_m)
        x_m, y_m, radius_m = (reader.sint() / 10 for _ in range(3))
        return Status(pose, variance, activity, (x_m, y_m, radius_m), tether_m)

    return whole(data, read)


@dataclass(frozen=True)
class Fix:
    """A robot was seen: where it stood in the team frame, at what time, and how sure that is."""

    robot: int
    t_s: float
    pose: Pose
    variance: Variance


def pack_fix(fix: Fix) -> bytes:
    """Return the payload of a FIX frame."""
    out = Writer()
    out.byte(fix.robot)
    out.uint(round(fix.t_s * 100))
    out.pose(fix.pose)
    out.variance(fix.variance)
    return bytes(out.data)


def unpack_fix(data: bytes) -> Fix:
    """Take the payload of a FIX frame apart."""
    return whole(data, lambda r: Fix(r.byte(), r.uint() / 100, r.pose(), r.variance()))


@dataclass(frozen=True)
class TetherCommand:
    """An Anchor-bot is to run its drum to a length at a rate."""

    robot: int
    target_m: float
    rate_mps: float


def pack_tethers(commands: Sequence[TetherCommand]) -> bytes:
    """Return the payload of a TETHER frame: one command for each Anchor-bot concerned."""
    out = Writer()
    for command in commands:
        out.byte(command.robot)
        out.uint(round(command.target_m * 100))
        out.uint(round(command.rate_mps * 1000))
    return bytes(out.data)


def unpack_tethers(data: bytes) -> list[TetherCommand]:
    """Take the payload of a TETHER frame apart."""
    reader = Reader(data)
    commands: list[TetherCommand] = []
    while not reader.at_end:
        commands.append(TetherCommand(reader.byte(), reader.uint() / 100, reader.uint() / 1000))
    return commands
