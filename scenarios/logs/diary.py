"""What a robot's log keeps to be looked at: where it was, what it saw, and its map as it grew.

MessagePack under topics of their own, in the log that also tells what it was handed
(`logs.handed`). `run.mcap`, exports and what is sent live to ROS 2 are made of these notes.
A life's first note of its map holds all known cells, each later one those that changed by more than
rounding; the last one of a robot that lived to the end is whole and unrounded again.
"""

import contextlib
import struct
import zlib
from collections.abc import Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import cv2
import msgpack
import numpy as np
from numpy.typing import NDArray

from agents.geometry import Floats, GridFrame, Pose, Singles
from agents.ports import Exposure
from scenarios.errors import StudyError
from scenarios.logs.notebook import LogFile

POSE, SEEN, TEAM_MAP, IMAGE = "pose", "seen", "team_map", "image"
TOPICS = frozenset((POSE, SEEN, TEAM_MAP, IMAGE))
MAP_NOTES = 100
"""Notes of its map that a robot makes in a run that lasts to its limit."""
JPEG_QUALITY = 80
SEEN_POINTS = 4000
"""Points of a look that are noted; a look of more is thinned, evenly over the cells it fell on."""
STEPS = {"elevation": 2.0**-10, "sigma": 2.0**-13, "log_odds": 2.0**-8}
"""What is noted of a map on the way is rounded to these: m, m, and log-odds."""


@dataclass(frozen=True)
class PoseNote:
    """Where a robot was, and where it believed to be."""

    true: Pose
    believed: Pose
    covariance: Floats
    """(4, 4) of (x, y, z, yaw), team frame."""
    still: bool
    """Whether it stood: on the way a robot does not know yet how far it has come."""


@dataclass(frozen=True)
class SeenNote:
    """What one look gave."""

    points_m: Singles
    """(N, 3) in the team frame, by where the robot believed to be."""
    pan_rad: float
    tilt_rad: float


@dataclass
class Chart:
    """A robot's team map at a moment, row 0 south."""

    frame: GridFrame
    layers: dict[str, Singles] = field(default_factory=dict[str, Singles])
    """(rows, cols) by name, NaN unknown: elevation and sigma in m, or log_odds."""


class Diary:
    """Writes a robot's notes into its log."""

    def __init__(self, log: LogFile | None, frame: GridFrame, every_ns: int) -> None:
        """Begin; without a log nothing is noted. Maps are noted `every_ns`."""
        self._log = log
        self._frame = frame
        self._every_ns = every_ns
        self._due_ns = 0
        self._noted: dict[str, Singles] = {}

    def is_due(self, t_ns: int) -> bool:
        """Say whether it is time to note the map."""
        return self._log is not None and t_ns >= self._due_ns

    def pose(self, t_ns: int, note: PoseNote) -> None:
        """Note where the robot is."""
        if self._log is not None:
            covariance = [float(value) for value in note.covariance.ravel()]
            wire = (_plain(note.true), _plain(note.believed), covariance, note.still)
            self._log.keep(POSE, _packed(wire), t_ns)

    def seen(self, t_ns: int, exposure: Exposure, points_m: Floats, believed: Pose) -> None:
        """Note what a look gave: its points (N, 3) in the levelled frame of a robot that stood."""
        if self._log is not None and len(points_m):
            placed = thinned(believed.team_from_robot(points_m), self._frame.cell_m)
            data = zlib.compress(placed.astype("<f4").tobytes(), 1)
            self._log.keep(SEEN, _packed((exposure.pan_rad, exposure.tilt_rad, data)), t_ns)

    def image(self, t_ns: int, grey: NDArray[np.uint8]) -> None:
        """Note the left image (H, W) of a pair, as JPEG."""
        if self._log is not None:
            ok, data = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            assert ok
            self._log.keep(IMAGE, data.tobytes(), t_ns)

    def map(self, t_ns: int, grids: dict[str, Floats], *, whole: bool = False) -> None:
        """Note a map's grids (rows, cols; not finite: unknown)."""
        if self._log is None:
            return
        self._due_ns = (t_ns // self._every_ns + 1) * self._every_ns
        layers = {name: _settled(values, STEPS[name], whole) for name, values in grids.items()}
        changed = np.zeros(self._frame.shape, dtype=np.bool_)
        for name, values in layers.items():
            before = None if whole else self._noted.get(name)
            if before is None:
                before = np.full(self._frame.shape, np.nan, np.float32)
            changed |= (values != before) & ~(np.isnan(values) & np.isnan(before))
        fresh, self._noted = whole or not self._noted, layers
        frame = self._frame
        place = (frame.x_m, frame.y_m, frame.cell_m, frame.rows, frame.cols)
        cells = np.flatnonzero(changed).astype("<i4")
        told = {name: _shuffled(values[changed]) for name, values in layers.items()}
        steps = np.diff(cells, prepend=0).astype("<i4")
        wire = (place, fresh, zlib.compress(_bytes_apart(steps), 1), told)
        self._log.keep(TEAM_MAP, _packed(wire), t_ns)


def thinned(points_m: Floats, cell_m: float) -> Floats:
    """Return at most `SEEN_POINTS` of points (N, 3), in their order.

    One of each cell (seen from above) comes first, then the rest evenly: so a look that was thinned
    still falls on all the cells that it fell on, unless these are too many.
    """
    if len(points_m) <= SEEN_POINTS:
        return points_m
    cells = np.floor(points_m[:, :2] / cell_m).astype(np.int64)
    cells -= cells.min(axis=0)
    _, first = np.unique(cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1], return_index=True)
    others = np.setdiff1d(np.arange(len(points_m)), first)
    if len(first) >= SEEN_POINTS:
        first, others = np.sort(first), others[:0]
        first = first[np.arange(SEEN_POINTS) * len(first) // SEEN_POINTS]
    room = SEEN_POINTS - len(first)
    more = others[np.arange(min(room, len(others))) * len(others) // max(room, 1)]
    return points_m[np.sort(np.concatenate((first, more)))]


class NoteError(StudyError):
    """A note that can't be read: the log is damaged."""


@contextlib.contextmanager
def _reading(topic: str) -> Generator[None]:
    bad = (ValueError, TypeError, IndexError, zlib.error, msgpack.UnpackException)
    try:
        yield
    except bad as error:
        raise NoteError(f"a robot's log is damaged: {topic} can't be read ({error})") from error


def read_pose(data: bytes) -> PoseNote:
    """Return the note in a message of topic `pose`; raises NoteError if there is none."""
    with _reading(POSE):
        true, believed, covariance, still = msgpack.unpackb(data)
        return PoseNote(Pose(*true), Pose(*believed), np.array(covariance).reshape(4, 4), still)


def read_seen(data: bytes) -> SeenNote:
    """Return the note in a message of topic `seen`; raises NoteError if there is none."""
    with _reading(SEEN):
        pan_rad, tilt_rad, points = msgpack.unpackb(data)
        points_m = np.frombuffer(zlib.decompress(points), "<f4").reshape(-1, 3)
        return SeenNote(points_m, pan_rad, tilt_rad)


def draw(chart: Chart | None, data: bytes) -> Chart:
    """Return a chart with a message of topic `team_map` drawn into it; None: the first one.

    The chart that was given is not changed. Raises NoteError if there is no map in the message.
    """
    with _reading(TEAM_MAP):
        place, fresh, told_cells, told = msgpack.unpackb(data)
        frame = GridFrame(*place)
        steps = _bytes_together(zlib.decompress(told_cells), "<i4")
        cells = np.cumsum(steps, dtype=np.int64)
        layers: dict[str, Singles] = {}
        for name, values in told.items():
            kept = None if chart is None or fresh else chart.layers.get(name)
            grid = np.full(frame.shape, np.nan, np.float32) if kept is None else kept.copy()
            grid.ravel()[cells] = _bytes_together(zlib.decompress(values), "<f4")
            layers[name] = grid
        return Chart(frame, layers)


def _plain(pose: Pose) -> tuple[float, ...]:
    return tuple(float(v) for v in (pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad))


def _packed(value: object) -> bytes:
    return cast("bytes", msgpack.packb(value))


def _settled(values: Floats, step: float, whole: bool) -> Singles:
    finite = np.where(np.isfinite(values), values, np.nan)
    return (finite if whole else np.round(finite / step) * step).astype(np.float32)


def _shuffled(values: Singles) -> bytes:
    return zlib.compress(_bytes_apart(values.astype("<f4")), 1)


def _bytes_apart(values: Any) -> bytes:
    """Return all first bytes, then all second ones ...: numbers that are alike pack well so."""
    return values.view(np.uint8).reshape(-1, 4).T.tobytes()


def _bytes_together(data: bytes, dtype: str) -> Any:
    return np.frombuffer(data, np.uint8).reshape(4, -1).T.copy().view(dtype).ravel()


_RECORD = struct.Struct("<BQ")
_CHANNEL, _MESSAGE = 4, 5
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_MAGIC_BYTES = 8


@dataclass(frozen=True)
class Note:
    """One message of a robot's log."""

    robot: str
    t_ns: int
    topic: str
    data: bytes


class LogTail:
    """Reads a robot's log while it grows, or as its robot's death left it."""

    def __init__(self, path: Path, robot: str) -> None:
        """Begin at the log's beginning."""
        self.path, self.robot = path, robot
        self._at = _MAGIC_BYTES
        self._topics: dict[int, str] = {}

    def read(self, topics: frozenset[str]) -> list[Note]:
        """Return what has been written whole since the last call, of some topics."""
        notes: list[Note] = []
        with self.path.open("rb") as stream:
            stream.seek(self._at)
            data = memoryview(stream.read())
        at = 0
        while at + _RECORD.size <= len(data):
            kind, length = _RECORD.unpack_from(data, at)
            body = data[at + _RECORD.size : at + _RECORD.size + length]
            if len(body) < length:
                break
            at += _RECORD.size + length
            if kind == _CHANNEL:
                number, _, size = struct.unpack_from("<HHI", body)
                self._topics[number] = bytes(body[8 : 8 + size]).decode(errors="replace")
            elif kind == _MESSAGE:
                number, _, t_ns, _ = _MESSAGE_HEAD.unpack_from(body)
                topic = self._topics.get(number, "")
                if topic in topics:
                    notes.append(Note(self.robot, t_ns, topic, bytes(body[_MESSAGE_HEAD.size :])))
        self._at += at
        return notes
