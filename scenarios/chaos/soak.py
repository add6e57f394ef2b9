"""A long run under faults: does anything grow that should not?

A small team maps for hours, and in each half hour something else goes wrong. The memory of every
process is sampled as simulated time passes; what grew in the second half of the run is told.
"""

import statistics
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from comms.timebase import from_s, to_s
from scenarios.chaos.draw import draw_faults, under
from scenarios.chaos.faults import KINDS, Fault
from scenarios.chaos.small import small_changes
from scenarios.chaos.trial import folder_in_memory, stage_of
from scenarios.crews.crew import Crew, MemoryCrew
from scenarios.crews.processes import ZenohCrew, start_fork_server
from scenarios.crews.robotprocess import unique_bytes
from scenarios.live import LiveView
from scenarios.play.virtual import VirtualRun
from scenarios.schema import Scenario, load
from scenarios.schema.overrides import Override, parse_override
from scenarios.wire import Report

SPAN_S = 1800.0
"""Faults of one span are over before the next begins."""
SAMPLES = 100
"""Samples of each process's memory."""
RUNNER = "runner"
ENDLESS = (
    "planner.max_looks=1000000",
    "sensor.look_s=60",
    "sample_s=60",
    "drive.odometry_sigma=0.0001",
    "drive.slip_sigma=0.0001",
    "drive.slip_bias_sigma=0",
    "drive.yaw_sigma_deg_per_m=0.0001",
    "drive.yaw_sigma_deg_per_turn=0.0001",
)
"""Robots that look for as long as they live, and do not drift: ground that is mapped stays so."""


@dataclass
class Soaked:
    """What came of it."""

    simulated_s: float
    ending: str
    faults: tuple[Fault, ...]
    looks: int
    frames: int
    memory: dict[str, list[tuple[float, int]]] = field(
        default_factory=dict[str, list[tuple[float, int]]]
    )
    """By process: (simulated s, bytes shared with no other process)."""

    def growth(self) -> dict[str, float]:
        """Return by what share each process grew in the second half of the run.

        The medians of its first and its last fifth are compared: a robot that was started again
        begins with little.
        """
        found: dict[str, float] = {}
        for name, samples in sorted(self.memory.items()):
            half = [size for t_s, size in samples if t_s >= self.simulated_s / 2]
            fifth = max(1, len(half) // 5)
            if len(half) >= 2:
                early, late = statistics.median(half[:fifth]), statistics.median(half[-fifth:])
                found[name] = late / early - 1.0
        return found

    def facts(self) -> dict[str, Any]:
        """Return what is kept of it."""
        kinds = [fault.kind for fault in self.faults]
        return {
            "simulated_s": self.simulated_s,
            "ending": self.ending,
            "faults_injected": {kind: kinds.count(kind) for kind in sorted(set(kinds))},
            "looks": self.looks,
            "frames": self.frames,
            "memory_growth_in_second_half": self.growth(),
            "memory_bytes": {
                name: [[t_s, size] for t_s, size in samples]
                for name, samples in sorted(self.memory.items())
            },
        }


def soak_scenario(hours: float, seed: int, changes: Sequence[Override] = ()) -> Scenario:
    """Return a team of three in a world of a few tiles, with hours of faults before it."""
    base = small_changes("pair")
    base += [parse_override(text) for text in (*ENDLESS, "air=zenoh", "robots.count=3")]
    limit = parse_override(f"limit_s={3600 * hours:g}")
    return load("pair", [*base, limit, *changes], seed=seed)


def soak_faults(scenario: Scenario, seed: int) -> tuple[Fault, ...]:
    """Return what goes wrong, span by span; everybody who goes comes back."""
    kinds = [name for name, kind in KINDS.items() if kind.heals]
    found: list[Fault] = []
    for span in range(int(scenario.limit_s // SPAN_S)):
        drawn = draw_faults(scenario, seed * 10_000 + span, kinds, 0.9 * SPAN_S)
        found += [replace(fault, at_s=fault.at_s + span * SPAN_S) for fault in drawn]
    return tuple(found)


class _Soaking(VirtualRun):
    """A run that goes on to its limit, keeps no records, and samples memory."""

    keeps_logs = False
    samples: dict[str, list[tuple[float, int]]]
    looks = frames = 0

    def open_agenda(self) -> list[str]:
        self.samples = defaultdict(list)
        self.at(0, self._sample)
        return super().open_agenda()

    def _sample(self) -> None:
        crew = self.crew
        pids = crew.pids() if isinstance(crew, ZenohCrew) else {}
        for name, pid in {RUNNER: None, **pids}.items():
            size = unique_bytes(pid)
            if size is not None:
                self.samples[name].append((to_s(self.now_ns), size))
        self.at(self.now_ns + from_s(self.scenario.limit_s / SAMPLES), self._sample)

    def _settled(self) -> bool:
        return False

    def _take_rows(self, told: Report) -> None:
        """Count what would be kept: the records of a run are as long as the run."""
        self.looks += sum(row[0] == "look" for row in told.rows)
        self.frames += sum(row[0] == "tx" for row in told.rows)

    def _take_segments(self, told: Report) -> None:
        super()._take_segments(told)
        del self.tracks[told.name][:-2]


def soak(scenario: Scenario, seed: int) -> Soaked:
    """Run a scenario to its limit under faults, and return what its processes took."""
    faults = soak_faults(scenario, seed)
    stormy = under(scenario, scenario.seed, faults, scenario.limit_s - 1.0)
    crew: Crew
    if scenario.air == "zenoh":
        start_fork_server()
        crew = ZenohCrew()
    else:
        crew = MemoryCrew()
    with folder_in_memory() as out:
        run = _Soaking(stage_of(stormy), out, crew, LiveView("", quiet=True))
        try:
            run.play()
        finally:
            crew.close()
    return Soaked(to_s(run.now_ns), run.ending, faults, run.looks, run.frames, dict(run.samples))
