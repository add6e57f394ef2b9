"""One run under faults, and all that its records say afterwards."""

import shutil
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from multiprocessing import active_children, forkserver
from pathlib import Path
from typing import Any, cast

from comms.timebase import to_s
from scenarios.crews.crew import Crew, MemoryCrew, Obituary
from scenarios.crews.processes import ZenohCrew, start_fork_server
from scenarios.live import LiveView
from scenarios.play.actor import Actor
from scenarios.play.virtual import VirtualRun
from scenarios.records.folder import make_folder_in_memory
from scenarios.records.summary import RobotFinal
from scenarios.records.tables import Records
from scenarios.schema import Scenario
from scenarios.scores.ledger import Ledger
from scenarios.stage import Stage, set_stage
from scenarios.wire import Report
from sim.motion import Segment


@dataclass
class Evidence:
    """What is known of a run that has ended."""

    scenario: Scenario
    records: Records
    actors: list[Actor]
    finals: list[RobotFinal]
    ledger: Ledger
    ending: str
    """settled, limit, fault or nobody left; empty where the run itself broke off."""
    simulated_s: float
    tethers: dict[str, list[Segment]] = field(default_factory=dict[str, list[Segment]])
    """How each drum ran, in order."""
    freezes_s: dict[str, list[float]] = field(default_factory=dict[str, list[float]])
    """When each robot's motion was frozen, for it was gone."""
    orphans: list[str] = field(default_factory=list[str])
    """Processes that outlived the run."""


class _Watched(VirtualRun):
    """A run whose drums and freezes are kept."""

    keeps_logs = False

    def __init__(self, stage: Stage, out: Path, crew: Crew) -> None:
        super().__init__(stage, out, crew, LiveView("", quiet=True))
        self.ledger = Ledger(stage.terrain.frame)
        self.tethers: dict[str, list[Segment]] = {}
        self.freezes_s: dict[str, list[float]] = {}
        self._anchors = [n for n, robot in stage.scenario.robots.items() if robot.role == "anchor"]

    def take(self, told: Report | Obituary) -> None:
        if isinstance(told, Report) and told.name in self._anchors:
            segments = [Segment.from_wire(wire) for wire in told.segments]
            self.tethers.setdefault(told.name, []).extend(segments)
        super().take(told)

    def bury(self, name: str, state: str = "killed") -> None:
        self.freezes_s.setdefault(name, []).append(to_s(self.now_ns))
        super().bury(name, state)


def run_trial(scenario: Scenario) -> Evidence:
    """Run a scenario, keep no files, and return what is known of it."""
    with folder_in_memory() as out:
        if scenario.air == "zenoh":
            start_fork_server()
            crew: Crew = ZenohCrew()
        else:
            crew = MemoryCrew(counts_cost=False)
        play = _Watched(stage_of(scenario), out, crew)
        try:
            play.play()
        finally:
            crew.close()
    assert play.ledger is not None
    return Evidence(
        scenario=scenario,
        records=play.records,
        actors=list(play.actors.values()),
        finals=play.finals(),
        ledger=play.ledger,
        ending=play.ending,
        simulated_s=to_s(play.now_ns),
        tethers=play.tethers,
        freezes_s=play.freezes_s,
        orphans=_orphans(),
    )


def stage_of(scenario: Scenario) -> Stage:
    """Return the stage of a scenario; the worlds of the last few are kept, truth and all."""
    if scenario.world.seed is None:
        return set_stage(scenario)
    still = scenario.model_copy(update={"events": (), "air": "memory", "seed": 0})
    return _made_stage(still.model_dump_json()).under(scenario)


@lru_cache(maxsize=4)
def _made_stage(text: str) -> Stage:
    return set_stage(Scenario.model_validate_json(text))


@contextmanager
def folder_in_memory() -> Generator[Path]:
    """Make a folder for the robots' disks, in memory where that can be."""
    folder = make_folder_in_memory()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _orphans() -> list[str]:
    """Return the processes of robots that still run: those known, and any other of the server's."""
    known = {child.pid: child.name for child in active_children()}
    server = getattr(cast("Any", forkserver)._forkserver, "_forkserver_pid", None)
    living = [pid for pid in _children_of(server) if pid not in known] if server else []
    return [f"{name} (pid {pid})" for pid, name in known.items()] + [f"pid {pid}" for pid in living]


def _children_of(parent: int) -> list[int]:
    """Return the processes, not yet ended, whose parent this is; none where there is no /proc."""
    found: list[int] = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # ended meanwhile
            state, above = stat.read_text().rsplit(")", 1)[1].split()[:2]
            if int(above) == parent and state != "Z":
                found.append(int(stat.parent.name))
    return sorted(found)
