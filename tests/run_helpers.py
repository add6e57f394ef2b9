"""Whole runs on small worlds, and what their records say."""

import csv
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from multiprocessing import active_children
from pathlib import Path
from typing import Any
from unittest.mock import patch

import tomli_w

from agents.robot import Robot
from comms.profiles import PROFILES
from scenarios import runner
from scenarios.crews.crew import MemoryCrew
from scenarios.schema import Scenario, dump, load, parse
from scenarios.wire import Plan

SMALL = (
    "air=memory",
    "world.window_m=[16.0, 14.0]",
    "map.cell_m=0.2",
    "sensor.columns=64",
    "sensor.rows=48",
    "planner.max_candidates=20",
    "planner.max_looks=10",
    "limit_s=900",
)
LOW_CLIFF = ("world.terrain.drop_m=3.0", "world.terrain.edge_meander_m=1.0")
RECORDS = ("summary.json", "looks.csv", "frames.csv", "maps.csv", "events.csv")
UHF = PROFILES["uhf-9600"]
Row = dict[str, Any]


def small(name: str, *overrides: str, events: list[dict[str, Any]] | None = None) -> Scenario:
    """Return a library scenario cut down to about a second of computing."""
    cliff = LOW_CLIFF if name == "cliff" else ()
    scenario = load(name, [*SMALL, *cliff, *overrides])
    text = dump(scenario) + "".join(f"\n[[events]]\n{tomli_w.dumps(e)}" for e in events or [])
    return parse(tomllib.loads(text), "test")


class WatchedCrew(MemoryCrew):
    """A crew in this process whose robots can be looked at when the run is over."""

    def __init__(self) -> None:
        super().__init__()
        self.robots: dict[str, Robot] = {}
        """By name: the newest life's."""

    def launch(self, plans: list[Plan]) -> None:
        super().launch(plans)
        self.robots.update({p.name: self._members[p.name].host.robot for p in plans})


@dataclass
class Ran:
    """A run that has ended, and its records."""

    out: Path
    summary: dict[str, Any]
    robots: dict[str, Robot] = field(default_factory=dict[str, Robot])

    def table(self, name: str) -> list[Row]:
        """Return a table's rows; numbers as numbers, what is not there as None."""
        with (self.out / f"{name}.csv").open(newline="") as file:
            return [{k: _value(v) for k, v in row.items()} for row in csv.DictReader(file)]

    def frames(self) -> list[Row]:
        """Return one row per frame that was sent, however many team-mates it had."""
        seen: dict[tuple[Any, ...], Row] = {}
        for row in self.table("frames"):
            seen.setdefault((row["from"], row["start_s"], row["end_s"], row["kind"]), row)
        return list(seen.values())

    def events(self, robot: str, what: str) -> list[Row]:
        return [e for e in self.table("events") if (e["robot"], e["what"]) == (robot, what)]

    def robot(self, name: str) -> dict[str, Any]:
        return self.summary["robots"][name]

    def digests(self, *names: str) -> set[str]:
        return {self.robot(name)["team_map_digest"] for name in names or self.summary["robots"]}


def _value(text: str) -> str | float | None:
    if text == "":
        return None
    try:
        return float(text)
    except ValueError:
        return text


def run_of(scenario: Scenario, out: Path) -> Ran:
    """Run a scenario as the command line does, but for the picture, the report and run.mcap."""
    crew = WatchedCrew()
    with ExitStack() as stack:
        stack.enter_context(patch.object(runner, "draw"))
        stack.enter_context(patch.object(runner, "write_report"))
        stack.enter_context(patch.object(runner, "MemoryCrew", lambda: crew))
        result = runner.run(scenario, out, quiet=True, merge=False)
    assert active_children() == [], "a process was left behind"
    return Ran(out, result.summary, crew.robots)


def records_of(ran: Ran) -> dict[str, bytes]:
    return {name: (ran.out / name).read_bytes() for name in RECORDS}


def children_of(pid: int) -> list[int]:
    """Return the living processes whose parent this is."""
    return [child for child, (parent, _) in _processes() if parent == pid]


def session_of(pid: int) -> list[int]:
    """Return the living processes of a session."""
    return [child for child, (_, session) in _processes() if session == pid]


def _processes() -> Iterator[tuple[int, tuple[int, int]]]:
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            fields = (entry / "stat").read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue  # ended meanwhile
        if fields[0] != "Z":
            yield int(entry.name), (int(fields[1]), int(fields[3]))
