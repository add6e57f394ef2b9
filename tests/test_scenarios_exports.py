"""Maps and ways in the formats of others, read back by the programs of others."""

import importlib
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
from diary_helpers import FRAME, ROBOTS, pose_at, written_run
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio import Affine

from agents.geometry import Floats, Ints
from scenarios import cli
from scenarios.exports.grids import trinary
from scenarios.exports.octomap import FREE, HALF, OCCUPIED, tree_bytes
from scenarios.formats.rtm import MapFileError
from scenarios.logs.diary import Chart
from sim.planar_world import load_map
from sim.terrain_files import read_elevation

WEST, EAST, SOUTH, NORTH = FRAME.extent_m


def exported(folder: Path, form: str, kind: str = "elevation") -> tuple[dict[str, Floats], Path]:
    """Return a run's map, and the stem of what was exported of it."""
    last = written_run(folder, kind)
    told = ["export", str(folder), "--robot", ROBOTS[kind], "--format", form]
    assert cli.main(told) == 0
    return last, folder / "export" / ROBOTS[kind]


def share(log_odds: Floats) -> Floats:
    return 1 / (1 + np.exp(-log_odds))


def test_a_geotiff_has_heights_and_sigmas_in_place(tmp_path: Path) -> None:
    last, stem = exported(tmp_path, "geotiff")
    with rasterio.open(stem.with_suffix(".tif")) as raster:
        assert raster.descriptions == ("elevation", "sigma")
        assert raster.transform == Affine(0.25, 0, WEST, 0, -0.25, NORTH)
        assert raster.crs.to_wkt().startswith("LOCAL_CS")
        found = raster.read()
    for got, want in zip(found, last.values(), strict=True):
        known = np.where(np.isfinite(want), want, np.nan).astype("f4")
        assert np.array_equal(got[::-1], known, equal_nan=True)
    again = read_elevation(str(stem.with_suffix(".tif")))
    assert again.cell_m == 0.25
    assert np.array_equal(again.elevation_m, last["elevation"].astype("f4"), equal_nan=True)


def test_a_geotiff_of_a_floor_has_probabilities(tmp_path: Path) -> None:
    last, stem = exported(tmp_path, "geotiff", "planar")
    with rasterio.open(stem.with_suffix(".tif")) as raster:
        assert raster.descriptions == ("occupied",)
        np.testing.assert_allclose(raster.read(1)[::-1], share(last["log_odds"]), atol=1e-6)


def test_a_map_of_ground_from_a_file_lies_where_the_file_does(tmp_path: Path) -> None:
    ground = tmp_path / "ground.tif"
    heights = np.zeros((40, 50), np.float32)
    place = Affine(0.5, 0, 500_000, 0, -0.5, 5_000_020)
    options: dict[str, Any] = {"height": 40, "width": 50, "count": 1, "dtype": "float32"}
    with rasterio.open(ground, "w", "GTiff", crs="EPSG:32633", transform=place, **options) as out:
        out.write(heights, 1)
    run = tmp_path / "run"
    written_run(run, "elevation", f"world.terrain.file={ground}")
    assert cli.main(["export", str(run), "--robot", "recon", "--format", "geotiff"]) == 0
    with rasterio.open(run / "export" / "recon.tif") as raster:
        assert raster.crs.to_epsg() == 32633
        assert raster.transform.c == 500_000 + WEST
        assert raster.transform.f == 5_000_000 + NORTH


def test_an_npz_can_be_ground_again(tmp_path: Path) -> None:
    last, stem = exported(tmp_path, "npz")
    again = read_elevation(str(stem.with_suffix(".npz")))
    assert again.cell_m == 0.25
    assert np.array_equal(again.elevation_m, last["elevation"].astype("f4"), equal_nan=True)
    with np.load(stem.with_suffix(".npz")) as archive:
        assert list(archive["origin"]) == [WEST, SOUTH]
        sigma = np.where(np.isfinite(last["sigma"]), last["sigma"], np.nan)
        assert np.array_equal(archive["sigma"][::-1], sigma.astype("f4"), equal_nan=True)


def test_an_npz_of_a_floor_has_probabilities(tmp_path: Path) -> None:
    last, stem = exported(tmp_path, "npz", "planar")
    with np.load(stem.with_suffix(".npz")) as archive:
        np.testing.assert_allclose(archive["occupied"][::-1], share(last["log_odds"]), atol=1e-6)


def ply(path: Path) -> tuple[str, np.ndarray[Any, Any]]:
    head, _, data = path.read_bytes().partition(b"end_header\n")
    text = head.decode()
    count = int(re.findall(r"element vertex (\d+)", text)[0])
    names = re.findall(r"property float (\w+)", text)
    return " ".join(names), np.frombuffer(data, "<f4").reshape(count, len(names))


def test_a_ply_has_a_vertex_for_each_known_cell(tmp_path: Path) -> None:
    last, stem = exported(tmp_path, "ply")
    names, points = ply(stem.with_suffix(".ply"))
    assert names == "x y z sigma"
    want = [
        (*FRAME.centre_of(row, col), last["elevation"][row, col], last["sigma"][row, col])
        for row, col in np.argwhere(np.isfinite(last["elevation"]))
    ]
    np.testing.assert_allclose(points, np.array(want), rtol=1e-6)
    last, stem = exported(tmp_path / "floor", "ply", "planar")
    names, points = ply(stem.with_suffix(".ply"))
    assert names == "x y z occupied"
    assert len(points) == np.count_nonzero(np.nan_to_num(last["log_odds"]) > 0)


def test_map_server_files_say_where_one_can_drive(tmp_path: Path) -> None:
    last, stem = exported(tmp_path, "map_server", "planar")
    image = cv2.imread(str(stem.with_suffix(".png")), cv2.IMREAD_UNCHANGED)[::-1]
    p = share(last["log_odds"])
    with np.errstate(invalid="ignore"):
        assert np.array_equal(image == 0, p > 0.65)
        assert np.array_equal(image == 254, p < 0.196)
    assert (image[np.isnan(p)] == 205).all()
    world = load_map(stem.with_suffix(".yaml"), cell_m=0.25, footprint_m=0.1)
    assert world.frame == FRAME
    assert np.array_equal(world.solid, image != 254)


def test_map_server_files_say_where_they_lie(tmp_path: Path) -> None:
    _, stem = exported(tmp_path, "map_server")
    text = stem.with_suffix(".yaml").read_text()
    assert "origin: [-1, 2, 0.0]" in text
    assert "resolution: 0.25" in text


def test_what_is_too_steep_is_solid_and_what_has_unknown_neighbours_is_unknown() -> None:
    east = np.arange(13) * np.ones((9, 1))
    z = np.where(east < 6, 0.1 * east, 0.2 * east - 0.6).astype("f4")  # 22 and 39 degrees
    z[4, 2] = np.nan
    grey = trinary(Chart(FRAME, {"elevation": z, "sigma": z}), 25.0)
    inner = grey[1:-1, 1:-1]
    assert (inner[:, 7:] == 0).all()
    assert (inner[:2, :4] == 254).all()
    assert {(4, 1), (4, 3), (3, 2), (5, 2), (4, 2)} == {
        (r + 1, c + 1) for r, c in np.argwhere(inner == 205)
    }
    assert (inner != 205).sum() + (grey == 205).sum() == grey.size, "the edge is unknown"


def test_ways_are_lines_of_tum(tmp_path: Path) -> None:
    _, stem = exported(tmp_path, "tum")
    true = np.loadtxt(f"{stem}-true.tum")
    believed = np.loadtxt(f"{stem}-believed.tum")
    assert true.shape == (61, 8)
    assert list(believed[:, 0]) == list(range(0, 61, 2))
    pose = pose_at(13)
    want = (13, pose.x_m, pose.y_m, pose.z_m, 0, 0, np.sin(0.65), np.cos(0.65))
    np.testing.assert_allclose(true[13], want, rtol=1e-8)


@pytest.mark.filterwarnings("ignore")
def test_evo_finds_the_error_of_a_way(tmp_path: Path) -> None:
    pytest.importorskip("evo", reason="evo is an extra of the tests")
    metrics, sync = (importlib.import_module(f"evo.core.{name}") for name in ("metrics", "sync"))
    file_interface = importlib.import_module("evo.tools.file_interface")
    _, stem = exported(tmp_path, "tum")
    true = file_interface.read_tum_trajectory_file(f"{stem}-true.tum")
    believed = file_interface.read_tum_trajectory_file(f"{stem}-believed.tum")
    pair = sync.associate_trajectories(true, believed)
    assert pair[0].num_poses == 31
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data(pair)
    assert error.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(0.1, rel=1e-6)


# --- OctoMap --------------------------------------------------------------------------------------


def tree_of(path: Path) -> Any:
    pyoctomap = pytest.importorskip("pyoctomap", reason="pyoctomap is an extra")
    tree = pyoctomap.OcTree(1.0)
    assert tree.readBinary(str(path))
    return tree


def state(tree: Any, x: float, y: float, z: float) -> str:
    node = tree.search(np.array([x, y, z]))
    if node is None:
        return "unknown"
    return "occupied" if tree.isNodeOccupied(node) else "free"


def test_octomap_reads_a_tree_of_ground(tmp_path: Path) -> None:
    last, stem = exported(tmp_path, "octomap")
    tree = tree_of(stem.with_suffix(".bt"))
    assert tree.getResolution() == 0.25
    head = stem.with_suffix(".bt").read_bytes().split(b"data\n")[0].decode()
    assert int(re.findall(r"size (\d+)", head)[0]) == tree.size() == tree.calcNumNodes()
    for row in range(FRAME.rows):
        for col in range(FRAME.cols):
            x, y = FRAME.centre_of(row, col)
            z = float(last["elevation"][row, col])
            if np.isnan(z):
                assert state(tree, x, y, -3.0) == "unknown"
            else:
                assert state(tree, x, y, z) == "occupied"
                assert state(tree, x, y, z + 0.26) == "unknown"


def test_octomap_reads_a_floor(tmp_path: Path) -> None:
    last, stem = exported(tmp_path, "octomap", "planar")
    tree = tree_of(stem.with_suffix(".bt"))
    for row in range(FRAME.rows):
        for col in range(FRAME.cols):
            odds = last["log_odds"][row, col]
            want = "unknown" if np.isnan(odds) else "occupied" if odds > 0 else "free"
            assert state(tree, *FRAME.centre_of(row, col), 0.1) == want


@given(
    keys=st.lists(st.tuples(*[st.integers(-9, 8)] * 3), min_size=1, max_size=40, unique=True),
    block=st.booleans(),
    seed=st.integers(0, 1000),
)
@settings(max_examples=25, deadline=None)
def test_every_voxel_comes_back_from_octomap(
    tmp_path_factory: pytest.TempPathFactory,
    keys: list[tuple[int, int, int]],
    block: bool,
    seed: int,
) -> None:
    states = np.random.default_rng(seed).choice([FREE, OCCUPIED], len(keys)).astype(np.uint8)
    voxels = np.array(keys)
    if block:  # eight of a kind, which become one
        corner = np.array([[i >> 2, i >> 1 & 1, i & 1] for i in range(8)]) + 16
        voxels = np.vstack((voxels, corner))
        states = np.append(states, np.full(8, FREE, np.uint8))
    path = tmp_path_factory.mktemp("tree") / "a.bt"
    path.write_bytes(tree_bytes(voxels, states, 0.5))
    tree = tree_of(path)
    assert tree.size() == tree.calcNumNodes()
    assert f"size {tree.size()}\n".encode() in path.read_bytes()
    for voxel, one in zip(voxels, states, strict=True):
        assert state(tree, *(0.5 * (voxel + 0.5))) == ("free" if one == FREE else "occupied")


def test_of_two_voxels_in_one_place_the_occupied_one_counts(tmp_path: Path) -> None:
    voxels = np.zeros((2, 3), dtype=np.int64)
    for states in ([FREE, OCCUPIED], [OCCUPIED, FREE]):
        (tmp_path / "a.bt").write_bytes(tree_bytes(voxels, np.array(states, np.uint8), 0.5))
        assert state(tree_of(tmp_path / "a.bt"), 0.25, 0.25, 0.25) == "occupied"


@pytest.mark.parametrize(
    ("keys", "words"),
    [(np.zeros((0, 3), np.int64), "no known cell"), (np.array([[0, HALF, 0]]), "reaches")],
)
def test_what_no_tree_can_hold_is_refused(keys: Ints, words: str) -> None:
    with pytest.raises(MapFileError, match=words):
        tree_bytes(keys, np.full(len(keys), OCCUPIED, np.uint8), 0.1)


# --- refusals -------------------------------------------------------------------------------------


def test_what_cannot_be_exported_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written_run(tmp_path / "run")
    for told, words in (
        (["export", str(tmp_path), "--format", "npz"], "is no run"),
        (["export", str(tmp_path / "run"), "--robot", "bob", "--format", "npz"], "no such robot"),
        (["export", str(tmp_path / "run"), "--robot", "cliffbot", "--format", "npz"], "no map"),
        (["export", str(tmp_path / "run"), "--robot", "cliffbot", "--format", "tum"], "no poses"),
    ):
        assert cli.main(told) == 2
        assert words in capsys.readouterr().err


def test_all_robots_that_kept_something_are_exported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written_run(tmp_path)
    assert cli.main(["export", str(tmp_path), "--format", "npz", "--format", "ply"]) == 0
    assert capsys.readouterr().out.count("recon.") == 2
    assert len(list((tmp_path / "export").iterdir())) == 2
