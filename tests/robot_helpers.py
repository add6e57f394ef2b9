"""Whole robots' minds on real folders, without body, radio or clock."""

from pathlib import Path

import numpy as np
from team_helpers import FRAME, FRAMES, MAX_ERROR_M, SURE, mask_of

from agents.briefing import AgentSettings
from agents.disk import Disk
from agents.geometry import Pose
from agents.maps.elevationlook import LookCells
from agents.maps.planarlook import LookOdds
from agents.maps.voxellook import VoxelLook
from agents.messages import unpack_chunks
from agents.ports import Hardware
from agents.robot import Robot
from agents.settings import (
    DriveSettings,
    MapSettings,
    PlannerSettings,
    SensorSettings,
    SharingSettings,
    TetherSettings,
)
from agents.store import Chunk
from comms.frames import Frame, Kind

START = Pose(16.0, 1.0, 0.0, 0.0)
ROSTER = ("recon", "cliffbot", "anchor-left", "anchor-right")
PAYLOAD_BYTES = 200
NS = 1_000_000_000


class Log:
    def __init__(self) -> None:
        self.events: list[tuple[str, str]] = []

    def look(self, exposure, *, expected_cells, obtained_cells, new_cells) -> None: ...

    def event(self, what: str, detail: str = "") -> None:
        self.events.append((what, detail))

    def told(self, what: str) -> list[str]:
        return [detail for event, detail in self.events if event == what]


def settings_of(index: int, kind: str = "elevation") -> AgentSettings:
    return AgentSettings(
        name=ROSTER[index],
        index=index,
        roster=ROSTER,
        roles=("recon", "cliffbot", "anchor", "anchor"),
        frame=FRAMES[kind],
        start=START,
        start_covariance=SURE,
        goal_m=None,
        method="information-interest" if kind == "elevation" else "information",
        map=MapSettings(kind=kind, cell_m=FRAME.cell_m, tile_cells=16, max_error_m=MAX_ERROR_M),
        sensor=SensorSettings(),
        drive=DriveSettings(),
        planner=PlannerSettings(),
        sharing=SharingSettings(),
        tether=TetherSettings(),
    )


def robot_on(folder: Path, index: int = 0, kind: str = "elevation") -> Robot:
    """Start a robot, in its next life where the folder knows a former one."""
    disk = Disk(folder)
    disk.begin()
    return Robot(settings_of(index, kind), Hardware(), disk, Log(), np.random.default_rng(0))


def log_of(robot: Robot) -> Log:
    assert isinstance(robot.log, Log)
    return robot.log


def hear(
    robot: Robot,
    kind: Kind,
    payload: bytes,
    sender: int = 1,
    t_s: float = 1.0,
    life: int = 0,
    seq: int = 0,
) -> None:
    robot.on_frame(Frame(sender, life, seq, kind, payload), round(t_s * NS))


def measure(robot: Robot, cells: LookCells | LookOdds | VoxelLook) -> None:
    """Take in one look, as a mapper does once its points are binned."""
    if not robot.own.submaps:
        robot.own.begin_submap(robot.pose, robot.filter.covariance)
    robot.own.submaps[-1].observe(cells)
    robot.tiles_changed(len(robot.own.submaps) - 1, mask_of(cells))


def save(robot: Robot) -> None:
    robot.disk.save_layer(robot._layer_content())


def say(robot: Robot, frames: int, t_s: float = 100.0) -> list[Chunk]:
    """Let the link ask so many times; return the chunks of map that went out."""
    chunks: list[Chunk] = []
    for n in range(frames):
        outgoing = robot.choose_frame(round((t_s + n) * NS), PAYLOAD_BYTES)
        if outgoing is not None:
            assert len(outgoing.payload) <= PAYLOAD_BYTES
            if outgoing.kind == Kind.MAP:
                chunks += unpack_chunks(outgoing.payload, robot.me)
    return chunks
