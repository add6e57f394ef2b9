"""What a robot keeps on disk, so that it comes back after a crash with all that it measured.

- `incarnation`: how often this robot has started; grown, and on disk, before its first frame.
- `journal`: every version that it published, appended before the first byte of it is sent. So what
  team-mates may have heard under this incarnation is known after a crash, and nothing that was
  published is ever published again under the next one.
- `layer`: the own layer and the believed pose, written whole after each look.

A record that was cut short by the crash ends the journal; a half-written layer is never seen. A
disk that refuses is told, and the robot goes on: it maps, but it says nothing under an incarnation
that is not on disk, and publishes nothing that is not in its journal.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import msgpack
import numpy as np

from agents.errors import AgentError
from agents.files import Files, LocalFiles
from agents.geometry import Floats, GridFrame, Pose
from agents.layers import Anchor, OwnLayer, Submap
from agents.maps.kind import MapKind
from agents.store import AnchorKey, Chunk, Origin, TileKey

HEAD_BYTES = 8
"""A record's length, and its complement: a spoilt length must not pass for a torn record."""
UNKNOWN_LIFE = 255
"""The incarnation of a robot that can't know which one it is; nothing is ever said under it."""


class DiskError(AgentError):
    """A file of the robot's can't be written or read."""


@dataclass
class Recovered:
    """What was found on disk of former incarnations."""

    chunks: list[Chunk] = field(default_factory=list[Chunk])
    """Every published version, whole."""
    submaps: list[tuple[Origin, int, Any]] = field(default_factory=list[tuple[Origin, int, Any]])
    """The last incarnation's own submaps, with their origin and index."""
    anchors: dict[AnchorKey, Anchor] = field(default_factory=dict[AnchorKey, Anchor])
    """Of the incarnations before the last: without them nobody knows where their maps lie."""
    pose: Pose | None = None
    covariance: Floats | None = None
    problems: list[str] = field(default_factory=list[str])
    """One sentence for each file, or part of one, that can't be read."""


@dataclass(frozen=True)
class _Journal:
    """What a journal holds."""

    chunks: list[Chunk]
    whole_bytes: int
    """Length up to the end of the last whole record."""
    damaged: bool
    """A record inside is spoilt: not all that was published is known."""


class Disk:
    """One robot's folder."""

    def __init__(self, folder: Path, files: Files | None = None) -> None:
        """Use a folder; it is made when first written to."""
        self.folder = folder
        self.incarnation = 0
        self._files: Files = files or LocalFiles()
        self._is_known = True
        """Whether the number of this incarnation is certain to be new."""
        self._is_durable = False
        self._journal_bytes: int | None = None
        """Length of the journal's whole records; None: it may end in a torn one."""

    def begin(self) -> int:
        """Begin the next incarnation and make it durable; return its number, from 0.

        Raises:
            DiskError: the folder can't be read or written. `incarnation` holds a number all the
                same, to map under; see `confirm`.

        """
        path = self.folder / "incarnation"
        try:
            data = self._files.read(path)
            self.incarnation = 0 if data is None else int(data) + 1
        except (OSError, ValueError) as error:
            self._is_known = False
            self.incarnation = UNKNOWN_LIFE
            raise DiskError(f"{path}: cannot be read as a number: {error}") from error
        self.confirm()
        self._mend_journal()
        return self.incarnation

    def confirm(self) -> None:
        """Make sure that this incarnation is on disk; nothing may be said under it before.

        Raises:
            DiskError: it is not, or which one this is can't be known.

        """
        if self._is_durable:
            return
        path = self.folder / "incarnation"
        if not self._is_known:
            raise DiskError(f"{path}: cannot be read, so nobody knows which life this is")
        self._replace(path, str(self.incarnation).encode(), durable=True)
        self._is_durable = True

    def journal(self, chunk: Chunk) -> None:
        """Append a version that is about to be published.

        Raises:
            DiskError: it could not be written; then it must not be sent either.

        """
        self.confirm()
        if self._journal_bytes is None:
            self._mend_journal()
        record = _record(chunk)
        path = self.folder / "journal"
        whole_bytes, self._journal_bytes = self._journal_bytes, None
        try:
            self._files.append(path, record)
        except OSError as error:
            raise DiskError(f"{path}: cannot be written: {error}") from error
        self._journal_bytes = (whole_bytes or 0) + len(record)

    def layer_content(
        self,
        layer: OwnLayer[Any],
        pose: Pose,
        covariance: Floats,
        former: Mapping[AnchorKey, Anchor],
    ) -> tuple[object, ...]:
        """Return the own layer and the believed pose as `save_layer` takes them: a copy.

        `former` are the anchors of this robot's former incarnations.
        """
        return (
            self.incarnation,
            _numbers(pose),
            covariance.ravel().tolist(),
            [_submap_record(submap) for submap in layer.submaps],
            [(tuple(key), _anchor_record(former[key])) for key in sorted(former)],
        )

    def save_layer(self, content: tuple[object, ...]) -> None:
        """Write what `layer_content` gave, whole or not at all.

        Raises:
            DiskError: it could not be written; the file before stays.

        """
        self._replace(self.folder / "layer", zlib.compress(_packed(content), 1))

    def recover(self, frame: GridFrame, kind: MapKind[Any, Any]) -> Recovered:
        """Return what former incarnations left; nothing where this is the first.

        What can't be read is in `problems`. Where not all is known that was published, the cells of
        the last incarnation's layer stay behind: team-mates may have them, and to publish them
        again would count them twice.
        """
        recovered = Recovered()
        try:
            journal = _records(self._read_journal())
        except DiskError as error:
            journal = _Journal([], 0, damaged=True)
            recovered.problems.append(str(error))
        recovered.chunks = journal.chunks
        try:
            self._recover_layer(recovered, frame, kind, damaged=journal.damaged)
        except DiskError as error:
            recovered.submaps.clear()
            recovered.problems.append(str(error))
        return recovered

    def _recover_layer(
        self, recovered: Recovered, frame: GridFrame, kind: MapKind[Any, Any], *, damaged: bool
    ) -> None:
        path = self.folder / "layer"
        try:
            data = self._files.read(path)
            if data is None:
                return
            content: Any = msgpack.unpackb(zlib.decompress(data))
            incarnation, pose, covariance, submaps, former = content
            if damaged or self._lost_count_since(incarnation):
                recovered.problems.append(f"{path}: not taken up, for the journal was spoilt")
                submaps = list[Any]()
            robot = recovered.chunks[0].key.robot if recovered.chunks else -1
            for index, record in enumerate(submaps):
                anchor, cells = record
                submap = kind.restored(frame, _anchor_of(anchor), cells)
                recovered.submaps.append((Origin(robot, incarnation), index, submap))
            recovered.anchors = {AnchorKey(*key): _anchor_of(record) for key, record in former}
            recovered.pose = Pose(*pose)
            recovered.covariance = np.array(covariance).reshape(4, 4)
        except (OSError, ValueError, TypeError, IndexError, zlib.error) as error:
            raise DiskError(f"{path}: is no saved layer: {error}") from error

    def _lost_count_since(self, incarnation: int) -> bool:
        """Say whether a later incarnation found the journal spoilt, and put it aside."""
        later = range(incarnation + 1, self.incarnation + 1)
        return any(self._files.read(self._aside(number)) is not None for number in later)

    def _aside(self, incarnation: int) -> Path:
        return self.folder / f"journal.{incarnation}"

    def _mend_journal(self) -> None:
        """Cut a record that was cut short off the journal: what comes next must be found.

        One that is spoilt inside is put aside, and what is whole in it is written anew.
        """
        data = self._read_journal()
        found = _records(data)
        path = self.folder / "journal"
        try:
            if found.damaged:
                whole = b"".join(_record(chunk) for chunk in found.chunks)
                self._files.replace(self._aside(self.incarnation), data)
                self._files.replace(path, whole)
                self._journal_bytes = len(whole)
                return
            if len(data) > found.whole_bytes:
                self._files.cut(path, found.whole_bytes)
        except OSError as error:
            raise DiskError(f"{path}: cannot be mended: {error}") from error
        self._journal_bytes = found.whole_bytes

    def _read_journal(self) -> bytes:
        path = self.folder / "journal"
        try:
            return self._files.read(path) or b""
        except OSError as error:
            raise DiskError(f"{path}: cannot be read: {error}") from error

    def _replace(self, path: Path, data: bytes, *, durable: bool = False) -> None:
        try:
            self._files.replace(path, data, durable=durable)
        except OSError as error:
            raise DiskError(f"{path}: cannot be written: {error}") from error


def _record(chunk: Chunk) -> bytes:
    body = _packed((tuple(chunk.key), chunk.version, chunk.data))
    return _head(len(body)) + body + _crc(body)


def _head(length: int) -> bytes:
    return length.to_bytes(4, "little") + (length ^ 0xFFFFFFFF).to_bytes(4, "little")


def _records(data: bytes) -> _Journal:
    """Return the versions in a journal.

    What is cut short, or spoilt, at the very end is what a crash left: it was never sent. What is
    spoilt further in was.
    """
    chunks: list[Chunk] = []
    at, whole_bytes, spoilt = 0, 0, 0
    while at + HEAD_BYTES <= len(data):
        start, length = at + HEAD_BYTES, int.from_bytes(data[at : at + 4], "little")
        if data[at:start] != _head(length):
            spoilt += 1  # where the next record begins nobody knows
            break
        end = start + length
        body, at = data[start:end], end + 4
        if data[end:at] != _crc(body):
            spoilt += at < len(data)
            continue
        key, version, payload = cast("tuple[list[int], int, bytes]", msgpack.unpackb(body))
        chunks.append(Chunk(TileKey(*key), version, len(payload), 0, payload))
        whole_bytes = at
    return _Journal(chunks, whole_bytes, damaged=spoilt > 0)


def _packed(content: object) -> bytes:
    return cast("bytes", msgpack.packb(content))


def _crc(body: bytes) -> bytes:
    return zlib.crc32(body).to_bytes(4, "little")


def _numbers(pose: Pose) -> tuple[float, float, float, float]:
    return (pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad)


def _anchor_record(anchor: Anchor) -> tuple[object, ...]:
    return (anchor.version, _numbers(anchor.pose), _numbers(anchor.corrected), anchor.variance)


def _anchor_of(record: Any) -> Anchor:
    version, pose, corrected, (x, y, z, yaw) = record
    return Anchor(version, Pose(*pose), Pose(*corrected), (x, y, z, yaw))


def _submap_record(submap: Submap) -> tuple[object, ...]:
    """Return a submap as plain values: its anchor and the cells that it knows."""
    return (_anchor_record(submap.anchor), submap.cells())
