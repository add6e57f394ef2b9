"""What the runner and the hosts say to each other on the world plane: plans, grants, reports."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import msgpack

from agents.geometry import Bools, Pose
from scenarios.schema import Scenario
from sim.worlds import World

Pack = dict[str, Any]


@dataclass(frozen=True)
class Plan:
    """All that a host needs to bring one robot to life, handed over when its process starts."""

    scenario: Scenario
    name: str
    terrain: World
    observable: Bools
    """The cells, (rows, cols) or (layers, rows, cols), that the team could see from where it can
    stand."""
    starts: dict[str, Pose]
    """True start poses of the whole team."""
    goal_m: tuple[float, float] | None
    landmarks: dict[str, Pose]
    """Where landmarks stand."""
    folder: Path
    """The run's folder."""
    start_ns: int = 0
    """Simulated instant at which the robot starts."""
    pose: Pose | None = None
    """Where its body truly stands then, if not at its start pose."""
    tether_m: float | None = None
    """Length out of its drum then."""
    first_number: int = 0
    """Number of its first packet: a robot that restarts goes on counting."""
    baseline: dict[str, int] = field(default_factory=dict[str, int])
    """Packets that each team-mate had sent before this robot started: it never hears them."""
    segments: tuple[tuple[Any, ...], ...] = ()
    """Motion of the others up to now."""
    link_events: tuple[int, ...] = ()
    """Indices (in the timeline) of the link events that have happened."""
    trouble_events: tuple[int, ...] = ()
    """The same of the events by which parts of this robot have failed."""
    keeps_log: bool = True
    """Whether it writes its own log."""
    keeps_ledger: bool = False
    """Whether the world keeps a ledger of what its sensors measure (`scenarios.scores.ledger`)."""
    keeps_growth: bool = False
    """Whether it tells how its map grows and what it plans (`scenarios.view`)."""
    endpoint: str = ""
    """Where the runner's Zenoh router listens; empty in the one-process form."""
    pictures: Path | None = None
    """Where robots of one computer keep what they decode, for each other; None: nowhere."""
    epoch_s: float | None = None
    """On the real clock: monotonic time of the run's start; None: it will be told ("begin")."""


@dataclass
class Grant:
    """Permission to run up to `end_ns`, with all that has to be known for it."""

    end_ns: int
    floor_ns: int = 0
    counts: dict[str, int] = field(default_factory=dict[str, int])
    """Packets to have taken, by sender, before anything runs."""
    segments: list[Any] = field(default_factory=list[Any])
    commands: list[Any] = field(default_factory=list[Any])
    """("link", index in the timeline), ("trouble", index in the timeline), ("freeze", robot, t_ns),
    ("events", what happens by now, with what was done by hand), ("begin", epoch_s) on the real
    clock, or ("finish",)."""

    def to_wire(self) -> bytes:
        """Return the grant as MessagePack bytes."""
        return cast("bytes", msgpack.packb(vars(self)))

    @staticmethod
    def from_wire(data: bytes) -> "Grant":
        """Return the grant in `data`."""
        return Grant(**cast("Pack", msgpack.unpackb(data)))


@dataclass
class Report:
    """What happened in a window, and when something will happen next."""

    name: str
    incarnation: int
    next_ns: int | None = None
    sent: int = 0
    urgent: list[Any] = field(default_factory=list[Any])
    """(receiver, arrival in ns) of packets of this window that wake their receiver."""
    segments: list[Any] = field(default_factory=list[Any])
    rows: list[Any] = field(default_factory=list[Any])
    cuts: list[Any] = field(default_factory=list[Any])
    """(packet number, t_s) of frames that were cut short."""
    measured: list[Any] = field(default_factory=list[Any])
    """Entries of the ledger, where one is kept."""
    growth: list[Any] = field(default_factory=list[Any])
    """Where a playback is kept: (t_ns, mapped cells that can be seen, whether this is the life's
    first, what changed of the team map; see `scenarios.view.growth`)."""
    plans: list[Any] = field(default_factory=list[Any])
    """The same: (t_ns, what the robot is up to; see `scenarios.view.witness`)."""
    status: Pack = field(default_factory=dict[str, Any])
    """The newest sample of the robot's state, when there is a new one."""
    fault: str = ""
    """A traceback, where the robot's own program failed."""
    final: Pack | None = None
    """After "finish": the robot's end state and what its process cost."""

    def to_wire(self) -> bytes:
        """Return the report as MessagePack bytes."""
        return cast("bytes", msgpack.packb(vars(self)))

    @staticmethod
    def from_wire(data: bytes) -> "Report":
        """Return the report in `data`."""
        return Report(**cast("Pack", msgpack.unpackb(data)))
