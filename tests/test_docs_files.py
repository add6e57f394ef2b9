"""Every command of docs/files.md does what the page says, on small ground and a small run."""

import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from diary_helpers import written_run
from rasterio import Affine
from run_helpers import LOW_CLIFF, SMALL
from test_docs import ROOT, blocks

from scenarios import cli, runner

PAGE = ROOT / "docs" / "files.md"
COMMANDS = [
    line
    for block in blocks(PAGE, "")
    for line in block.splitlines()
    if line.startswith("ropeteam ")
]
BRIEF = ("limit_s=20", "planner.max_looks=1", "planner.first_looks=1", "planner.headings=4")
EXPORTED = ("tif", "npz", "ply", "yaml", "png", "bt", "-true.tum", "-believed.tum")


def write_grounds(folder: Path) -> None:
    """Write ground and a floor in all the forms that the page speaks of."""
    z = 2.0 + 0.1 * np.random.default_rng(0).normal(size=(40, 40)).astype(np.float32)
    np.savez(folder / "ground.npz", elevation=z, cell_size=0.5)
    place = Affine(0.5, 0, 500_000, 0, -0.5, 5_000_020)
    options = {"height": 40, "width": 40, "count": 1, "dtype": "float32", "crs": "EPSG:32633"}
    with rasterio.open(folder / "ground.tif", "w", "GTiff", transform=place, **options) as out:
        out.write(z, 1)
    rows = "\n".join(" ".join(f"{height:.3f}" for height in row) for row in z)
    (folder / "ground.asc").write_text(f"ncols 40\nnrows 40\ncellsize 0.5\n{rows}\n")
    cv2.imwrite(str(folder / "ground.png"), np.round(z / 4.0 * 65535).astype(np.uint16))
    cv2.imwrite(str(folder / "floor.png"), np.full((200, 200), 254, np.uint8))
    keys = ("image: floor.png", "resolution: 0.1", "origin: [0, 0, 0]", "negate: 0")
    (folder / "floor.yaml").write_text("\n".join((*keys, "free_thresh: 0.2")))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with the files that the page speaks of, and a run that has ended."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(runner, "draw", lambda *_: None)
    write_grounds(tmp_path)
    written_run(tmp_path / "runs" / "cliff")
    return tmp_path


def run_of(argv: list[str], here: Path) -> None:
    planar = "planar" in argv
    sets = [one for one in SMALL if not (planar and one.startswith("map."))]
    sets += LOW_CLIFF if "cliff" in argv else ()
    small = [word for one in (*sets, *BRIEF) for word in ("--set", one)]
    if "--out" not in argv:
        argv = [*argv, "--out", "out"]
    assert cli.main([*argv, *small, "--quiet", "--overwrite"]) == 0
    out = here / argv[argv.index("--out") + 1]
    assert (out / "run.mcap").stat().st_size > 1000


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_page(
    command: str, here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = shlex.split(command, comments=True)[1:]
    if "--ros2" in argv or argv[0] == "ros2":
        monkeypatch.setattr("scenarios.commands.ros2.ROUTER", "tcp/127.0.0.1:1")
        assert cli.main(argv) == 2, "no router runs here; with one: test_scenarios_ros2"
        assert "rmw_zenohd" in capsys.readouterr().err
    elif argv[0] == "run":
        run_of(argv, here)
    elif argv[0] == "view":
        for name in ("DISPLAY", "WAYLAND_DISPLAY"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setattr("shutil.which", lambda name: "/usr/bin/rerun")
        assert cli.main(argv) == 0
        said = capsys.readouterr().out
        assert "/usr/bin/rerun --bind 127.0.0.1 --serve-web runs/cliff/run.mcap" in said
    else:
        assert cli.main(argv) == 0
        assert "bytes" in capsys.readouterr().out


def test_all_formats_of_the_page_are_written(here: Path) -> None:
    exports = [shlex.split(one)[1:] for one in COMMANDS if one.startswith("ropeteam export")]
    for argv in exports:
        assert cli.main(argv) == 0
    written = Path("runs/cliff/export").iterdir()
    names = {path.name.removeprefix("recon").lstrip(".") for path in written}
    assert names == set(EXPORTED)
    assert Path("runs/cliff/run.mcap").is_file()


def test_the_page_names_all_that_is_accepted() -> None:
    text = PAGE.read_text()
    for told in ("`.npz`", "`.tif`", "`.asc`", "`.png`", "`.yaml`"):
        assert told in text
    assert len(COMMANDS) >= 12
