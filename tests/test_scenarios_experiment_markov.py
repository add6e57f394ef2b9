"""The `markov` experiment: Fig. 7's samples, sweeps as reference, and the laws of sigma."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenarios.errors import UsageError
from scenarios.experiments.figure import save_figure
from scenarios.experiments.frame import Options
from scenarios.experiments.markov import EXPERIMENT, Trial, measure, nearest, trials
from scenarios.experiments.markov_claims import chosen, conclude, values
from scenarios.experiments.markov_surfaces import (
    holes,
    neighbour_mean,
    sample,
    swept,
)
from scenarios.experiments.tables import Row

SHARED = Path(os.environ.get("ROPETEAM_SHARED", Path(__file__).parents[2] / "shared"))
MARS = SHARED / "data" / "dem" / "mars_gale_hirise_1m.npz"


@pytest.fixture(scope="module")
def rows() -> Sequence[Row]:
    parts = [
        ("sample", "sinusoid"),
        ("sample", "step"),
        ("sample", "step, low half"),
        ("size", "sinusoid"),
        ("ground", "cliff"),
        ("ground", "plain"),
    ]
    return [row for part in parts for row in measure(Trial(*part, 1))]


def test_sweeps_by_hand() -> None:
    line = np.array([[0.0, np.nan, np.nan, 3.0]])
    filled, sweeps = swept(line, 1e-9)
    assert filled[0] == pytest.approx([0.0, 1.0, 2.0, 3.0])
    assert 20 < sweeps < 60
    once, sweeps = swept(line, 10.0)
    assert sweeps == 1
    assert once[0] == pytest.approx([0.0, 0.0, 1.5, 3.0])


def test_neighbours_outside_the_grid_do_not_count() -> None:
    grid = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    want = [[2.5, 2.5], [10 / 3, 11 / 3], [4.5, 4.5]]
    assert neighbour_mean(grid) == pytest.approx(np.array(want))


@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 2, 5, 30]))
@settings(max_examples=25, deadline=None)
def test_holes_take_their_share_and_are_as_wide_as_asked(seed: int, diameter: int) -> None:
    unknown = holes((40, 60), diameter, 0.3, np.random.default_rng(seed))
    assert unknown.mean() >= 0.3
    assert unknown.mean() <= 0.3 + (diameter + 2) ** 2 / 2400
    assert not unknown.all()


def test_samples_are_unknown_where_the_figure_says() -> None:
    for name, share in (("sinusoid", 0.5), ("step", 0.5), ("step, low half", 0.5)):
        truth, known_m = sample(name, np.random.default_rng(3))
        unknown = np.isnan(known_m)
        assert unknown.mean() == pytest.approx(share, abs=0.13)
        assert np.abs(known_m - truth)[~unknown].max() < 0.03
    assert (truth[unknown] == 0.0).all()


def test_the_nearest_known_height_by_brute_force() -> None:
    rng = np.random.default_rng(1)
    known_m = np.where(rng.random((12, 15)) < 0.6, np.nan, rng.random((12, 15)))
    got = nearest(known_m)
    known = np.argwhere(~np.isnan(known_m))
    for cell in np.argwhere(np.isnan(known_m)):
        far = np.hypot(*(known - cell).T)
        ties = [known_m[tuple(k)] for k in known[far == far.min()]]
        assert got[tuple(cell)] in ties


def test_made_up_parts_and_files_become_trials(tmp_path: Path) -> None:
    path = tmp_path / "mine.npz"
    np.savez(path, elevation=np.random.default_rng(0).normal(size=(70, 80)).cumsum(0), cell_size=1)
    made = trials(Options(2, {"ground": [str(path)]}))
    assert len(made) == 6 * 2 + 1
    found = measure(made[-1])
    assert {row["surface"] for row in found} == {"mine"}
    with pytest.raises(UsageError, match=r"no\.npz"):
        trials(Options(1, {"ground": ["no.npz"]}))


def test_a_trial_is_the_same_again_but_for_its_times() -> None:
    def timeless(trial: Trial) -> list[Row]:
        return [{k: v for k, v in row.items() if "cpu_s" not in k} for row in measure(trial)]

    for trial in (Trial("sample", "sinusoid", 4), Trial("size", "sinusoid", 4)):
        assert timeless(trial) == timeless(trial)


def test_claims_say_what_the_rows_say(rows: Sequence[Row]) -> None:
    known, harmonic, worst_case, early, size, *sigmas = conclude(rows).claims
    assert known.held
    assert known.number == 0.0
    assert harmonic.held
    assert 0 < harmonic.number < 1e-8
    assert not worst_case.held
    assert worst_case.number == pytest.approx(1.0, abs=0.01)
    assert early.held
    assert early.number > 0.1
    assert size.held
    assert len(sigmas) == 4
    in_use, median = sigmas[:2]
    assert in_use.number > max(0.9, median.number)
    assert not in_use.held


def test_claims_that_do_not_hold_are_told_so(rows: Sequence[Row]) -> None:
    spoilt = [
        {**row, "known_moved_m": 0.1, "residual_m": 0.1, "rmse_m": 9.0} if "seed" in row else row
        for row in rows
    ]
    known, harmonic, _, _, size, *_ = conclude(spoilt).claims
    assert [known.held, harmonic.held, size.held] == [False] * 3


def test_errors_grow_with_the_holes(rows: Sequence[Row]) -> None:
    errors = values(chosen(rows, part="size"), "rmse_m")
    assert errors == sorted(errors)


def test_tables_and_figure_hold_all_parts(rows: Sequence[Row], tmp_path: Path) -> None:
    assert [len(table.rows) for table in conclude(rows).tables] == [3, 3, 6, 2 * 2 * 6]
    save_figure(tmp_path / "figure.png", lambda figure: EXPERIMENT.draw(figure, rows))
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.skipif(not MARS.exists(), reason="the real elevation files are not here")
def test_on_mars_the_variogram_covers_the_errors_in_holes() -> None:
    found = chosen(measure(Trial("ground", str(MARS), 1)), unknown="holes", law="in use")
    assert min(values(found, "within_2")) > 0.95
    assert 0.3 < np.mean(values(found, "z_rms")) < 1.0
