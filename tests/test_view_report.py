"""A run's report is one file that asks nothing of the network; runs are compared by their files."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from run_helpers import Ran, run_of, small

from scenarios.cli import main
from scenarios.commands.parsing import BAD_INPUT, OK
from scenarios.schema import load
from scenarios.view.compare import (
    as_text,
    coverage_curve,
    difference,
    differs,
    read_all,
    sent_curve,
    write_comparison,
)
from scenarios.view.growth import grown
from scenarios.view.page import MODULES, asset, served
from scenarios.view.playback import read_playback
from scenarios.view.report import write_report
from scenarios.view.rundir import read_run
from scenarios.view.varied import Value, varied

QUICK = ("planner.max_looks=3", "limit_s=240", "map.cell_m=0.4", "sensor.columns=32")
KILLED = [{"at_s": 100.0, "restart": "explorer-2", "after_s": 20.0}]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    scenario = small("pair", *QUICK, 'title="<b>Pair</b> & co"', events=KILLED)
    return run_of(scenario, tmp_path_factory.mktemp("run") / "pair")


@pytest.fixture(scope="module")
def floor(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    sets = ("air=memory", "world.window_m=[16.0, 16.0]", "planner.max_looks=4", "limit_s=400")
    return run_of(load("planar", sets), tmp_path_factory.mktemp("run") / "floor")


@pytest.mark.parametrize("which", ["ran", "floor"])
def test_the_playback_ends_in_the_maps_that_the_run_ended_with(
    which: str, request: pytest.FixtureRequest
) -> None:
    run: Ran = request.getfixturevalue(which)
    head, rows = read_playback(run.out)
    shape = (head["frame"]["rows"], head["frame"]["cols"])
    for index, robot in enumerate(head["robots"]):
        steps = [row for row in rows["growth"] if row[0] == index]
        assert steps == sorted(steps, key=lambda row: row[1])
        lives = [number for number, row in enumerate(steps) if row[3]]
        assert len(lives) == (2 if robot["name"] == "explorer-2" else 1)
        data = [row[4] for row in steps[lives[-1] :]]
        told = run.robot(robot["name"])
        shown, own = np.zeros(shape, np.uint16), np.zeros(shape, bool)
        for step in data:
            grown(shown, own, step)
        maps = [row for row in run.table("maps") if row["robot"] == robot["name"]]
        assert np.count_nonzero(shown) == maps[-1]["map_cells"]
        if told["own_cells"] and len(lives) == 1:
            assert 0 < np.count_nonzero(own) <= told["own_cells"]
    assert head["observable_cells"] == run.summary["team"]["observable_cells"]


def test_a_report_is_one_file_without_a_link_to_anywhere(ran: Ran) -> None:
    path = write_report(ran.out)
    text = path.read_text(encoding="utf-8")
    assert path == ran.out / "report.html"
    assert path.stat().st_size < 1_000_000
    outside = r"""(src|href)\s*=\s*["']?(?!data:)[^"'> ]|@import|url\(\s*["']?(?!data:)"""
    markup = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(outside, markup)
    assert "default-src 'none'" in text
    assert "<title>&lt;b&gt;Pair&lt;/b&gt; &amp; co" in text


def test_a_report_is_the_same_made_again(ran: Ran, tmp_path: Path) -> None:
    first = write_report(ran.out, tmp_path / "a.html").read_bytes()
    assert main(["report", str(ran.out), "--out", str(tmp_path / "b.html")]) == OK
    assert (tmp_path / "b.html").read_bytes() == first


def test_no_script_can_end_its_own_element() -> None:
    for name in (*(f"{m}.js" for m in MODULES), "report.js", "compare.js", "uPlot.iife.min.js"):
        assert "</script" not in asset(name).lower(), name


def test_scripts_import_each_other_by_names_that_exist() -> None:
    for name in (*MODULES, "report", "compare", "live"):
        wanted = re.findall(r'from "ropeteam/(\w+)"', asset(f"{name}.js"))
        assert set(wanted) <= set(MODULES), name
    assert all(f"ropeteam/{name}" in served("x") for name in MODULES)


BAD = {
    "no folder": shutil.rmtree,
    "no summary": lambda run: (run / "summary.json").unlink(),
    "broken summary": lambda run: (run / "summary.json").write_text("{"),
    "no table": lambda run: (run / "looks.csv").unlink(),
    "other table": lambda run: (run / "frames.csv").write_text("a,b\n1,2\n"),
    "broken table": lambda run: (run / "maps.csv").write_text(
        (run / "maps.csv").read_text().replace("explorer-1", "nobody")
    ),
    "no playback": lambda run: (run / "playback.bin").unlink(),
    "broken playback": lambda run: (run / "playback.bin").write_bytes(b"\x00" * 100),
}


@pytest.mark.parametrize("fault", BAD)
def test_what_is_no_run_is_refused_in_one_sentence(
    fault: str, ran: Ran, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    shutil.copytree(ran.out, run)
    BAD[fault](run)
    assert main(["report", str(run)]) == BAD_INPUT
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1
    assert str(run) in said


def test_an_out_that_can_not_be_written_is_refused(
    ran: Ran, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(ran.out), "--out", str(tmp_path / "no" / "r.html")]) == BAD_INPUT
    assert "can't be written" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (["--paused"], "--view"),
        (["--port", "80"], "--view"),
        (["--view", "--port", "70000"], "65535"),
    ],
)
def test_options_of_the_live_view_want_a_view(
    args: list[str], word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["run", "pair", "--out", str(out), *args]) == BAD_INPUT
    assert word in capsys.readouterr().err
    assert not out.exists()


def test_view_opens_a_former_runs_report(ran: Ran, tmp_path: Path) -> None:
    browser, told = tmp_path / "browser", tmp_path / "told"
    browser.write_text(f'#!/bin/sh\necho "$1" > {told}\n')
    browser.chmod(0o755)
    done = subprocess.run(
        [sys.executable, "-m", "scenarios.cli", "view", str(ran.out)],
        env={**os.environ, "BROWSER": str(browser)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"In the browser: {ran.out / 'report.html'}\n"
    assert told.read_text().strip() == (ran.out / "report.html").as_uri()


def test_view_says_where_a_report_is_that_no_browser_can_open(
    ran: Ran, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    assert main(["view", str(ran.out)]) == OK
    assert f"open {ran.out / 'report.html'} yourself" in capsys.readouterr().out


# --- runs side by side ---------------------------------------------------------------------------


def test_runs_are_set_side_by_side(
    ran: Ran, floor: Ran, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "c.html"
    assert main(["compare", str(ran.out), str(floor.out), "--out", str(out)]) == OK
    said = capsys.readouterr().out
    assert "team.coverage" in said
    assert str(out) in said
    assert "default-src 'none'" in out.read_text()
    runs = read_all([ran.out, floor.out])
    assert differs(runs, "scenario")
    assert not differs(runs, "seed")
    assert runs[0].values["sent_bytes"] == sum(
        robot["sent_bytes"] for robot in ran.summary["robots"].values()
    )


def test_what_was_set_differently_comes_first(ran: Ran, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(ran.out, other)
    told = (other / "scenario.toml").read_text()
    told = re.sub(r"^limit_s = .*", "limit_s = inf", told, flags=re.M)
    (other / "scenario.toml").write_text(
        told.replace('restart = "explorer-2"', 'kill = "explorer-1"')
    )
    runs = read_all([ran.out, other])
    lines = as_text(runs).splitlines()
    blank = lines.index("")
    assert lines[0].split() == ["set", "differently", *(run.label for run in runs)]
    assert any(line.startswith("limit_s") and line.endswith("inf") for line in lines[:blank])
    assert any(line.startswith("event 1") and "kill = explorer-1" in line for line in lines[:blank])
    assert write_comparison(runs, tmp_path / "c.html").stat().st_size > 10_000


@given(st.dictionaries(st.sampled_from("abc"), st.none() | st.integers(0, 1) | st.booleans()))
def test_settings_vary_where_runs_have_not_all_the_same(one: dict[str, Value]) -> None:
    other = {"a": 0, "b": True}
    found = dict(varied([one, other]))
    assert set(found) == {k for k in "abc" if repr(one.get(k)) != repr(other.get(k))}
    assert all(values == [one.get(k), other.get(k)] for k, values in found.items())
    assert varied([one, one, one]) == []


def test_a_scenario_that_is_no_toml_is_refused(
    ran: Ran, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(ran.out, tmp_path / "other")
    (tmp_path / "other" / "scenario.toml").write_text("a = ")
    assert main(["compare", str(ran.out), str(tmp_path / "other")]) == BAD_INPUT
    assert str(tmp_path / "other") in capsys.readouterr().err


def test_a_run_beside_itself_has_no_differences(ran: Ran) -> None:
    runs = read_all([ran.out, ran.out])
    assert runs[0].label != runs[1].label
    assert "%" not in as_text(runs)
    assert "set differently" not in as_text(runs)
    assert not any(differs(runs, key) for key in runs[0].values)


def test_one_run_is_no_comparison(ran: Ran, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(ran.out)]) == BAD_INPUT
    assert "two or more" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("first", "value", "words"),
    [
        (2.0, 3.0, "+50.0 %"),
        (200, 100, "-50.0 %"),
        (0, 5, "+5"),
        (1, 1000, "+999"),
        (1.0, 1.0, ""),
        (1.0, 1.0001, ""),
        (None, 1.0, ""),
        (True, False, ""),
        ("a", "b", ""),
    ],
)
def test_differences_are_told_in_words(first: object, value: object, words: str) -> None:
    assert difference(first, value) == words  # pyright: ignore[reportArgumentType]


def test_curves_are_those_of_the_tables(ran: Ran) -> None:
    run = read_run(ran.out)
    sent = sent_curve(run.frames)
    assert sent == sorted(sent)
    assert round(1000 * sent[-1][1]) == sum(r["sent_bytes"] for r in ran.summary["robots"].values())
    coverage = coverage_curve(run.looks)
    assert coverage[-1][1] == round(max(100 * float(row["coverage"]) for row in run.looks), 3)


def test_an_equal_label_is_told_apart(ran: Ran, tmp_path: Path) -> None:
    twin = tmp_path / ran.out.name
    shutil.copytree(ran.out, twin)
    labels = [run.label for run in read_all([ran.out, twin])]
    assert len(set(labels)) == 2
    assert json.loads((twin / "summary.json").read_text()) == ran.summary
