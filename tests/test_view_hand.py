"""What is done to a run by hand is an event of its scenario: run again, it gives the same records.
And whoever only watches changes nothing.
"""

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from run_helpers import RECORDS, small

from scenarios import runner
from scenarios.replay import replay
from scenarios.schema import Scenario, load
from scenarios.view import desk as desks
from scenarios.view.desk import Desk
from scenarios.view.hand import DeedError, event_of, instant_ns, with_event
from scenarios.view.livepage import LivePage

MS = 1_000_000
QUICK = ("planner.max_looks=4", "limit_s=300", "map.cell_m=0.4", "sensor.columns=32")
WITH_STOP = [{"at_s": 150.0, "stop": "explorer-2"}, {"at_s": 180.0, "resume": "explorer-2"}]


class Watcher(LivePage):
    """Watches a run without a browser, and does things when it is time to."""

    def __init__(self, *deeds: tuple[float, dict[str, Any]]) -> None:
        super().__init__()
        self.deeds = list(deeds)
        self.told: list[dict[str, Any]] = []

    def begin(self, play: Any, title: str) -> None:
        assert title
        self.desk = play.desk = Desk(self._hear)

    def end(self, play: Any, told: dict[str, Any]) -> None:
        del play
        self.told.append({"type": "end", "end": told})

    def _hear(self, told: dict[str, Any]) -> None:
        self.told.append(told)
        assert self.desk is not None
        while self.deeds and told.get("now_s", 0.0) >= self.deeds[0][0]:
            self.desk.ask(self.deeds.pop(0)[1])

    def of(self, kind: str) -> list[dict[str, Any]]:
        return [told for told in self.told if told["type"] == kind]


@contextmanager
def without_pictures() -> Iterator[None]:
    with (
        patch.object(runner, "draw"),
        patch.object(runner, "write_report"),
        patch.object(desks, "TELL_S", 0.0),
    ):
        yield


def run_with(scenario: Scenario, out: Path, page: LivePage | None = None) -> dict[str, bytes]:
    with without_pictures():
        runner.run(scenario, out, quiet=True, page=page)
    return {name: (out / name).read_bytes() for name in RECORDS}


def test_watching_changes_nothing(tmp_path: Path) -> None:
    scenario = small("pair", *QUICK)
    alone = run_with(scenario, tmp_path / "alone")
    watcher = Watcher((30.0, {"do": "pause"}), (30.0, {"do": "step"}), (30.0, {"do": "go"}))
    assert run_with(scenario, tmp_path / "watched", watcher) == alone
    assert len(watcher.of("rows")) > 20
    assert [told["paused"] for told in watcher.of("state")] == [True, True, False]
    assert watcher.told[-1]["type"] == "end"


def test_a_run_that_was_meddled_with_can_be_run_again(tmp_path: Path) -> None:
    scenario = small("pair", *QUICK, events=WITH_STOP)
    deeds = (
        (20.0, {"do": "cut", "robot": "explorer-1"}),
        (60.0, {"do": "heal", "robot": "explorer-1"}),
        (90.0, {"do": "kill", "robot": "explorer-2"}),
        (110.0, {"do": "revive", "robot": "explorer-2"}),
        (200.0, {"do": "kill", "robot": "explorer-1"}),
        (201.0, {"do": "kill", "robot": "explorer-1"}),
        (202.0, {"do": "kill", "robot": "nobody"}),
    )
    watcher = Watcher(*deeds)
    meddled = run_with(scenario, tmp_path / "meddled", watcher)
    done = [(told["deed"], told["robot"]) for told in watcher.of("done")]
    assert done == [(wish["do"], wish["robot"]) for _, wish in deeds[:5]]
    assert ["is dead" in told["why"] for told in watcher.of("no")] == [True, False]
    as_run = load(str(tmp_path / "meddled" / "scenario.toml"))
    planned = [(event.kind, event.target) for event in as_run.timeline()]
    assert planned == [
        ("link", "explorer-1"),
        ("link", "explorer-1"),
        ("kill", "explorer-2"),  # it can't be stopped after that
        ("restart", "explorer-2"),
        ("kill", "explorer-1"),
    ]
    assert run_with(as_run, tmp_path / "again") == meddled
    for robot in as_run.robots:
        assert replay(tmp_path / "meddled", robot, tmp_path / f"alone-{robot}").same
    alone = run_with(scenario, tmp_path / "alone")
    assert alone["events.csv"] != meddled["events.csv"]


def test_on_the_wall_clock_nobody_holds_time_but_robots_can_be_killed(tmp_path: Path) -> None:
    scenario = small("pair", *QUICK, "limit_s=120", "clock.mode=real", "clock.speed=60.0")
    watcher = Watcher((20.0, {"do": "pause"}), (30.0, {"do": "kill", "robot": "explorer-2"}))
    run_with(scenario, tmp_path / "real", watcher)
    assert watcher.of("state")[-1]["has_pace"] is False
    assert [told["robot"] for told in watcher.of("done")] == ["explorer-2"]
    planned = load(str(tmp_path / "real" / "scenario.toml")).timeline()
    assert [(event.kind, event.at_s) for event in planned] == [
        ("kill", watcher.of("done")[0]["at_s"])
    ]
    assert b"explorer-2,kill" in (tmp_path / "real" / "events.csv").read_bytes()


def test_a_paused_run_goes_on_step_by_step(tmp_path: Path) -> None:
    ends: list[float] = []

    class Stepper(Watcher):
        def _hear(self, told: dict[str, Any]) -> None:
            super()._hear(told)
            assert self.desk is not None
            if told["type"] == "state" and told["paused"] and not told["steps"]:
                ends.append(self.of("rows")[-1]["now_s"])
                self.desk.ask({"do": "step" if len(ends) < 5 else "go"})

    run_with(
        small("pair", *QUICK, "limit_s=100"), tmp_path / "run", Stepper((0.0, {"do": "pause"}))
    )
    assert len(ends) == 5
    assert all(0 < after - before <= desks.STEP_S for before, after in itertools.pairwise(ends))


def test_what_was_planned_and_has_become_impossible_is_left_out() -> None:
    scenario = small("pair", events=WITH_STOP)
    changed = with_event(scenario, event_of("kill", "explorer-2", 100_000 * MS))
    assert [event.kind for event in changed.timeline()] == ["kill"]
    kept = with_event(scenario, event_of("kill", "explorer-2", 200_000 * MS))
    assert [event.kind for event in kept.timeline()] == ["stop", "resume", "kill"]


def test_what_can_not_happen_is_refused_in_a_sentence() -> None:
    scenario = small("pair")
    with pytest.raises(DeedError, match="end of the run"):
        with_event(scenario, event_of("kill", "explorer-1", round(scenario.limit_s * 1e9)))
    with pytest.raises(DeedError, match="no such robot"):
        with_event(scenario, event_of("cut", "nobody", MS))


def test_a_deed_falls_on_a_moment_of_its_own() -> None:
    assert instant_ns(0, []) == MS
    assert instant_ns(5 * MS - 1, []) == 5 * MS
    assert instant_ns(5 * MS, [6 * MS, 7 * MS]) == 8 * MS
