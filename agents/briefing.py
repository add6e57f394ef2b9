"""What a robot is told before it starts, and what it talks to besides its body."""

import asyncio
from dataclasses import dataclass, field
from typing import Protocol

from agents.geometry import Floats, GridFrame, Pose
from agents.messages import (
    Status,
    TetherCommand,
)
from agents.ports import Exposure
from agents.pose.landmarks import Landmark
from agents.settings import (
    DriveSettings,
    MapSettings,
    PlannerSettings,
    SensorSettings,
    SharingSettings,
    TetherSettings,
)
from comms.frames import Kind

ACTIVITIES = (
    "starting",
    "exploring",
    "waiting",
    "descending",
    "holding",
    "watching",
    "done",
    "searching",
)
"""What a robot may be doing, as its status says by number."""


@dataclass(frozen=True)
class AgentSettings:
    """All that a robot is told before it starts."""

    name: str
    index: int
    roster: tuple[str, ...]
    roles: tuple[str, ...]
    frame: GridFrame
    """The team's grid."""
    start: Pose
    """Where it believes to stand in the team frame, by the team's first localisation."""
    start_covariance: Floats
    """(4, 4) of (x, y, z, yaw)."""
    goal_m: tuple[float, float] | None
    """Where the Cliff-bot is to go."""
    method: str
    map: MapSettings
    sensor: SensorSettings
    drive: DriveSettings
    planner: PlannerSettings
    sharing: SharingSettings
    tether: TetherSettings
    whole: GridFrame | None = None
    """The team's grid, where `frame` is only a region of it that this robot keeps; the corner of
    the region is a tile's. None: it keeps all."""
    landmarks: tuple[Landmark, ...] = ()
    """Things whose place in the team frame everybody knows, and by which one can know one's own."""
    start_known: bool = True
    """Whether it knows where it starts; if not, `start` is a place of its own making."""


class RobotLog(Protocol):
    """What a robot writes down for people; it never reads it."""

    def look(
        self, exposure: Exposure, *, expected_cells: float, obtained_cells: int, new_cells: int
    ) -> None:
        """Note one exposure."""
        ...

    def event(self, what: str, detail: str = "") -> None:
        """Note something that happened, in words."""
        ...


class RadioPort(Protocol):
    """What a robot asks of its radio."""

    @property
    def next_seq(self) -> int:
        """The number that the next frame will bear."""
        ...

    def kick(self) -> None:
        """Say that there may be something to send."""
        ...

    def send_urgent(
        self, kind: Kind, payload: bytes, key: str, until_ns: int | None = None
    ) -> None:
        """Send before all else."""
        ...


@dataclass
class Mate:
    """What was heard of a team-mate."""

    status: Status
    heard_s: float


@dataclass
class Inbox:
    """Commands for this robot that its role has not taken yet."""

    tethers: list[TetherCommand] = field(default_factory=list[TetherCommand])
    arrived: asyncio.Event = field(default_factory=asyncio.Event)
