"""What robots say to each other, byte by byte: the payloads inside the frames.

Whatever a peer may send is checked while it is read: a payload is understood whole or refused
with a MessageError. What robots say of what they have is in `agents.sharing.reports`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from agents.geometry import Pose
from agents.layers import Anchor
from agents.store import MARK_BITS, MAX_PAYLOAD_BYTES, AnchorKey, Chunk, TileKey
from agents.wire import MessageError, Reader, Variance, Writer, whole

MARK_BYTES = MARK_BITS // 8

# --- map chunks -----------------------------------------------------------------------------

RELAYED, FROM_START, TO_END = 1, 2, 4


def write_chunk(out: Writer, chunk: Chunk, sender: tuple[int, int]) -> None:
    """Add a map chunk; what the frame's sender measured itself names no origin."""
    relayed = (chunk.key.robot, chunk.key.incarnation) != sender
    to_end = chunk.offset + len(chunk.data) == chunk.total
    flags = RELAYED * relayed | FROM_START * (chunk.offset == 0) | TO_END * to_end
    out.byte(flags)
    if relayed:
        out.uint(chunk.key.robot)
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
    robot, incarnation = (reader.uint(), reader.byte()) if flags & RELAYED else sender
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
    out.uint(key.robot)
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
        key = AnchorKey(reader.uint(), reader.byte(), reader.uint())
        version, is_moved = divmod(reader.uint(), 2)
        pose = reader.pose()
        corrected = reader.pose() if is_moved else pose
        return key, Anchor(version, pose, corrected, reader.variance())

    return whole(data, read)


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
    store_mark: int = 0
    """`Store.mark` of what it has published and heard."""
    settled: bool = False
    """It has nothing left to send."""


SETTLED = 0x80
"""Beside the activity's index, in one byte."""


def pack_status(status: Status) -> bytes:
    """Return the payload of a STATUS frame."""
    out = Writer()
    out.byte(status.activity | SETTLED * status.settled)
    out.data.extend(status.store_mark.to_bytes(MARK_BYTES, "little"))
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
        settled, activity = divmod(reader.byte(), SETTLED)
        mark = int.from_bytes(reader.bytes(MARK_BYTES), "little")
        pose, variance = reader.pose(), reader.variance()
        tether_m = reader.uint() / 100
        claim = None
        if not reader.at_end:
            x_m, y_m, radius_m = (reader.sint() / 10 for _ in range(3))
            claim = (x_m, y_m, radius_m)
        return Status(pose, variance, activity, claim, tether_m, mark, settled == 1)

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
    out.uint(fix.robot)
    out.uint(round(fix.t_s * 100))
    out.pose(fix.pose)
    out.variance(fix.variance)
    return bytes(out.data)


def unpack_fix(data: bytes) -> Fix:
    """Take the payload of a FIX frame apart."""
    return whole(data, lambda r: Fix(r.uint(), r.uint() / 100, r.pose(), r.variance()))


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
        out.uint(command.robot)
        out.uint(round(command.target_m * 100))
        out.uint(round(command.rate_mps * 1000))
    return bytes(out.data)


def unpack_tethers(data: bytes) -> list[TetherCommand]:
    """Take the payload of a TETHER frame apart."""
    reader = Reader(data)
    commands: list[TetherCommand] = []
    while not reader.at_end:
        commands.append(TetherCommand(reader.uint(), reader.uint() / 100, reader.uint() / 1000))
    return commands
