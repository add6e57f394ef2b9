"""The `edge` experiment: deviations measured anew, and what is said of Figs. 8 and 9."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.ground.edge import Edge
from scenarios.errors import UsageError
from scenarios.experiments import edge as experiment
from scenarios.experiments.edge_claims import conclude
from scenarios.experiments.edge_ground import Trial, found_edge, outer_pixels, site_of
from scenarios.experiments.figure import save_figure
from scenarios.experiments.frame import Options
from scenarios.experiments.tables import Row

COARSE = Trial("Viking 1", 0.02, 1, 0.1, 0.2)


@pytest.fixture(scope="module")
def rows() -> Sequence[Row]:
    made = [COARSE, replace(COARSE, site="Viking 2"), replace(COARSE, cell_m=0.01)]
    return [row for trial in made for row in experiment.measure(trial)]


def test_there_is_a_trial_for_each_site_size_and_seed() -> None:
    made = experiment.trials(Options(3, {"wheel_m": ["0.2"]}))
    assert len(made) == 2 * 2 * 3
    assert {trial.wheel_m for trial in made} == {0.2}
    with pytest.raises(UsageError, match=r"unknown_share=0.95: must be at most 0.9"):
        experiment.trials(Options(1, {"unknown_share": ["0.95"]}))


def test_the_same_ground_at_both_sizes_and_the_robot_stands_on_known_flat_plateau() -> None:
    coarse, fine = site_of(COARSE), site_of(replace(COARSE, cell_m=0.01))
    blocks = fine.ground_m.reshape(400, 2, 400, 2).mean(axis=(1, 3))
    assert np.median(np.abs(blocks - coarse.ground_m)) < 0.005
    assert coarse.known_distance_m[coarse.cell] == 0.0
    assert coarse.completed_m[coarse.cell] == coarse.contact_m
    assert coarse.cell[0] > 300
    again = site_of(COARSE)
    assert np.array_equal(again.completed_m, coarse.completed_m)
    other = site_of(replace(COARSE, seed=2))
    assert not np.array_equal(other.ground_m, coarse.ground_m)


def square(side: int, size: int) -> Edge:
    plateau = np.zeros((size, size), dtype=bool)
    plateau[5 : 5 + side, 5 : 5 + side] = True
    low, high = 5.0, 4.0 + side
    corners = np.array([[low, low], [low, high], [high, high], [high, low]])
    return Edge(corners, 0.0, 0.0, plateau)


def test_deviations_by_hand() -> None:
    exact = experiment.deviations(square(20, 40))
    assert exact == {"anew_max_px": 0.0, "rim_mean_px": 0.0, "segment_mean_px": 0.0}
    found = square(20, 40)
    found.plateau[25:28, 14] = True  # a spur of three pixels on one side
    off = experiment.deviations(found)
    assert off["anew_max_px"] == 3.0
    assert off["segment_mean_px"] == pytest.approx(3.0 / 4)
    boundary = outer_pixels(found.plateau)
    assert off["rim_mean_px"] == pytest.approx((1 + 2 + 2 + 3) / len(boundary), abs=0.05)


def test_pixels_at_the_maps_border_are_left_out_of_the_mean() -> None:
    found = square(20, 40)
    found.plateau[:25, 5:25] = True
    off = experiment.deviations(found)
    assert off["anew_max_px"] == 5.0
    along_the_sides = 2 * (4 + 3 + 2 + 1)
    assert off["rim_mean_px"] < along_the_sides / 60 + 0.1


def test_both_ways_keep_the_bound_and_ours_finds_more(rows: Sequence[Row]) -> None:
    assert all(float(row["max_px"]) <= float(row["bound_px"]) for row in rows)
    assert all(float(r["anew_max_px"]) <= float(r["bound_px"]) + 0.5 for r in rows)
    ours, papers = (
        np.mean([float(row["true_overlap"]) for row in rows if row["way"] == way])
        for way in ("ours", "paper")
    )
    assert ours >= papers
    assert ours > 0.9


def test_the_threshold_is_the_papers_way() -> None:
    site = site_of(COARSE)
    by_threshold = found_edge(site, COARSE, "paper").plateau
    apart_m = np.abs(site.completed_m - site.contact_m)[by_threshold]
    assert (apart_m <= COARSE.wheel_m).mean() > 0.9


def test_claims_say_what_the_rows_say(rows: Sequence[Row]) -> None:
    claims = conclude(rows).claims
    assert len(claims) == 9
    assert claims[0].number == max(
        float(r["max_px"]) for r in rows if r["way"] == "paper" and r["cell_m"] == 0.02
    )
    assert "Fig. 9 has 4.99" in claims[0].found
    assert all(claim.held for claim in (*claims[:2], *claims[4:8]))


def test_claims_that_do_not_hold_are_told_so(rows: Sequence[Row]) -> None:
    worse = {"max_px": 11.0, "segment_mean_px": 9.0, "simple": False, "hull_share": 1.0}
    spoilt = [{**row, **worse, "anew_max_px": 12.0, "beyond_px": 99.0} for row in rows]
    claims = conclude(spoilt).claims
    assert not any(claim.held for claim in claims[:8])


def test_other_wheels_are_not_compared_with_the_papers_numbers() -> None:
    trial = replace(COARSE, wheel_m=0.2)
    claims = conclude(experiment.measure(trial)).claims
    assert not any("mean tolerance" in claim.text for claim in claims)
    assert "Fig. 9 has" not in claims[0].found
    assert "10 pixels" in claims[0].text


def test_tables_and_figure_hold_all_kinds(rows: Sequence[Row], tmp_path: Path) -> None:
    assert [len(table.rows) for table in conclude(rows).tables] == [6, 6]
    save_figure(tmp_path / "f.png", lambda figure: experiment.EXPERIMENT.draw(figure, rows))
    assert (tmp_path / "f.png").read_bytes().startswith(b"\x89PNG")
