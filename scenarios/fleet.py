"""A fleet larger than one run of processes: up to thousands of robots on one virtual loop.

The same robots as everywhere (`agents.robot`, `agents.roles`, `comms.radio`) with a cheap sensor
and planner, on ground whose area grows with their number. A frame reaches whoever stands within
radio range at the end of its transmission, and nobody else: the air looks only at the squares of
the ground around the sender, so that a frame costs its listeners and not the fleet.
"""

import asyncio
import math
from collections import Counter, defaultdict
from collections.abc import Coroutine
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from agents.briefing import AgentSettings
from agents.disk import Disk
from agents.geometry import GridFrame, Pose
from agents.ports import Exposure
from agents.robot import Robot
from agents.roles import explore
from agents.settings import (
    DriveSettings,
    MapSettings,
    PlannerSettings,
    SensorSettings,
    SharingSettings,
    TetherSettings,
)
from agents.sharing.value import Value
from comms.air import Handler, Packet
from comms.ears import Passing
from comms.faults import Fate, Verdict
from comms.frames import Kind, Opener, Sealer
from comms.link import Receiver, Transmitter
from comms.linksettings import ProfileName
from comms.profiles import PROFILES
from comms.radio import Radio
from comms.timebase import from_s, sleep_until_ns
from sim.clock import VirtualLoop
from sim.ground import Terrain
from sim.motion import Motions, Segment
from sim.rig import make_rig
from sim.stereo.settings import LightSettings

KEY = b"a fleet's own key"
EVERYBODY = "everybody"
"""Stands in a packet for all who can hear it."""
STAGGER_S = 30.0
"""Robots begin within so long: they are not switched on by one hand."""


CHEAP_SENSOR = SensorSettings(columns=12, rows=8, fov_deg=110.0, range_m=3.0, look_s=10.0)
SURE_DRIVE = DriveSettings(
    speed_mps=0.1, turn_rate_radps=0.3, footprint_m=0.5, slip_sigma=0.0, slip_bias_sigma=0.0
)
COARSE_MAP = MapSettings(cell_m=0.25, tile_cells=16)


@dataclass(frozen=True)
class FleetSettings:
    """How large a fleet is, and how far it hears and cares."""

    robots: int
    spacing_m: float = 6.0
    """Between neighbours at the start; the ground grows with the fleet."""
    radio_m: float = 9.0
    """Radio range."""
    horizon_m: float | None = 6.0
    """`sharing.horizon_m`; None: everything is for everybody."""
    region_m: float | None = 22.0
    """A robot keeps the ground so far to each side of its start; None: all of it. It has to hold
    what it can hear of: radio range, horizon, and the way that it goes itself."""
    seed: int = 1
    profile: ProfileName = "uhf-9600"
    sensor: SensorSettings = CHEAP_SENSOR
    drive: DriveSettings = SURE_DRIVE
    map: MapSettings = COARSE_MAP


class MemoryFiles:
    """A robot's disk in memory (`agents.files.Files`)."""

    def __init__(self) -> None:
        """Start empty."""
        self._files: dict[Path, bytes] = {}

    def read(self, path: Path) -> bytes | None:
        """Return what a file holds, or None where there is none."""
        return self._files.get(path)

    def append(self, path: Path, data: bytes) -> None:
        """Write behind what a file holds."""
        self._files[path] = self._files.get(path, b"") + data

    def replace(self, path: Path, data: bytes, *, durable: bool = False) -> None:
        """Write a file whole."""
        del durable
        self._files[path] = data

    def cut(self, path: Path, length_bytes: int) -> None:
        """Shorten a file."""
        self._files[path] = self._files[path][:length_bytes]


class _Quiet:
    """Keeps sums instead of records (`RobotLog` and `RadioLog`)."""

    def __init__(self) -> None:
        self.looks = 0
        self.bytes: Counter[str] = Counter()
        self.frames: Counter[str] = Counter()
        self.events: Counter[str] = Counter()

    def look(self, exposure: Exposure, **facts: float) -> None:
        del exposure, facts
        self.looks += 1

    def event(self, what: str, detail: str = "") -> None:
        del detail
        self.events[what] += 1

    def on_tx(self, *, kind: Kind, charged_bytes: int, **times: int) -> None:
        del times
        self.bytes[kind.name.lower()] += charged_bytes
        self.frames[kind.name.lower()] += 1

    def on_cut(self, number: int) -> None:
        del number

    def on_rx(self, sender: str, number: int, arrive_ns: int, verdict: str) -> None:
        del sender, number, arrive_ns, verdict


class _NearReceiver(Receiver):
    """Hears all that the air brings: who is in range was decided there."""

    def __init__(self) -> None:
        super().__init__({}, {})

    def knows(self, sender: str) -> bool:
        del sender
        return True

    def fate(self, passing: Passing) -> Fate:
        del passing
        return Fate(Verdict.DELIVERED)


class _Ether:
    """All airs of a fleet: brings a packet to whoever is in range."""

    def __init__(self, fleet: "Fleet") -> None:
        self._fleet = fleet
        self._handlers: dict[str, Handler] = {}
        self._squares: dict[tuple[int, int], list[str]] = defaultdict(list)
        self._square_of: dict[str, tuple[int, int]] = {}

    def listen(self, name: str, handler: Handler) -> None:
        self._handlers[name] = handler

    def stands(self, name: str, pose: Pose) -> None:
        """Note where a robot is."""
        side_m = self._fleet.settings.radio_m
        square = (math.floor(pose.x_m / side_m), math.floor(pose.y_m / side_m))
        before = self._square_of.get(name)
        if before != square:
            if before is not None:
                self._squares[before].remove(name)
            self._squares[square].append(name)
            self._square_of[name] = square

    def put(self, sender: str, packet: Packet) -> None:
        fleet = self._fleet
        here = fleet.pose_now(sender)
        row, col = self._square_of[sender]
        near = [
            name
            for r in (row - 1, row, row + 1)
            for c in (col - 1, col, col + 1)
            for name in self._squares[r, c]
        ]
        arrive_ns = packet.arrivals[0][1]
        reach_m = fleet.settings.radio_m
        hearing = [
            self._handlers[name]
            for name in sorted(near)
            if name != sender and fleet.pose_now(name).distance_m(here) <= reach_m
        ]

        def arrive() -> None:
            for handler in hearing:
                handler(packet, arrive_ns)

        fleet.loop.post(arrive_ns, fleet.index[sender], packet.number, arrive, True)


@dataclass
class _End:
    """One robot's end of the ether."""

    ether: _Ether
    name: str

    def put(self, packet: Packet) -> None:
        self.ether.put(self.name, packet)

    def listen(self, handler: Handler) -> None:
        self.ether.listen(self.name, handler)


@dataclass
class Member:
    """A robot of the fleet, and what is counted of it."""

    robot: Robot
    radio: Radio
    log: _Quiet
    motions: Motions = field(repr=False, default_factory=Motions)


class Fleet:
    """Robots on a lattice, each free to go where it likes."""

    def __init__(self, settings: FleetSettings) -> None:
        """Put all robots together; nothing runs yet."""
        self.settings = settings
        self.loop = VirtualLoop(settings.robots)  # its own timers come behind packets
        side = math.ceil(math.sqrt(settings.robots))
        cells = math.ceil(settings.spacing_m * side / settings.map.cell_m)
        self.frame = GridFrame(0.0, 0.0, settings.map.cell_m, cells, cells)
        self.terrain = rolling_ground(self.frame)
        self.roster = tuple(f"r{number}" for number in range(settings.robots))
        self.index = {name: number for number, name in enumerate(self.roster)}
        self._roles = ("explorer",) * settings.robots
        self._ether = _Ether(self)
        self._luck = np.random.default_rng(settings.seed).spawn(settings.robots)
        self.members: dict[str, Member] = {}
        self.faults: list[str] = []
        for number, name in enumerate(self.roster):
            row, col = divmod(number, side)
            x_m, y_m = ((p + 0.5) * settings.spacing_m for p in (col, row))
            self._add(name, x_m, y_m)

    def pose_now(self, name: str) -> Pose:
        """Return where a robot truly is."""
        pose = self.members[name].motions.pose_at(name, self.loop.now_ns)
        assert pose is not None
        return pose

    def run(self, until_s: float) -> None:
        """Run up to a simulated time."""
        self.loop.run_window(from_s(until_s))
        if self.faults:
            raise RuntimeError(f"a robot's program failed: {self.faults[0]}")

    def close(self) -> None:
        """End all robots."""
        tasks = asyncio.all_tasks(self.loop)
        for task in tasks:
            task.cancel()
        self.loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
        self.loop.close()

    def _add(self, name: str, x_m: float, y_m: float) -> None:
        settings, number = self.settings, self.index[name]
        luck = self._luck[number].spawn(5)
        start = Pose(x_m, y_m, self.terrain.height_m(x_m, y_m), float(luck[0].uniform(-3, 3)))
        motions, log = Motions(), _Quiet()
        motions.add(Segment(name, 0, 0, start, start))

        def publish(segment: Segment) -> None:
            motions.add(segment)
            self._ether.stands(name, segment.end)

        rig = make_rig(
            name,
            {name: "explorer"},
            landmarks={},
            terrain=self.terrain,
            motions=motions,
            publish=publish,
            delay_ns=1,
            start=start,
            start_ns=0,
            tether_m=None,
            sensor=settings.sensor,
            drive=settings.drive,
            tether=TetherSettings(),
            body_rng=luck[1],
            camera_rng=luck[2],
            light=LightSettings(),
            ground_salt=0,
        )
        disk = Disk(Path(name), MemoryFiles())
        disk.begin()
        robot = Robot(self._told(name, start), rig.hardware, disk, log, luck[3])
        transmitter = Transmitter({EVERYBODY: PROFILES[settings.profile]}, luck[4])
        radio = Radio(
            name,
            _End(self._ether, name),
            sealer=Sealer(KEY, number, 0),
            opener=Opener(KEY, settings.robots, number),
            transmitter=transmitter,
            receiver=_NearReceiver(),
            choose=robot.choose_frame,
            on_frame=robot.on_frame,
            log=log,
        )
        robot.radio = radio
        robot.rate_bps = lambda: transmitter.rate_bps
        self.members[name] = Member(robot, radio, log, motions)
        self._ether.stands(name, start)
        begin_ns = from_s(float(luck[0].uniform(0.0, STAGGER_S)))
        for part in (radio.run(), robot.heartbeat(), explore(robot)):
            self.loop.create_task(self._from(begin_ns, part))

    async def _from(self, begin_ns: int, part: Coroutine[Any, Any, None]) -> None:
        await sleep_until_ns(begin_ns)
        try:
            await part
        except Exception as error:
            self.faults.append(f"{type(error).__name__}: {error}")

    def _region(self, start: Pose) -> GridFrame:
        """Return the part of the ground that a robot keeps: whole tiles."""
        whole, region_m = self.frame, self.settings.region_m
        if region_m is None:
            return whole
        side = self.settings.map.tile_cells
        side_m = side * whole.cell_m

        def span(at_m: float, cells: int) -> tuple[int, int]:
            low = max(0, math.floor((at_m - region_m) / side_m))
            return low * side, min(cells, (math.ceil((at_m + region_m) / side_m)) * side)

        (row, top), (col, right) = span(start.y_m, whole.rows), span(start.x_m, whole.cols)
        x_m, y_m = (n * whole.cell_m for n in (col, row))
        return GridFrame(x_m, y_m, whole.cell_m, top - row, right - col)

    def _told(self, name: str, start: Pose) -> AgentSettings:
        settings = self.settings
        return AgentSettings(
            name=name,
            index=self.index[name],
            roster=self.roster,
            roles=self._roles,
            frame=self._region(start),
            whole=self.frame,
            start=start,
            start_covariance=np.diag([1e-6, 1e-6, 1e-6, 1e-8]),
            goal_m=None,
            method="wander",
            map=settings.map,
            sensor=settings.sensor,
            drive=settings.drive,
            planner=PlannerSettings(first_looks=1, candidate_step_m=1.0, max_looks=10_000),
            sharing=SharingSettings(horizon_m=settings.horizon_m),
            tether=TetherSettings(),
        )


def rolling_ground(frame: GridFrame) -> Terrain:
    """Return ground of gentle waves, the same everywhere in kind."""
    x_m = frame.x_m + (np.arange(frame.cols) + 0.5) * frame.cell_m
    y_m = frame.y_m + (np.arange(frame.rows) + 0.5) * frame.cell_m
    waves = 0.15 * np.sin(x_m / 1.7)[np.newaxis, :] + 0.15 * np.cos(y_m / 2.3)[:, np.newaxis]
    return Terrain(frame, waves.astype(np.float32), np.ones(frame.shape, dtype=np.float32))


@dataclass(frozen=True)
class Account:
    """What a fleet's robots sent and kept, on average for each, over a span of time."""

    robots: int
    looks: float
    bytes_per_min: dict[str, float]
    """Charged bytes, by kind of frame."""
    digest_bytes: float
    """Mean length of a digest frame, as charged."""
    mates: float
    """Team-mates that count for a robot."""
    tiles: float
    """Tiles in its store."""
    payload_bytes: float
    beliefs: float
    """Tiles that it remembers of its team-mates' stores, over all of them."""

    @property
    def all_bytes_per_min(self) -> float:
        """Bytes of all kinds."""
        return sum(self.bytes_per_min.values())


def account(fleet: Fleet, begin_s: float, until_s: float) -> Account:
    """Run a fleet and count what happens between two times."""
    fleet.run(begin_s)
    members = list(fleet.members.values())
    before = [(Counter(m.log.bytes), Counter(m.log.frames), m.log.looks) for m in members]
    fleet.run(until_s)
    minutes, count = (until_s - begin_s) / 60.0, len(members)
    sent: Counter[str] = Counter()
    frames: Counter[str] = Counter()
    looks = 0
    for member, (sent_then, frames_then, looks_then) in zip(members, before, strict=True):
        sent.update(member.log.bytes - sent_then)
        frames.update(member.log.frames - frames_then)
        looks += member.log.looks - looks_then
    policies = [m.robot.sharing for m in members]
    repairs = [policy.repair for policy in policies if isinstance(policy, Value)]
    return Account(
        robots=count,
        looks=looks / count,
        bytes_per_min={kind: n / minutes / count for kind, n in sorted(sent.items())},
        digest_bytes=sent["digest"] / max(1, frames["digest"]),
        mates=sum(len(r.believed) for r in repairs) / count,
        tiles=sum(len(m.robot.store.keys()) for m in members) / count,
        payload_bytes=sum(m.robot.store.payload_bytes for m in members) / count,
        beliefs=sum(len(b.tiles) for r in repairs for b in r.believed.values()) / count,
    )
