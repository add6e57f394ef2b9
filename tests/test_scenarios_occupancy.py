"""Runs on floors and in caves: coverage by its definition, the same again, no back door."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from occupancy_helpers import PAIR, SMALL, small
from run_helpers import RECORDS, Ran, records_of, run_of

from agents.geometry import Floats
from agents.maps.occupancy import MAPPED
from agents.maps.voxel import VoxelOccupancy
from scenarios.errors import ScenarioError
from scenarios.pictures.overview import Overview, draw, map_facts
from scenarios.records.summary import Ending, RobotFinal, summarise
from scenarios.records.tables import Records
from scenarios.schema import dump, load
from scenarios.scores.occupancy import PlanarTruth, VoxelTruth
from scenarios.stage import set_stage


@pytest.fixture(scope="module", params=sorted(SMALL))
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("occupancy")


@pytest.fixture(scope="module")
def pair(name: str, folder: Path) -> Ran:
    return run_of(small(name), folder / name)


def truth_of(name: str) -> PlanarTruth | VoxelTruth:
    truth = set_stage(small(name)).truth
    assert isinstance(truth, PlanarTruth | VoxelTruth)
    return truth


def log_odds_of(ran: Ran, robot: str, truth: PlanarTruth | VoxelTruth) -> Floats:
    fused = ran.robots[robot].team.fused()
    if isinstance(fused, VoxelOccupancy):
        assert isinstance(truth, VoxelTruth)
        return np.nan_to_num(fused.dense(truth.frame))
    return fused.log_odds


# --- a team of two --------------------------------------------------------------------------


def test_a_team_maps_what_can_be_seen_and_says_that_it_is_done(pair: Ran) -> None:
    team = pair.summary["team"]
    assert pair.summary["outcome"] == "complete"
    assert team["coverage"] > 0.85
    assert team["maps_equal"]
    assert team["wrong_cells"] < 0.03 * team["mapped_cells"]
    assert team["elevation_rmse_m"] is None
    for robot in PAIR:
        assert "no other look is worth its way" in pair.events(robot, "explored")[0]["detail"]
        assert "done" in {event["detail"] for event in pair.events(robot, "activity")}
        assert pair.robots[robot].claim is None
        assert pair.robot(robot)["hazards_hit"] <= 3


def test_coverage_is_the_mapped_share_of_the_observable_cells(name: str, pair: Ran) -> None:
    truth = truth_of(name)
    for robot in PAIR:
        told = [row["coverage"] for row in pair.table("looks") if row["robot"] == robot]
        done = np.abs(log_odds_of(pair, robot, truth)) > MAPPED
        last = np.count_nonzero(done & truth.observable) / truth.observable.sum()
        # Looks of the other that came after its own last one may add to it.
        assert told[-1] <= last + 1e-12
        assert last - told[-1] < 0.2
        assert 0 < told[0] < told[-1] <= 1
        drops = [max(0.0, a - b) for a, b in itertools.pairwise(told)]
        assert max(drops) < 0.02, "what is mapped is seldom put in doubt again"


def test_what_one_robot_measured_the_other_has_by_radio(pair: Ran) -> None:
    for row in [r for r in pair.table("maps") if r["t_s"] >= pair.summary["simulated_s"]]:
        assert row["heard_bits"] > 0
        assert row["map_cells"] >= row["own_cells"]
    kinds = {frame["kind"] for frame in pair.frames()}
    assert {"map", "anchor", "status"} <= kinds


@pytest.mark.slow
def test_where_nobody_hears_anybody_each_maps_alone(name: str, folder: Path) -> None:
    deaf = run_of(small(name, "links.up=false"), folder / f"deaf-{name}")
    assert deaf.frames() == []
    assert all(row["heard_bits"] == 0 for row in deaf.table("maps"))
    alone = run_of(small(name, "robots.count=1"), folder / f"alone-{name}")
    mine = [
        {key: row[key] for key in ("t_s", "pan_rad", "obtained_cells", "distance_m")}
        for ran in (deaf, alone)
        for row in ran.table("looks")
        if row["robot"] == "explorer-1"
    ]
    assert mine[: len(mine) // 2] == mine[len(mine) // 2 :]


# --- the same again -------------------------------------------------------------------------


@pytest.mark.slow
def test_the_same_seed_gives_the_same_records_and_another_other_ones(
    name: str, pair: Ran, folder: Path
) -> None:
    assert records_of(run_of(small(name), folder / f"again-{name}")) == records_of(pair)
    other = records_of(run_of(small(name, "seed=2"), folder / f"other-{name}"))
    assert all(other[record] != records_of(pair)[record] for record in RECORDS)


@pytest.mark.slow
def test_many_processes_give_the_records_of_one(name: str, pair: Ran, folder: Path) -> None:
    assert records_of(run_of(small(name, "air=zenoh"), folder / f"zenoh-{name}")) == records_of(
        pair
    )


def test_the_scenario_that_a_run_leaves_can_be_run_again(name: str, tmp_path: Path) -> None:
    path = tmp_path / "again.toml"
    path.write_text(dump(small(name)))
    assert load(str(path)) == small(name)


# --- bad input ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scenario", "overrides", "words"),
    [
        ("planar", ["method=information-interest"], '"information-interest": must be one of'),
        ("cave", ["method=team"], 'method = "team": must be one of random, raster, max-new'),
        ("planar", ["sharing.policy=paper"], "must be one of value, latest-first, raw"),
        ("cave", ["sharing.policy=paper"], "must be one of value, latest-first, raw"),
        ("planar", ["world.window_m=[20.0, 30.0]"], "both sides must be equal"),
        ("planar", ["world.map=nowhere.yaml"], "no such file"),
        ("cave", ["world.cave.file=nowhere.ply"], "no such file"),
        ("planar", ["world.cell_m=0.01"], "world.cell_m = 0.01: must be a number of at least 0.05"),
        ("cave", ["world.cave.chambers=0"], "must be a whole number of at least"),
        ("cave", ["map.tile_cells=128"], "of cubes at most 64 cells a side can be sent"),
        ("cave", ["robots.explorer-1.start=[1.0, 1.0, 0.0]"], "is for ground and floors: leave"),
        ("cave", ["map.kind=planar", f"world.cave.file={__file__}"], 'it needs map.kind = "voxel"'),
        (
            "planar",
            ["map.kind=elevation", "method=raster", f"world.map={__file__}"],
            'needs map.kind = "planar"',
        ),
        ("planar", ["map.kind=flat"], "must be one of elevation, planar"),
        (
            "cliff",
            ["map.kind=planar", "method=information"],
            "every robot must be one of recon, explorer",
        ),
    ],
)
def test_what_does_not_fit_a_kind_of_map_is_refused_in_a_sentence(
    scenario: str, overrides: list[str], words: str
) -> None:
    with pytest.raises(ScenarioError) as error:
        load(scenario, overrides)
    assert words in str(error.value)


# --- pictures -------------------------------------------------------------------------------


def test_a_picture_is_drawn(name: str, tmp_path: Path) -> None:
    scenario, stage, truth = small(name), set_stage(small(name)), truth_of(name)
    map_of = np.where(truth.observable, np.where(truth.solid, 4.0, -4.0), np.nan)
    finals = [
        RobotFinal(robot, state, 5, 9, "aa", 1.0, 10, log_odds=log_odds)
        for robot, state, log_odds in (
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
    overview = Overview("A pair", summary, stage.terrain.frame, truth, finals, records)
    draw(tmp_path / "picture.png", overview)
    assert (tmp_path / "picture.png").stat().st_size > 10_000
