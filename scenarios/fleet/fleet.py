"""Robots on a lattice, all on one virtual loop."""

import asyncio
import math
from collections.abc import Coroutine
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from agents.briefing import AgentSettings
from agents.disk import Disk
from agents.geometry import GridFrame, Pose
from agents.recall import RECALL
from agents.robot import Robot
from agents.roles import explore
from agents.settings import PlannerSettings, SharingSettings, TetherSettings
from comms.frames import Opener, Sealer
from comms.link import Transmitter
from comms.profiles import PROFILES
from comms.radio import Radio
from comms.timebase import from_s, sleep_until_ns
from scenarios.fleet.ether import End, Ether, NearReceiver
from scenarios.fleet.memory import MemoryFiles, Sums
from scenarios.fleet.settings import FleetSettings
from sim.clock import VirtualLoop
from sim.ground import Terrain
from sim.motion import Motions, Segment
from sim.rig import make_rig
from sim.stereo.settings import LightSettings

KEY = b"a fleet's own key"
EVERYBODY = "everybody"
"""Stands in a packet for all who can hear it."""
PICTURES = 4096
"""Decoded tiles that are kept for all: those who hear a frame decode it at about the same time."""
STAGGER_S = 30.0
"""Robots begin within so long: they are not switched on by one hand."""


@dataclass
class Member:
    """A robot of the fleet, and what is counted of it."""

    robot: Robot
    radio: Radio
    log: Sums
    motions: Motions = field(repr=False, default_factory=Motions)


class Fleet:
    """Robots on a lattice, each free to go where it likes."""

    def __init__(self, settings: FleetSettings) -> None:
        """Put all robots together; nothing runs yet."""
        self.settings = settings
        RECALL.keep(PICTURES)
        self.loop = VirtualLoop(settings.robots)  # its own timers come behind packets
        side = math.ceil(math.sqrt(settings.robots))
        cells = math.ceil(settings.spacing_m * side / settings.map.cell_m)
        self.frame = GridFrame(0.0, 0.0, settings.map.cell_m, cells, cells)
        self.terrain = rolling_ground(self.frame)
        self.roster = tuple(f"r{number}" for number in range(settings.robots))
        self.index = {name: number for number, name in enumerate(self.roster)}
        self._roles = ("explorer",) * settings.robots
        self._ether = Ether(self.loop, settings.radio_m, self.pose_now)
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
        RECALL.keep(0)

    def _add(self, name: str, x_m: float, y_m: float) -> None:
        settings, number = self.settings, self.index[name]
        luck = self._luck[number].spawn(5)
        start = Pose(x_m, y_m, self.terrain.height_m(x_m, y_m), float(luck[0].uniform(-3, 3)))
        motions, log = Motions(), Sums()
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
            End(self._ether, name, number),
            sealer=Sealer(KEY, number, 0),
            opener=Opener(KEY, settings.robots, number),
            transmitter=transmitter,
            receiver=NearReceiver(),
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
