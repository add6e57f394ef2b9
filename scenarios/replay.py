"""One robot of a run once more, alone, from its own log: the same program, the same decisions.

Nothing but the robot runs: no team-mates, no conductor, no Zenoh, one thread. It is handed what its
log says that it was handed (`logs.handed`), lives on a fresh disk, and writes a new log, which
is held against the old one, message by message.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import count, zip_longest
from pathlib import Path
from typing import Any, cast

from comms.air import Packet
from comms.timebase import from_s, to_s
from scenarios.errors import UsageError
from scenarios.host import Host
from scenarios.logs.handed import HANDED, Life, Message, read_life
from scenarios.records import folder
from scenarios.schema import Scenario, load
from scenarios.stage import set_stage
from scenarios.wire import Plan
from sim.clock import VirtualLoop

_SHOWN_CHARS = 160


@dataclass(frozen=True)
class Replayed:
    """What came of a replay."""

    robot: str
    lives: int
    windows: int
    records: dict[str, int]
    """Messages of the old log, by topic."""
    digest: str
    """Of the robot's store when its last life ended."""
    digest_then: str
    """The same by the run's summary; empty where there is none."""
    difference: str = ""
    """The first message in which the new log differs from the old one; empty: in none."""

    @property
    def same(self) -> bool:
        """Whether the robot decided as it did then."""
        return not self.difference and self.digest_then in ("", self.digest)


class _Nowhere:
    """Where a replayed robot's packets go: what they did to others is in its log already."""

    def put(self, packet: Packet) -> None:
        """Drop a packet."""


Halt = Callable[[Host], None]
"""Called with the robot as it stands at the start of a window."""


def replay(
    run: Path, robot: str, out: Path, *, break_s: float | None = None, halt: Halt = lambda _: None
) -> Replayed:
    """Replay a robot's lives, one after another, in a folder of their own.

    `halt` is called once, before the window in which the simulated time `break_s` falls.

    Raises:
        StudyError: this is no run, no robot of it, or no run that can be replayed; `out` can't be
            written to.

    """
    scenario = _scenario(run)
    whole = _plan(scenario, robot, out)
    lives = [(path, read_life(path)) for path in _logs(run, robot)]
    folder.prepare(out, overwrite=False)
    halting = _Halting(break_s, halt)
    difference, digest = "", ""
    with ExitStack() as graves:
        for path, life in lives:
            digest = _live(life, life.plan(whole), halting, graves)
            difference = difference or _difference(life, read_life(out / path.name))
    return Replayed(
        robot=robot,
        lives=len(lives),
        windows=sum(len(life.windows) for _, life in lives),
        records=dict(Counter(m.topic for _, life in lives for m in life.messages)),
        digest=digest,
        digest_then=_digest_then(run, robot, lives[-1][1]),
        difference=difference,
    )


def watch(run: Path, robot: str, out: Path, born: Halt, *, until_s: float) -> None:
    """Let a robot of a run live its first life once more, up to a simulated time, and watch it.

    `born` is called with the robot before it does anything. Raises as `replay` does.
    """
    plan = _plan(_scenario(run), robot, out)
    life = read_life(_logs(run, robot)[0])
    folder.prepare(out, overwrite=False)
    late = (n for n, w in enumerate(life.windows, 1) if w.grant.end_ns > from_s(until_s))
    windows = life.windows[: next(late, None)]
    with ExitStack() as graves:
        _live(replace(life, windows=windows), life.plan(plan), _Halting(0.0, born), graves)


class _Halting:
    """Halts once, at its time."""

    def __init__(self, break_s: float | None, halt: Halt) -> None:
        self._due_ns = None if break_s is None else from_s(break_s)
        self._halt = halt

    def before(self, host: Host, end_ns: int) -> None:
        """Halt, if this is the window."""
        if self._due_ns is not None and end_ns > self._due_ns:
            self._due_ns = None
            self._halt(host)


def _scenario(run: Path) -> Scenario:
    path = run / "scenario.toml"
    if not path.is_file():
        raise UsageError(f"{run}: is no run: there is no scenario.toml in it")
    scenario = load(str(path))
    if scenario.clock.mode != "virtual":
        raise UsageError(
            f"{run}: was on the {scenario.clock.mode} clock, which no log can bring back; only a"
            " run on the virtual clock can be replayed"
        )
    return scenario


def _plan(scenario: Scenario, robot: str, out: Path) -> Plan:
    if robot not in scenario.robots:
        team = ", ".join(scenario.robots)
        raise UsageError(f"--robot {robot}: there is no such robot; must be one of {team}")
    stage = set_stage(scenario)
    return Plan(
        scenario=scenario,
        name=robot,
        terrain=stage.terrain,
        observable=stage.truth.observable,
        starts=stage.starts,
        goal_m=stage.goal_m,
        landmarks=stage.landmarks,
        folder=out,
    )


def _logs(run: Path, robot: str) -> list[Path]:
    """Return the logs of a robot's lives, the first one first."""
    found: list[Path] = []
    for life in count():
        path = run / (f"{robot}-{life}.mcap" if life else f"{robot}.mcap")
        if not path.is_file():
            break
        found.append(path)
    if not found:
        raise UsageError(f"{run}: there is no {robot}.mcap in it: the robot never lived")
    return found


def _live(life: Life, plan: Plan, halting: _Halting, graves: ExitStack) -> str:
    """Live a life once more; return the digest of the robot's store at its end.

    It is buried with the others: nothing of a dead robot's program may run in its next life.
    """
    loop = VirtualLoop(list(plan.scenario.robots).index(plan.name), plan.start_ns)
    host = Host(plan, loop, _Nowhere())
    graves.callback(host.bury)
    try:
        host.start()
        for window in life.windows:
            halting.before(host, window.grant.end_ns)
            host.run_window(window.grant, window.packets)
        return host.robot.store.digest()
    finally:
        host.abandon()


def _difference(then: Life, now: Life) -> str:
    """Say where a life first went another way than its log; nothing where it did not.

    A log that its robot's death cut short is held against as much of the new one.
    """
    for number, (old, new) in enumerate(zip_longest(_told(then), _told(now)), start=1):
        if old is None and not then.ended_in_order:
            return ""
        if old != new:
            return f"record {number}: was {_show(old)}, is {_show(new)}"
    return ""


def _told(life: Life) -> Iterator[Message]:
    """Yield what the robot itself wrote."""
    return (message for message in life.messages if message.topic != HANDED)


def _show(message: Message | None) -> str:
    if message is None:
        return "none"
    text = message.data.decode(errors="replace")
    cut = text if len(text) <= _SHOWN_CHARS else f"{text[:_SHOWN_CHARS]}..."
    return f"{message.topic} at {to_s(message.t_ns):g} s {cut}"


def _digest_then(run: Path, robot: str, last: Life) -> str:
    """Return the digest that the summary tells; of a robot that died it tells an older one."""
    path = run / "summary.json"
    if not (path.is_file() and last.ended_in_order):
        return ""
    told = cast("dict[str, Any]", json.loads(path.read_text()))
    return str(told["robots"][robot]["team_map_digest"])
