"""The `localisation` experiment: walks by fiducials, and what is said of Fig. 19's claims."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from scenarios.errors import UsageError
from scenarios.experiments.figure import save_figure
from scenarios.experiments.frame import Options
from scenarios.experiments.localisation import EXPERIMENT, Trial, measure, trials
from scenarios.experiments.localisation_claims import OURS, conclude, curve
from scenarios.experiments.localisation_images import Walk
from scenarios.experiments.localisation_images import measure as measure_images
from scenarios.experiments.localisation_walk import WAYS, Course, walk
from scenarios.experiments.tables import Row


def course(**changes: float) -> Course:
    values = {"distance_m": 0.35, "count": 12, "motions": 12, "step_m": 0.05}
    values |= {"false_share": 0.02, "noise_s": 0.0008} | changes
    return Course(**{**values, "count": int(values["count"]), "motions": int(values["motions"])})


def a_walk(seed: int = 1, **changes: float) -> list[Row]:
    return list(walk(course(**changes), np.random.default_rng(seed)))


@pytest.fixture(scope="module")
def rows() -> Sequence[Row]:
    made = [
        Trial(seed, course(distance_m=d, count=n, motions=16))
        for seed in (1, 2)
        for d in (0.35, 1.1)
        for n in (6, 24)
    ]
    return [row for trial in made for row in measure(trial)]


def test_without_noise_every_way_finds_home() -> None:
    last = a_walk(noise_s=1e-9, false_share=1e-9)[-1]
    assert all(float(last[f"{way} error_m"]) < 1e-6 for way in WAYS)
    assert last["said_m"] == pytest.approx(0.0, abs=1e-6)


def test_the_error_follows_the_noise_and_nothing_else() -> None:
    one, ten = (a_walk(noise_s=s, false_share=1e-9)[-1] for s in (1e-5, 1e-4))
    for key in (OURS, "said_m", "closed form error_m"):
        assert float(ten[key]) == pytest.approx(10 * float(one[key]), rel=0.05)


def test_as_many_fiducials_are_tracked_as_was_asked_for() -> None:
    counts = [int(row["tracked"]) for row in a_walk(count=24)]
    assert 22 < np.mean(counts) <= 24


def test_a_walk_among_false_tracks_is_lost_now_and_then_and_goes_on() -> None:
    found = a_walk(count=6, false_share=0.5, motions=20)
    lost = [row for row in found if row["lost"]]
    assert lost
    assert len(found) == 20
    assert all(math.isfinite(float(row[OURS])) for row in found)


def test_a_trial_is_the_same_again_and_others_differ() -> None:
    small = Trial(1, course())
    assert measure(small) == measure(small)
    assert measure(small) != measure(Trial(2, course()))


def test_trials_take_what_is_set() -> None:
    made = trials(Options(2, {"step_m": ["0.02"], "noise_s": ["0.01"]}))
    assert len(made) == 2 * 2 * 4
    assert {(trial.course.step_m, trial.course.noise_s) for trial in made} == {(0.02, 0.01)}
    with pytest.raises(UsageError, match="step_m=0"):
        trials(Options(1, {"step_m": ["0"]}))


def test_claims_say_what_the_rows_say(rows: Sequence[Row]) -> None:
    drift, growth, nearer, more, spread, said, paper = conclude(rows).claims
    assert drift.held
    end_m = 16 * 0.05
    assert drift.number == pytest.approx(100 * curve(rows, OURS, 0.35, 24)[-1] / end_m)
    assert growth.held
    assert nearer.held
    far, near = (curve(rows, OURS, d, 24)[-1] for d in (1.1, 0.35))
    assert nearer.number <= far / near
    assert more.held
    assert more.number > 1.5
    assert spread.number != pytest.approx(1.0, abs=0.01)
    assert said.number < 1.25
    assert paper.held
    assert paper.number > 1.2


def test_a_claim_that_does_not_hold_is_told_so(rows: Sequence[Row]) -> None:
    level = [{**row, OURS: 0.01} if row["kind"] == "path" else row for row in rows]
    _, growth, nearer, more, *_ = conclude(level).claims
    assert [growth.held, nearer.held, more.held] == [False] * 3
    assert nearer.number == pytest.approx(1.0)


def test_tables_and_figure_hold_all_kinds(rows: Sequence[Row], tmp_path: Path) -> None:
    assert [len(table.rows) for table in conclude(rows).tables] == [4, 4]
    save_figure(tmp_path / "figure.png", lambda figure: EXPERIMENT.draw(figure, rows))
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


# --- from images --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def seen() -> Sequence[Row]:
    made = [Walk(1, d, (12, 40), 4, 0.05) for d in (0.35, 1.1)]
    return [row for trial in made for row in measure_images(trial, every=2)]


def test_a_walk_by_images_stays_on_its_way(seen: Sequence[Row]) -> None:
    for distance_m, most_m in ((0.35, 0.004), (1.1, 0.012)):
        assert curve(seen, OURS, distance_m, 40)[-1] < most_m
        last = [r for r in seen if r["kind"] == "path" and r["distance_m"] == distance_m][-1]
        assert float(last["seen_m"]) == pytest.approx(distance_m, rel=0.15)
        assert int(last["tracked"]) > 30


def test_images_are_tabled_like_formulas(seen: Sequence[Row]) -> None:
    assert {row["kind"] for row in seen} == {"path", "step"}
    assert {"refined error_m", "Eq. 12 error_m", "said_m"} <= set(seen[0])


def test_images_have_trials_of_their_own() -> None:
    made = trials(Options(2, {"source": ["images"]}))
    assert len(made) == 2 * 2
    assert all(isinstance(trial, Walk) for trial in made)
    with pytest.raises(UsageError, match="source=nonsense: must be one of formula, images"):
        trials(Options(1, {"source": ["nonsense"]}))
    with pytest.raises(UsageError, match="noise_s: images have their own"):
        trials(Options(1, {"source": ["images"], "noise_s": ["0.01"]}))
