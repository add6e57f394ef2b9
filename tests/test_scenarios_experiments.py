"""The frame of the experiments: trials in, files out, the same for any number of processes."""

import csv
import json
import pickle
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import pytest

from scenarios import cli, experiments
from scenarios.commands import experiment as command
from scenarios.commands import run as run_command
from scenarios.errors import StudyError, UsageError
from scenarios.experiments import EXPERIMENTS, frame
from scenarios.experiments.frame import Claim, Experiment, Findings, Options
from scenarios.experiments.tables import Row, Table, as_csv, as_text, estimate, rows_csv
from scenarios.records import folder
from scenarios.runner import RobotFaultError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def trials(options: Options) -> Sequence[int]:
    return [seed * round(options.number("scale", 1.0)) for seed in range(1, options.seeds + 1)]


def measure(trial: int) -> Sequence[Row]:
    if trial == 13:
        raise UsageError("trial 13 is out of luck")
    MEASURED.append(trial)
    value = float(np.random.default_rng(trial).normal())
    return [{"seed": trial, "value": value}, {"seed": trial, "note": "a, b"}]


def conclude(rows: Sequence[Row]) -> Findings:
    values = [float(row["value"]) for row in rows if "value" in row]
    table = Table("means", "Means", ["what", "mean"], [["all", estimate(values)]], ["", ".3f"])
    claim = Claim(
        "values are low", "Fig. 0", max(values) < 9, max(values), "The largest was small."
    )
    return Findings([table], [claim])


def draw(figure: "Figure", rows: Sequence[Row]) -> None:
    figure.subplots().plot([float(row["value"]) for row in rows if "value" in row])


TOY = Experiment(trials, measure, conclude, draw, {"scale": "of the seeds"})


@pytest.fixture(autouse=True)
def toy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a toy experiment among the others."""
    module = ModuleType("scenarios.experiments.toy_one")
    module.EXPERIMENT = TOY  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "scenarios.experiments.toy_one", module)
    monkeypatch.setitem(experiments.EXPERIMENTS, "toy-one", "a toy")
    monkeypatch.setattr(cli, "COMMANDS", (run_command, command))


def files(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(out.iterdir()) if path.is_file()}


MEASURED: list[int] = []


def test_a_stopped_experiment_goes_on_and_finds_the_same(tmp_path: Path) -> None:
    out, whole = tmp_path / "out", tmp_path / "whole"
    with pytest.raises(UsageError, match="out of luck"):
        frame.run("toy-one", Options(14), out, jobs=1)
    MEASURED.clear()
    frame.run("toy-one", Options(12), out, jobs=1, resume=True)
    assert MEASURED == []
    frame.run("toy-one", Options(12, {"scale": ["2"]}), out, jobs=1, resume=True)
    assert MEASURED == [14, 16, 18, 20, 22, 24]  # of 2, 4 ... 24 the others were there
    frame.run("toy-one", Options(12, {"scale": ["2"]}), whole, jobs=1)
    assert files(out) == files(whole)


def test_an_experiment_does_not_go_on_with_something_else(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="holds no experiment 'toy-one'"):
        frame.run("toy-one", Options(2), tmp_path / "none", jobs=1, resume=True)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / folder.MARK).write_text("of another kind")
    with pytest.raises(StudyError, match="holds no experiment 'toy-one'"):
        frame.run("toy-one", Options(2), tmp_path / "run", jobs=1, resume=True)
    frame.run("toy-one", Options(2), tmp_path / "out", jobs=1)
    (tmp_path / "out" / "trials" / "experiment").write_text("another")
    with pytest.raises(StudyError, match="holds no experiment 'toy-one'"):
        frame.run("toy-one", Options(2), tmp_path / "out", jobs=1, resume=True)
    with pytest.raises(UsageError, match="--resume --overwrite"):
        frame.run("toy-one", Options(2), tmp_path / "out", jobs=1, resume=True, overwrite=True)


def test_an_experiment_leaves_rows_tables_claims_and_a_figure(tmp_path: Path) -> None:
    findings = frame.run("toy-one", Options(3, {"scale": ["2"]}), tmp_path / "out", jobs=1)
    left = files(tmp_path / "out")
    assert set(left) == {folder.MARK, "rows.csv", "means.csv", "experiment.json", "figure.png"}
    rows = list(csv.DictReader(left["rows.csv"].decode().splitlines()))
    assert [row["seed"] for row in rows] == ["2", "2", "4", "4", "6", "6"]
    told = json.loads(left["experiment.json"])
    assert (told["experiment"], told["seeds"], told["sets"]) == ("toy-one", 3, {"scale": ["2"]})
    assert told["claims"][0]["held"] is True
    assert told["claims"][0]["number"] == findings.claims[0].number
    assert told["tables"][0]["rows"][0][1]["count"] == 3
    assert left["figure.png"].startswith(b"\x89PNG")


def test_files_are_the_same_for_any_number_of_processes(tmp_path: Path) -> None:
    for jobs in (1, 2):
        frame.run("toy-one", Options(4), tmp_path / str(jobs), jobs=jobs)
    assert files(tmp_path / "1") == files(tmp_path / "2")


def test_a_trial_that_cannot_be_leaves_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(StudyError, match="trial 13"):
        frame.run("toy-one", Options(2, {"scale": ["13"]}), out, jobs=1)
    assert not out.exists()
    assert str(pickle.loads(pickle.dumps(UsageError("from a process")))) == "from a process"


def test_the_command_prints_tables_and_verdicts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    argv = ["experiment", "toy-one", "--seeds", "2", "--jobs", "1", "--out", str(out)]
    assert cli.main(argv) == 0
    told = capsys.readouterr()
    assert "held: values are low (Fig. 0)" in told.out
    assert str(out) in told.out
    assert told.err == ""
    assert cli.main(argv) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert cli.main([*argv, "--overwrite", "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_without_out_a_free_folder_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    argv = ["experiment", "toy-one", "--seeds", "1", "--quiet"]
    for _ in range(2):
        assert cli.main(argv) == 0
    assert cli.main([*argv, "--overwrite"]) == 0
    names = sorted(path.name for path in Path("runs").iterdir())
    assert names == ["experiment-toy-one-1", "experiment-toy-one-1-2"]


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        ("nothing", "no experiment 'nothing'"),
        ("toy-one --seeds 0", "--seeds 0"),
        ("toy-one --jobs 0", "--jobs 0"),
        ("toy-one --set scale", "must be KEY=VALUE"),
        ("toy-one --set size=3", "knows no 'size'; it knows: scale"),
        ("toy-one --set scale=-1", "scale=-1: must be a number above 0"),
        ("toy-one --set scale=x", "scale=x: must be a number above 0"),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_is_written(
    argv: str,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["experiment", *argv.split()]) == 2
    told = capsys.readouterr()
    assert words in told.err
    assert told.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [name for name in EXPERIMENTS if name != "toy-one"])
def test_every_experiment_that_is_listed_is_there(name: str) -> None:
    assert isinstance(frame.load(name), Experiment)


# --- tables ---------------------------------------------------------------------------------------


def test_an_interval_by_hand() -> None:
    # t(0.975, 2) = 4.3027; the values' deviation is 1.
    found = estimate([1.0, 2.0, 3.0])
    assert (found.mean, found.count) == (2.0, 3)
    assert found.half_width == pytest.approx(4.302653 / 3**0.5)
    assert f"{found:.1f}" == "2.0 ± 2.5"
    assert f"{estimate([5.0]):.1f}" == "5.0"
    assert estimate([5.0]).half_width is None


def test_about_95_of_100_intervals_hold_the_truth() -> None:
    rng = np.random.default_rng(0)
    hit = 0
    for _ in range(400):
        found = estimate(rng.normal(size=5).tolist())
        assert found.half_width is not None
        hit += abs(found.mean) <= found.half_width
    assert 0.92 < hit / 400 < 0.98


def test_tables_as_text_and_as_csv() -> None:
    rows = [["one", 1, estimate([1.0, 3.0])], ["three", 3000, estimate([2.0])]]
    table = Table("t", "A title", ["name", "n", "mean"], rows, ["", ",", ".1f"])
    assert as_text(table).splitlines() == [
        "A title",
        "name       n        mean",
        "one        1  2.0 ± 12.7",
        "three  3,000         2.0",
    ]
    header, one, three = csv.reader(as_csv(table).splitlines())
    assert header == ["name", "n", "mean", "mean low", "mean high"]
    assert one[:3] == ["one", "1", "2.0"]
    assert [float(end) for end in one[3:]] == pytest.approx([-10.7062, 14.7062], abs=1e-4)
    assert three == ["three", "3000", "2.0", "", ""]


def test_rows_of_different_kinds_share_a_file() -> None:
    text = rows_csv([{"a": 1}, {"b": "x, y", "a": 2}])
    assert text == 'a,b\n1,\n2,"x, y"\n'


def test_a_fault_of_a_robot_travels_from_a_worker_process() -> None:
    fault = pickle.loads(pickle.dumps(RobotFaultError("recon", "ValueError: byte")))
    assert str(fault) == "recon's program failed:\nValueError: byte"
