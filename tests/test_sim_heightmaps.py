"""Ground from text and pictures: read as others wrote it, refused in a sentence if it is none."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from sim.errors import WorldError
from sim.planar_world import load_map
from sim.settings import TerrainSettings
from sim.terrain_files import read_elevation

ASC = """ncols 5
nrows 4
xllcorner 100.0
yllcorner 200.0
cellsize 0.5
NODATA_value -9999
0 1 2 3 4
10 11 12 13 14
20 21 -9999 23 24
30 31 32 33 34.5
"""


def asc(folder: Path, text: str = ASC) -> str:
    path = folder / "ground.asc"
    path.write_text(text)
    return str(path)


def png(folder: Path, picture: Any, name: str = "ground.png") -> str:
    assert cv2.imwrite(str(folder / name), picture)
    return str(folder / name)


def test_an_ascii_grid_is_read_north_row_first(tmp_path: Path) -> None:
    file = read_elevation(asc(tmp_path))
    assert file.cell_m == 0.5
    assert list(file.elevation_m[0]) == [30, 31, 32, 33, 34.5]
    assert np.isnan(file.elevation_m[1, 2])
    assert np.isnan(file.elevation_m).sum() == 1


def test_an_ascii_grid_may_break_its_lines_anywhere(tmp_path: Path) -> None:
    head, body = ASC.split("-9999\n", 1)
    a = read_elevation(asc(tmp_path))
    b = read_elevation(asc(tmp_path, head + "-9999\n" + body.replace(" ", "\n")))
    assert np.array_equal(a.elevation_m, b.elevation_m, equal_nan=True)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("ncols 5\n", "", "has no 'ncols'"),
        ("cellsize 0.5", "dx 0.5", "has no 'cellsize'"),
        ("cellsize 0.5", "cellsize wide", "'wide'"),
        ("cellsize 0.5", "cellsize -1", "cell size is -1"),
        ("cellsize 0.5", "cellsize nan", "cell size is nan"),
        ("ncols 5", "ncols 5.5", "'5.5'"),
        ("ncols 5", "ncols -5", "'-5'"),
        ("ncols 5", "ncols 6", "holds 20 heights"),
        ("ncols 5", "ncols 99999999999999999999", "whole number"),
        ("ncols 5", "ncols 99999999", "allowed are at most"),
        ("34.5", "34.5 7", "holds 21 heights"),
        ("34.5", "", "holds 19 heights"),
        ("34.5", "deep", "no height"),
        ("34.5", "34.5é", "no ASCII"),
        ("nrows 4", "nrows 4 rows", "'nrows 4 rows"),
        (ASC, "", "has no 'ncols'"),
        (ASC, "\0" * 500, "no ASCII grid"),
        (ASC, "a b\n" * 50, "has no end"),
    ],
)
def test_a_bad_ascii_grid_is_refused_in_a_sentence(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    assert old in ASC
    with pytest.raises(WorldError, match=r"ground\.asc") as refused:
        read_elevation(asc(tmp_path, ASC.replace(old, new)))
    assert words in str(refused.value)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_greys_are_heights_between_those_of_black_and_white(tmp_path: Path, kind: Any) -> None:
    white = np.iinfo(kind).max
    picture = np.zeros((5, 6), dtype=kind)
    picture[0] = white  # the northern row
    picture[4, 0] = round(0.2 * white)
    file = read_elevation(png(tmp_path, picture), 0.25, (-2.0, 8.0))
    assert file.cell_m == 0.25
    assert list(file.elevation_m[-1]) == [8.0] * 6
    assert file.elevation_m[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert file.elevation_m[0, 1] == -2.0


def test_what_is_transparent_is_unknown(tmp_path: Path) -> None:
    picture = np.full((5, 6, 4), 100, dtype=np.uint8)
    picture[..., 3] = 255
    picture[2, 3, 3] = 0
    file = read_elevation(png(tmp_path, picture), 1.0, (0.0, 1.0))
    assert list(np.argwhere(np.isnan(file.elevation_m))[0]) == [2, 3]
    assert np.isnan(file.elevation_m).sum() == 1


def test_a_bad_picture_is_refused_in_a_sentence(tmp_path: Path) -> None:
    grey, colours = np.zeros((5, 6), np.uint8), np.zeros((5, 6, 3), np.uint8)
    colours[0, 0, 0] = 9
    good = Path(png(tmp_path, grey))
    with pytest.raises(WorldError, match=r"set world\.terrain\.grey_m"):
        read_elevation(str(good), 1.0)
    with pytest.raises(WorldError, match=r"set world\.terrain\.cell_m"):
        read_elevation(str(good), None, (0.0, 1.0))
    with pytest.raises(WorldError, match="has colours"):
        read_elevation(png(tmp_path, colours, "blue.png"), 1.0, (0.0, 1.0))
    data = good.read_bytes()
    bomb = data[:16] + b"\x7f\xff\xff\xff\x7f\xff\xff\xff" + data[24:]
    for name, bad, words in (
        ("bomb.png", bomb, "allowed are at most"),
        ("cut.png", data[:40], "no readable PNG"),
        ("short.png", data[:18], "is no PNG"),
        ("text.png", b"heights", "is no PNG"),
    ):
        (tmp_path / name).write_bytes(bad)
        with pytest.raises(WorldError, match=words):
            read_elevation(str(tmp_path / name), 1.0, (0.0, 1.0))


def test_grey_is_only_for_pictures() -> None:
    assert TerrainSettings(file="a.png", cell_m=1.0, grey_m=(0.0, 3.0)).grey_m == (0.0, 3.0)
    with pytest.raises(ValueError, match=r"grey_m is for a \.png"):
        TerrainSettings(file="a.tif", grey_m=(0.0, 3.0))


FLOOR = {
    "image": "floor.png",
    "resolution": "0.1",
    "origin": "[1.0, 2.0, 0.0]",
    "negate": "0",
    "free_thresh": "0.2",
}


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("resolution", "0", "number above 0"),
        ("resolution", "-0.1", "number above 0"),
        ("resolution", "inf", "number above 0"),
        ("resolution", "fine", "must be a number"),
        ("origin", "[1.0, 2.0]", "must be"),
        ("origin", "here", "must be"),
        ("origin", "[1.0, nan, 0.0]", "must be"),
        ("origin", "[1.0, 2.0, 0.5]", "not turned"),
        ("negate", "perhaps", "must be 0 or 1"),
        ("image", "none.png", "absent"),
        ("image", "floor.yaml", "can't be read"),
    ],
)
def test_a_bad_floor_is_refused_in_a_sentence(
    tmp_path: Path, key: str, value: str, words: str
) -> None:
    png(tmp_path, np.full((80, 80), 254, np.uint8), "floor.png")
    path = tmp_path / "floor.yaml"
    path.write_text("".join(f"{k}: {v}\n" for k, v in FLOOR.items()))
    assert load_map(path).frame.rows == 20
    path.write_text("".join(f"{k}: {v}\n" for k, v in {**FLOOR, key: value}.items()))
    with pytest.raises(WorldError, match=r"floor\.yaml") as refused:
        load_map(path)
    assert words in str(refused.value)


def test_a_floor_of_bytes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "floor.yaml"
    path.write_bytes(b"\xff\xfe\x00image")
    with pytest.raises(WorldError, match="no map_server yaml"):
        load_map(path)
