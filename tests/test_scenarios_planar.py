"""What is of floors alone: real buildings, how a map is scored, ends of runs."""

from pathlib import Path

import numpy as np
import pytest
from occupancy_helpers import small
from run_helpers import run_of
from sim_helpers import SHARED

from scenarios.schema import dump, load
from scenarios.scores.occupancy import PlanarTruth, score_floor, union_floor

BUILDING = SHARED / "data" / "occupancy" / "tetam_lab_0p1.yaml"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("planar")


def test_a_run_that_ends_because_looks_ran_out_says_so(folder: Path) -> None:
    ran = run_of(small("planar", "robots.count=1", "planner.max_looks=3"), folder / "spent")
    assert ran.summary["outcome"] == "partial"
    assert (
        "explorer-1 took all looks allowed (planner.max_looks = 3)"
        in (ran.summary["outcome_reason"])
    )
    assert ran.events("explorer-1", "explored") == []
    assert len([row for row in ran.table("looks") if row["robot"] == "explorer-1"]) == 3


def test_when_one_dies_the_other_maps_on(folder: Path) -> None:
    event = '[[events]]\nat_s = 60.0\nkill = "explorer-2"\n'
    path = folder / "killed.toml"
    path.write_text(dump(small("planar", "limit_s=3000")) + "\n" + event)
    killed = run_of(load(str(path)), folder / "killed")
    assert killed.robot("explorer-2")["state"] == "killed"
    assert killed.summary["team"]["coverage"] > 0.85


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


# --- scores ---------------------------------------------------------------------------------

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
