"""Studies: what their files make, what sweeps keep, what the table holds, what is drawn."""

import json
import math
import os
import re
import shlex
import signal
import subprocess
import sys
import textwrap
import time
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenarios import cli, shelf
from scenarios.commands.sweep import time_left
from scenarios.errors import StudyError
from scenarios.experiments.tables import estimate
from scenarios.schema import load, parse
from scenarios.studies import engine as engines
from scenarios.studies.engine import in_turn, on_dask
from scenarios.studies.figure import chosen, draw_study, lines_of
from scenarios.studies.study import Study, Trial, find, read_study, trials
from scenarios.studies.sweep import Progress, Swept, read_trial, sweep
from scenarios.studies.table import FILE, Row, read_table, row_of, write_table
from scenarios.studies.trial import Told, measure, measures_of

ROOT = Path(__file__).parents[1]
TINY = """
name = "tiny"
title = "A tiny study"
scenario = "pair"
seeds = 2
set.world.window_m = [14.0, 14.0]
set."map.cell_m" = 0.25
set.sensor = { columns = 24, rows = 16 }
set.planner.max_candidates = 6
set.limit_s = 40
[axes]
links.rate_bps = [600, 9600]
sharing.policy = ["value", "raw"]
[plot]
x = "links.rate_bps"
y = ["team.coverage", "robots.sent_bytes.mean"]
by = "sharing.policy"
"""


def study_of(folder: Path, text: str = TINY, **options: Any) -> tuple[Study, list[Trial], Path]:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "tiny.toml"
    path.write_text(text)
    study = read_study(path, **options)
    return study, trials(study, path), path


class Bench:
    """An engine that makes up what comes of trials, at once, and notes which it was given."""

    def __init__(self, *, stop_after: int | None = None, failing: Sequence[str] = ()) -> None:
        self.ran: list[str] = []
        self._stop_after, self._failing = stop_after, failing

    def __call__(self, given: Sequence[Trial], out: Path) -> Iterator[tuple[Trial, Told]]:
        assert out.is_dir()
        for trial in given:
            if self._stop_after is not None and len(self.ran) >= self._stop_after:
                raise KeyboardInterrupt
            self.ran.append(trial.id)
            if trial.id in self._failing:
                yield trial, Told("failed", "ValueError: out of luck", "the traceback")
            else:
                yield trial, told_of(float(len(trial.text)))


def told_of(coverage: float) -> Told:
    robot = {
        "state": "alive",
        "looks": 3,
        "sent_bytes": 70,
        "dropped_frames": {"loss": 2, "range": 1},
        "role": "x",
    }
    other = {**robot, "state": "killed", "looks": 5, "dropped_frames": {}, "pose_error": None}
    summary = {
        "schema": 1,
        "seed": 9,
        "simulated_s": 40.0,
        "outcome": "complete",
        "robots": {"a": robot, "b": other},
        "team": {"coverage": coverage, "elevation_rmse_m": None, "maps_equal": True},
        "mission": {},
    }
    return Told("done", summary=json.dumps(summary), measures={"team.coverage_mean": 0.25})


def swept(out: Path, folder: Path, engine: Any = None, **options: Any) -> Swept:
    study, made, path = study_of(folder)
    return sweep(study, made, out, engine or Bench(), source=path.read_text(), **options)


# --- what a study is --------------------------------------------------------------------------


def test_trials_are_all_combinations_each_a_complete_scenario(tmp_path: Path) -> None:
    _, made, _ = study_of(tmp_path)
    assert len(made) == 2 * 2 * 2
    assert list(made[0].values) == ["links.rate_bps", "sharing.policy", "seed"]
    assert [t.values["seed"] for t in made[:4]] == [1, 2, 1, 2]
    assert len({t.id for t in made}) == len(made)
    for trial in made:
        scenario = parse(tomllib.loads(trial.text), "test")
        assert scenario.links.rate_bps == trial.values["links.rate_bps"]
        assert scenario.sharing.policy == trial.values["sharing.policy"]
        assert (scenario.seed, scenario.air) == (trial.values["seed"], "memory")
        assert (scenario.map.cell_m, scenario.sensor.rows) == (0.25, 16)


def test_more_seeds_and_values_leave_the_ids_of_the_others(tmp_path: Path) -> None:
    few = {t.id for t in study_of(tmp_path)[1]}
    more = TINY.replace("[600, 9600]", "[600, 1200, 9600]")
    many = {t.id for t in study_of(tmp_path, more, seeds=3)[1]}
    assert few < many
    assert len(many) == 3 * 2 * 3


def test_cases_change_several_keys_and_are_told_by_their_own_words(tmp_path: Path) -> None:
    text = TINY.split("[axes]", maxsplit=1)[0] + (
        "[[cases]]\nis = { lost = 0 }\n[[cases]]\nis = { lost = 1 }\n"
        'set = { robots.count = 3, events = [{ at_s = 20, kill = "explorer-3" }] }\n'
    )
    _, made, _ = study_of(tmp_path, text)
    assert [dict(t.values) for t in made] == [
        {"lost": lost, "seed": seed} for lost in (0, 1) for seed in (1, 2)
    ]
    assert 'kill = "explorer-3"' in made[-1].text
    assert "kill" not in made[0].text


def test_an_axis_may_reach_into_events_and_hold_lists(tmp_path: Path) -> None:
    text = TINY.split("[axes]", maxsplit=1)[0] + (
        'set.events = [{ at_s = 5, kill = "explorer-2" }]\n[axes]\n'
        '"events.0.at_s" = [10, 30]\nworld.window_m = [[14.0, 14.0], [16.0, 12.0]]\n'
    )
    text = text.replace("set.events", "set . events")
    _, made, _ = study_of(tmp_path, text)
    assert "at_s = 30" in made[-1].text
    assert made[-1].values["world.window_m"] == "[16.0, 12.0]"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("seeds = 2", "seeds = 0"), "seeds = 0: must be"),
        (("seeds = 2", "sedes = 2"), "did you mean seeds"),
        (('"pair"', '"pare"'), "did you mean pair"),
        (("[600, 9600]", "600"), "must be a list of its values"),
        (("[600, 9600]", "[]"), "must be a list of its values"),
        (("[600, 9600]", "[600, -1]"), r"links.rate_bps = -1: links.rate_bps = -1.*at least 0"),
        (("links.rate_bps", "links.rat_bps"), "did you mean rate_bps"),
        (("links.rate_bps =", "seed ="), "can't be an axis"),
        (('["value", "raw"]', '["value", "rare"]'), "must be one of"),
        (("[plot]", "[plt]"), "did you mean plot"),
        (("limit_s = 40", "limit_s = 0"), "limit_s = 0"),
        (("[600, 9600]", f"[{', '.join(map(str, range(1, 30_000)))}]"), "at most 100000"),
        (
            ("[axes]", "[[cases]]\nis = { a = 1 }\n[[cases]]\nis = { b = 1 }\n[axes]"),
            "same columns",
        ),
        (("[axes]", "[[cases]]\nis = { seed = 1 }\n[axes]"), "seed: two columns"),
        (("[axes]", "a = 2026-01-01\n[axes]"), "there is no such key"),
    ],
)
def test_a_study_that_cannot_be_is_refused_in_a_sentence(
    tmp_path: Path, change: tuple[str, str], words: str
) -> None:
    with pytest.raises(StudyError, match=words) as refused:
        study_of(tmp_path, TINY.replace(*change))
    assert "tiny.toml" in str(refused.value) or "pare" in str(refused.value)


@pytest.mark.parametrize("name", shelf.names(shelf.STUDIES))
def test_the_studies_that_come_along_are_sound_and_say_what_they_answer(name: str) -> None:
    path = find(name)
    study = read_study(path)
    assert study.name == name
    assert study.title.startswith("What ")
    made = trials(study, path)
    assert 8 <= len({t.id for t in made}) <= 100, "a laptop does it in minutes"
    assert study.plot is not None
    for column in (study.plot.x, study.plot.by):
        assert column is None or column in made[0].values


@pytest.mark.parametrize("name", shelf.names(shelf.STUDIES))
def test_what_a_study_says_can_be_typed_can_be(name: str) -> None:
    text = find(name).read_text()
    lines = [line.lstrip("# ").removeprefix("Try:").strip() for line in text.splitlines()]
    typed = [shlex.split(line)[1:] for line in lines if line.startswith("ropeteam ")]
    assert typed
    for argv in typed:
        cli.make_parser().parse_args(argv)


def test_the_study_of_the_documents_is_sound(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "studies.md").read_text()
    text = textwrap.dedent(
        re.findall(r'^ {4}name = "mine"\n(?: {4}.*\n|\n)*', page, re.MULTILINE)[0]
    )
    _, made, _ = study_of(tmp_path, text)
    assert len(made) == 2 * 3 * 2 * 2 * 5


def test_trials_that_are_the_same_are_run_once(tmp_path: Path) -> None:
    cases = "".join(f"[[cases]]\nis = {{ lost = 0, at_s = {t} }}\n" for t in (1, 2))
    study, made, path = study_of(tmp_path, TINY.split("[axes]", maxsplit=1)[0] + cases)
    bench = Bench()
    result = sweep(study, made, tmp_path / "out", bench, source=path.read_text())
    assert (len(made), len(bench.ran), result.total) == (4, 2, 2)
    assert [row["at_s"] for row in read_table(tmp_path / "out")] == [1, 1, 2, 2]


def test_the_studies_that_were_promised_are_there() -> None:
    assert shelf.names(shelf.STUDIES) == ["bandwidth", "failure", "loss", "mission", "team-size"]
    path = find("bandwidth")
    rates = [float(t.values["links.rate_bps"]) for t in trials(read_study(path, seeds=1), path)]
    assert (min(rates), max(rates)) == (300, 1e6)
    path = find("team-size")
    counts = [int(t.values["robots.count"]) for t in trials(read_study(path, seeds=1), path)]
    assert (min(counts), max(counts)) == (1, 16)


# --- sweeps -------------------------------------------------------------------------------------


def test_a_sweep_leaves_a_row_and_a_folder_for_each_trial(tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = swept(out, tmp_path)
    assert result == Swept(out, total=8, done=8, failed=0, kept=0)
    rows = read_table(out)
    assert [row["seed"] for row in rows] == [1, 2] * 4
    for row in rows:
        place = out / "trials" / str(row["trial"])
        assert load(str(place / "scenario.toml")).seed == row["seed"]
        assert json.loads((place / "summary.json").read_text())["schema"] == 1
        assert row["state"] == "done"
        assert row["team.coverage_mean"] == 0.25
        assert row["robots.looks.sum"] == 8
        assert row["robots.looks.max"] == 5
        assert row["robots.dropped_frames.sum"] == 3
        assert (row["robots.count"], row["robots.alive"]) == (2, 1)
        assert "robots.role.sum" not in row


def test_a_sweep_that_was_stopped_goes_on_and_ends_like_one_that_was_not(tmp_path: Path) -> None:
    out, whole = tmp_path / "out", tmp_path / "whole"
    first = Bench(stop_after=3)
    with pytest.raises(KeyboardInterrupt):
        swept(out, tmp_path, first)
    assert sum(row["state"] == "missing" for row in read_table(out)) == 5
    second = Bench()
    result = swept(out, tmp_path, second)
    assert (result.kept, result.done) == (3, 8)
    assert not set(first.ran) & set(second.ran)
    swept(whole, tmp_path)
    assert read_table(out) == read_table(whole)
    assert (out / FILE).read_bytes() == (whole / FILE).read_bytes()
    third = Bench()
    swept(out, tmp_path, third)
    assert third.ran == []


def test_what_was_cut_short_is_run_again(tmp_path: Path) -> None:
    out = tmp_path / "out"
    swept(out, tmp_path)
    _, made, _ = study_of(tmp_path)
    (out / "trials" / made[0].id / "trial.json").write_text('{"schema": 1, "st')
    (out / "trials" / made[1].id / "summary.json").unlink()
    again = Bench()
    swept(out, tmp_path, again)
    assert again.ran == [made[0].id, made[1].id]


def test_a_failed_trial_is_told_with_its_log_and_holds_nobody_up(tmp_path: Path) -> None:
    out = tmp_path / "out"
    _, made, _ = study_of(tmp_path)
    bad = made[2].id
    result = swept(out, tmp_path, Bench(failing=[bad]))
    assert (result.done, result.failed) == (8, 1)
    row = read_table(out)[2]
    assert (row["state"], row["error"]) == ("failed", "ValueError: out of luck")
    assert row["team.coverage"] is None
    assert (out / "trials" / bad / "error.log").read_text() == "the traceback"
    kept = Bench()
    assert swept(out, tmp_path, kept).failed == 1
    assert kept.ran == []
    retried = Bench()
    assert swept(out, tmp_path, retried, retry=True).failed == 0
    assert retried.ran == [bad]
    assert not (out / "trials" / bad / "error.log").exists()


def test_a_sweep_never_touches_a_folder_of_something_else(tmp_path: Path) -> None:
    out = tmp_path / "out"
    swept(out, tmp_path)
    study, made, path = study_of(tmp_path / "b", TINY.replace('"tiny"', '"other"'))
    with pytest.raises(StudyError, match="holds the study 'tiny', not 'other'"):
        sweep(study, made, out, Bench(), source=path.read_text())
    assert len(list((out / "trials").iterdir())) == 8
    sweep(study, made[:1], out, Bench(), source=path.read_text(), overwrite=True)
    assert len(list((out / "trials").iterdir())) == 1
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "precious").touch()
    with pytest.raises(StudyError, match="no former run"):
        swept(tmp_path / "mine", tmp_path)


def test_progress_counts_all_and_guesses_the_time_left(tmp_path: Path) -> None:
    told: list[Progress] = []
    swept(tmp_path / "out", tmp_path, tell=told.append)
    assert [p.done for p in told] == list(range(9))
    assert told[0].left_s is None
    assert all(p.left_s is not None and p.left_s >= 0 for p in told[1:])
    assert told[-1].left_s == 0
    assert [time_left(s) for s in (5, 600, 9000)] == ["5 s", "10 min", "2.5 h"]


# --- trials -------------------------------------------------------------------------------------


def test_a_trial_is_a_function_of_its_scenario_on_every_engine(tmp_path: Path) -> None:
    study, made, path = study_of(tmp_path)
    one = [made[0]]
    broken = Trial("broken", {"links.rate_bps": 1, "sharing.policy": "x", "seed": 1}, "no = 1")
    outs = [tmp_path / name for name in ("here", "dask")]
    for out, engine in zip(outs, (in_turn, on_dask(2)), strict=True):
        result = sweep(study, [*one, broken], out, engine, source=path.read_text())
        assert (result.done, result.failed) == (2, 1)
    assert (outs[0] / FILE).read_bytes() == (outs[1] / FILE).read_bytes()
    for trial in one:
        summaries = [(out / "trials" / trial.id / "summary.json").read_bytes() for out in outs]
        assert summaries[0] == summaries[1]
        assert json.loads((outs[1] / "trials" / trial.id / "host.json").read_text())["wall_s"] > 0
    assert "ScenarioError" in (outs[1] / "trials" / "broken" / "error.log").read_text()
    assert "there is no such key" in str(read_table(outs[1])[1]["error"])
    left = [path.name for path in outs[1].iterdir() if path.name.startswith(".")]
    assert left == [".ropeteam-run"]


def crash(text: str, death_log: str) -> Told:
    """Stand in for a trial: one takes its whole process down."""
    if text == "crash":
        Path(death_log).write_text("where it was")
        os.kill(os.getpid(), signal.SIGKILL)
    return told_of(1.0)


def test_a_trial_that_kills_its_process_is_told_and_the_others_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engines, "measure", crash)
    monkeypatch.setattr(engines, "DEATHS", 2)
    given = [Trial(name, {"seed": 1}, name) for name in ("one", "crash", "two", "three")]
    told = {trial.id: result for trial, result in on_dask(1)(given, tmp_path)}
    assert {name for name, result in told.items() if result.state == "done"} == {
        "one",
        "two",
        "three",
    }
    assert told["crash"].error == "its process died (2 times)"
    assert "KilledWorker" in told["crash"].log
    assert "where it was" in told["crash"].log
    assert list(tmp_path.iterdir()) == []


def test_a_scheduler_that_does_not_answer_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engines, "CONNECT_S", 0.5)
    trial = Trial("one", {"seed": 1}, "x")
    with pytest.raises(StudyError, match="no Dask scheduler answers there"):
        list(on_dask(scheduler="tcp://127.0.0.1:9")([trial], tmp_path))


def test_a_cluster_is_used_by_its_address(tmp_path: Path) -> None:
    from distributed import LocalCluster  # noqa: PLC0415  (slow to import)

    _, made, _ = study_of(tmp_path)
    with LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        dashboard_address=":0",
        local_directory=tmp_path,
    ) as cluster:
        address = cluster.scheduler_address
        ((trial, told),) = on_dask(scheduler=address)(made[:1], tmp_path)
    assert (trial, told.state) == (made[0], "done")
    assert told.summary == measure(made[0].text).summary


def test_measures_by_hand(tmp_path: Path) -> None:
    lines = ["t_s,robot,map_cells", "0,a,0", "0,b,0", "10,a,60", "10,b,40", "30,a,80", "30,b,90"]
    (tmp_path / "maps.csv").write_text("\n".join(lines))
    (tmp_path / "events.csv").write_text("t_s,robot,what,detail\n25.5,bot,reached,\n")
    summary = {"team": {"observable_cells": 100}, "mission": {"cliffbot_reached": True}}
    found = measures_of(tmp_path, summary, limit_s=50.0)
    assert (found["team.mapped_50_s"], found["team.mapped_80_s"]) == (10.0, 30.0)
    # 0 for 10 s, 0.5 for 20 s, 0.85 for the 20 s that are left
    assert found["team.coverage_mean"] == pytest.approx((0.5 * 20 + 0.85 * 20) / 50)
    assert found["mission.reached_at_s"] == 25.5
    never = measures_of(tmp_path, {"team": {"observable_cells": 1000}, "mission": {}}, 50.0)
    assert never["team.mapped_50_s"] is None
    assert "mission.reached_at_s" not in never


# --- the table ----------------------------------------------------------------------------------

numbers = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**40), 2**40), st.floats(allow_nan=False), st.text()
)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.dictionaries(st.sampled_from("abcd"), numbers), min_size=1, max_size=6))
def test_any_rows_come_back_from_the_table_or_as_their_words(
    tmp_path_factory: pytest.TempPathFactory, rows: list[Row]
) -> None:
    path = tmp_path_factory.mktemp("table") / FILE
    write_table(path, [{"trial": "x", **row} for row in rows], {"study": "s"})
    back = read_table(path)
    for name in {name for row in rows for name in row}:
        values = [row.get(name) for row in rows]
        kinds = {type(value) for value in values if value is not None}
        for before, after in zip(values, (row[name] for row in back), strict=True):
            mixed = len(kinds) > 1 and kinds != {int, float}
            assert after == (str(before) if mixed and before is not None else before)


def test_a_folder_without_a_study_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="holds no study"):
        read_table(tmp_path)
    (tmp_path / FILE).write_bytes(b"PAR1 not at all")
    with pytest.raises(StudyError, match="can't be read as Parquet"):
        read_table(tmp_path)


# --- the picture --------------------------------------------------------------------------------


def made_up() -> list[Row]:
    rows: list[Row] = []
    for policy in ("value", "raw"):
        for rate in (300, 9600, 1_000_000):
            for seed in (1, 2, 3):
                y = None if (policy, rate, seed) == ("raw", 300, 1) else rate / 1e6 + seed
                row: Row = {"rate": rate, "policy": policy, "seed": seed, "y": y, "state": "done"}
                rows.append(row)
    rows.append({"rate": 300, "policy": "raw", "seed": 4, "y": 1e9, "state": "failed"})
    return rows


def test_lines_hold_means_intervals_and_who_is_missing() -> None:
    raw, value = lines_of(made_up(), "rate", "y", "policy")
    assert (raw.name, value.name) == ("raw", "value")
    assert [p.x for p in value.points] == [300, 9600, 1_000_000]
    expected = estimate([0.0003 + seed for seed in (1, 2, 3)])
    assert value.points[0].y == expected
    # By hand: the mean of 1, 2, 3 with Student's t = 4.303 and s / sqrt(3) = 0.577
    assert expected.mean == pytest.approx(2.0003)
    assert expected.half_width == pytest.approx(4.3027 / math.sqrt(3), abs=1e-3)
    assert (raw.points[0].trials, raw.points[0].share) == (3, pytest.approx(2 / 3))


def test_a_picture_is_drawn_of_numbers_words_and_what_is_missing(tmp_path: Path) -> None:
    for x, by in (("rate", "policy"), ("policy", "rate"), ("rate", None)):
        path = tmp_path / f"{x}.png"
        (table,) = draw_study(path, made_up(), x=x, y=["y"], by=by, title="T")
        assert path.read_bytes().startswith(b"\x89PNG")
        assert len(table.rows) == (3 if by is None else 6)
    only = chosen(made_up(), ["policy=value", "rate=300"])
    assert [row["seed"] for row in only] == [1, 2, 3]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"x": "rates"}, "rates: there is no such column; there are: rate, policy"),
        ({"y": ["policy"]}, "no trial has a number there"),
        ({"by": "nothing"}, "there is no such column"),
    ],
)
def test_what_cannot_be_drawn_is_refused(
    tmp_path: Path, options: dict[str, Any], words: str
) -> None:
    with pytest.raises(StudyError, match=words):
        draw_study(
            tmp_path / "f.png", made_up(), **{"x": "rate", "y": ["y"], "by": None, **options}
        )
    for condition in ("rate", "speed=1", "rate=7"):
        with pytest.raises(StudyError, match=r"--where|no such column"):
            chosen(made_up(), [condition])
    assert not (tmp_path / "f.png").exists()


# --- the commands -------------------------------------------------------------------------------


def test_the_commands_sweep_go_on_and_plot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engines, "on_dask", lambda jobs, scheduler: Bench())
    study_of(tmp_path)
    file, out = str(tmp_path / "tiny.toml"), str(tmp_path / "out")
    assert cli.main(["sweep", file, "--out", out, "--seeds", "1", "--jobs", "1"]) == 0
    assert "4 of 4 trials have ended" in capsys.readouterr().out
    assert (tmp_path / "out" / "figure.png").is_file()
    assert cli.main(["sweep", file, "--out", out]) == 0
    assert "(4 were there already)" in capsys.readouterr().out
    plot = ["plot", out, "--x", "links.rate_bps", "--y", "team.coverage"]
    assert cli.main([*plot, "--by", "sharing.policy", "--where", "seed=1"]) == 0
    assert "links.rate_bps-team.coverage.png" in capsys.readouterr().out
    assert cli.main([*plot, "--by", "policy"]) == 2
    assert "sharing.policy" in capsys.readouterr().err
    bad = ["sweep", file, "--out", out, "--jobs"]
    assert cli.main([*bad, "0"]) == 2
    assert cli.main([*bad, "1", "--scheduler", "tcp://x:1"]) == 2
    assert cli.main(["sweep", "nothing-here"]) == 2
    assert "bandwidth" in capsys.readouterr().err
    assert cli.main(["plot", str(tmp_path), "--x", "a", "--y", "b"]) == 2


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_ctrl_c_leaves_a_sweep_that_can_be_gone_on_with(tmp_path: Path) -> None:
    study, made, _ = study_of(tmp_path, TINY.replace("limit_s = 40", "limit_s = 120"), seeds=6)
    out = tmp_path / "out"
    command = [sys.executable, "-m", "scenarios.cli", "sweep", str(tmp_path / "tiny.toml")]
    process = subprocess.Popen(
        [*command, "--out", str(out), "--seeds", "6", "--jobs", "1"],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline_s = time.monotonic() + 120
    while not list(out.glob("trials/*/trial.json")) and time.monotonic() < deadline_s:
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all of them
    said, errors = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "goes on from there" in said
    assert errors.splitlines()[-1] == "interrupted"
    assert "Traceback" not in errors
    ended = [trial for trial in made if read_trial(out, trial) is not None]
    assert 0 < len(ended) < len(made)
    assert sum(row["state"] == "done" for row in read_table(out)) == len(ended)
    rows = [row_of(trial, read_trial(out, trial)) for trial in made]
    assert [row["trial"] for row in rows] == [row["trial"] for row in read_table(out)]
    assert study.seeds == 6
