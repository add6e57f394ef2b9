"""The experiment on thin links: what it measures of a run, and what it concludes."""

import math

import pytest

from scenarios.errors import UsageError
from scenarios.experiments import sharing
from scenarios.experiments.frame import Options
from scenarios.experiments.sharing import Trial, conclude, measure, scenario_of, trials
from scenarios.experiments.sharing_claims import chosen
from scenarios.experiments.tables import Row

SMALL = (
    "world.window_m=[16.0, 14.0]",
    "map.cell_m=0.2",
    "sensor.columns=64",
    "sensor.rows=48",
    "planner.max_candidates=20",
)


def test_every_run_is_made_once() -> None:
    made = trials(Options(seeds=2))
    assert len(made) == len(set(made))
    assert {trial.policy for trial in made} == {"value", "latest-first", "raw", "paper"}
    assert [t for t in made if t.part == "lag" and t.policy == "value"] == []
    alone = trials(Options(seeds=1, sets={"part": ["lag"]}))
    assert {trial.policy for trial in alone} == {"value", "latest-first", "raw", "paper"}


def test_an_unknown_part_is_refused() -> None:
    with pytest.raises(UsageError, match="--set part=speed: must be one of catch-up, lag, mission"):
        trials(Options(sets={"part": ["speed"]}))


def test_rates_are_those_that_are_asked_for() -> None:
    thin = scenario_of(Trial("mission", "pair", 1, "value", 600.0)).links
    assert (thin.profile, thin.rate_bps) == ("sojourner", 600.0)
    free = scenario_of(Trial("mission", "pair", 1, "value", math.inf)).links
    assert (free.profile, free.rate_bps) == ("unlimited", None)


def test_a_run_with_a_thin_link_lacks_more_than_one_without_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sharing.MISSION_S, "pair", 240.0)
    rows: list[Row] = []
    for rate_bps in (math.inf, 2400.0, 0.0):
        rows += measure(Trial("mission", "pair", 1, "value", rate_bps, SMALL))
    free, thin, none = chosen(rows, row="run")
    assert free["lacking_share"] < 0.05, "what is not worth a version of its tile stays untold"
    assert 0 <= thin["lacking_share"] < none["lacking_share"]
    assert none["lacking_share"] == pytest.approx(1.0)
    assert none["kb_per_robot_min"] == 0
    series = chosen(rows, row="series", rate_bps=math.inf)
    assert [row["t_s"] for row in series][:3] == pytest.approx([0.0, 30.0, 60.0], abs=1.7)
    findings = conclude(rows)
    assert [table.name for table in findings.tables] == ["mission"]
    kept = findings.claims[-1]
    assert 0 < kept.number <= 1.05


def test_catching_up_is_timed_from_the_samples() -> None:
    def sample(heard: float, **others: float) -> dict[str, dict[str, float]]:
        told = {"map_cells": 0.0, "own_bits": 0.0, "heard_bits": heard}
        return {"cliffbot": told, "anchor-left": {**told, "heard_bits": 100.0}}

    samples = {1500.0: sample(0.0), 1510.0: sample(89.9), 1520.0: sample(90.0)}
    summary = {"robots": {"anchor-left": {"map_payload_bytes": 3000}}}
    found = sharing._catch_up(samples, summary)
    assert found["catch_up_s"] == 20.0
    assert found["ideal_s"] == pytest.approx(0.9 * 8 * 3000 / 2400)
    assert sharing._catch_up({1500.0: sample(0.0)}, summary)["catch_up_s"] == math.inf
