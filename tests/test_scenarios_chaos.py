"""Trials by chaos: what holds under any faults, and that what does not hold is found out."""

import json
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.disk import Disk, Recovered
from agents.layers import OwnLayer
from agents.maps.elevation import ElevationKind
from agents.sharing.policy import Policy
from agents.sharing.repair import Repair
from agents.teammap import TeamMap
from scenarios import cli
from scenarios.chaos.draw import draw_faults, known_kinds, under
from scenarios.chaos.faults import KINDS, LINK_KINDS, Fault
from scenarios.chaos.invariants import INVARIANTS, violations
from scenarios.chaos.series import Series, run_one, run_series, shortest
from scenarios.chaos.small import small_changes
from scenarios.chaos.trial import Evidence, run_trial
from scenarios.errors import UsageError
from scenarios.logs.notebook import Notebook
from scenarios.records.tables import DELIVERED
from scenarios.schema import Scenario, dump, load, parse
from scenarios.schema.overrides import parse_override
from sim.winch import SimWinch

HORIZON_S = 90.0
LOSSY = Fault("loss", 3.0, 60.0, "all", 0.7)
RESTART = Fault("restart", 18.0, 10.0, "explorer-2")
WIDER = ("world.window_m=[12.0, 12.0]", "world.terrain.drop_m=1.5", "map.cell_m=0.25",
         "sensor.fov_deg=60", "sensor.range_m=12", "sensor.look_s=3", "planner.first_looks=12",
         "planner.max_looks=12", "tether.rate_mps=0.05")  # fmt: skip
"""A bank on which a robot looks long enough to be corrected by more than a cell."""


@lru_cache
def small(name: str) -> Scenario:
    return load(name, [*small_changes(name), "limit_s=1500"])


def series(name: str = "pair", kinds: Sequence[str] = ()) -> Series:
    return Series(small(name), known_kinds(kinds), HORIZON_S)


def run(*faults: Fault, name: str = "pair", seed: int = 1, **changes: object) -> Evidence:
    scenario = under(small(name), seed, faults, HORIZON_S + 1)
    return run_trial(scenario.model_copy(update=changes))


def broken(evidence: Evidence) -> set[str]:
    return {violation.invariant for violation in violations(evidence)}


def events(evidence: Evidence, robot: str, what: str) -> list[str]:
    found = [e for e in evidence.records.events if (e.robot, e.what) == (robot, what)]
    return [e.detail for e in sorted(found, key=lambda e: e.t_s)]


# --- drawing --------------------------------------------------------------------------------


@given(st.integers(0, 2**40), st.sampled_from(["pair", "cliff"]))
@settings(max_examples=60, deadline=None)
def test_whatever_is_drawn_is_a_scenario_that_could_be_written_by_hand(
    seed: int, name: str
) -> None:
    faults = draw_faults(small(name), seed, tuple(KINDS), HORIZON_S)
    assert 1 <= len(faults) <= 6
    assert all(f.at_s >= 0 and f.at_s + f.for_s <= HORIZON_S + 0.002 for f in faults)
    scenario = under(small(name), seed, faults, HORIZON_S + 1)
    assert parse(tomllib.loads(dump(scenario)), "drawn") == scenario
    assert draw_faults(small(name), seed, tuple(KINDS), HORIZON_S) == faults


def test_every_kind_of_fault_is_drawn_and_no_other_than_was_asked_for() -> None:
    drawn = [f.kind for seed in range(400) for f in series().faults(seed)]
    assert set(drawn) == set(KINDS)
    only = series(kinds=("kill", "loss"))
    assert {f.kind for seed in range(40) for f in only.faults(seed)} == {"kill", "loss"}
    with pytest.raises(UsageError, match=r"--faults earthquake: .*kill"):
        known_kinds(["earthquake"])


@pytest.mark.parametrize("kind", sorted(LINK_KINDS))
def test_links_are_sound_again_once_a_fault_is_over(kind: str) -> None:
    fault = Fault(kind, 5.0, 20.0, {"partition": "explorer-1"}.get(kind, "all"), 0.5)
    if kind == "one-way":
        fault = Fault(kind, 5.0, 20.0, "explorer-1>explorer-2")
    scenario = under(small("pair"), 1, [fault], 91.0)
    from comms.profiles import resolve  # noqa: PLC0415  (this test alone looks into links)

    changes = [event.link_change() for event in scenario.timeline() if event.at_s < 90]
    pair = ("explorer-1", "explorer-2")
    sound = resolve(scenario.links, *pair)
    assert resolve(scenario.links, *pair, changes[: len(changes) // 2]) != sound
    after = resolve(scenario.links, *pair, changes)
    assert (after.up, after.rate_bps, after.loss) == (sound.up, sound.rate_bps, sound.loss)
    faults = ("burst_ns", "duplication", "reordering", "bit_errors")
    assert all(getattr(after.faults, key) == 0 for key in faults)


# --- what faults do -------------------------------------------------------------------------


def test_a_sound_team_breaks_nothing_and_the_same_seed_is_the_same_run() -> None:
    first, again = run(LOSSY, RESTART), run(LOSSY, RESTART)
    assert violations(first) == []
    assert first.ending == "settled"
    assert [f.digest for f in first.finals] == [f.digest for f in again.finals]
    assert first.records.frame_rows() == again.records.frame_rows()


def test_a_blind_camera_shows_nothing_for_as_long_as_it_is_blind() -> None:
    evidence = run(Fault("blind", 2.0, 8.0, "explorer-1"))
    looks = [x for x in evidence.records.looks if x.robot == "explorer-1"]
    assert {x.t_s < 2 or x.t_s >= 10: x.obtained_cells > 0 for x in looks} == {
        False: False,
        True: True,
    }
    assert violations(evidence) == []


def test_stuck_wheels_don_t_turn_and_the_robot_knows_it() -> None:
    evidence = run(Fault("stuck", 0.0, 80.0, "explorer-1"))
    assert "wheels stuck" in events(evidence, "explorer-1", "halted")
    assert evidence.finals[0].distance_m == 0.0
    assert evidence.finals[1].distance_m > 0.5
    assert violations(evidence) == []


def test_a_full_disk_is_told_once_and_what_waited_for_it_is_sent_afterwards() -> None:
    evidence = run(Fault("disk", 0.0, 60.0, "explorer-1"))
    told = events(evidence, "explorer-1", "disk")
    assert told
    assert all("No space left on device" in text for text in told)
    assert len(told) < 5
    maps = [x for x in evidence.records.frames if (x.sender, x.kind) == ("explorer-1", "map")]
    relayed = {x.start_s < 60.0: x for x in maps}
    assert False in relayed, "its own map came when there was room again"
    assert violations(evidence) == []
    assert evidence.finals[1].team_cells == evidence.finals[0].team_cells


def test_a_robot_that_comes_back_to_a_full_disk_counts_nothing_twice() -> None:
    faults = [
        Fault("disk", 15.0, 20.0, "explorer-2"),
        Fault("restart", 18.0, 5.0, "explorer-2"),
        Fault("restart", 50.0, 5.0, "explorer-2"),
    ]
    evidence = run(*faults)
    assert violations(evidence) == []
    assert len(events(evidence, "explorer-2", "restart")) == 4, "two by the scenario, two its own"


def test_who_is_back_before_an_earlier_restart_is_over_is_not_started_twice() -> None:
    faults = [
        Fault("restart", 2.34, 23.939, "explorer-1"),
        Fault("restart", 8.53, 7.749, "explorer-1"),
    ]
    evidence = run(*faults)
    assert violations(evidence) == []
    assert next(a.lives for a in evidence.actors if a.name == "explorer-1") == 2


def test_a_slow_computer_takes_its_time_and_comes_to_the_same_end() -> None:
    swift, slow = run(), run(Fault("slow", 0.0, 80.0, "explorer-1", 3.0))
    assert violations(slow) == []
    looks = [[x.t_s for x in e.records.looks if x.robot == "explorer-1"] for e in (swift, slow)]
    assert looks[1][-1] > looks[0][-1] + 10


def test_a_robot_that_leaves_says_nothing_more_and_its_map_stays() -> None:
    evidence = run(Fault("leave", 18.0, 0.0, "explorer-3"))
    gone = next(final for final in evidence.finals if final.name == "explorer-3")
    assert gone.state == "left"
    assert gone.elevation_m is not None, "it gave a last report"
    frames = [tx for tx in evidence.records.frames if tx.sender == "explorer-3"]
    assert frames
    assert all(tx.start_s <= 18.0 for tx in frames)
    assert evidence.finals[0].team_cells >= gone.team_cells
    assert violations(evidence) == []


def test_a_kill_in_one_process_is_a_kill_of_a_process() -> None:
    faults = [Fault("kill", 21.0, 0.0, "explorer-1"), Fault("blind", 2.0, 9.0, "explorer-2"),
              Fault("leave", 22.0, 0.0, "explorer-3")]  # fmt: skip
    one, many = run(*faults), run(*faults, air="zenoh")
    assert violations(one) == violations(many) == []
    assert one.records.frame_rows() == many.records.frame_rows()
    assert [f.state for f in many.finals] == ["killed", "alive", "left"]
    for name in small("pair").robots:
        assert (one.ledger.information(name) == many.ledger.information(name)).all()


def test_a_submap_whose_anchor_was_corrected_is_measured_where_it_lies_now() -> None:
    wider = [parse_override(text) for text in WIDER]
    scenario = load("cliff", [*small_changes("cliff"), *wider, "limit_s=1500"])
    drawn = Series(scenario, known_kinds(()), 90.0)
    evidence = run_trial(drawn.scenario_of(12, drawn.faults(12)))
    assert all(final.moved for final in evidence.finals if final.state == "alive")
    assert violations(evidence) == []
    evidence.finals = [replace(final, moved={}) for final in evidence.finals]
    assert broken(evidence) == {"nothing counted twice"}


# --- the net catches ------------------------------------------------------------------------

Bug = Callable[[], Iterator[None]]


@contextmanager
def a_merge_that_adds_twice() -> Iterator[None]:
    real = ElevationKind.fuse

    def fuse(self, layers, shape):
        return real(self, [*layers] * 2, shape)

    with patch.object(ElevationKind, "fuse", fuse):
        yield


@contextmanager
def cells_that_are_published_again_after_a_crash() -> Iterator[None]:
    real = TeamMap.published_mask
    with patch.object(TeamMap, "published_mask", lambda *args: real(*args) & False):
        yield


@contextmanager
def a_version_that_does_not_grow() -> Iterator[None]:
    real = Policy.publish

    def publish(self, key):
        self.versions.pop(key, None)
        return real(self, key)

    with patch.object(Policy, "publish", publish):
        yield


@contextmanager
def a_digest_that_is_never_sent() -> Iterator[None]:
    with patch.object(Repair, "next_report", lambda *args: None):
        yield


@contextmanager
def a_disk_that_forgets() -> Iterator[None]:
    with patch.object(Disk, "recover", lambda *args: Recovered()):
        yield


@contextmanager
def a_radio_that_keeps_quiet_about_lost_frames() -> Iterator[None]:
    real = Notebook.on_rx

    def on_rx(self, sender, number, arrive_ns, verdict):
        if verdict == DELIVERED:
            real(self, sender, number, arrive_ns, verdict)

    with patch.object(Notebook, "on_rx", on_rx):
        yield


@contextmanager
def a_drum_that_runs_on_instead_of_braking() -> Iterator[None]:
    with patch.object(SimWinch, "brake", lambda self: self.pay_out(self.length_m + 1.0, 0.05)):
        yield


@contextmanager
def a_program_that_fails() -> Iterator[None]:
    with patch.object(OwnLayer, "begin_submap", side_effect=ValueError("a mistake of ours")):
        yield


@pytest.mark.parametrize(
    ("bug", "faults", "invariant"),
    [
        (a_merge_that_adds_twice, [], "nothing counted twice"),
        (cells_that_are_published_again_after_a_crash, [RESTART], "nothing counted twice"),
        (a_version_that_does_not_grow, [], "ends in order"),
        (a_digest_that_is_never_sent, [LOSSY], "survivors equal"),
        (a_disk_that_forgets, [RESTART], "no cell lost"),
        (a_radio_that_keeps_quiet_about_lost_frames, [LOSSY], "frames accounted for"),
        (a_program_that_fails, [], "ends in order"),
    ],
)
def test_a_bug_that_is_put_in_is_found(bug: Bug, faults: list[Fault], invariant: str) -> None:
    with bug():
        assert invariant in broken(run(*faults))
    assert broken(run(*faults)) == set()


def test_a_life_that_never_reached_its_disk_may_lose_its_cells() -> None:
    """Seed 201900: full from before it joined; its second life finds nothing, and says nothing."""
    disk = Fault("disk", 19.939, 70.061, "explorer-1")
    late = Fault("late", 33.008, 0.0, "explorer-1")
    restart = Fault("restart", 72.156, 6.069, "explorer-1")
    assert broken(run(disk, late, restart, seed=201900)) == set()


def test_a_drum_that_runs_without_a_command_is_found() -> None:
    sound = run(name="cliff", seed=3)
    drums = [s for segments in sound.tethers.values() for s in segments]
    ran = [s for s in drums if s.tether_at(s.start_ns) != s.tether_at(s.end_ns)]
    assert len(ran) > 10, "the Cliff-bot went down"
    assert violations(sound) == []
    with a_drum_that_runs_on_instead_of_braking():
        assert "tethers safe" in broken(run(name="cliff", seed=3))


def test_a_process_that_is_left_behind_is_found() -> None:
    evidence = run()
    evidence.orphans.append("explorer-1 (pid 17)")
    assert broken(evidence) == {"no orphan"}
    assert set(INVARIANTS) >= broken(evidence)


# --- shrinking, and what is said ---------------------------------------------------------------


@given(st.sets(st.integers(0, 5)), st.integers(1, 6))
@settings(max_examples=60, deadline=None)
def test_what_is_left_of_the_faults_still_fails_and_nothing_can_be_left_out(
    culprits: set[int], count: int
) -> None:
    faults = tuple(Fault("kill", float(n), 0.0, "a") for n in range(count))
    needed = {float(n) for n in culprits if n < count}

    def fails(some: Sequence[Fault]) -> bool:
        return needed <= {fault.at_s for fault in some}

    assert {fault.at_s for fault in shortest(faults, fails)} == needed


def test_a_failure_is_told_as_one_line_and_the_fewest_faults(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    kinds = "restart,blind,stuck"
    chosen = series(kinds=kinds.split(","))
    seed = next(
        s for s in range(1000)
        if any(f.kind == "restart" and 15 < f.at_s < 40 for f in chosen.faults(s))
        and len(chosen.faults(s)) > 2
    )  # fmt: skip
    out = tmp_path / "chaos.json"
    arguments = ["chaos", "pair", "--small", "--seed", str(seed), "--runs", "1", "--faults", kinds]
    with a_disk_that_forgets():
        assert cli.main([*arguments, "--out", str(out)]) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[0] == f"ropeteam chaos pair --seed {seed} --runs 1 --small --faults {kinds}"
    needs = [line for line in said if line.startswith("  needs")]
    assert len(needs) == 1
    assert "restart" in needs[0]
    facts = json.loads(out.read_text())
    assert facts["violations"] == {"no cell lost": 1}
    assert len(facts["failures"][0]["shortest"]) == 1
    assert cli.main(arguments) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "violations: none"


def test_a_series_is_the_runs_of_its_seeds() -> None:
    tally = run_series(series(), 40, 8)
    single = [run_one(series(), 40 + i) for i in range(2)]
    assert (tally.runs, tally.failures) == (8, [])
    assert sum(tally.injected.values()) == sum(len(series().faults(40 + i)) for i in range(8))
    assert [outcome.broken for outcome in single] == [(), ()]


def test_bad_options_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for more in (["--runs", "0"], ["--faults", "rain"], ["--until", "0"], ["--set", "x=1"]):
        assert cli.main(["chaos", "pair", "--small", *more]) == 2
        assert capsys.readouterr().err.count("\n") == 1
