"""The `compress` experiment: what it measures, and what it says of the paper's claims."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from scenarios.errors import UsageError
from scenarios.experiments.compress import EXPERIMENT, MADE_UP, Trial, ground_of, measure, trials
from scenarios.experiments.compress_claims import CUTOFFS_BITS, conclude
from scenarios.experiments.figure import save_figure
from scenarios.experiments.frame import Options
from scenarios.experiments.tables import Row

SHARED = Path(os.environ.get("ROPETEAM_SHARED", Path(__file__).parents[2] / "shared"))
MARS = SHARED / "data" / "dem" / "mars_gale_hirise_1m.npz"


@pytest.fixture(scope="module")
def rows() -> Sequence[Row]:
    return [row for kind in MADE_UP for row in measure(Trial(kind, 1, (0.1, 0.25)))]


def test_there_is_a_trial_for_each_seed_and_ground_and_one_for_a_file(tmp_path: Path) -> None:
    file = a_file(tmp_path)
    sets = {"ground": [file], "max_error_m": ["0.2", "0.1", "0.2"]}
    made = trials(Options(3, sets))
    assert [(trial.ground, trial.seed) for trial in made] == [
        *((kind, seed) for kind in MADE_UP for seed in (1, 2, 3)),
        (file, 1),
    ]
    assert all(trial.max_errors_m == (0.1, 0.2) for trial in made)


def a_file(folder: Path) -> str:
    z = np.random.default_rng(0).normal(size=(30, 40)).cumsum(0)
    z[:5] = np.nan
    path = folder / "mine.npz"
    np.savez(path, elevation=z, cell_size=0.5)
    return str(path)


def test_a_file_is_measured_beside_made_up_ground(tmp_path: Path) -> None:
    found = measure(Trial(a_file(tmp_path), 1, (0.25,)))
    assert {row["ground"] for row in found} == {"mine"}
    assert {row["cells"] for row in found} == {25 * 40}


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        ({"ground": ["no.npz"]}, "no.npz"),
        ({"max_error_m": ["0"]}, "max_error_m=0: must be a number above 0"),
        ({"max_error_m": ["0.1", "x"]}, "max_error_m=x: must be a number above 0"),
    ],
)
def test_bad_settings_are_refused_before_anything_is_measured(
    sets: dict[str, Sequence[str]], words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        trials(Options(1, sets))


def test_made_up_ground_comes_from_its_seed() -> None:
    first, known = ground_of(Trial("cliff", 1, (0.1,)))
    again, _ = ground_of(Trial("cliff", 1, (0.1,)))
    other, _ = ground_of(Trial("cliff", 2, (0.1,)))
    assert known.all()
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_all_compressors_tell_the_same_leaves(rows: Sequence[Row]) -> None:
    for cutoff in CUTOFFS_BITS:
        same = [
            (row["leaves"], row["error_m"])
            for row in rows
            if (row["codec"], row["ground"], row["seed"]) == ("paper", "cliff", 1)
            and (row["cutoff_bits"], row["max_error_m"]) == (cutoff, 0.1)
        ]
        assert len(same) == 4
        assert len(set(same)) == 1


def test_the_claims_say_what_the_rows_say(rows: Sequence[Row]) -> None:
    order, huffman, lzw, reduced, bound, same_bins, same_error = conclude(rows).claims
    assert order.held
    assert order.number > 1.5
    assert not huffman.held
    assert huffman.number == pytest.approx(1.0)
    assert not lzw.held
    assert lzw.number > 1.1
    assert reduced.held  # at these bins; not at finer ones
    assert not bound.held
    worst = max(
        float(row["error_m"]) / float(row["max_error_m"])
        for row in rows
        if row["codec"] == "paper" and row["cutoff_bits"] == 0.5
    )
    assert bound.number == worst > 2
    assert f"{worst:.1f} at 0.5 bit" in bound.found
    assert same_bins.held
    assert same_bins.number < 0.6
    assert same_error.held


def test_a_claim_that_holds_is_told_so(rows: Sequence[Row]) -> None:
    exact = [
        {**row, "error_m": row["max_error_m"]} if row["codec"] == "paper" else row for row in rows
    ]
    bound = conclude(exact).claims[4]
    assert bound.held
    assert bound.number == 1.0


def test_ours_is_bounded_and_so_is_a_cut_off_of_0(rows: Sequence[Row]) -> None:
    bounded = [row for row in rows if row["codec"] == "ours" or row.get("cutoff_bits") == 0.0]
    assert len(bounded) == 2 * 2 * 5
    assert all(float(row["error_m"]) <= float(row["max_error_m"]) + 1e-6 for row in bounded)


def test_tables_and_figure_hold_all_ways(rows: Sequence[Row], tmp_path: Path) -> None:
    tables = {table.name: table for table in conclude(rows).tables}
    assert [len(tables[name].rows) for name in ("bytes", "errors", "rmse", "information")] == [
        2 * 17,
        2 * 5,
        2 * 5,
        2 * 5,
    ]
    save_figure(tmp_path / "figure.png", lambda figure: EXPERIMENT.draw(figure, rows))
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.skipif(not MARS.exists(), reason="the real elevation files are not here")
def test_on_mars_the_cut_off_bounds_no_error_either() -> None:
    claims = conclude(measure(Trial(str(MARS), 1, (0.1,)))).claims
    assert not claims[4].held
    assert claims[5].number < 0.3
