import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from stereo_helpers import PAIRS, motorcycle, needs_motorcycle, scored, shot

from agents.stereo.points import Cloud
from scenarios.cli import main
from scenarios.formats.stereo import (
    UNMATCHED_BGR,
    StereoError,
    depth_picture,
    read_calibration,
    read_grey,
    write_cloud,
)

JSON = '{"focal_px": 500, "cx_px": 320, "cy_px": 240, "baseline_m": 0.2, "doffs_px": 3, "who": 1}'
MIDDLEBURY = """\
cam0=[500.0 0 320; 0 500.0 240; 0 0 1]
cam1=[500.0 0 323; 0 500.0 240; 0 0 1]
doffs=3
baseline=200
width=640
"""
KITTI = """\
P0: 500 0 320 0 0 500 240 0 0 0 1 0
P1: 500 0 323 -100 0 500 240 0 0 0 1 0
"""
OPENCV = """\
%YAML:1.0
---
P1: !!opencv-matrix
   rows: 3
   cols: 4
   dt: d
   data: [ 500., 0., 320., 0., 0., 500., 240., 0., 0., 0., 1., 0. ]
P2: !!opencv-matrix
   rows: 3
   cols: 4
   dt: d
   data: [ 500., 0., 323., -100., 0., 500., 240., 0., 0., 0., 1., 0. ]
"""


@pytest.fixture
def pair(tmp_path: Path) -> tuple[str, str]:
    got = shot()
    paths = [str(tmp_path / f"{side}.png") for side in ("left", "right")]
    for path, image in zip(paths, (got.left, got.right), strict=True):
        cv2.imwrite(path, image)
    return paths[0], paths[1]


@pytest.mark.parametrize(
    ("name", "text"),
    [("a.json", JSON), ("calib.txt", MIDDLEBURY), ("k.txt", KITTI), ("o.yml", OPENCV)],
)
def test_all_kinds_of_calibration_say_the_same(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    c = read_calibration(str(path), 640, 480)
    assert (c.focal_px, c.cx_px, c.cy_px, c.doffs_px) == (500, 320, 240, 3)
    assert c.baseline_m == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.json", "{", "no calibration of a pair"),
        ("a.json", "[1]", "no calibration of a pair"),
        ("a.json", '{"focal_px": 3}', "cx_px, cy_px, baseline_m"),
        ("a.json", JSON.replace("0.2", "-1"), "baseline_m is -1"),
        ("a.txt", "cam0=[1 2]\nbaseline=3", "no calibration of a pair"),
        ("a.txt", "hello", "no calibration of a pair"),
        ("a.yml", OPENCV.replace("P2", "P9"), "without P1 and P2"),
    ],
)
def test_a_wrong_calibration_is_refused_in_one_sentence(
    tmp_path: Path, name: str, text: str, said: str
) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(StereoError, match=said):
        read_calibration(str(path), 640, 480)


def test_the_command_writes_what_it_is_asked_for(
    tmp_path: Path, pair: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    calibration = tmp_path / "pair.json"
    calibration.write_text(
        json.dumps({"focal_px": 277.1, "cx_px": 159.5, "cy_px": 119.5, "baseline_m": 0.3})
    )
    disparity, cloud, picture = (str(tmp_path / n) for n in ("d.npy", "c.ply", "p.png"))
    options = ["--calibration", str(calibration), "--disparity", disparity, "--out", cloud]
    assert main(["stereo", *pair, *options, "--picture", picture]) == 0
    found = np.load(disparity)
    assert found.dtype == np.float32
    assert found.shape == (240, 320)
    assert np.isnan(found).any()
    assert cv2.imread(picture).shape == (240, 320, 3)
    head, _, body = Path(cloud).read_bytes().partition(b"end_header\n")
    count = int(np.isfinite(found).sum())
    assert f"element vertex {count}".encode() in head
    assert len(body) == count * 19
    said = capsys.readouterr().out
    assert "sigma = S T L^n" in said
    assert "little texture" in said


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--out", "c.ply"], "--calibration"),
        (["--max-disparity", "900"], "900"),
        (["--min-disparity", "90", "--max-disparity", "60"], "90 to 60"),
        (["--calibration", "nowhere.json"], "nowhere.json"),
        (["--disparity", "/nowhere/d.npy"], "/nowhere/d.npy"),
        (["--picture", "p.nonsense"], "p.nonsense"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(
    tmp_path: Path,
    pair: tuple[str, str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["stereo", *pair, *options]) == 2
    error = capsys.readouterr().err.strip()
    assert said in error
    assert len(error.splitlines()) == 1


def test_what_is_no_image_is_refused(tmp_path: Path, pair: tuple[str, str]) -> None:
    text = tmp_path / "a.png"
    text.write_text("hello")
    assert main(["stereo", str(text), pair[1]]) == 2
    assert main(["stereo", str(tmp_path / "none.png"), pair[1]]) == 2


def test_twelve_bits_in_sixteen_are_scaled_to_eight(tmp_path: Path) -> None:
    path = str(tmp_path / "deep.png")
    cv2.imwrite(path, np.array([[0, 2048, 4095]] * 3, dtype=np.uint16))
    assert read_grey(path)[0].tolist() == [0, 128, 255]


def test_the_picture_is_red_near_blue_far_and_grey_where_nothing_is_known() -> None:
    picture = depth_picture(np.array([[np.nan, 1.0, 50.0]], dtype=np.float32))
    assert tuple(picture[0, 0]) == UNMATCHED_BGR
    assert picture[0, 1, 0] > picture[0, 1, 2]
    assert picture[0, 2, 2] > picture[0, 2, 0]


def test_points_come_back_from_their_file(tmp_path: Path) -> None:
    found = Cloud(
        np.array([[1.0, 2.0, 3.0]]), np.array([np.eye(3) * 0.01]), np.zeros((1, 2), dtype=np.int64)
    )
    path = tmp_path / "c.ply"
    write_cloud(str(path), found, np.full((2, 2), 77, dtype=np.uint8))
    body = path.read_bytes().partition(b"end_header\n")[2]
    assert np.frombuffer(body[:16], dtype="<f4").tolist() == pytest.approx([1, 2, 3, 0.1])
    assert list(body[16:]) == [77, 77, 77]


@needs_motorcycle
def test_the_command_on_a_real_pair(tmp_path: Path) -> None:
    out, picture = str(tmp_path / "d.npy"), str(tmp_path / "p.png")
    images = [str(PAIRS / f"motorcycle_{side}.png") for side in ("left", "right")]
    assert main(["stereo", *images, "--disparity", out, "--picture", picture]) == 0
    density, bad = scored(np.load(out), motorcycle().truth_px)
    assert density > 0.85
    assert bad < 0.055
