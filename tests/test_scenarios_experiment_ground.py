"""`sandpit` and `field`: verdicts on hand-made rows, errors by hand, bad input, one small run."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from agents.geometry import GridFrame
from scenarios.cli import main
from scenarios.errors import StudyError
from scenarios.experiments import field, sandpit
from scenarios.experiments.figure import save_figure
from scenarios.experiments.frame import Claim, Options
from scenarios.experiments.ground import accuracy, claims
from scenarios.experiments.ground.grids import grid_of
from scenarios.experiments.ground.runs import ORACLE, OURS, PAPER, measure
from scenarios.experiments.tables import Row

CELLS = {
    "raster": 100,
    "raster-yaw": 300,
    "information-line": 400,
    "information-edge": 700,
    "information-interest": 1000,
    OURS: 1200,
    ORACLE: 1500,
}


def rows_of(obtained: dict[str, float] | None = None, seeds: int = 2) -> list[Row]:
    """Return rows in which a way maps so many cells in each of ten looks."""
    rows: list[Row] = []
    for method, cells in CELLS.items():
        for seed in range(1, seeds + 1):
            base: Row = {"site": "sandpit", "method": method, "seed": seed}
            rows.append({**base, "row": "run", "first_cells": 9, "looks": 10})
            for look in range(1, 21 if method == "information-line" else 11):
                row: Row = {**base, "row": "look", "look": look, "new_cells": cells}
                row["cells"] = cells * look
                if method != ORACLE:
                    row |= {"expected_cells": 1000.0, "driven_m": 2.0 * look, "x_m": 1.0}
                    row |= {
                        "obtained_cells": 1000.0 * (obtained or {}).get(method, 1.0),
                        "y_m": 1.0,
                    }
                rows.append(row)
    return rows


def told(made: Sequence[Claim], words: str) -> Claim:
    return next(claim for claim in made if words in claim.text)


def test_verdicts_follow_from_the_numbers() -> None:
    made = claims.conclude_sandpit(rows_of({"information-line": 0.5})).claims
    assert (told(made, "ten times").held, told(made, "ten times").number) == (True, 10.0)
    half = told(made, "needs 20 for")
    assert (half.held, half.number) == (True, pytest.approx(1000 * 10 / (400 * 20)))
    assert told(made, "from method 3 over 4 to 5").held
    assert told(made, "method 5 expects").held
    assert told(made, "fall apart").number == pytest.approx(0.5)
    assert told(made, "fall apart").held
    assert told(made, "1.15 times").number == pytest.approx(1.2)
    assert told(made, "greedy oracle").number == pytest.approx(0.8)


def test_a_claim_that_fails_is_said_to_fail() -> None:
    rows = rows_of({"information-interest": 0.7})
    for row in rows:
        if row["method"] == "raster" and "cells" in row:
            row["cells"] = int(row["cells"]) * 5
    made = claims.conclude_sandpit(rows).claims
    assert not told(made, "ten times").held
    assert not told(made, "method 5 expects").held
    assert not told(made, "fall apart").held


def test_a_run_that_was_over_early_keeps_what_it_had() -> None:
    rows = [r for r in rows_of(seeds=1) if not (r["method"] == OURS and r.get("look", 0) > 4)]
    assert claims.at_look(rows, OURS, 10) == {1: 4800.0}
    nothing = [r for r in rows if not (r["method"] == OURS and r["row"] == "look")]
    assert claims.at_look(nothing, OURS, 10) == {1: 0.0}


def test_only_looks_after_the_third_are_compared() -> None:
    rows = rows_of(seeds=1)
    for row in rows:
        if row["method"] == "information-interest" and row.get("look", 9) in (1, 2, 3):
            row["obtained_cells"] = 0.0
    assert claims.agreement(rows, "information-interest") == {1: pytest.approx(1.0)}


def test_the_field_speaks_of_the_cliffbot_and_of_errors() -> None:
    rows = [r for r in rows_of() if r["method"] in ("information-line", "information-interest")]
    for row in rows:
        if row["row"] == "run":
            row |= {"reached": False, "hazards": 1, "safe_path": False, "near_rmse_m": 0.05}
            row |= {"far_rmse_m": 0.3}
    made = claims.conclude_field(rows).claims
    assert not told(made, "keeps out of the rocks").held
    assert told(made, "0.10 m").held
    assert not told(made, "0.20 m").held
    assert [table.name for table in claims.conclude_field(rows).tables] == ["looks", "maps"]


def test_figures_are_drawn_without_and_with_maps(tmp_path: Path) -> None:
    save_figure(tmp_path / "a.png", lambda figure: sandpit.EXPERIMENT.draw(figure, rows_of()))
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_the_distance_to_a_surface_by_hand() -> None:
    frame = GridFrame(0.0, 0.0, 0.1, 40, 40)
    slope = np.tile(np.arange(40) * 0.1, (40, 1))
    where = np.zeros((40, 40), dtype=bool)
    where[20, 20] = True
    off = accuracy.to_surface_m(slope + 0.1, slope, where, frame)
    assert off == pytest.approx(0.1 / math.sqrt(2), rel=0.03)
    assert accuracy.to_surface_m(slope, slope, where, frame) == pytest.approx(0.0, abs=1e-9)
    assert accuracy.slope_deg(slope, 0.1) == pytest.approx(45.0)


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        ({"method": ["best"]}, r"method=best: must be one of"),
        ({"looks": ["none"]}, r"looks=none: must be a whole number"),
        ({"looks": ["0"]}, r"looks=0"),
        ({"sensor": ["radar"]}, r"--sensor radar: must be one of range, stereo"),
        ({"world.terrain.file": ["nowhere.npz"]}, r"nowhere.npz"),
        ({"scenario": ["map.cell_m=no"]}, r"map.cell_m"),
        ({"links.profile": ["string"]}, r"profile"),
    ],
)
@pytest.mark.parametrize("experiment", [sandpit, field])
def test_bad_settings_are_refused_before_anything_runs(
    experiment: object, sets: dict[str, list[str]], words: str
) -> None:
    with pytest.raises(StudyError, match=words):
        experiment.trials(Options(1, sets))  # type: ignore[attr-defined]


def test_every_way_is_tried_over_every_seed_and_method_3_twice_as_long() -> None:
    trials = sandpit.trials(Options(2, {"looks": ["5"]}))
    assert [t.method for t in trials if t.seed == 2] == [*PAPER, OURS, ORACLE]
    assert {t.looks for t in trials if t.method == "information-line"} == {10}
    assert {t.looks for t in trials if t.method != "information-line"} == {5}
    assert {t.method for t in trials if t.pictured and t.seed == 2} == set()


def test_a_sensor_that_an_experiment_does_not_know_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["experiment", "markov", "--sensor", "stereo"]) == 2
    assert "knows no 'sensor'" in capsys.readouterr().err


QUICK = [
    "world.window_m=[14.0, 12.0]",
    "map.cell_m=0.2",
    "sensor.columns=64",
    "sensor.rows=48",
    "planner.max_candidates=20",
]


@pytest.mark.slow
def test_a_small_sandpit_is_run_looked_at_again_and_drawn(tmp_path: Path) -> None:
    sets = {"looks": ["5"], "scenario": QUICK, "method": ["information-interest", ORACLE]}
    rows = [row for t in sandpit.trials(Options(1, sets)) for row in measure(t)]
    looks = [row for row in rows if row["row"] == "look"]
    assert [r["look"] for r in looks if r["method"] == ORACLE] == [1, 2, 3, 4, 5]
    mine = [r for r in looks if r["method"] == "information-interest"]
    run = next(r for r in rows if r["row"] == "run" and r["method"] == "information-interest")
    grids = {str(r["grid"]): grid_of(r) for r in rows if r["row"] == "grid"}
    # What the robot knew when it lived its looks again is what its record says that it mapped.
    assert int((grids["known"] > 0.5).sum()) == int(run["first_cells"]) + int(mine[-1]["cells"])
    assert (grids["acquired"] > 0.5).sum() == mine[3]["obtained_cells"]
    assert 0 < grids["interest"].min() < grids["interest"].max() == 1
    save_figure(tmp_path / "a.png", lambda figure: sandpit.EXPERIMENT.draw(figure, rows))
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_a_missing_run_is_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", str(tmp_path), "--robot", "recon", "--look", "1"]) == 2
    assert "is no run" in capsys.readouterr().err
