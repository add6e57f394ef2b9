"""Every `ropeteam` command in README.md and docs/ is run, page by page, in the page's own order."""

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from docs_helpers import PAGES, ROOT, Command, commands, scenarios, smaller, study
from run_helpers import LOW_CLIFF
from stereo_helpers import SENSOR, STEREO, shot
from test_docs_files import write_grounds

from agents.stereo.eyes import calibration_of
from scenarios import cli

ELSEWHERE = {
    "security.md": "openssl's commands; test_comms_zenoh_security carries them out",
    "hosts.md": "three computers; below, all on this one",
}
"""Pages whose commands are run by other tests."""
APART = ("experiment",)
"""Minutes each, however small: run one by one, below."""
NEEDED = ("cliff-1", "cliff", "demo")
"""Runs that pages speak of and that an earlier page left; here the same one, made once."""
REFUSED = {"--ros2": "rmw_zenohd", "ros2": "rmw_zenohd", "tcp://10.0.0.7:8786": "tcp://127.0.0.1:1"}
"""What can't be had here (ROS's router, a cluster) is refused in a sentence that names it."""
EXPERIMENTS = [
    one
    for page in PAGES
    for one in commands(page)
    if one.argv[0] == "ropeteam" and one.argv[1] in APART
]
FEW = {
    "compress": ["cell_m=0.4"],
    "descents": ["sensor=range", "cell_m=0.2", "scenario=planner.max_looks=6"],
    "edge": [],
    "field": ["looks=1", "method=random"],
    "localisation": [],
    "markov": [],
    "planar-one": ["looks=3", "method=random"],
    "planar-two": ["looks=3", "method=random"],
    "sandpit": ["looks=2", "method=random"],
    "sharing": [
        f"scenario={one}"
        for one in (
            "world.window_m=[16.0, 14.0]",
            "map.cell_m=0.4",
            "sensor.columns=32",
            "sensor.rows=24",
            "planner.max_looks=3",
            "planner.max_candidates=10",
            "planner.headings=4",
            *LOW_CLIFF,
        )
    ],
}
"""Settings with which an experiment takes least; besides `--seeds 1`."""


@pytest.fixture(scope="module")
def ready(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a reader's files and a finished run."""
    folder = tmp_path_factory.mktemp("reader")
    write_grounds(folder)
    taken, calibration = shot(), calibration_of(SENSOR, STEREO)
    cv2.imwrite(str(folder / "left.png"), taken.left)
    cv2.imwrite(str(folder / "right.png"), taken.right)
    told = {
        name: getattr(calibration, name) for name in ("focal_px", "cx_px", "cy_px", "baseline_m")
    }
    (folder / "pair.json").write_text(json.dumps(told))
    shipped = ROOT / "scenarios" / "library" / "studies" / "bandwidth.toml"
    (folder / "bandwidth.toml").write_text(study(shipped.read_text()))
    first = smaller(Command("", "ropeteam run cliff --out runs/demo"))
    subprocess.run(ropeteam(first), cwd=folder, check=True, env=environment(folder))
    return folder


def ropeteam(argv: list[str]) -> list[str]:
    return [sys.executable, "-m", "scenarios.cli", *argv]


def environment(folder: Path) -> dict[str, str]:
    """Return what a command finds: this program, viewers that open nothing, no debugger."""
    viewer = folder / "bin" / "rerun"
    viewer.parent.mkdir(exist_ok=True)
    viewer.write_text('#!/bin/sh\ntest -s "$(eval echo \\$$#)"\n')
    viewer.chmod(0o755)
    path = os.pathsep.join([str(viewer.parent), os.environ["PATH"]])
    told = {"PYTHONPATH": str(ROOT), "PATH": path, "PYTHONBREAKPOINT": "0"}
    told |= {"BROWSER": "true", "DISPLAY": ":0"}
    return {**os.environ, **told}


@pytest.fixture
def reader(ready: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], None]:
    """Return what brings a reader to a page: in a folder of their own, with what they have."""

    def arrive(page: Path) -> None:
        if page.name in ELSEWHERE:
            pytest.skip(ELSEWHERE[page.name])
        monkeypatch.chdir(tmp_path)
        for key, value in environment(ready).items():
            monkeypatch.setenv(key, value)
        lay_out(ready, tmp_path, page)

    return arrive


WITH_COMMANDS = pytest.mark.parametrize(
    "page", [page for page in PAGES if commands(page)], ids=lambda page: page.name
)


@pytest.mark.timeout(400)  # README.md has two dozen
@WITH_COMMANDS
def test_the_commands_of_a_page(
    page: Path,
    reader: Callable[[Path], None],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """All in this process, without what a run draws at its end."""
    reader(page)
    monkeypatch.setattr("scenarios.runner.draw", lambda *_: None)
    for command in commands(page):
        if command.argv[0] == "cd":
            break  # to where a package is installed: below, in processes that know of it
        if command.argv[1] not in APART:
            try:
                code = cli.main(smaller(command))
            except SystemExit as done:  # --help
                code = done.code
            hold(command, code, capfd.readouterr().err)


@pytest.mark.slow
@pytest.mark.timeout(900)
@WITH_COMMANDS
def test_the_commands_of_a_page_in_a_shell(
    page: Path, reader: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each in a process of its own, robots too, pictures and all."""
    reader(page)
    for command in commands(page):
        if command.argv[0] == "cd":
            monkeypatch.chdir(Path.cwd() / command.argv[1])
        elif command.argv[0] == "pip":
            monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(ROOT), installed(Path.cwd()))))
        elif command.argv[1] not in APART:
            argv = [word.replace("air=memory", "air=zenoh") for word in smaller(command)]
            ran = subprocess.run(ropeteam(argv), capture_output=True, text=True, check=False)
            hold(command, ran.returncode, ran.stderr)


def installed(package: Path) -> str:
    """Install a package as its reader does, but beside this program and not in it."""
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--target", "site"]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, "."], check=True)
    return str(package / "site")


def lay_out(ready: Path, here: Path, page: Path) -> None:
    """Put into a folder what a reader has who came to this page."""
    for file in ready.iterdir():
        if file.is_file():
            (here / file.name).symlink_to(file)
    (here / "runs").mkdir()
    made = " ".join(command.line for command in commands(page))
    for name in NEEDED:
        if f"--out runs/{name} " not in f"{made} ":
            (here / "runs" / name).symlink_to(ready / "runs" / "demo")
    for name, text in scenarios(page).items():
        (here / name).write_text(text)


def hold(command: Command, code: object, said: str) -> None:
    """Hold that a command ended well, or was refused as it has to be."""
    refusal = next((REFUSED[word] for word in command.argv if word in REFUSED), None)
    assert "Traceback" not in said, f"{command.line}\n{said}"
    assert code == (0 if refusal is None else 2), f"{command.line}\n{said}"
    assert refusal is None or refusal in said


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("command", EXPERIMENTS, ids=lambda c: f"{c.page}-{c.argv[2]}")
def test_an_experiment_of_the_documents(command: Command, ready: Path, tmp_path: Path) -> None:
    name = command.argv[2]
    np.savez(tmp_path / "mine.npz", **np.load(ready / "ground.npz"))
    argv = [*command.argv[1:], "--jobs", "1", "--out", "out", "--quiet"]
    argv += [] if "--seeds" in argv else ["--seeds", "1"]
    argv += [word for one in FEW[name] for word in ("--set", one)]
    ran = subprocess.run(
        ropeteam([word.replace("3", "1") if word == "3" else word for word in argv]),
        cwd=tmp_path,
        env=environment(ready),
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, f"{shlex.join(argv)}\n{ran.stderr}"
    assert (tmp_path / "out" / "experiment.json").is_file()


def test_no_page_has_commands_that_are_not_looked_at() -> None:
    lines = [
        f"{page.name}: {line}"
        for page in PAGES
        for line in page.read_text("utf-8").splitlines()
        if line.startswith("ropeteam ")
    ]
    found = [f"{one.page}: {one.line}" for page in PAGES for one in commands(page)]
    assert [line for line in lines if line not in found] == []
    assert len(found) > 80
