"""A run on the wall clock: robots live by it, at any speed; the runner only listens and acts.

The same hosts as on the virtual clock, on a `ScaledLoop` instead. Packets go from robot to robot as
they come; grants carry no time here, only the motion of others and what happens to the world.
"""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from comms.timebase import NS
from scenarios.crews.crew import Crew
from scenarios.live import LiveView
from scenarios.play.play import Play
from scenarios.stage import Stage
from scenarios.wire import Grant, Plan

READY_S = 0.05
"""Wall seconds from the last robot's readiness to the start of the run's clock."""
FINISH_S = 10.0
"""Wall seconds that robots have to end in order."""


class RealRun(Play):
    """One run on the wall clock."""

    def __init__(self, stage: Stage, out: Path, crew: Crew, view: LiveView) -> None:
        """Take the stage; nothing runs yet."""
        super().__init__(stage, out, crew, view)
        self._speed = stage.scenario.clock.speed
        self._epoch_s: float | None = None
        self._up: set[str] = set()
        self._end_ns: int | None = None

    @property
    def now_ns(self) -> int:
        """The run's time; it stands still once the run is over."""
        if self._end_ns is not None:
            return self._end_ns
        if self._epoch_s is None:
            return 0
        return max(0, round((time.monotonic() - self._epoch_s) * self._speed * NS))

    def play(self) -> None:
        """Run until the mission is over and the maps have settled, or to the limit."""
        self.bring_up(self.open_agenda())
        while self._news.keys() - self._up and not self.ending:
            self._listen()  # the clock starts once all are there
        epoch_s = time.monotonic() + READY_S
        for name in list(self._news):
            self.crew.grant(name, Grant(0, commands=[("begin", epoch_s)]))
        self._epoch_s = epoch_s
        self.first_grant_s = time.perf_counter() + READY_S
        while not self.ending:
            self._listen()
            self.attend()
            self.keep_appointments()
            self._tell()
            self.show()
        self._finish()

    def plans(self, names: list[str]) -> list[Plan]:
        """Return what robots are told that start now, the clock's start among it."""
        return [replace(plan, epoch_s=self._epoch_s) for plan in super().plans(names)]

    def bring_up(self, names: list[str]) -> None:
        """Bring robots to life; they are there a moment later."""
        self.crew.launch(self.plans(names))

    def leave(self, name: str) -> None:
        """Let a robot end in order; it is gone once its last report has come."""
        if name in self._news:
            self.crew.grant(name, Grant(self.now_ns, commands=[("finish",)]))
            deadline_s = time.monotonic() + FINISH_S
            while name not in self._finals and time.monotonic() < deadline_s:
                self._listen()
            self.crew.dismiss(name)
            self.bury(name, "left")

    def _listen(self) -> None:
        """Take all reports that have come."""
        told = self.crew.poll()
        while told is not None:
            self._up.add(told.name)
            self.take(told)
            told = self.crew.poll()

    def _tell(self) -> None:
        """Tell robots what they have not been told yet."""
        for name, grant in list(self._news.items()):
            if grant.segments or grant.commands:
                self._news[name] = Grant(0)
                self.crew.grant(name, grant)

    def _finish(self) -> None:
        """Let every robot that still runs end in order."""
        end_ns = self.now_ns
        for name in list(self._news):
            if self.actors[name].state == "stopped":
                self.crew.kill(name)
                del self._news[name]
                continue
            self.crew.grant(name, Grant(end_ns, commands=[("finish",)]))
        deadline_s = time.monotonic() + FINISH_S
        while self._news.keys() - self._finals.keys() and time.monotonic() < deadline_s:
            self._listen()
        self._end_ns = end_ns
        self.close_records()

    def final_facts_of_clock(self) -> dict[str, Any]:
        """Return how far deliveries were behind their due times, in wall seconds."""
        lags = np.array([lag for final in self._finals.values() for lag in final["lags_s"]])
        if lags.size == 0:
            return {"delivery_lag_s": None}
        return {
            "delivery_lag_s": {
                "frames": int(lags.size),
                "median": float(np.median(lags)),
                "p95": float(np.percentile(lags, 95)),
                "max": float(lags.max()),
            }
        }
