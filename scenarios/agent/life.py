"""The life of a robot by itself: from its settings to the signal that ends it."""

import asyncio
import json
import math
import signal
import sys
import time
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import numpy as np

from agents.briefing import AgentSettings
from agents.disk import Disk, DiskError
from agents.geometry import Pose
from agents.ports import Exposure, Hardware
from agents.robot import Robot
from agents.roles import ROLES
from comms.frames import Opener, Sealer
from comms.link import Receiver, Transmitter
from comms.profiles import resolve
from comms.radio import Radio
from comms.timebase import NS, from_s
from comms.zenoh_air import Wire, open_client
from comms.zenoh_security import Credentials
from scenarios.agent.air import AgentAir
from scenarios.agent.settings import AgentFile
from scenarios.crews.realserve import SWITCH_S
from scenarios.logs.notebook import LogFile, Notebook
from scenarios.records.tables import EventRow, LookRow, write_atomic
from sim.clock import ScaledLoop

STATUS_S = 2.0
"""How often `status.json` is written, and the log handed to the disk."""
LEASE_MS = 10_000
"""A router that was silent for so long is taken for lost; the session then begins anew."""


class AgentLog:
    """Keeps the robot's log, and says on the terminal what happens."""

    def __init__(self, agent: "Agent", notebook: Notebook) -> None:
        """Write into a notebook for an agent."""
        self._agent, self._notebook = agent, notebook

    def look(
        self, exposure: Exposure, *, expected_cells: float, obtained_cells: int, new_cells: int
    ) -> None:
        """Note one exposure; where it was taken is where the robot believes to stand."""
        pose = self._agent.robot.pose
        row = LookRow(
            self._agent.file.name, exposure.t_s, pose.x_m, pose.y_m, pose.z_m, exposure.pan_rad,
            exposure.tilt_rad, expected_cells, obtained_cells, new_cells, math.nan, math.nan,
        )  # fmt: skip
        self._notebook.add(row, from_s(exposure.t_s))

    def event(self, what: str, detail: str = "") -> None:
        """Note something that happened."""
        t_s = self._agent.loop.time()
        self._notebook.add(EventRow(t_s, self._agent.file.name, what, detail), from_s(t_s))
        print(f"{self._agent.file.name}: {what}{': ' if detail else ''}{detail}", flush=True)


class Agent:
    """One robot, its hardware, its radio, on the real clock."""

    def __init__(self, file: AgentFile, key: bytes, hardware: Hardware) -> None:
        """Put it together; a folder that holds a former life is taken up."""
        self.file = file
        self.loop = ScaledLoop(1.0)
        asyncio.set_event_loop(self.loop)
        self.loop.begin(time.monotonic() - (time.time() - file.epoch_s))
        folder = Path(file.folder)
        folder.mkdir(parents=True, exist_ok=True)
        self._status_path = folder / "status.json"
        disk = Disk(folder / "disk")
        refusal = ""
        try:
            disk.begin()
        except DiskError as error:
            refusal = str(error)
        life = disk.incarnation
        log = LogFile(folder / f"{file.name}-{life}.mcap")
        self._notebook = Notebook(file.name, log, lambda: from_s(self.loop.time()))
        self.log = AgentLog(self, self._notebook)
        luck = np.random.default_rng([file.seed, life, *file.name.encode()]).spawn(3)
        settings = _agent_settings(file)
        self.robot = Robot(settings, hardware, disk, self.log, luck[0])
        self.air = AgentAir(file.name, life, self.log.event)
        self._transmitter, receiver = _ends(file, settings.roster, luck[1:])
        self.radio = Radio(
            file.name,
            self.air,
            sealer=Sealer(key, settings.index, life),
            opener=Opener(key, len(settings.roster), settings.index),
            transmitter=self._transmitter,
            receiver=receiver,
            choose=self.robot.choose_frame,
            on_frame=self.robot.on_frame,
            log=self._notebook,
            late_tolerance_ns=NS,
        )
        self.robot.radio = self.radio
        self.robot.rate_bps = self._rate_bps
        self._over = asyncio.Event()
        self._fault: BaseException | None = None
        if refusal:
            self.log.event("disk", refusal)

    def _rate_bps(self) -> float:
        return self._transmitter.rate_bps if self._transmitter.can_send() else math.inf

    def run(self) -> None:
        """Live until SIGINT or SIGTERM.

        Raises:
            Exception: whatever went wrong in the robot's own program.

        """
        sys.setswitchinterval(SWITCH_S)
        for number in (signal.SIGINT, signal.SIGTERM):
            self.loop.add_signal_handler(number, self._over.set)
        try:
            self.loop.run_until_complete(self._live())
        finally:
            self.air.close()
            self._notebook.close()
            self.loop.close()
        if self._fault is not None:
            raise self._fault

    async def _live(self) -> None:
        role = ROLES[self.file.role]
        parts = (
            self.air.join(self._connect),
            self.radio.run(),
            self.robot.heartbeat(),
            self._tell(),
            role(self.robot),
        )
        tasks = [asyncio.create_task(self._guarded(part)) for part in parts]
        await self._over.wait()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await self.robot.save()
        self._write_status()

    async def _guarded(self, part: Coroutine[Any, Any, None]) -> None:
        try:
            await part
        except Exception as error:
            self._fault = self._fault or error
            self._over.set()

    def _connect(self) -> Wire:
        router = self.file.router
        keys = Path(router.keys) if router.keys else None
        credentials = None if keys is None else Credentials.of(keys, self.file.name)
        return open_client(router.endpoint, LEASE_MS, credentials=credentials)

    async def _tell(self) -> None:
        """Write the status and empty the notebook, every now and then."""
        while True:
            self._write_status()
            self._notebook.take()
            await asyncio.sleep(STATUS_S)

    def _write_status(self) -> None:
        robot, now_s = self.robot, self.loop.time()
        facts = {
            "name": self.file.name,
            "t_s": now_s,
            "incarnation": robot.me.incarnation,
            "activity": robot.activity,
            "looks": robot.looks,
            "pose": [float(value) for value in vars_of(robot.pose)],
            "team_cells": robot.team.known_entries(),
            "digest": robot.store.digest(),
            "settled": robot.settled,
            "sent_bytes": self.radio.traffic.sent_bytes,
            "received_bytes": self.radio.traffic.received_bytes,
            "dropped_frames": dict(sorted(self.radio.dropped.items())),
            "silent_s": {name: now_s - t_s for name, t_s in sorted(self.air.heard_s.items())},
        }
        write_atomic(self._status_path, json.dumps(facts, indent=2) + "\n")


def vars_of(pose: Pose) -> tuple[float, float, float, float]:
    """Return x, y, z (m) and yaw (rad)."""
    return (pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad)


def _agent_settings(file: AgentFile) -> AgentSettings:
    roster = tuple(file.team.roles)
    start, turn = file.start, math.radians(file.start.sigma_deg)
    place = start.sigma_m**2
    return AgentSettings(
        name=file.name,
        index=roster.index(file.name),
        roster=roster,
        roles=tuple(file.team.roles.values()),
        frame=file.frame,
        start=Pose(start.x_m, start.y_m, start.z_m, math.radians(start.yaw_deg)),
        start_covariance=np.diag([place, place, place, turn**2]),
        goal_m=file.team.goal_m,
        method=file.method,
        map=file.map,
        sensor=file.sensor,
        drive=file.drive,
        planner=file.planner,
        sharing=file.sharing,
        tether=file.tether,
    )


def _ends(
    file: AgentFile, roster: tuple[str, ...], luck: list[np.random.Generator]
) -> tuple[Transmitter, Receiver]:
    """Return both ends of the links, by the file."""
    mates = [name for name in roster if name != file.name]
    to_mates = {mate: resolve(file.links, file.name, mate, []) for mate in mates}
    from_mates = {mate: resolve(file.links, mate, file.name, []) for mate in mates}
    lots = dict(zip(mates, luck[1].spawn(max(1, len(mates))), strict=False))
    return Transmitter(to_mates, luck[0]), Receiver(from_mates, lots)
