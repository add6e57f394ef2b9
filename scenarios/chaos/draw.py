"""Fault schedules, drawn from a seed."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from scenarios.chaos.faults import KINDS, LINK_KINDS, Fault, Table, heal_links
from scenarios.errors import UsageError
from scenarios.schema import Scenario
from scenarios.schema.events import Event, check_events

PURPOSE = 0xC4A05
"""Sets the dice of faults apart from all others of a seed."""
MOST_FAULTS = 6
TRIES = 12
"""A fault that does not fit among the others (the dead don't hang) is drawn again so often."""
ROUND_S = 0.001


def known_kinds(names: Sequence[str]) -> tuple[str, ...]:
    """Return the kinds of faults that are asked for, all where none is.

    Raises:
        UsageError: there is no such kind.

    """
    for name in names:
        if name not in KINDS:
            raise UsageError(f"--faults {name}: there is none; allowed: {', '.join(KINDS)}")
    return tuple(names) or tuple(KINDS)


def draw_faults(
    scenario: Scenario, seed: int, kinds: Sequence[str], horizon_s: float
) -> tuple[Fault, ...]:
    """Return what goes wrong in one run: one to six faults, at any instant up to a horizon.

    At least one robot is left to the end, and each fault that heals is over by the horizon.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(PURPOSE,)))
    possible = [kind for kind in kinds if len(scenario.robots) > 1 or kind not in LINK_KINDS]
    faults: list[Fault] = []
    for _ in range(int(rng.integers(1, MOST_FAULTS + 1))):
        for _ in range(TRIES):
            fault = _draw(scenario, rng, possible[int(rng.integers(len(possible)))], horizon_s)
            if _fits(scenario, [*faults, fault]):
                faults.append(fault)
                break
    return tuple(sorted(faults, key=lambda fault: fault.at_s))


def _draw(scenario: Scenario, rng: np.random.Generator, name: str, horizon_s: float) -> Fault:
    kind = KINDS[name]
    at_s = float(rng.uniform(0.0, 0.95)) * horizon_s
    for_s = float(np.exp(rng.uniform(np.log(1.0), np.log(horizon_s)))) if kind.heals else 0.0
    for_s = min(for_s, horizon_s - at_s)
    whom, amount = kind.whom(scenario, rng), kind.amount(rng)
    return Fault(
        name, _rounded(at_s), max(ROUND_S, _rounded(for_s)) if for_s else 0.0, whom, amount
    )


def _rounded(seconds: float) -> float:
    return round(seconds / ROUND_S) * ROUND_S if seconds >= ROUND_S else 0.0


def _fits(scenario: Scenario, faults: Sequence[Fault]) -> bool:
    events = [Event.model_validate(table) for table in events_of(scenario, faults)]
    joins_s = {name: robot.join_s or 0.0 for name, robot in scenario.robots.items()}
    gone = {fault.whom for fault in faults if fault.kind in ("kill", "leave")}
    return len(gone) < len(scenario.robots) and not check_events(events, joins_s, scenario.limit_s)


def events_of(scenario: Scenario, faults: Sequence[Fault]) -> list[Table]:
    """Return the events of all faults, in the order of their instants."""
    tables = [table for fault in faults for table in KINDS[fault.kind].events(scenario, fault)]
    return sorted(tables, key=lambda table: table["at_s"])


def under(scenario: Scenario, seed: int, faults: Sequence[Fault], heal_s: float) -> Scenario:
    """Return a scenario with a seed and faults, and links that are sound again at `heal_s`.

    Its own events are left out: the faults may not fit in among them.
    """
    tables: list[dict[str, Any]] = events_of(scenario, faults)
    if any(fault.kind in LINK_KINDS for fault in faults):
        tables += heal_links(scenario, heal_s)
    events = tuple(Event.model_validate(table) for table in tables)
    return scenario.model_copy(update={"seed": seed, "events": events})
