"""`descents`: verdicts on hand-made rows, classes of ground by hand, bad input, a small mission."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.geometry import GridFrame
from scenarios.errors import StudyError
from scenarios.experiments import descents
from scenarios.experiments.descents_claims import BECAME, conclude, pooled
from scenarios.experiments.descents_figure import draw
from scenarios.experiments.figure import save_figure
from scenarios.experiments.frame import Claim, Options
from scenarios.experiments.ground.accuracy import CLASSES, accuracy, by_class
from scenarios.experiments.tables import Row
from scenarios.records.summary import RobotFinal
from scenarios.schema import load
from scenarios.stage import set_stage
from sim.ground import Terrain


def row_of(seed: int, became: str, **changes: float) -> Row:
    row: Row = {
        "seed": seed,
        "became": became,
        "way_exists": True,
        "reason": "it said why",
        "looks": 20,
        "legs": 10,
        "legs_told": 6,
        "ill_looks": 3,
        "recon_pose_rms_m": 0.05,
        "simulated_s": 2000.0,
        "near_rmse_m": 0.04,
        "far_rmse_m": 0.1,
    }
    for one in CLASSES:
        row |= {f"{one.name}_cells": 100, f"{one.name}_height_m": 0.1}
        row |= {f"{one.name}_surface_m": 0.05}
    return {**row, **changes}


def told(rows: list[Row], words: str) -> Claim:
    return next(claim for claim in conclude(rows).claims if words in claim.text)


def test_verdicts_follow_from_what_became_of_the_missions() -> None:
    rows = [row_of(seed, "down") for seed in range(1, 20)]
    assert told(rows, "or stays and says so").held
    assert told(rows, "it gets down").held
    stayed = [*rows, row_of(20, "stayed"), row_of(21, "stayed")]
    assert told(stayed, "or stays and says so").number == 1.0
    assert not told(stayed, "it gets down").held
    for ending in ("hurt", "neither"):
        worse = [*stayed, row_of(22, ending), row_of(23, ending)]
        assert not told(worse, "or stays and says so").held
    missions = conclude(worse).tables[0]
    assert [line[1:] for line in missions.rows] == [
        [19, ""],
        [2, "20 21"],
        [2, "22 23"],
        [0, ""],
    ]
    failures = conclude(worse).tables[1]
    assert [line[0] for line in failures.rows] == ["20", "21", "22", "23"]
    assert failures.rows[0][2:] == ["yes", "it said why"]
    assert len(conclude(rows).tables) == len(conclude(worse).tables) - 1


def test_one_mission_with_a_bad_map_is_enough_for_did_not_hold() -> None:
    rows = [row_of(1, "down"), row_of(2, "down", near_rmse_m=0.11)]
    near = told(rows, "at most 0.10 m")
    assert (near.held, near.number) == (False, 0.11)
    assert "1 of 2 were within" in near.found
    assert told(rows, "at most 0.20 m").held


def test_errors_are_pooled_over_cells_not_over_missions() -> None:
    rows = [row_of(1, "down"), row_of(2, "down", gentle_near_cells=300, gentle_near_height_m=0.3)]
    expected = math.sqrt((100 * 0.1**2 + 300 * 0.3**2) / 400)
    assert pooled(rows, "gentle_near", "height") == pytest.approx(expected)


@dataclass
class Ended:
    """A run that has ended, as far as errors ask about it."""

    stage: Any
    finals: list[RobotFinal]


@dataclass
class Staged:
    terrain: Terrain


def test_every_cell_within_ten_metres_belongs_to_one_class() -> None:
    """Level ground in the west, a slope of 45 degrees in the east; a map that is 30 cm too high."""
    frame = GridFrame(0.0, 0.0, 0.5, 60, 60)
    east = np.maximum(0.0, (np.arange(60) - 30) * 0.5)
    truth = np.tile(east, (60, 1)).astype(np.float32)
    terrain = Terrain(frame, truth, np.ones_like(truth))
    map_m = truth + np.float32(0.3)
    final = RobotFinal(
        "recon", "alive", 0, 0, "", 0.0, 0, elevation_m=map_m, sigma_m=np.full_like(truth, 0.1)
    )
    ended: Any = Ended(Staged(terrain), [final])
    told = by_class(ended, [(15.0, 15.0)])
    rows, cols = np.indices((60, 60))
    away = np.hypot(rows - 30, cols - 30) * 0.5
    assert sum(int(told[f"{one.name}_cells"]) for one in CLASSES) == (away <= 10).sum()
    near = int(told["gentle_near_cells"]) + int(told["steep_near_cells"])
    assert near == (away <= 5).sum()
    assert told["gentle_near_height_m"] == pytest.approx(0.3, abs=1e-6)
    assert told["steep_far_height_m"] == pytest.approx(0.3, abs=1e-6)
    assert told["steep_far_surface_m"] == pytest.approx(0.3 / math.sqrt(2), rel=0.1)
    whole = accuracy(ended, [(15.0, 15.0)])
    assert whole["near_rmse_m"] == told["gentle_near_height_m"]


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        ({"sensor": ["radar"]}, r"--sensor radar: must be one of range, stereo"),
        ({"cell_m": ["wide"]}, r"cell_m=wide"),
        ({"first_seed": ["1.5"]}, r"first_seed=1.5: must be a whole number"),
        ({"scenario": ["planner.max_looks=no"]}, r"max_looks"),
        ({"world.terrain.file": ["nowhere.npz"]}, r"nowhere.npz"),
    ],
)
def test_bad_settings_are_refused_before_anything_runs(
    sets: dict[str, list[str]], words: str
) -> None:
    with pytest.raises(StudyError, match=words):
        descents.trials(Options(1, sets))


def test_legs_are_summed_over_what_is_told_of_each_way() -> None:
    said = [("recon", "motion from images", "6 of 13 legs"), ("recon", "ill look", "too dark")]
    said += [("recon", "motion from images", "0 of 2 legs"), ("cliffbot", "ill look", "")]
    events = [{"robot": robot, "what": what, "detail": detail} for robot, what, detail in said]
    assert descents.legs(events) == {"legs": 15, "legs_told": 6, "ill_looks": 1}


def test_seeds_begin_where_they_are_told_to() -> None:
    made = descents.trials(Options(2, {"first_seed": ["7"]}))
    assert [trial.seed for trial in made] == [7, 8]
    assert "map.cell_m=0.05" in made[0].sets


@pytest.mark.slow
def test_a_small_mission_is_run_and_drawn(tmp_path: Path) -> None:
    quick = ["world.window_m=[20.0, 18.0]", "limit_s=200", "sensor.columns=64", "sensor.rows=48"]
    sets = {"sensor": ["range"], "cell_m": ["0.2"], "scenario": quick}
    rows = [row for trial in descents.trials(Options(1, sets)) for row in descents.measure(trial)]
    (row,) = rows
    assert row["became"] in BECAME
    assert int(row["looks"]) > 5
    assert 0 < float(row["near_rmse_m"]) < 0.1
    assert conclude(rows).tables[-2].rows
    save_figure(tmp_path / "a.png", lambda figure: draw(figure, rows))
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_a_way_exists_unless_a_wall_leads_all_across() -> None:
    stage = set_stage(load("cliff", ("air=memory",), seed=1))
    terrain = stage.terrain
    assert isinstance(terrain, Terrain)
    assert stage.goal_m is not None
    assert descents.way_exists(stage)
    row = terrain.frame.cell_of(*stage.goal_m)[0] + 25
    walled = terrain.elevation_m.copy()
    walled[row : row + 3] += 2.0
    assert not descents.way_exists(replace(stage, terrain=replace(terrain, elevation_m=walled)))
