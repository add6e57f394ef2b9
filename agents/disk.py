"""What a robot keeps on disk, so that it comes back after a crash with all that it measured.

- `incarnation`: how often this robot has started; grown, and on disk, before its first frame.
- `journal`: every version that it published, appended before the first byte of it is sent. So what
  team-mates may have heard under this incarnation is known after a crash, and nothing that was
  published is ever published again under the next one.
- `layer`: the own layer and the believed pose, written whole after each look.

A record that was cut short by the crash ends the journal; a half-written layer is never seen.
"""

import os
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import msgpack
import numpy as np

from agents.errors import AgentError
from agents.geometry import Floats, GridFrame, Pose
from agents.layers import Anchor, OwnLayer, Submap
from agents.maps.kind import MapKind
from agents.store import AnchorKey, Chunk, Origin, TileKey

LENGTH_BYTES = 4


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


class Disk:
    """One robot's folder."""

    def __init__(self, folder: Path) -> None:
        """Use a folder; it is made when first written to."""
        self.folder = folder
        self.incarnation = 0

    def begin(self) -> int:
        """Begin the next incarnation and make it durable; return its number, from 0.

        Raises:
            DiskError: the folder can't be read or written.

        """
        path = self.folder / "incarnation"
        try:
            before = int(path.read_text()) if path.exists() else -1
        except (OSError, ValueError) as error:
            raise DiskError(f"{path}: cannot be read as a number: {error}") from error
        self.incarnation = before + 1
        self._replace(path, str(self.incarnation).encode(), durable=True)
        self._mend_journal()
        return self.incarnation

    def journal(self, chunk: Chunk) -> None:
        """Append a version that is about to be published.

        Raises:
            DiskError: it could not be written; then it must not be sent either.

        """
        body = _packed((tuple(chunk.key), chunk.version, chunk.data))
        record = len(body).to_bytes(LENGTH_BYTES, "little") + body + _crc(body)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with (self.folder / "journal").open("ab") as file:
                file.write(record)
        except OSError as error:
            raise DiskError(f"{self.folder / 'journal'}: cannot be written: {error}") from error

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

        Raises:
            DiskError: a file is there but unreadable.

        """
        recovered = Recovered(self._read_journal()[0])
        path = self.folder / "layer"
        if not path.exists():
            return recovered
        try:
            content: Any = msgpack.unpackb(zlib.decompress(path.read_bytes()))
            incarnation, pose, covariance, submaps, former = content
            recovered.pose = Pose(*pose)
            recovered.covariance = np.array(covariance).reshape(4, 4)
            robot = recovered.chunks[0].key.robot if recovered.chunks else -1
            for index, record in enumerate(submaps):
                anchor, cells = record
                submap = kind.restored(frame, _anchor_of(anchor), cells)
                recovered.submaps.append((Origin(robot, incarnation), index, submap))
            recovered.anchors = {AnchorKey(*key): _anchor_of(record) for key, record in former}
        except (OSError, ValueError, TypeError, IndexError, zlib.error) as error:
            raise DiskError(f"{path}: is no saved layer: {error}") from error
        return recovered

    def _mend_journal(self) -> None:
        """Cut a record that was cut short off the journal: what comes next must be found."""
        path = self.folder / "journal"
        _, whole_bytes = self._read_journal()
        try:
            if path.exists() and path.stat().st_size > whole_bytes:
                os.truncate(path, whole_bytes)
        except OSError as error:
            raise DiskError(f"{path}: cannot be mended: {error}") from error

    def _read_journal(self) -> tuple[list[Chunk], int]:
        """Return the versions in the journal, and the length of its whole records in bytes."""
        path = self.folder / "journal"
        try:
            data = path.read_bytes() if path.exists() else b""
        except OSError as error:
            raise DiskError(f"{path}: cannot be read: {error}") from error
        chunks: list[Chunk] = []
        at = 0
        while at + LENGTH_BYTES <= len(data):
            end = at + LENGTH_BYTES + int.from_bytes(data[at : at + LENGTH_BYTES], "little")
            body = data[at + LENGTH_BYTES : end]
            if data[end : end + 4] != _crc(body):
                break  # cut short by a crash: it was never sent
            key, version, payload = cast("tuple[list[int], int, bytes]", msgpack.unpackb(body))
            chunks.append(Chunk(TileKey(*key), version, len(payload), 0, payload))
            at = end + 4
        return chunks, at

    def _replace(self, path: Path, data: bytes, *, durable: bool = False) -> None:
        part = path.with_name(f".{path.name}.part")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with part.open("wb") as file:
                file.write(data)
                if durable:
                    file.flush()
                    os.fsync(file.fileno())
            os.replace(part, path)
        except OSError as error:
            raise DiskError(f"{path}: cannot be written: {error}") from error


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
