"""Whole runs on floors: coverage by its definition, the same records on any air, no back door."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from run_helpers import RECORDS, Ran, records_of, run_of
from sim_helpers import SHARED

from agents.maps.planar import MAPPED
from scenarios.errors import ScenarioError
from scenarios.overview import Overview, draw, map_facts
from scenarios.planarscore import PlanarTruth, score_floor, union_floor
from scenarios.record import Records
from scenarios.schema import Scenario, dump, load
from scenarios.stage import set_stage
from scenarios.summary import Ending, RobotFinal, summarise

BUILDING = SHARED / "data" / "occupancy" / "tetam_lab_0p1.yaml"
PAIR = ("explorer-1", "explorer-2")


def small(*overrides: str) -> Scenario:
    """Return two explorers on a floor of 16 m, who see 5 m far: a few seconds of computing."""
    sets = (
        "air=memory", "robots.count=2", "world.window_m=[16.0, 16.0]", "sensor.fov_deg=75",
        "sensor.range_m=5", "sensor.columns=96", "planner.max_candidates=40", "limit_s=2400",
    )  # fmt: skip
    return load("planar", [*sets, *overrides])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("planar")


@pytest.fixture(scope="module")
def pair(folder: Path) -> Ran:
    return run_of(small(), folder / "pair")


# --- a team on a floor ----------------------------------------------------------------------


def test_a_team_maps_what_can_be_seen_and_says_that_it_is_done(pair: Ran) -> None:
    team = pair.summary["team"]
    assert pair.summary["outcome"] == "complete"
    assert team["coverage"] > 0.85
    assert team["maps_equal"]
    assert team["wrong_cells"] < 0.03 * team["mapped_cells"]
    assert team["elevation_rmse_m"] is None
    for name in PAIR:
        assert "no other look is worth its way" in pair.events(name, "explored")[0]["detail"]
        assert "done" in {event["detail"] for event in pair.events(name, "activity")}
        assert pair.robots[name].claim is None


def test_a_run_that_ends_because_looks_ran_out_says_so(folder: Path) -> None:
    ran = run_of(small("robots.count=1", "planner.max_looks=3"), folder / "spent")
    assert ran.summary["outcome"] == "partial"
    assert (
        "explorer-1 took all looks allowed (planner.max_looks = 3)"
        in (ran.summary["outcome_reason"])
    )
    assert ran.events("explorer-1", "explored") == []
    assert len([row for row in ran.table("looks") if row["robot"] == "explorer-1"]) == 3


def test_coverage_is_the_mapped_share_of_the_observable_cells(pair: Ran) -> None:
    stage = set_stage(small())
    observable = stage.truth.observable
    for name in PAIR:
        told = [row["coverage"] for row in pair.table("looks") if row["robot"] == name]
        log_odds = pair.robots[name].team.fused().log_odds
        last = np.count_nonzero((np.abs(log_odds) > MAPPED) & observable) / observable.sum()
        # Looks of the other that came after its own last one may add to it.
        assert told[-1] <= last + 1e-12
        assert last - told[-1] < 0.2
        assert 0 < told[0] < told[-1] <= 1
        drops = [max(0.0, a - b) for a, b in itertools.pairwise(told)]
        assert max(drops) < 0.02, "what is mapped is seldom put in doubt again"


def test_what_one_robot_measured_the_other_has_by_radio(pair: Ran) -> None:
    for row in [r for r in pair.table("maps") if r["t_s"] >= pair.summary["simulated_s"]]:
        assert row["heard_bits"] > 0
        assert row["map_cells"] >= row["own_cells"] / 2
    kinds = {frame["kind"] for frame in pair.frames()}
    assert {"map", "anchor", "status"} <= kinds


def test_where_nobody_hears_anybody_each_maps_alone(folder: Path) -> None:
    deaf = run_of(small("links.up=false"), folder / "deaf")
    assert deaf.frames() == []
    assert all(row["heard_bits"] == 0 for row in deaf.table("maps"))
    alone = run_of(small("robots.count=1"), folder / "alone")
    mine = [
        {key: row[key] for key in ("t_s", "pan_rad", "obtained_cells", "distance_m")}
        for ran in (deaf, alone)
        for row in ran.table("looks")
        if row["robot"] == "explorer-1"
    ]
    assert mine[: len(mine) // 2] == mine[len(mine) // 2 :]


def test_when_one_dies_the_other_maps_on(folder: Path) -> None:
    event = '[[events]]\nat_s = 60.0\nkill = "explorer-2"\n'
    path = folder / "killed.toml"
    path.write_text(dump(small("limit_s=3000")) + "\n" + event)
    killed = run_of(load(str(path)), folder / "killed")
    assert killed.robot("explorer-2")["state"] == "killed"
    assert killed.summary["team"]["coverage"] > 0.85


# --- the same again -------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_records_and_another_other_ones(
    pair: Ran, folder: Path
) -> None:
    assert records_of(run_of(small(), folder / "again")) == records_of(pair)
    other = records_of(run_of(small("seed=2"), folder / "other"))
    assert all(other[name] != records_of(pair)[name] for name in RECORDS)


def test_many_processes_give_the_records_of_one(pair: Ran, folder: Path) -> None:
    assert records_of(run_of(small("air=zenoh"), folder / "zenoh")) == records_of(pair)


def test_the_scenario_that_a_run_leaves_can_be_run_again(pair: Ran) -> None:
    assert load(str(pair.out / "scenario.toml")) == small()


# --- real buildings -------------------------------------------------------------------------


@pytest.mark.skipif(not BUILDING.is_file(), reason=f"the building {BUILDING} is not here")
@pytest.mark.parametrize("policy", ["value", "raw"])
def test_a_real_building_is_mapped(folder: Path, policy: str) -> None:
    ran = run_of(
        load("planar", [
            "air=memory", f"world.map={BUILDING}", "method=information", "robots.count=2",
            "sensor.fov_deg=75", "sensor.range_m=10", f"sharing.policy={policy}",
        ]),
        folder / f"building-{policy}",
    )  # fmt: skip
    team = ran.summary["team"]
    assert team["coverage"] > 0.9
    assert team["wrong_cells"] < 0.05 * team["mapped_cells"]


# --- bad input ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["method=information-interest"], 'method = "information-interest": must be one of'),
        (["sharing.policy=paper"], "sends no planar maps; must be one of value, latest-first, raw"),
        (["world.window_m=[20.0, 30.0]"], "both sides must be equal"),
        (["world.map=nowhere.yaml"], "no such file"),
        (["world.cell_m=0.01"], "world.cell_m = 0.01: must be a number of at least 0.05"),
        (["map.kind=elevation", "method=raster", f"world.map={__file__}"], 'needs map.kind = "pl'),
        (["map.kind=flat"], "must be one of elevation, planar"),
    ],
)
def test_what_does_not_fit_a_floor_is_refused_in_a_sentence(
    overrides: list[str], words: str
) -> None:
    with pytest.raises(ScenarioError) as error:
        load("planar", overrides)
    assert words in str(error.value)


def test_a_cliffbot_has_no_place_on_a_floor() -> None:
    with pytest.raises(ScenarioError, match="every robot must be one of recon, explorer"):
        load("cliff", ["map.kind=planar", "method=information"])


# --- scores and pictures --------------------------------------------------------------------

SOLID = np.array([[True, False, False], [True, False, True]])
SEEN = np.array([[True, True, True], [False, True, True]])
TRUTH = PlanarTruth(SOLID, SEEN)


def test_a_floor_is_scored_against_the_truth() -> None:
    log_odds = np.array([[3.0, -3.0, 3.0], [-3.0, -2.0, np.nan]], np.float32)
    score = score_floor(log_odds, TRUTH)
    assert (score.mapped_cells, score.coverage, score.wrong_cells) == (3, 3 / 5, 2)
    nothing = np.full((2, 3), np.nan, np.float32)
    assert score_floor(nothing, TRUTH).coverage == 0
    assert score_floor(log_odds, PlanarTruth(SOLID, SEEN & False)).coverage == 0


def test_the_union_of_floors_takes_the_surest_of_each_cell() -> None:
    one = np.array([[1.0, np.nan, -4.0]], np.float32)
    other = np.array([[-3.0, 0.5, 4.0]], np.float32)
    assert union_floor([one, other], (1, 3)).tolist() == [[-3.0, 0.5, -4.0]]
    assert np.isnan(union_floor([], (1, 2))).all()


def test_a_picture_is_drawn_of_a_floor(tmp_path: Path) -> None:
    scenario = small()
    stage = set_stage(scenario)
    truth = stage.truth
    assert isinstance(truth, PlanarTruth)
    map_of = np.where(truth.observable, np.where(truth.solid, 4.0, -4.0), np.nan)
    finals = [
        RobotFinal(name, state, 5, 9, "aa", 1.0, 10, log_odds=log_odds)
        for name, state, log_odds in (
            ("explorer-1", "alive", map_of.astype(np.float32)),
            ("explorer-2", "killed", None),
        )
    ]
    assert map_facts(finals[0], truth) == "100 % of what can be seen, 0.0 % of that wrong"
    assert map_facts(finals[1], truth) == ""
    records = Records(list(scenario.robots))
    summary = summarise(scenario, records, finals, truth, Ending(60.0, "complete", "done"))
    assert summary["team"]["coverage"] == 1.0
    json.dumps(summary)
    overview = Overview("A floor", summary, stage.terrain.frame, truth, finals, records)
    draw(tmp_path / "picture.png", overview)
    assert (tmp_path / "picture.png").stat().st_size > 10_000
