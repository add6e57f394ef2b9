import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from scenarios import cli, runner
from scenarios.errors import FolderError
from scenarios.records import folder
from scenarios.runner import RunOptions
from scenarios.schema import Scenario
from sim.errors import WorldError


class Runs:
    """Stands in for the runner: notes what it was asked for, or fails as it is told."""

    def __init__(self) -> None:
        self.calls: list[tuple[Scenario, Path, RunOptions]] = []
        self.fails: BaseException | None = None

    def run(self, scenario: Scenario, out: Path, options: RunOptions) -> None:
        self.calls.append((scenario, out, options))
        if self.fails is not None:
            raise self.fails


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Runs:
    made = Runs()
    monkeypatch.setattr(runner, "run", made.run)
    monkeypatch.chdir(tmp_path)
    return made


def exit_code(*argv: str) -> int:
    try:
        return cli.main(argv)
    except SystemExit as left:
        return -1 if left.code is None else int(left.code)


def refusal(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    """Return the one line on stderr that a refused command leaves."""
    assert exit_code(*argv) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert "Traceback" not in told.err
    assert told.err.endswith("\n")
    return told.err[:-1]


def test_a_run_gets_what_was_asked_for(runs: Runs) -> None:
    argv = ["run", "cliff", "--seed", "7", "--out", "here", "--quiet", "--clock", "real"]
    assert exit_code(*argv, "--speed", "20", "--set", "links.profile=sojourner") == 0
    ((scenario, out, options),) = runs.calls
    assert (scenario.seed, scenario.clock.mode, scenario.clock.speed) == (7, "real", 20)
    assert scenario.links.profile == "sojourner"
    assert out == Path("here")
    assert options == RunOptions(quiet=True)


def test_a_run_is_watched_as_was_asked_for(runs: Runs) -> None:
    assert exit_code("run", "cliff", "--view", "--no-browser", "--paused", "--port", "8011") == 0
    page = runs.calls[0][2].page
    assert page is not None
    assert (page.opens, page.paused, page.port) == (False, True, 8011)


def test_the_clock_of_the_command_line_replaces_that_of_the_file(runs: Runs) -> None:
    real = ["--set", "clock.mode=real", "--set", "clock.speed=9"]
    assert exit_code("run", "cliff", *real) == 0
    Path("mine.toml").write_text(
        'name="mine"\nlimit_s=9\nrobots.count=1\nclock={mode="real",speed=5.0}\n'
    )
    assert exit_code("run", "mine.toml", "--clock", "virtual") == 0
    assert exit_code("run", "mine.toml", "--speed", "2") == 0
    clocks = [(s.clock.mode, s.clock.speed) for s, _, _ in runs.calls]
    assert clocks == [("real", 9), ("virtual", 1), ("real", 2)]


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        ("", "COMMAND"),
        ("fly cliff", "there is no fly"),
        ("run", "NAME|FILE"),
        ("run clif", "did you mean cliff?"),
        ("run no/such.toml", "no such file"),
        ("run cliff --seed x", "'x' is no whole number"),
        ("run cliff --seed -1", "--seed -1: seed = -1"),
        ("run cliff --se 3", "--se"),
        ("run cliff --clock sun", "there is no sun"),
        ("run cliff --speed fast", "'fast' is no number"),
        ("run cliff --speed 2", "--clock real"),
        ("run cliff --speed 1", "--clock real"),
        ("run cliff --clock virtual --speed 2", "--clock real"),
        ("run cliff --clock real --speed 0", "a number above 0"),
        ("run cliff --clock real --speed -1", "a number above 0"),
        ("run cliff --clock real --speed nan", "a number above 0"),
        ("run cliff --clock real --speed inf", "a number above 0"),
        ("run cliff --set links.rate=3", "did you mean rate_bps?"),
        ("run cliff --set links", "must be KEY=VALUE"),
        ("check clif", "did you mean cliff?"),
    ],
)
def test_bad_input_is_refused_in_one_line_and_nothing_is_written(
    argv: str, words: str, runs: Runs, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    told = refusal(capsys, *argv.split())
    assert words in told
    assert "\n" not in told
    assert not runs.calls
    assert not list(tmp_path.iterdir())


def test_a_bad_world_is_bad_input(runs: Runs, capsys: pytest.CaptureFixture[str]) -> None:
    runs.fails = WorldError("x.npz: has no elevation")
    assert refusal(capsys, "run", "cliff") == "cliff: x.npz: has no elevation"


def test_ctrl_c_exits_with_130(runs: Runs) -> None:
    runs.fails = KeyboardInterrupt()
    assert exit_code("run", "cliff") == 130


def test_a_ctrl_c_in_code_made_of_text_exits_with_130_too(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(
        "import scenarios.schema\n"
        "def load(*_, **__):\n    exec('raise KeyboardInterrupt')\n"
        "scenarios.schema.load = load\n"
    )
    path = os.pathsep.join((str(tmp_path), str(Path(__file__).parents[1])))
    done = subprocess.run(
        [sys.executable, "-m", "scenarios.cli", "check", "cliff"],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


def test_a_ctrl_c_that_falls_into_a_destructor_counts(
    runs: Runs, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Last:
        def __del__(self) -> None:
            raise KeyboardInterrupt

    def run(*_: object) -> None:
        del last[:]
        time.sleep(10)

    last = [Last()]
    monkeypatch.setattr(runner, "run", run)
    # Tests that a shell runs in the background ignore Ctrl-C from the start.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert exit_code("run", "cliff") == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "interrupted\n"


def test_a_fault_of_ours_exits_with_1_and_shows_where(
    runs: Runs, capsys: pytest.CaptureFixture[str]
) -> None:
    runs.fails = ZeroDivisionError("oh")
    assert exit_code("run", "cliff") == 1
    told = capsys.readouterr().err
    assert "ZeroDivisionError: oh" in told
    assert "fault of the program" in told


def test_list_and_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code("list") == 0
    listed = capsys.readouterr().out
    assert re.search("^cliff +Four robots", listed, re.MULTILINE)
    assert re.search("^bandwidth +What 300 bps", listed, re.MULTILINE)
    assert "pair " in listed
    assert exit_code("--version") == 0
    assert capsys.readouterr().out.startswith("ropeteam ")


@pytest.mark.parametrize("argv", [("--help",), ("run", "--help")])
def test_help_has_examples_that_work(argv: tuple[str, ...], runs: Runs, capsys: Any) -> None:
    assert exit_code(*argv) == 0
    helped = capsys.readouterr().out
    Path("ground.npz").touch()
    lines = [line.strip() for line in helped.splitlines() if line.startswith("  ropeteam run")]
    commands = [line.split("  ")[0].split()[1:] for line in lines]
    assert len(commands) >= 5
    for command in commands:
        if not command[1].startswith("runs/"):
            assert exit_code(*command) == 0, command


def test_check_tells_of_every_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text('name="bad"\nlimit_s=-1\nrobots.count=1\n')
    torn = tmp_path / "torn.npz"
    torn.write_bytes(b"no archive")
    ground = tmp_path / "ground.toml"
    ground.write_text(f'name="g"\nlimit_s=9\nrobots.count=1\nworld.terrain.file="{torn}"\n')
    assert exit_code("check", "pair", str(bad), str(ground)) == 2
    told = capsys.readouterr()
    assert told.out == "pair: fine (explorer-1, explorer-2)\n"
    first, second = told.err.splitlines()
    assert "limit_s = -1" in first
    assert "torn.npz" in second
    assert exit_code("check", "cliff") == 0


def test_light_commands_import_nothing_heavy() -> None:
    code = (
        "import sys; from scenarios.cli import main; main(['list']);"
        "print(sorted({'numpy', 'pydantic', 'rich', 'numba'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_folder_of_something_else_is_never_written_to(
    runs: Runs, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("mine").mkdir()
    Path("mine/summary.json").write_text("precious")
    Path("file").touch()
    for out, words in (("mine", "no former run"), ("file", "is a file"), ("file/x", "is a file")):
        for extra in ([], ["--overwrite"]):
            assert words in refusal(capsys, "run", "cliff", "--out", out, *extra)
            with pytest.raises(FolderError):
                folder.prepare(Path(out), overwrite=True)
    assert Path("mine/summary.json").read_text() == "precious"
    assert not runs.calls


def test_a_former_run_is_replaced_only_when_asked_for_and_only_its_own_files(
    runs: Runs, capsys: pytest.CaptureFixture[str]
) -> None:
    out = Path("old")
    folder.prepare(out, overwrite=False)
    for name in ("summary.json", "recon.mcap", "robots/recon/layer", "notes.txt"):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text("old")
    assert "--overwrite" in refusal(capsys, "run", "cliff", "--out", "old")
    assert exit_code("run", "cliff", "--out", "old", "--overwrite") == 0
    assert runs.calls[0][2].overwrite
    folder.prepare(out, overwrite=True)
    assert sorted(path.name for path in out.iterdir()) == [folder.MARK, "notes.txt"]


def test_a_run_without_out_finds_a_free_folder(runs: Runs) -> None:
    for _ in range(3):
        assert exit_code("run", "cliff", "--seed", "4") == 0
        folder.prepare(runs.calls[-1][1], overwrite=False)
        (runs.calls[-1][1] / "summary.json").touch()
    assert exit_code("run", "cliff", "--seed", "4", "--overwrite") == 0
    outs = [str(out) for _, out, _ in runs.calls]
    assert outs == ["runs/cliff-4", "runs/cliff-4-2", "runs/cliff-4-3", "runs/cliff-4"]


def test_a_folder_for_kernels_that_takes_nothing_is_told(tmp_path: Path) -> None:
    """In a process of its own: the folder is settled when kernels are first imported."""
    taken = tmp_path / "file"
    taken.write_text("not a folder")
    done = subprocess.run(
        [sys.executable, "-m", "scenarios.cli", "run", "pair", "--out", str(tmp_path / "run")],
        env={**os.environ, "ROPETEAM_CACHE": str(taken)},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr == (
        f"{taken}: compiled kernels can't be kept there (Not a directory); name a folder that can"
        " be written to: ROPETEAM_CACHE=DIR\n"
    )
    assert not (tmp_path / "run").exists()
