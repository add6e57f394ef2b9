"""What happens to the robots of a run: they come, hang, go on, leave and die."""

from abc import abstractmethod
from pathlib import Path
from typing import Any

from comms.timebase import from_s, to_s
from scenarios.crews.crew import Crew
from scenarios.play.listening import Listening
from scenarios.stage import Stage
from scenarios.wire import Grant, Plan


class Fates(Listening):
    """A run whose robots can be brought to life and lose it."""

    keeps_logs = True
    """Whether each robot writes its own log."""

    def __init__(self, stage: Stage, out: Path, crew: Crew) -> None:
        """Take the stage; nobody is there yet."""
        super().__init__(stage.scenario)
        self.stage, self.out, self.crew = stage, out, crew
        self.link_events: list[int] = []
        """Changes of links that have happened, by their place in the timeline."""
        self.trouble_events: list[int] = []

    @abstractmethod
    def bring_up(self, names: list[str]) -> None:
        """Bring robots to life now."""

    @abstractmethod
    def leave(self, name: str) -> None:
        """Let a robot end its work in order, now."""

    def plans(self, names: list[str]) -> list[Plan]:
        """Return what robots are told that start now, and expect them."""
        plans = [self._plan(name) for name in names]
        for name in names:
            self._up_again(name)
            self.actors[name].lives += 1
            self._news[name] = Grant(0)
        return plans

    def _plan(self, name: str) -> Plan:
        now_ns = self.now_ns
        actor = self.actors[name]
        born_before = actor.lives > 0
        return Plan(
            scenario=self.scenario,
            name=name,
            terrain=self.stage.terrain,
            observable=self.stage.truth.observable,
            starts=self.stage.starts,
            goal_m=self.stage.goal_m,
            landmarks=self.stage.landmarks,
            folder=self.out,
            start_ns=now_ns,
            pose=self.motions.pose_at(name, now_ns) if born_before else None,
            tether_m=self.motions.tether_at(name, now_ns) if born_before else None,
            first_number=actor.next_number,
            baseline=dict(self._counts),
            segments=tuple(w for mate in self.roster for w in self._segments[mate]),
            link_events=tuple(self.link_events),
            trouble_events=tuple(self.trouble_events),
            keeps_log=self.keeps_logs,
            keeps_ledger=self.ledger is not None,
            keeps_growth=self.reel is not None,
        )

    def _up_again(self, name: str) -> None:
        actor = self.actors[name]
        if actor.down_since_s is not None:
            self.records.add_downtime(name, actor.down_since_s, to_s(self.now_ns))
            actor.down_since_s = None
        actor.state = "alive"
        self._tell_state(name)

    def _tell_state(self, name: str) -> None:
        if self.reel is not None:
            self.reel.state(name, to_s(self.now_ns), self.actors[name].state)

    def _kill(self, name: str) -> None:
        if name in self._news:
            self.crew.kill(name)
            self.bury(name)

    def bury(self, name: str, state: str = "killed") -> None:
        """Put on record that a robot is gone, and tell the others that it moves no more."""
        del self._news[name]
        self._down(name, state)
        self.motions.freeze(name, self.now_ns)
        if self.reel is not None:
            self.reel.freeze(name, self.now_ns)
        self._tell_all(("freeze", name, self.now_ns))

    def _down(self, name: str, state: str) -> None:
        """Note that a robot runs no more; a frame that it has in the air is lost."""
        actor = self.actors[name]
        actor.state = state
        actor.down_since_s = to_s(self.now_ns)
        self._tell_state(name)
        last = actor.last_tx
        if last is not None and from_s(last.end_s) >= self.now_ns:
            self.records.add_cut(name, last.seq, to_s(self.now_ns))

    def stop(self, name: str) -> None:
        """Hang a robot."""
        if name in self._news:
            self.crew.stop(name)
            self._down(name, "stopped")

    def resume(self, name: str) -> None:
        """Let a hung robot go on."""
        if name in self._news:
            self.crew.resume(name)
            self._up_again(name)

    def _tell_all(self, command: tuple[Any, ...]) -> None:
        for grant in self._news.values():
            grant.commands.append(command)
