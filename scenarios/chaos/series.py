"""A series of runs, each under faults of its own; what breaks is shrunk to what breaks it."""

import contextlib
import gc
import time
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Any

from scenarios.chaos.draw import draw_faults, under
from scenarios.chaos.faults import Fault
from scenarios.chaos.invariants import Violation, violations
from scenarios.chaos.trial import Evidence, run_trial
from scenarios.schema import Scenario
from scenarios.workers import workers

BATCH = 50
"""Runs between two rounds of collecting garbage, and given to a process at once."""


@dataclass(frozen=True)
class Series:
    """What is run: a scenario, and what may go wrong in it."""

    scenario: Scenario
    kinds: tuple[str, ...]
    horizon_s: float
    """Faults happen, and are over, before this."""

    def faults(self, seed: int) -> tuple[Fault, ...]:
        """Return what goes wrong in the run of a seed."""
        return draw_faults(self.scenario, seed, self.kinds, self.horizon_s)

    def scenario_of(self, seed: int, faults: Sequence[Fault]) -> Scenario:
        """Return the run of a seed as a scenario of its own."""
        return under(self.scenario, seed, faults, self.horizon_s + 1.0)


@dataclass
class Failure:
    """A run in which something broke."""

    seed: int
    faults: tuple[Fault, ...]
    broken: list[Violation]
    shrunk: tuple[Fault, ...] = ()
    """The fewest of the faults that still break the same."""


@dataclass
class Tally:
    """What a series came to."""

    runs: int = 0
    simulated_s: float = 0.0
    wall_s: float = 0.0
    injected: Counter[str] = field(default_factory=Counter[str])
    endings: Counter[str] = field(default_factory=Counter[str])
    broken: Counter[str] = field(default_factory=Counter[str])
    failures: list[Failure] = field(default_factory=list[Failure])

    def facts(self) -> dict[str, Any]:
        """Return what is kept of it."""
        return {
            "runs": self.runs,
            "wall_s": self.wall_s,
            "simulated_s": self.simulated_s,
            "faults_injected": dict(sorted(self.injected.items())),
            "endings": dict(sorted(self.endings.items())),
            "violations": dict(sorted(self.broken.items())),
            "failures": [
                {
                    "seed": failure.seed,
                    "violations": [str(violation) for violation in failure.broken],
                    "faults": [fault.facts() for fault in failure.faults],
                    "shortest": [fault.facts() for fault in failure.shrunk],
                }
                for failure in self.failures
            ],
        }


@dataclass(frozen=True)
class Outcome:
    """What one run came to, small enough to be handed from process to process."""

    seed: int
    faults: tuple[Fault, ...]
    ending: str
    simulated_s: float
    broken: tuple[Violation, ...]


def run_one(series: Series, seed: int, faults: Sequence[Fault] | None = None) -> Outcome:
    """Run one seed, with its own faults or others, and check it."""
    drawn = series.faults(seed) if faults is None else tuple(faults)
    try:
        evidence: Evidence = run_trial(series.scenario_of(seed, drawn))
    except Exception as error:
        broken = Violation("ends in order", f"the run broke off: {type(error).__name__}: {error}")
        return Outcome(seed, drawn, "broken off", 0.0, (broken,))
    found = tuple(violations(evidence))
    return Outcome(seed, drawn, evidence.ending, evidence.simulated_s, found)


def run_batch(series: Series, seeds: Sequence[int]) -> list[Outcome]:
    """Run some seeds in this process."""
    with _quiet_memory():
        return [run_one(series, seed) for seed in seeds]


def run_series(
    series: Series,
    first_seed: int,
    runs: int,
    *,
    jobs: int = 1,
    told: Callable[[Tally], None] = lambda tally: None,
    shrinks: bool = True,
) -> Tally:
    """Run a series; run i has seed `first_seed + i`. `told` hears of it after each batch."""
    started_s = time.perf_counter()
    tally = Tally()
    seeds = list(range(first_seed, first_seed + runs))
    batches = [seeds[at : at + BATCH] for at in range(0, runs, BATCH)]
    for outcomes in _outcomes(series, batches, jobs):
        for outcome in outcomes:
            _count(tally, outcome)
        tally.wall_s = time.perf_counter() - started_s
        told(tally)
    if shrinks:
        for failure in tally.failures:
            failure.shrunk = shrink(series, failure)
    return tally


def _outcomes(series: Series, batches: list[list[int]], jobs: int) -> Generator[list[Outcome]]:
    if jobs <= 1:
        for batch in batches:
            yield run_batch(series, batch)
        return
    with workers(jobs) as pool:
        yield from pool.map(run_batch, [series] * len(batches), batches)


def _count(tally: Tally, outcome: Outcome) -> None:
    tally.runs += 1
    tally.simulated_s += outcome.simulated_s
    tally.injected.update(fault.kind for fault in outcome.faults)
    tally.endings[outcome.ending] += 1
    tally.broken.update({violation.invariant for violation in outcome.broken})
    if outcome.broken:
        tally.failures.append(Failure(outcome.seed, outcome.faults, list(outcome.broken)))


def shrink(series: Series, failure: Failure) -> tuple[Fault, ...]:
    """Return the fewest faults (none can be left out) that break one of the same invariants.

    Delta debugging (Zeller and Hildebrandt, 2002): leave out halves, then quarters ... for as long
    as the run still fails.
    """
    names = {violation.invariant for violation in failure.broken}

    def fails(faults: Sequence[Fault]) -> bool:
        outcome = run_one(series, failure.seed, faults)
        return any(violation.invariant in names for violation in outcome.broken)

    return shortest(failure.faults, fails)


def shortest(
    faults: tuple[Fault, ...], fails: Callable[[Sequence[Fault]], bool]
) -> tuple[Fault, ...]:
    """Return a part of the faults that still fails, and of which nothing can be left out."""
    if fails(()):
        return ()
    parts = 2
    while len(faults) >= 2:
        size = -(-len(faults) // parts)
        pieces = [faults[at : at + size] for at in range(0, len(faults), size)]
        rests = [sum((p for p in pieces if p is not piece), ()) for piece in pieces]
        smaller = next((rest for rest in rests if rest and fails(rest)), None)
        if smaller is not None:
            faults, parts = smaller, max(2, parts - 1)
        elif size == 1:
            break
        else:
            parts = min(len(faults), 2 * parts)
    return faults


@contextlib.contextmanager
def _quiet_memory() -> Generator[None]:
    """Collect garbage between batches only: a run makes little, and looking for it takes time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
        gc.collect()
