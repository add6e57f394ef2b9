"""What goes wrong in somebody's first hour is told in one sentence that says what to do."""

import os
import resource
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from run_helpers import LOW_CLIFF, SMALL, session_of

from comms.timebase import to_s
from scenarios import cli
from scenarios.logs.notebook import LogFile, Notebook
from scenarios.records.tables import EventRow
from scenarios.view.desk import Watched
from scenarios.view.livepage import LivePage

ROOT = Path(__file__).parents[1]
TINY = [word for one in (*SMALL, *LOW_CLIFF, "limit_s=20") for word in ("--set", one)]
AIRS = ["memory", pytest.param("zenoh", marks=pytest.mark.slow)]


def refusal(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    """Return the one line with which a command is refused."""
    assert cli.main(argv) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1, told
    return told


def test_a_python_that_is_too_old_is_named(tmp_path: Path) -> None:
    old = tmp_path / "python3.9"
    old.write_text("#!/bin/sh\nexit 1\n")  # as one that finds itself older than 3.11
    old.chmod(0o755)
    made = subprocess.run(
        ["make", "-C", ROOT, "setup", f"VENV={tmp_path / 'venv'}", f"PYTHON={old}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert made.returncode != 0
    assert f"needs Python 3.11 or later; tried: {old}. Name one: make PYTHON=" in made.stderr
    assert "Traceback" not in made.stderr
    assert not (tmp_path / "venv").exists()


def test_a_python_that_lacks_our_packages() -> None:
    bare = [sys.executable, "-S", "-m", "scenarios.cli", "run", "cliff"]  # -S: no site-packages
    made = subprocess.run(bare, cwd=ROOT, capture_output=True, text=True, check=False)
    assert made.returncode == 2
    assert made.stderr.count("\n") == 1
    assert "not installed for" in made.stderr
    assert "make setup" in made.stderr


def test_a_port_in_use(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        view = ("--view", "--no-browser", "--port", port)
        told = refusal(capsys, "run", "cliff", *TINY, *view, "--out", str(tmp_path / "run"))
    assert port in told


def test_no_browser_is_said_and_the_run_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    said: list[str] = []
    page = LivePage(say=said.append)

    play = SimpleNamespace(reel=SimpleNamespace(head={}), desk=None)
    try:
        page.begin(cast("Watched", play), "a run")
    finally:
        page.close()
    assert said[0].startswith("Live view: http://127.0.0.1:")
    assert said[1] == "No browser can be opened here: open the address yourself."


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["run", "clif"], "did you mean cliff?"),
        (["run", "mine.toml"], "no such file"),
        (["run", "cliff", "--set", "links.rate=600"], "did you mean rate_bps?"),
        (["run", "cliff", "--set", "world.terrain.file=ground.npz"], "no such file"),
        (["runn", "cliff"], "there is no runn, did you mean run? choose from run, "),
        (["report", "runs/none"], "runs/none"),
        (["export", "runs/none", "--format", "tum"], "runs/none"),
        (["compare", "runs/a", "runs/b"], "runs/a"),
        (["sweep", "bandwith"], "allowed: bandwidth"),
    ],
)
def test_a_typo_or_a_missing_file(
    argv: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    try:
        code = cli.main(argv)
    except SystemExit as left:
        code = left.code
    told = capsys.readouterr().err
    assert code == 2
    assert words in told
    assert told.count("\n") == 1, told
    assert not list(tmp_path.iterdir())


def test_a_folder_that_may_not_be_written_to(capsys: pytest.CaptureFixture[str]) -> None:
    told = refusal(capsys, "run", "cliff", *TINY, "--quiet", "--out", "/proc/mine")
    assert told.startswith("--out /proc/mine: can't be written: ")


@pytest.mark.parametrize("command", [("chaos", "pair", "--small"), ("soak",)])
@pytest.mark.parametrize("out", ["/proc/mine.json", "."])
def test_a_file_that_may_not_be_written_is_refused_before_the_work(
    command: tuple[str, ...], out: str, capsys: pytest.CaptureFixture[str]
) -> None:
    told = refusal(capsys, *command, "--out", out)
    assert told.startswith(f"--out {out}: ")


def test_a_folder_that_holds_a_run_is_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / ".ropeteam-run").write_text("a run")
    told = refusal(capsys, "run", "cliff", "--out", str(tmp_path))
    assert "holds a former run; must be empty, or add --overwrite" in told


def ropeteam(*argv: str, largest_bytes: int | None = None) -> subprocess.Popen[str]:
    """Start the command line in a session of its own, where no file may get larger."""

    most = "unlimited" if largest_bytes is None else str(largest_bytes // 1024)
    limited = ["bash", "-c", f'ulimit -f {most}; exec "$@"', "bash"]
    return subprocess.Popen(
        [*limited, sys.executable, "-m", "scenarios.cli", *argv],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        start_new_session=True,
    )


@pytest.mark.parametrize("air", AIRS)
def test_a_full_disk_ends_logs_not_robots_and_is_told_in_the_end(tmp_path: Path, air: str) -> None:
    out = tmp_path / "out"
    words = ("run", "cliff", *TINY, "--set", f"air={air}", "--set", "limit_s=200", "--quiet")
    process = ropeteam(*words, "--out", str(out), largest_bytes=20 * 1024)
    _, told = process.communicate(timeout=100)
    assert told.count("\n") == 1, told
    assert told.startswith(f"{out}: takes no more files of this run: File too large")
    assert process.returncode == 2
    assert session_of(process.pid) == []
    assert max(path.stat().st_size for path in out.glob("*.mcap")) == 20 * 1024


def test_a_log_that_the_disk_refuses_ends_and_says_so(tmp_path: Path) -> None:
    log = LogFile(tmp_path / "r.mcap")
    notebook = Notebook("r", log, lambda: 7)
    row = EventRow(to_s(7), "r", "activity", "x" * 1000)
    notebook.add(row, 7)
    notebook.take()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, hard))
        for _ in range(100):
            notebook.add(row, 7)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    notebook.close()
    told = [wire for wire in notebook.rows if "its log ends here: File too large" in str(wire)]
    assert len(told) == 1, "once, and the rows go on to the runner"
    assert len(notebook.rows) == 101
    assert (tmp_path / "r.mcap").stat().st_size == 3000


def assert_nobody_is_left(process: subprocess.Popen[str]) -> None:
    deadline_s = time.monotonic() + 10  # the servers that started the others take a moment
    while session_of(process.pid) and time.monotonic() < deadline_s:
        time.sleep(0.05)
    assert session_of(process.pid) == []


@pytest.mark.parametrize("air", AIRS)
def test_ctrl_c_twice_ends_at_once_and_leaves_nobody_behind(tmp_path: Path, air: str) -> None:
    out = tmp_path / "out"
    longer = ("--set", "limit_s=7000", "--set", f"air={air}", "--set", "planner.max_looks=200")
    process = ropeteam("run", "cliff", *TINY, *longer, "--out", str(out))
    deadline_s = time.monotonic() + 60
    log = out / "recon.mcap"
    while not (log.is_file() and log.stat().st_size > 3000) and time.monotonic() < deadline_s:
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    for _ in range(2):
        os.killpg(process.pid, signal.SIGINT)
        time.sleep(0.15)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 130
    assert told == "interrupted\n"
    assert_nobody_is_left(process)


@pytest.mark.slow
def test_ctrl_c_ends_an_experiment_with_all_its_workers_at_once(tmp_path: Path) -> None:
    out = tmp_path / "out"
    sets = ("--set", "method=team-information", "--seeds", "4", "--jobs", "2")
    process = ropeteam("experiment", "planar-one", *sets, "--quiet", "--out", str(out))
    deadline_s = time.monotonic() + 60
    while len(session_of(process.pid)) < 3 and time.monotonic() < deadline_s:
        assert process.poll() is None, process.communicate()
        time.sleep(0.1)
    time.sleep(3)  # the workers, each a minute from its end, are at work
    os.killpg(process.pid, signal.SIGINT)
    _, told = process.communicate(timeout=15)
    assert process.returncode == 130
    assert told == "interrupted\n"
    assert_nobody_is_left(process)
