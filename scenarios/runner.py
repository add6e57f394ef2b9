"""Runs a scenario: sets the stage, starts the crew, lets the play run, writes the records."""

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from comms import kernels
from comms.timebase import to_s
from scenarios.compiling import compile_kernels
from scenarios.crews.crew import Crew, MemoryCrew, cpu_s
from scenarios.crews.processes import ZenohCrew, start_fork_server
from scenarios.crews.realmemory import RealMemoryCrew
from scenarios.crews.robotprocess import peak_bytes
from scenarios.errors import StudyError
from scenarios.live import LiveView
from scenarios.pictures.overview import Overview, draw
from scenarios.play.actor import conclude
from scenarios.play.play import Play
from scenarios.play.realtime import RealRun
from scenarios.play.virtual import VirtualRun
from scenarios.records import folder
from scenarios.records.report import report
from scenarios.records.summary import (
    HostCost,
    ProcessCost,
    RobotFinal,
    host_facts,
    summarise,
    write_json,
)
from scenarios.records.tables import write_atomic
from scenarios.ros2.bag import write_bag
from scenarios.schema import Scenario, dump
from scenarios.stage import Stage, set_stage
from scenarios.view.livepage import LivePage
from scenarios.view.reel import Reel
from scenarios.view.report import end_of, write_report
from scenarios.view.rundir import read_run

Beside = Callable[[Path], contextlib.AbstractContextManager[None]]
"""Something that goes on beside a run and only reads what its robots write."""


@dataclass(frozen=True)
class RunResult:
    """What a run leaves."""

    outcome: str
    summary: dict[str, Any]
    out: Path
    stage: Stage
    finals: list[RobotFinal]
    """The robots as they ended, with their maps."""


class RobotFaultError(Exception):
    """A robot's own program failed: a fault of ours."""

    def __init__(self, name: str, trace: str) -> None:
        """Name the robot, and keep its traceback."""
        super().__init__(name, trace)  # both, or it can't travel between processes
        self.name, self.trace = name, trace

    def __str__(self) -> str:
        """Say whose program failed, and where."""
        return f"{self.name}'s program failed:\n{self.trace}"


@dataclass(frozen=True)
class RunOptions:
    """What a run leaves and shows besides its records."""

    quiet: bool = False
    """Say nothing but errors."""
    overwrite: bool = False
    """Replace a former run in the folder."""
    picture: bool = True
    """Also a picture and a report."""
    merge: bool = True
    """Also a `run.mcap`."""
    page: LivePage | None = None
    """Where the run is shown while it goes on; it needs the picture."""
    beside: Beside | None = None
    """Entered with the run's folder before the robots start, and left when they ended."""
    crew_of: Callable[[], Crew] | None = None
    """Makes a crew of another kind than the scenario's `air` asks for."""


PLAIN = RunOptions()
RECORDS_ONLY = RunOptions(quiet=True, picture=False, merge=False)
"""For programs that run many."""


def run(scenario: Scenario, out: Path, options: RunOptions = PLAIN, **changes: Any) -> RunResult:
    """Run a scenario and write its records to `out`.

    `changes` are options by name: `run(scenario, out, quiet=True)`.

    Raises:
        WorldError: the scenario's terrain can't be used; nothing was written.
        FolderError: `out`, or the folder of compiled kernels, can't be written to.
        KeyboardInterrupt: Ctrl-C; the records up to then were written.
        RobotFaultError: a robot's own program failed; the records up to then were written.

    """
    options = replace(options, **changes)
    started_s = time.perf_counter()
    title = scenario.title or scenario.name
    view = LiveView(title, quiet=options.quiet)
    compile_s = _compile(view)
    if scenario.air == "zenoh" and options.crew_of is None:
        start_fork_server()
    stage = set_stage(scenario)
    crew = options.crew_of() if options.crew_of is not None else _crew(scenario)
    with contextlib.closing(options.page or LivePage()):
        with contextlib.closing(crew):
            folder.prepare(out, overwrite=options.overwrite)
            write_atomic(out / "scenario.toml", dump(scenario))
            is_virtual = scenario.clock.mode == "virtual"
            play: Play = (VirtualRun if is_virtual else RealRun)(stage, out, crew, view)
            if options.picture:
                play.reel = Reel(stage)
            company = contextlib.nullcontext() if options.beside is None else options.beside(out)
            with company, view, _ctrl_c(play.interrupt):
                if options.page is not None:
                    options.page.begin(play, title)
                play.play()
        result = _write_up(play, view, started_s + compile_s, compile_s, options)
    if options.merge:
        _merge(out, view)
    return result


def _merge(out: Path, view: LiveView) -> None:
    """Write `run.mcap`; a run is no worse for not having one."""
    try:
        write_bag(out)
    except StudyError as error:
        view.say(f"no run.mcap: {error}")


def _crew(scenario: Scenario) -> Crew:
    if scenario.air == "zenoh":
        return ZenohCrew()
    return MemoryCrew() if scenario.clock.mode == "virtual" else RealMemoryCrew()


@contextlib.contextmanager
def _ctrl_c(interrupt: Callable[[], None]) -> Generator[None]:
    """Have the first Ctrl-C end the run in order; a second one ends it at once."""

    def asked(number: int, frame: object) -> None:
        del number, frame
        signal.signal(signal.SIGINT, signal.default_int_handler)
        interrupt()

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, asked)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _write_up(
    play: Play, view: LiveView, started_s: float, compile_s: float, options: RunOptions
) -> RunResult:
    """Write all records of a run that has ended, and say what came out."""
    stage, out = play.stage, play.out
    simulated_s = to_s(play.now_ns)
    finals = play.finals()
    ending = conclude(stage.scenario, list(play.actors.values()), play.ending, simulated_s)
    summary = summarise(stage.scenario, play.records, finals, stage.truth, ending)
    play.records.write(out)
    write_json(out / "summary.json", summary)
    if options.picture:
        draw(
            out / "overview.png",
            Overview(
                title=stage.scenario.title or stage.scenario.name,
                summary=summary,
                frame=stage.terrain.frame,
                truth=stage.truth,
                robots=finals,
                records=play.records,
                tracks_m={name: np.array(way).reshape(-1, 2) for name, way in play.tracks.items()},
                goal_m=stage.goal_m,
            ),
        )
    if play.reel is not None:
        play.reel.write(out)
    costs = {
        name: ProcessCost(c.cpu_s, c.peak_memory_bytes, c.unique_memory_bytes)
        for name, c in play.crew.costs.items()
    }
    costs["runner"] = ProcessCost(cpu_s(), peak_bytes())
    host = HostCost(
        wall_s=time.perf_counter() - started_s,
        compile_s=compile_s,
        startup_s=play.first_grant_s - started_s,
        grants=play.grants,
        processes=costs,
        launch_s=play.launch_s,
    )
    write_json(out / "host.json", {**host_facts(host), **play.final_facts_of_clock()})
    if play.reel is not None:
        write_report(out)
    if options.page is not None:
        options.page.end(play, end_of(read_run(out)))
    view.say(report(summary, play.records, out))
    for actor in play.actors.values():
        if actor.fault:
            raise RobotFaultError(actor.name, actor.fault)
    if play.ending == "interrupted":
        raise KeyboardInterrupt
    return RunResult(ending.outcome, summary, out, stage, finals)


def _compile(view: LiveView) -> float:
    """Compile the kernels, where this source was never run on this machine.

    Raises:
        FolderError: they can't be kept.

    """
    if kernels.is_warm():
        return 0.0
    view.say("Compiling kernels: once on this machine, about a minute ...")
    return compile_kernels()
