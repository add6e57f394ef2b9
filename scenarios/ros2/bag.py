"""`run.mcap`: one file per run in the ROS 2 profile, merged from its robots' logs and records.

Rerun and the Foxglove family draw it as it is. Maps are written sparsely: occupancy grids at most
`GRIDS` times a robot, clouds and grid maps at most `CLOUDS` times, both at the end.
"""

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from agents.geometry import Pose
from comms.timebase import to_s
from scenarios.errors import StudyError
from scenarios.logs import diary
from scenarios.logs.diary import Chart, LogTail, Note, PoseNote
from scenarios.records.linkwindows import windows_of
from scenarios.ros2 import messages
from scenarios.ros2.cdr import encode
from scenarios.ros2.types import schema_text
from scenarios.schema import load

NAME = "run.mcap"
GRIDS, CLOUDS = 40, 8
PATH_POSES = 300


class BagError(StudyError):
    """A run of which no `run.mcap` can be made."""


@dataclass(frozen=True)
class Stamped:
    """A ROS 2 message, and where it goes."""

    t_ns: int
    topic: str
    kind: str
    data: bytes


@dataclass
class Teller:
    """Turns one robot's notes into messages."""

    robot: str
    grids_ns: frozenset[int] | None = None
    """When an occupancy grid is due; None: at every note."""
    clouds_ns: frozenset[int] | None = None
    chart: Chart | None = None
    ways: dict[str, list[tuple[int, Pose]]] = field(
        default_factory=lambda: {"true": [], "believed": []}
    )

    def tell(self, note: Note) -> Iterator[Stamped]:
        """Yield what a note has to say."""
        match note.topic:
            case diary.POSE:
                yield from self._pose(note)
            case diary.SEEN:
                points = diary.read_seen(note.data).points_m
                look = messages.cloud(note.t_ns, points)
                yield self._one(note.t_ns, "look", "sensor_msgs/msg/PointCloud2", look)
            case diary.IMAGE:
                image = messages.jpeg(note.t_ns, note.data)
                yield self._one(note.t_ns, "image", "sensor_msgs/msg/CompressedImage", image)
            case _:
                self.chart = diary.draw(self.chart, note.data)
                yield from self._map(note.t_ns, self.chart)

    def skip(self, note: Note) -> None:
        """Take a note in, and say nothing of it."""
        if note.topic == diary.TEAM_MAP:
            self.chart = diary.draw(self.chart, note.data)
        elif note.topic == diary.POSE:
            self._walk(note.t_ns, diary.read_pose(note.data))

    def _walk(self, t_ns: int, told: PoseNote) -> None:
        self.ways["true"].append((t_ns, told.true))
        if told.still:
            self.ways["believed"].append((t_ns, told.believed))

    def _one(self, t_ns: int, topic: str, kind: str, message: Mapping[str, Any]) -> Stamped:
        return Stamped(t_ns, f"/{ros_name(self.robot)}/{topic}", kind, encode(kind, message))

    def _pose(self, note: Note) -> Iterator[Stamped]:
        told, t_ns, me = diary.read_pose(note.data), note.t_ns, ros_name(self.robot)
        self._walk(t_ns, told)
        frames = [(f"{me}/true", told.true)]
        odometry = "nav_msgs/msg/Odometry"
        sure = 0.0 * told.covariance
        true = messages.odometry(t_ns, f"{me}/true", told.true, sure)
        yield self._one(t_ns, "odom_true", odometry, true)
        if told.still:
            frames.append((f"{me}/base", told.believed))
            believed = messages.odometry(t_ns, f"{me}/base", told.believed, told.covariance)
            yield self._one(t_ns, "odom", odometry, believed)
        kind = "tf2_msgs/msg/TFMessage"
        yield Stamped(t_ns, "/tf", kind, encode(kind, messages.transforms(t_ns, frames)))

    def _map(self, t_ns: int, chart: Chart) -> Iterator[Stamped]:
        if self.grids_ns is None or t_ns in self.grids_ns:
            grid = messages.occupancy_grid(t_ns, chart)
            yield self._one(t_ns, grid_topic(chart), "nav_msgs/msg/OccupancyGrid", grid)
        if self.clouds_ns is None or t_ns in self.clouds_ns:
            names = ("x", "y", "z", "sigma")
            points = messages.cloud(t_ns, messages.map_points(chart), names)
            yield self._one(t_ns, "map_points", "sensor_msgs/msg/PointCloud2", points)
            grid = messages.grid_map(t_ns, chart)
            yield self._one(t_ns, "grid_map", "grid_map_msgs/msg/GridMap", grid)
            for name, way in self.ways.items():
                path = messages.path(t_ns, thinned(way))
                yield self._one(t_ns, f"path_{name}", "nav_msgs/msg/Path", path)


def grid_topic(chart: Chart) -> str:
    """Return what a chart's occupancy grid is called: that of ground is only a picture."""
    return "map" if "log_odds" in chart.layers else "relief"


def ros_name(robot: str) -> str:
    """Return a robot's name as ROS allows it: letters, digits and single underscores."""
    return re.sub("[-_]+", "_", robot).rstrip("_")


def check_names(robots: Iterable[str]) -> None:
    """Refuse a team of which two would have one name in ROS.

    Raises:
        BagError: there are two such.

    """
    named: dict[str, str] = {}
    for robot in robots:
        other = named.setdefault(ros_name(robot), robot)
        if other != robot:
            raise BagError(
                f"robots {other!r} and {robot!r} would both be {ros_name(robot)!r} in ROS, where"
                " '-' is '_'; rename one"
            )


def thinned(way: list[tuple[int, Pose]]) -> list[tuple[int, Pose]]:
    """Return at most `PATH_POSES` of a way's poses, its last one among them."""
    stride = max(1, -(-len(way) // PATH_POSES))
    return way[::-1][::stride][::-1]


def logs_of(run: Path) -> dict[str, list[Path]]:
    """Return the logs of a run's robots, each robot's lives in order.

    Raises:
        BagError: this is no run.

    """
    if not (run / "scenario.toml").is_file():
        raise BagError(f"{run}: is no run: there is no scenario.toml in it")
    found: dict[str, list[Path]] = {}
    for robot in load(str(run / "scenario.toml")).robots:
        lives = [run / f"{robot}.mcap"]
        while lives[-1].is_file():
            lives.append(run / f"{robot}-{len(lives)}.mcap")
        found[robot] = lives[:-1]
    return found


def notes_of(run: Path) -> dict[str, list[Note]]:
    """Return the notes of each robot of a run, in order; none of a robot that kept no log."""
    return {
        robot: [note for path in lives for note in LogTail(path, robot).read(diary.TOPICS)]
        for robot, lives in logs_of(run).items()
    }


def write_bag(run: Path, out: Path | None = None) -> Path:
    """Write `run.mcap` of a run's folder, whole or not at all; return its path.

    Raises:
        BagError: this is no run, its logs hold no notes, or the file can't be written.

    """
    out = run / NAME if out is None else out
    if any(out in lives for lives in logs_of(run).values()):
        raise BagError(f"{out}: is the log of a robot called {out.stem!r}; give it another name")
    notes = notes_of(run)
    check_names(notes)
    if not any(notes.values()):
        raise BagError(
            f"{run}: its robots' logs hold neither maps nor poses; only a run by this version or a"
            " later one, with logs, can be merged"
        )
    part = out.with_name(f".{out.name}.part")
    try:
        with part.open("wb") as stream:
            _write(stream, run, notes)
        os.replace(part, out)
    except OSError as error:
        raise BagError(f"{out}: can't be written: {error.strerror}") from error
    finally:
        part.unlink(missing_ok=True)
    return out


def _write(stream: Any, run: Path, notes: dict[str, list[Note]]) -> None:
    writer = Writer(stream, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library="ropeteam")
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    for one in _in_order(run, notes):
        if one.kind not in schemas:
            text = schema_text(one.kind).encode()
            schemas[one.kind] = writer.register_schema(one.kind, "ros2msg", text)
        if one.topic not in channels:
            channels[one.topic] = writer.register_channel(one.topic, "cdr", schemas[one.kind])
        writer.add_message(channels[one.topic], one.t_ns, one.data, one.t_ns)
    writer.finish()


def _in_order(run: Path, notes: dict[str, list[Note]]) -> Iterator[Stamped]:
    """Yield all messages by time; of one moment, robot by robot."""
    tellers = {robot: _teller(robot, told) for robot, told in notes.items()}
    every = sorted((note for told in notes.values() for note in told), key=lambda n: n.t_ns)
    links = _links(run, every[-1].t_ns)
    due = next(links, None)
    for note in every:
        while due is not None and due.t_ns <= note.t_ns:
            yield due
            due = next(links, None)
        yield from tellers[note.robot].tell(note)
    if due is not None:
        yield due
    yield from links


def _teller(robot: str, notes: list[Note]) -> Teller:
    times = [note.t_ns for note in notes if note.topic == diary.TEAM_MAP]
    return Teller(robot, frozenset(spread(times, GRIDS)), frozenset(spread(times, CLOUDS)))


def spread(times: list[int], most: int) -> list[int]:
    """Return at most so many of the times, evenly chosen, the last one among them."""
    if len(times) <= most:
        return times
    return [times[-1 - (i * (len(times) - 1)) // most] for i in range(most)][::-1]


def _links(run: Path, end_ns: int) -> Iterator[Stamped]:
    kind = "ropeteam_msgs/msg/LinkStatistics"
    for window in windows_of(run, to_s(end_ns)):
        topic = f"/links/{ros_name(window.sender)}/{ros_name(window.receiver)}"
        yield Stamped(window.end_ns, topic, kind, encode(kind, messages.link_statistics(window)))
