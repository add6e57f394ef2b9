"""`ropeteam map`: maps into few bytes and back, within the bound, place and masks included."""

import os
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio import Affine

from scenarios import cli
from scenarios.commands import map as map_command
from scenarios.commands import run as run_command
from scenarios.formats.maps import npz_bytes, read_map
from scenarios.formats.rtm import ElevationMap, MapFileError, pack, unpack

SHARED = Path(os.environ.get("ROPETEAM_SHARED", Path(__file__).parents[2] / "shared"))
DEMS = sorted((SHARED / "data" / "dem").glob("*.npz"))


@pytest.fixture(autouse=True)
def in_a_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(cli, "COMMANDS", (run_command, map_command))
    monkeypatch.chdir(tmp_path)


def ground() -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return rough ground, its south-east corner unknown."""
    z = np.random.default_rng(3).normal(size=(40, 60)).cumsum(1)
    z[-10:, -20:] = np.nan
    return z


def written(name: str = "mine.npz", **more: Any) -> Path:
    arrays: dict[str, Any] = {"elevation": ground(), "cell_size": 0.25} | more
    np.savez(name, **arrays)
    return Path(name)


def main(*argv: str) -> int:
    try:
        return cli.main(["map", *argv])
    except SystemExit as left:
        return int(left.code or 0)


def refusal(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    capsys.readouterr()
    assert main(*argv) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    return told.err


# --- the command ----------------------------------------------------------------------------------


def test_a_map_goes_and_comes_back(capsys: pytest.CaptureFixture[str]) -> None:
    sigma = np.full((40, 60), 0.02)
    written(origin=[2600000.5, 1180000.0], crs="EPSG:2056", sigma=sigma)
    assert main("pack", "mine.npz", "mine.rtm", "--max-error", "0.05") == 0
    told = capsys.readouterr().out
    size = Path("mine.rtm").stat().st_size
    assert f"{size:,} bytes" in told
    assert f"{4 * 2400 / size:,.1f} times smaller than float32" in told
    assert "of 0.05 m" in told
    assert main("unpack", "mine.rtm", "again.npz") == 0
    with np.load("again.npz") as again:
        errors = np.abs(again["elevation"] - ground())
        assert float(np.nanmax(errors)) <= 0.05
        assert np.array_equal(np.isnan(again["elevation"]), np.isnan(ground()))
        assert float(again["cell_size"]) == 0.25
        assert again["origin"].tolist() == [2600000.5, 1180000.0]
        assert str(again["crs"]) == "EPSG:2056"
        assert 0.02 <= float(np.nanmin(again["sigma"])) < 0.03
    assert size < len(npz_bytes(read_map(Path("mine.npz")))) / 2


def test_info_tells_what_a_map_holds(capsys: pytest.CaptureFixture[str]) -> None:
    written(origin=[5.0, 7.0], crs="EPSG:32632")
    main("pack", "mine.npz", "mine.rtm", "--max-error", "0.05")
    for name in ("mine.npz", "mine.rtm"):
        capsys.readouterr()
        assert main("info", name) == 0
        told = capsys.readouterr().out
        assert "40 x 60 cells of 0.25 m (15 m east, 10 m north), 91.7 % known" in told
        assert "heights" in told
        assert "south-west corner 5 east, 7 north" in told
        assert "CRS EPSG:32632" in told
    assert "within 0.05 m" in told


def test_the_largest_error_is_found_by_decoding(capsys: pytest.CaptureFixture[str]) -> None:
    written()
    main("pack", "mine.npz", "mine.rtm", "--max-error", "0.3")
    line = capsys.readouterr().out.splitlines()[-1]
    found_m = float(line.split(" again ")[1].split(" m,")[0])
    decoded = unpack(Path("mine.rtm").read_bytes(), "mine.rtm").map.elevation_m[::-1]
    assert found_m == pytest.approx(float(np.nanmax(np.abs(decoded - ground()))), rel=1e-5)
    assert 0.2 < found_m <= 0.3


def test_a_geotiff_keeps_its_place() -> None:
    transform = Affine(0.5, 0.0, 691000.0, 0.0, -0.5, 5335000.0)
    tiff("mine.tif", transform, "EPSG:32632")
    found = read_map(Path("mine.tif"))
    assert found.cell_m == 0.5
    assert found.origin_m == (691000.0, 5335000.0 - 40 * 0.5)
    assert found.crs == "EPSG:32632"
    assert np.allclose(found.elevation_m[::-1], ground(), equal_nan=True, atol=1e-4)


def test_a_geotiff_without_metres_needs_a_cell_size(capsys: pytest.CaptureFixture[str]) -> None:
    tiff("mine.tif", Affine(1e-5, 0.0, 11.0, 0.0, -1e-5, 48.0), "EPSG:4326")
    pack_it = ("pack", "mine.tif", "mine.rtm", "--max-error", "0.05")
    assert "give it by --cell-m" in refusal(capsys, *pack_it)
    assert main(*pack_it, "--cell-m", "0.7") == 0
    found = unpack(Path("mine.rtm").read_bytes(), "").map
    assert (found.cell_m, found.origin_m, found.crs) == (0.7, None, None)
    assert float(np.nanmax(np.abs(found.elevation_m[::-1] - ground()))) <= 0.0501


def tiff(name: str, transform: Any, crs: str) -> None:
    shape = {"height": 40, "width": 60, "count": 1, "dtype": "float32"}
    with rasterio.open(name, "w", driver="GTiff", transform=transform, crs=crs, **shape) as file:
        file.write(ground().astype(np.float32), 1)


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        ("pack no.npz x.rtm --max-error 0.1", "no.npz: does not exist"),
        ("pack . x.rtm --max-error 0.1", "is no file"),
        ("pack mine.npz x.map --max-error 0.1", "must end in .rtm"),
        ("pack mine.npz no/x.rtm --max-error 0.1", "its folder no does not exist"),
        ("pack mine.npz old.rtm --max-error 0.1", "exists; add --overwrite"),
        ("pack mine.npz folder.rtm --max-error 0.1 --overwrite", "is a folder"),
        ("pack mine.npz x.rtm", "--max-error"),
        ("pack mine.npz x.rtm --max-error small", "'small' is no number"),
        ("pack mine.npz x.rtm --max-error 0", "bound of 0.0 m"),
        ("pack mine.npz x.rtm --max-error nan", "bound of nan m"),
        ("pack mine.npz x.rtm --max-error 0.1 --cell-m 2", "its own cell size of 0.25 m"),
        ("pack bare.npz x.rtm --max-error 0.1", "has no 'elevation'"),
        ("pack sigma.npz x.rtm --max-error 0.1", "sigma is (2, 2)"),
        ("pack origin.npz x.rtm --max-error 0.1", "origin is"),
        ("pack crs.npz x.rtm --max-error 0.1", "crs is"),
        ("pack text.txt x.rtm --max-error 0.1", "'.txt' can't be read"),
        ("unpack mine.npz x.npz", "is no .rtm map"),
        ("unpack old.rtm x.npz", "is no .rtm map"),
        ("info text.txt", "'.txt' can't be read"),
        ("info no.rtm", "does not exist"),
        ("", "ACTION"),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_is_written(
    argv: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    written()
    written("sigma.npz", sigma=np.zeros((2, 2)))
    written("origin.npz", origin=[1.0, np.nan])
    written("crs.npz", crs=7)
    np.savez("bare.npz", cell_size=1.0)
    Path("text.txt").write_text("not a map")
    Path("old.rtm").write_text("precious")
    Path("folder.rtm").mkdir()
    before = sorted(path.name for path in Path().iterdir())
    assert words in refusal(capsys, *argv.split())
    assert sorted(path.name for path in Path().iterdir()) == before
    assert Path("old.rtm").read_text() == "precious"


def test_overwrite_replaces_a_file() -> None:
    written()
    Path("old.rtm").write_text("old")
    assert main("pack", "mine.npz", "old.rtm", "--max-error", "0.1", "--overwrite") == 0
    assert unpack(Path("old.rtm").read_bytes(), "old.rtm").max_error_m == 0.1
    Path("old.npz").write_text("old")
    assert main("unpack", "old.rtm", "old.npz", "--overwrite") == 0
    assert read_map(Path("old.npz")).cell_m == 0.25


# --- the format -----------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 20), st.integers(1, 20)),
    cell_m=st.floats(1e-3, 1e3),
    max_error_m=st.sampled_from([0.001, 0.05, 3.0]),
    origin_m=st.none() | st.tuples(st.floats(-1e7, 1e7), st.floats(-1e7, 1e7)),
    crs=st.none() | st.text(max_size=40).filter(lambda text: text.isprintable()),
    known_share=st.sampled_from([0.0, 0.5, 1.0]),
)
def test_what_was_packed_comes_back(
    shape: tuple[int, int],
    cell_m: float,
    max_error_m: float,
    origin_m: tuple[float, float] | None,
    crs: str | None,
    known_share: float,
) -> None:
    rng = np.random.default_rng(1)
    z = np.where(rng.random(shape) < known_share, rng.normal(size=shape), np.nan)
    found = unpack(pack(ElevationMap(z, cell_m, origin_m, crs), max_error_m), "x")
    assert (found.map.cell_m, found.map.origin_m, found.map.crs) == (cell_m, origin_m, crs)
    assert found.max_error_m == max_error_m
    assert np.array_equal(np.isnan(found.map.elevation_m), np.isnan(z))
    assert np.abs(found.map.elevation_m - z)[np.isfinite(z)].max(initial=0.0) <= max_error_m


def test_any_change_of_a_byte_is_noticed() -> None:
    data = pack(ElevationMap(ground(), 0.5, (1.0, 2.0), "EPSG:4326"), 0.5)
    for at in range(0, len(data), 7):
        with pytest.raises(MapFileError):
            unpack(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :], "x.rtm")
    for wrong in (b"", data[:-1], data + b"\0"):
        with pytest.raises(MapFileError):
            unpack(wrong, "x.rtm")


def test_a_later_version_is_named() -> None:
    data = pack(ElevationMap(ground(), 0.5), 0.5)
    with pytest.raises(MapFileError, match="version 2, known is 1"):
        unpack(data[:3] + b"\2" + data[4:], "x.rtm")


def test_a_forged_body_is_refused() -> None:
    data = pack(ElevationMap(ground(), 0.5, None, "EPSG:1"), 0.5)
    for body in (data[8:40], data[8:25] + b"\xff\xff" + data[27:], b"\3" + bytes(20)):
        forged = data[:4] + struct.pack("<I", zlib.crc32(body)) + body
        with pytest.raises(MapFileError, match=r"x\.rtm: "):
            unpack(forged, "x.rtm")


@pytest.mark.skipif(not DEMS, reason="the real elevation files are not here")
@pytest.mark.parametrize("path", DEMS, ids=lambda path: path.stem)
def test_real_ground_comes_back_within_the_bound(path: Path) -> None:
    given_map = read_map(path)
    sent = pack(given_map, 0.1)
    found = unpack(sent, path.name).map
    known = np.isfinite(given_map.elevation_m)
    assert np.array_equal(known, np.isfinite(found.elevation_m))
    assert float(np.abs(found.elevation_m - given_map.elevation_m)[known].max()) <= 0.1
    assert len(sent) < 0.6 * len(npz_bytes(given_map))


def test_a_picture_is_no_map_and_an_ascii_grid_is_one(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "ground.png"), np.zeros((8, 8), np.uint8))
    with pytest.raises(MapFileError, match=r"make an \.npz"):
        read_map(tmp_path / "ground.png")
    rows = "\n".join("1 2 3 4" for _ in range(4))
    (tmp_path / "ground.asc").write_text(f"ncols 4\nnrows 4\ncellsize 0.5\n{rows}\n")
    assert read_map(tmp_path / "ground.asc").cell_m == 0.5
