"""What people do to a run by hand: it becomes an event of the scenario, as if it had been planned.

It happens at an instant that nobody has reached yet, between all others, so that the run which its
`scenario.toml` describes afterwards is this very one.
"""

from collections.abc import Sequence
from typing import Any, Literal

from comms.timebase import from_s, to_s
from scenarios.schema import Scenario
from scenarios.schema.events import Event, check_events, in_order

Deed = Literal["kill", "cut", "heal", "revive"]
DEEDS: tuple[Deed, ...] = ("kill", "cut", "heal", "revive")
REVIVED_AFTER_S = 10.0
"""How long a robot takes to come back that is brought back by hand."""
GRAIN_NS = 1_000_000
"""Deeds fall on whole milliseconds."""


class DeedError(Exception):
    """What was asked for can't happen now, in a sentence."""


def event_of(deed: Deed, robot: str, at_ns: int) -> Event:
    """Return what a deed is in a scenario."""
    at_s = to_s(at_ns)
    match deed:
        case "kill":
            return Event(at_s=at_s, kill=robot)
        case "cut":
            return Event(at_s=at_s, link=robot, up=False)
        case "heal":
            return Event(at_s=at_s, link=robot, up=True)
        case "revive":
            return Event(at_s=at_s, restart=robot, after_s=REVIVED_AFTER_S)


def instant_ns(reached_ns: int, taken_ns: Sequence[int]) -> int:
    """Return the first whole millisecond after all that was reached, at which nothing is due."""
    at_ns = (reached_ns // GRAIN_NS + 1) * GRAIN_NS
    while at_ns in taken_ns or from_s(to_s(at_ns)) != at_ns:
        at_ns += GRAIN_NS
    return at_ns


def with_event(scenario: Scenario, event: Event) -> Scenario:
    """Return a scenario in which an event happens besides.

    What no longer fits after it is left out: a robot that is killed can't be stopped later.

    Raises:
        DeedError: the event itself can't happen.

    """
    joins_s = {name: robot.join_s or 0.0 for name, robot in scenario.robots.items()}
    events = in_order([*scenario.events, event])
    while conflicts := check_events(events, joins_s, scenario.limit_s):
        misfits = {int(conflict.key.split(".")[1]) for conflict in conflicts}
        own = [c for c in conflicts if events[int(c.key.split(".")[1])] is event]
        if own:
            raise DeedError(f"{event.target} {own[0].sentence}")
        events = [e for index, e in enumerate(events) if index not in misfits]
    return scenario.model_copy(update={"events": tuple(events)})


def plain_events(scenario: Scenario) -> list[dict[str, Any]]:
    """Return a scenario's events as plain values, for robots that run already."""
    return [event.model_dump(mode="json", exclude_none=True) for event in scenario.timeline()]


def as_told(scenario: Scenario, events: Sequence[dict[str, Any]]) -> Scenario:
    """Return a scenario with the events that `plain_events` gave."""
    return scenario.model_copy(update={"events": tuple(Event(**event) for event in events)})
