"""Whole runs in caves: coverage by its definition, the same records on any air, no back door."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from run_helpers import RECORDS, Ran, records_of, run_of

from agents.maps.planar import MAPPED
from scenarios.cavern import floor_heights
from scenarios.errors import ScenarioError
from scenarios.overview import Overview, draw, map_facts
from scenarios.planarscore import VoxelTruth
from scenarios.record import Records
from scenarios.schema import Scenario, dump, load
from scenarios.stage import set_stage
from scenarios.summary import Ending, RobotFinal, summarise

PAIR = ("explorer-1", "explorer-2")


def small(*overrides: str) -> Scenario:
    """Return two explorers in a small cave, who see 5 m far: a few seconds of computing."""
    sets = (
        "air=memory", "world.window_m=[11.0, 10.0]", "world.cave.chambers=1",
        "world.cave.height_m=5.0", "world.cell_m=0.35", "drive.climb_m=0.4", "sensor.range_m=5",
        "sensor.columns=40", "sensor.rows=34",
        "planner.max_candidates=20", "planner.headings=8", "planner.min_gain_cells=80",
        "limit_s=2400",
    )  # fmt: skip
    return load("cave", [*sets, *overrides])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cave")


@pytest.fixture(scope="module")
def pair(folder: Path) -> Ran:
    return run_of(small(), folder / "pair")


def test_a_team_maps_a_cave_and_says_that_it_is_done(pair: Ran) -> None:
    team = pair.summary["team"]
    assert pair.summary["outcome"] == "complete"
    assert team["coverage"] > 0.85
    assert team["maps_equal"]
    assert team["wrong_cells"] < 0.02 * team["mapped_cells"]
    for name in PAIR:
        assert "no other look is worth its way" in pair.events(name, "explored")[0]["detail"]
        assert pair.robot(name)["hazards_hit"] <= 3


def test_coverage_is_the_mapped_share_of_the_observable_cells(pair: Ran) -> None:
    truth = set_stage(small()).truth
    assert isinstance(truth, VoxelTruth)
    for name in PAIR:
        told = [row["coverage"] for row in pair.table("looks") if row["robot"] == name]
        log_odds = np.nan_to_num(pair.robots[name].team.fused().dense(truth.frame))
        last = np.count_nonzero((np.abs(log_odds) > MAPPED) & truth.observable)
        assert told[-1] <= last / truth.observable.sum() + 1e-12
        assert 0 < told[0] < told[-1] <= 1


def test_what_one_robot_measured_the_other_has_by_radio(pair: Ran) -> None:
    for row in [r for r in pair.table("maps") if r["t_s"] >= pair.summary["simulated_s"]]:
        assert row["heard_bits"] > 0
        assert row["map_cells"] > row["own_cells"]
    kinds = {frame["kind"] for frame in pair.frames()}
    assert {"map", "anchor", "status"} <= kinds


@pytest.mark.slow
def test_the_same_seed_gives_the_same_records(pair: Ran, folder: Path) -> None:
    assert records_of(run_of(small(), folder / "again")) == records_of(pair)


@pytest.mark.slow
def test_many_processes_give_the_records_of_one(pair: Ran, folder: Path) -> None:
    ran = run_of(small("air=zenoh"), folder / "zenoh")
    assert records_of(ran) == records_of(pair)
    assert set(RECORDS) == set(records_of(ran))


@pytest.mark.slow
def test_where_nobody_hears_anybody_each_maps_alone(folder: Path) -> None:
    deaf = run_of(small("links.up=false"), folder / "deaf")
    assert deaf.frames() == []
    assert all(row["heard_bits"] == 0 for row in deaf.table("maps"))


def test_a_mesh_can_be_mapped(folder: Path) -> None:
    room = trimesh.creation.box(extents=(7.0, 5.0, 2.5))
    room.export(folder / "room.obj")
    ran = run_of(
        small(f"world.cave.file={folder / 'room.obj'}", "robots.count=1", "planner.max_looks=12"),
        folder / "room",
    )
    assert ran.summary["team"]["coverage"] > 0.8
    assert load(str(ran.out / "scenario.toml")).world.cave.file.endswith("room.obj")


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["method=team"], 'method = "team": must be one of random, raster, max-new'),
        (["sharing.policy=paper"], "must be one of value, latest-first, raw"),
        (["map.tile_cells=128"], "of cubes at most 64 cells a side can be sent"),
        (["world.cave.file=nowhere.ply"], "no such file"),
        (["world.cave.chambers=0"], "world.cave.chambers = 0: must be a whole number of at least"),
        (["robots.explorer-1.start=[1.0, 1.0, 0.0]"], "is for ground and floors: leave it out"),
        (["map.kind=planar", f"world.cave.file={__file__}"], 'it needs map.kind = "voxel"'),
    ],
)
def test_what_does_not_fit_a_cave_is_refused_in_a_sentence(
    overrides: list[str], words: str
) -> None:
    with pytest.raises(ScenarioError) as error:
        load("cave", overrides)
    assert words in str(error.value)


def test_a_picture_is_drawn_of_a_cave(tmp_path: Path) -> None:
    scenario = small()
    stage = set_stage(scenario)
    truth = stage.truth
    assert isinstance(truth, VoxelTruth)
    map_of = np.where(truth.observable, np.where(truth.solid, 4.0, -4.0), np.nan)
    finals = [
        RobotFinal(name, state, 5, 9, "aa", 1.0, 10, log_odds=log_odds)
        for name, state, log_odds in (
            ("explorer-1", "alive", map_of.astype(np.float32)),
            ("explorer-2", "killed", None),
        )
    ]
    assert map_facts(finals[0], truth) == "100 % of what can be seen, 0.0 % of that wrong"
    records = Records(list(scenario.robots))
    summary = summarise(scenario, records, finals, truth, Ending(60.0, "complete", "done"))
    assert summary["team"]["coverage"] == 1.0
    json.dumps(summary)
    overview = Overview("A cave", summary, stage.terrain.frame, truth, finals, records)
    draw(tmp_path / "picture.png", overview)
    assert (tmp_path / "picture.png").stat().st_size > 10_000


def test_heights_are_of_the_lowest_free_cell() -> None:
    truth = set_stage(small()).truth
    assert isinstance(truth, VoxelTruth)
    free = np.zeros(truth.solid.shape, dtype=bool)
    free[3:5, 1, 2] = True
    heights = floor_heights(free, truth.frame)
    assert np.isnan(heights).sum() == heights.size - 1
    assert heights[1, 2] == truth.frame.z_m + 3 * truth.frame.cell_m


def test_the_scenario_that_is_dumped_loads_again(tmp_path: Path) -> None:
    path = tmp_path / "again.toml"
    path.write_text(dump(small()))
    assert load(str(path)) == small()
