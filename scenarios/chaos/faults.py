"""Faults by name: what may go wrong, and the events of a scenario that make it so.

A fault is one thing that a person would name ("explorer-2 hangs from 30 to 70 s"); it heals by
itself, where it can, so that a list of faults stays a scenario when any of them is left out.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from comms.linksettings import AllLinks
from comms.profiles import resolve
from scenarios.schema import MAPPERS, Scenario

Table = dict[str, Any]
"""One event, as a scenario file has it."""

NEUTRAL: dict[str, Any] = {
    "up": True,
    "loss": 0.0,
    "burst_s": 0.0,
    "duplication": 0.0,
    "reordering": 0.0,
    "bit_errors": 0.0,
}
"""Keys of links that faults change, as they are where nothing is said of them."""


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong."""

    kind: str
    at_s: float
    for_s: float
    """How long it lasts; of a restart, how long the robot is away; 0: it does not heal."""
    whom: str
    """A robot, a pair "a>b" of them, "all", or a group "a+b"."""
    amount: float = 0.0
    """How bad it is: a probability, seconds of thinking, a share of the rate."""

    def __str__(self) -> str:
        """Tell it in a few words."""
        words = [self.kind, self.whom, f"at {self.at_s:g} s"]
        words += [f"for {self.for_s:g} s"] if self.for_s else []
        words += [f"({self.amount:g})"] if self.amount else []
        return " ".join(words)

    def facts(self) -> dict[str, Any]:
        """Return its fields, for records."""
        return asdict(self)


@dataclass(frozen=True)
class Kind:
    """How one kind of fault is drawn, and what it comes to."""

    whom: Callable[[Scenario, np.random.Generator], str]
    events: Callable[[Scenario, Fault], list[Table]]
    amount: Callable[[np.random.Generator], float] = lambda rng: 0.0
    heals: bool = True
    roles: tuple[str, ...] = ()
    """Only a team with one of these roles has it; empty: any."""


# --- whom it befalls ------------------------------------------------------------------------


def _robot(*roles: str) -> Callable[[Scenario, np.random.Generator], str]:
    def pick(scenario: Scenario, rng: np.random.Generator) -> str:
        names = [n for n, robot in scenario.robots.items() if not roles or robot.role in roles]
        return names[int(rng.integers(len(names)))]

    return pick


def _pair(scenario: Scenario, rng: np.random.Generator) -> str:
    sender, receiver = rng.permutation(list(scenario.robots))[:2]
    return f"{sender}>{receiver}"


def _link(scenario: Scenario, rng: np.random.Generator) -> str:
    """All links, those of one robot, or one directed link."""
    choice = int(rng.integers(3))
    if choice == 0:
        return "all"
    return _robot()(scenario, rng) if choice == 1 else _pair(scenario, rng)


def _group(scenario: Scenario, rng: np.random.Generator) -> str:
    names = list(scenario.robots)
    size = int(rng.integers(1, len(names)))
    chosen = rng.permutation(len(names))[:size]
    return "+".join(names[i] for i in sorted(chosen))


# --- what it comes to -------------------------------------------------------------------------


def _once(key: str) -> Callable[[Scenario, Fault], list[Table]]:
    return lambda scenario, fault: [{"at_s": fault.at_s, key: fault.whom}]


def _lasting(key: str, amount_key: str = "") -> Callable[[Scenario, Fault], list[Table]]:
    def events(scenario: Scenario, fault: Fault) -> list[Table]:
        del scenario
        more = {amount_key: fault.amount} if amount_key else {}
        return [{"at_s": fault.at_s, key: fault.whom, "for_s": fault.for_s, **more}]

    return events


def _hang(scenario: Scenario, fault: Fault) -> list[Table]:
    del scenario
    back_s = fault.at_s + fault.for_s
    return [{"at_s": fault.at_s, "stop": fault.whom}, {"at_s": back_s, "resume": fault.whom}]


def _restart(scenario: Scenario, fault: Fault) -> list[Table]:
    del scenario
    return [{"at_s": fault.at_s, "restart": fault.whom, "after_s": fault.for_s}]


def _links(
    *keys: str, by: Callable[[Scenario, Fault], Table]
) -> Callable[[Scenario, Fault], list[Table]]:
    """Change links, and have them as they were when it is over."""

    def events(scenario: Scenario, fault: Fault) -> list[Table]:
        said = by(scenario, fault)
        sound = {key: sound_value(scenario, key) for key in keys}
        over_s = fault.at_s + fault.for_s
        targets = _targets(scenario, fault.whom)
        begun = [{"at_s": fault.at_s, "link": target, **said} for target in targets]
        return begun + [{"at_s": over_s, "link": target, **sound} for target in targets]

    return events


def _targets(scenario: Scenario, whom: str) -> list[str]:
    """Return the links between a group and all others, both ways; or the one that is named."""
    inside = whom.split("+")
    if "+" not in whom and (">" in whom or whom == "all"):
        return [whom]
    outside = [name for name in scenario.robots if name not in inside]
    pairs = [(a, b) for a in inside for b in outside]
    return [f"{a}>{b}" for pair in pairs for a, b in (pair, pair[::-1])]


def sound_value(scenario: Scenario, key: str) -> Any:
    """Return what a key of links is for all, without any fault."""
    said = getattr(scenario.links, key)
    if said is not None:
        return said
    if key == "rate_bps":
        names = list(scenario.robots)
        return resolve(scenario.links, names[0], names[-1]).rate_bps
    return NEUTRAL[key]


def heal_links(scenario: Scenario, at_s: float) -> list[Table]:
    """Return the events by which all links are again as the scenario has them."""
    keys = [*NEUTRAL, "rate_bps"]
    tables: list[Table] = [
        {"at_s": at_s, "link": "all", **{key: sound_value(scenario, key) for key in keys}}
    ]
    own = {**scenario.links.robots, **scenario.links.pairs}
    for target, settings in own.items():
        said = {key: getattr(settings, key) for key in AllLinks.model_fields if key in keys}
        said = {key: value for key, value in said.items() if value is not None}
        if said:
            tables.append({"at_s": at_s, "link": target, **said})
    return tables


def _of(key: str, **more: Any) -> Callable[[Scenario, Fault], Table]:
    return lambda scenario, fault: {key: fault.amount, **more}


def _cut(scenario: Scenario, fault: Fault) -> Table:
    del scenario, fault
    return {"up": False}


def _thin(scenario: Scenario, fault: Fault) -> Table:
    rate_bps = sound_value(scenario, "rate_bps")
    return {"rate_bps": max(300.0, round(min(rate_bps, 1e6) * fault.amount)), "loss": 0.1}


def _bursty(scenario: Scenario, fault: Fault) -> Table:
    del scenario
    return {"burst_s": fault.amount, "burst_gap_s": 2 * fault.amount}


def _share(low: float, high: float) -> Callable[[np.random.Generator], float]:
    """Draw with every octave as likely as any other; two digits are enough."""
    return lambda rng: float(f"{math.exp(rng.uniform(math.log(low), math.log(high))):.2g}")


KINDS: dict[str, Kind] = {
    "kill": Kind(_robot(), _once("kill"), heals=False),
    "stop": Kind(_robot(), _hang),
    "restart": Kind(_robot(), _restart),
    "slow": Kind(_robot(), _lasting("slow", "think_s"), _share(0.05, 5.0)),
    "late": Kind(_robot(), _once("join"), heals=False),
    "leave": Kind(_robot(), _once("leave"), heals=False),
    "blind": Kind(_robot(*MAPPERS), _lasting("blind")),
    "stuck": Kind(_robot(*MAPPERS, "cliffbot"), _lasting("stuck")),
    "disk": Kind(_robot(), _lasting("full")),
    "down": Kind(_link, _links("up", by=_cut)),
    "one-way": Kind(_pair, _links("up", by=_cut)),
    "partition": Kind(_group, _links("up", by=_cut)),
    "degraded": Kind(_link, _links("rate_bps", "loss", by=_thin), _share(0.05, 0.5)),
    "loss": Kind(_link, _links("loss", by=_of("loss")), _share(0.05, 0.9)),
    "burst": Kind(_link, _links("burst_s", by=_bursty), _share(0.2, 10.0)),
    "duplicate": Kind(_link, _links("duplication", by=_of("duplication")), _share(0.05, 1.0)),
    "reorder": Kind(
        _link, _links("reordering", by=_of("reordering", reordering_s=5.0)), _share(0.05, 0.9)
    ),
    "damage": Kind(_link, _links("bit_errors", by=_of("bit_errors")), _share(1e-5, 3e-3)),
}
"""All that may go wrong, by name."""
LINK_KINDS = frozenset(
    ["down", "one-way", "partition", "degraded", "loss", "burst", "duplicate", "reorder", "damage"]
)
