"""What happens to a team while it runs: robots die, hang, come back, join or leave, parts of them
fail, links change.
"""

from collections.abc import Iterable, Sequence
from typing import Annotated, Literal, Self, get_args

from pydantic import Field, model_validator

from comms.linksettings import ALL, AllLinks, LinkChange, check_target, keys_said, pair_of
from comms.timebase import from_s
from scenarios.schema.problems import Conflict, plain
from sim.troubles import Trouble, TroubleKind

EventKind = Literal[
    "kill", "stop", "resume", "restart", "join", "leave", "blind", "stuck", "full", "slow", "link"
]
KINDS: tuple[EventKind, ...] = get_args(EventKind)
TROUBLES: dict[EventKind, TroubleKind] = {
    "blind": "blind",
    "stuck": "stuck",
    "full": "full",
    "slow": "slow",
}
"""What fails of a robot for a while, whether it runs or not: camera, wheels, disk, computer."""
FOR_EVER_NS = 2**63 - 1
RobotState = Literal["waiting", "alive", "stopped", "dead", "gone"]

# What each event does to a robot's state, and in which states it makes sense. A restart ends the
# robot, where it still runs, and starts it again `after_s` later.
_MOVES: dict[EventKind, tuple[tuple[RobotState, ...], RobotState]] = {
    "join": (("waiting",), "alive"),
    "kill": (("alive", "stopped"), "dead"),
    "stop": (("alive",), "stopped"),
    "resume": (("stopped",), "alive"),
    "restart": (("alive", "stopped", "dead"), "dead"),
    "leave": (("alive",), "gone"),
}
_IS: dict[RobotState, str] = {
    "waiting": "has not joined yet",
    "alive": "is running",
    "stopped": "is stopped",
    "dead": "is dead",
    "gone": "has left",
}
_LINK_KEYS = tuple(AllLinks.model_fields)


class Event(AllLinks):
    """One thing that happens at one moment; the keys of a link may stand beside `link` only."""

    at_s: Annotated[float, Field(ge=0)]
    """Simulated time at which it happens."""
    kill: str | None = None
    """A robot's process is killed (SIGKILL): it says nothing more."""
    stop: str | None = None
    """A robot hangs (SIGSTOP) until it is resumed."""
    resume: str | None = None
    """A stopped robot goes on (SIGCONT), where it was."""
    restart: str | None = None
    """A robot is killed, and started again `after_s` later, under a new incarnation."""
    after_s: Annotated[float, Field(gt=0)] | None = None
    """How long a restart takes."""
    join: str | None = None
    """A robot of the team starts now, instead of with the others."""
    leave: str | None = None
    """A robot ends its work in order, and says nothing more; it does not come back."""
    blind: str | None = None
    """A robot's camera shows nothing."""
    stuck: str | None = None
    """A robot's wheels don't turn, from its next leg on."""
    full: str | None = None
    """A robot's disk takes nothing more; what is on it can be read."""
    slow: str | None = None
    """A robot's computer is slow: whatever it thinks about takes `think_s` (virtual clock only)."""
    for_s: Annotated[float, Field(gt=0)] | None = None
    """How long blind, stuck, full and slow last; left out: to the end of the run."""
    think_s: Annotated[float, Field(gt=0, le=3600)] | None = None
    """Simulated seconds that each computation of a slow robot takes."""
    link: str | None = None
    """"all", a robot or a pair "sender>receiver", whose radio changes: profile, up, rate_bps..."""

    @model_validator(mode="after")
    def _one_thing(self) -> Self:
        kinds = [kind for kind in KINDS if getattr(self, kind) is not None]
        if len(kinds) != 1:
            found = " and ".join(kinds) or "none"
            raise ValueError(f"has {found} of {', '.join(KINDS)}; exactly one is allowed")
        if (kinds[0] == "restart") != (self.after_s is not None):
            raise ValueError("restart needs after_s (seconds), and nothing else may have it")
        if (kinds[0] == "slow") != (self.think_s is not None):
            raise ValueError("slow needs think_s (seconds), and nothing else may have it")
        if self.for_s is not None and kinds[0] not in TROUBLES:
            raise ValueError(f"has for_s; only {', '.join(TROUBLES)} may have it")
        said = keys_said(self)
        if kinds[0] == "link" and not said:
            raise ValueError(f"link needs something that changes: {', '.join(_LINK_KEYS)}")
        if kinds[0] != "link" and said:
            raise ValueError(f"has {', '.join(said)}; only an event with link may have it")
        if self.link is not None:
            check_target(self.link, said)
        return self

    @property
    def kind(self) -> EventKind:
        """What happens."""
        return next(kind for kind in KINDS if getattr(self, kind) is not None)

    @property
    def target(self) -> str:
        """To whom: a robot's name; for a link also "all" or "sender>receiver"."""
        return str(getattr(self, self.kind))

    @property
    def detail(self) -> str:
        """What is to be said of it beside its kind and target."""
        if self.kind == "link":
            return str(self.link_change())
        said = {"for": self.for_s, "thinks": self.think_s, "back after": self.after_s}
        return ", ".join(f"{word} {plain(value)} s" for word, value in said.items() if value)

    def link_change(self) -> LinkChange:
        """Return the change of links that this event is; it must be one."""
        assert self.kind == "link", self
        return LinkChange(
            self.target, AllLinks(**{key: getattr(self, key) for key in keys_said(self)})
        )

    def trouble(self) -> Trouble:
        """Return the failing of a part of a robot that this event is; it must be one."""
        assert self.kind in TROUBLES, self
        at_ns = from_s(self.at_s)
        until_ns = FOR_EVER_NS if self.for_s is None else at_ns + from_s(self.for_s)
        return Trouble(TROUBLES[self.kind], at_ns, until_ns, from_s(self.think_s or 0.0))


def in_order(events: Iterable[Event]) -> list[Event]:
    """Return events by time; those of the same moment in the order of the file."""
    return sorted(events, key=lambda event: event.at_s)


def check_events(
    events: Sequence[Event], joins_s: dict[str, float], limit_s: float
) -> list[Conflict]:
    """Return what can't happen: unknown names, times beyond the limit, a resume without a stop.

    `joins_s` has every robot of the team, with the time at which its own settings let it start.
    """
    numbered = sorted(enumerate(events), key=lambda pair: pair[1].at_s)
    late = [c for index, event in numbered for c in _check_time(index, event, limit_s)]
    named = [c for index, event in numbered for c in _check_target(index, event, joins_s)]
    return late + named + _check_states(numbered, joins_s)


def _check_time(index: int, event: Event, limit_s: float) -> list[Conflict]:
    if event.at_s >= limit_s:
        sentence = f"is not before the end of the run; must be below limit_s = {plain(limit_s)}"
        return [Conflict(f"events.{index}.at_s", event.at_s, sentence)]
    if event.after_s is not None and event.at_s + event.after_s >= limit_s:
        sentence = f"restarts after the end of the run; at_s + after_s < limit_s = {plain(limit_s)}"
        return [Conflict(f"events.{index}.after_s", event.after_s, sentence)]
    return []


def _check_target(index: int, event: Event, team: Iterable[str]) -> list[Conflict]:
    key = f"events.{index}.{event.kind}"
    team = list(team)
    if event.kind != "link":
        bad = event.target not in team
        return [Conflict(key, event.target, no_such_robot(team))] if bad else []
    if event.target == ALL:
        return []
    try:
        names = pair_of(event.target) if ">" in event.target else (event.target,)
    except ValueError as error:
        return [Conflict(key, event.target, str(error))]
    if all(name in team for name in names):
        return []
    return [Conflict(key, event.target, f'{no_such_robot(team)}, "all" or a pair "a>b" of them')]


def no_such_robot(team: Iterable[str]) -> str:
    """Say who is in the team."""
    return f"there is no such robot; must be one of {', '.join(team)}"


def _check_states(
    numbered: Sequence[tuple[int, Event]], joins_s: dict[str, float]
) -> list[Conflict]:
    return [c for name in joins_s for c in _check_life(name, numbered, joins_s[name])]


def _check_life(name: str, numbered: Sequence[tuple[int, Event]], joins_s: float) -> list[Conflict]:
    """Walk through one robot's life, and return the events that don't fit into it."""
    mine = [(i, e) for i, e in numbered if e.kind in _MOVES and e.target == name]
    joined_by_event = any(event.kind == "join" for _, event in mine)
    state: RobotState = "waiting" if joined_by_event else "alive"
    back_s = -1.0
    conflicts: list[Conflict] = []
    for index, event in mine:
        if back_s >= 0 and event.at_s >= back_s:
            state, back_s = "alive", -1.0
        too_early = not joined_by_event and event.at_s < joins_s
        allowed, after = _MOVES[event.kind]
        if state not in allowed or too_early or (event.kind == "join" and joins_s > 0):
            conflicts.append(_misfit(index, event, "waiting" if too_early else state, joins_s))
            continue
        state = after
        back_s = -1.0 if event.after_s is None else event.at_s + event.after_s
    return conflicts


def _misfit(index: int, event: Event, state: RobotState, joins_s: float) -> Conflict:
    key = f"events.{index}.{event.kind}"
    if event.kind == "join" and joins_s > 0:
        sentence = f"has join_s = {plain(joins_s)} already; only one of the two is allowed"
        return Conflict(key, event.target, sentence)
    allowed = " or ".join(_IS[state] for state in _MOVES[event.kind][0])
    sentence = f"{_IS[state]} at {plain(event.at_s)} s; {event.kind} needs a robot that {allowed}"
    return Conflict(key, event.target, sentence)
