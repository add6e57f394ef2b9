import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio import Affine
from rasterio.errors import NotGeoreferencedWarning
from sim_helpers import DEMS, needs

from sim.errors import WorldError
from sim.ground import Terrain
from sim.resample import resample
from sim.terrain import TerrainSettings, WorldSettings, make_terrain
from sim.terrain_files import read_elevation


def south_low(rows: int = 60, cols: int = 80) -> np.ndarray:
    """Return heights as files keep them, row 0 north: 0.1 per cell rising north, 0.01 east."""
    north, east = np.mgrid[rows - 1 : -1 : -1, 0:cols]
    return (0.1 * north + 0.01 * east).astype(np.float32)


def npz(tmp_path: Path, **arrays: Any) -> str:
    path = tmp_path / "ground.npz"
    np.savez(path, **arrays)
    return str(path)


def tif(tmp_path: Path, data: np.ndarray, **profile: Any) -> str:
    path = tmp_path / "ground.tif"
    keys: dict[str, Any] = {"crs": "EPSG:32633", "transform": Affine(0.5, 0, 5e5, 0, -0.5, 5e6)}
    keys |= profile
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(
            path,
            "w",
            driver="GTiff",
            height=data.shape[0],
            width=data.shape[1],
            count=1,
            dtype=data.dtype,
            **keys,
        ) as out:
            out.write(data, 1)
    return str(path)


def window(file: str, map_cell_m: float, window_m: float = 32.0, **keys: Any) -> Terrain:
    world = WorldSettings(
        terrain=TerrainSettings(kind="file", file=file, **keys), window_m=(window_m, window_m)
    )
    return make_terrain(world, map_cell_m, np.random.default_rng(0))


def test_row_0_of_a_file_is_north(tmp_path: Path) -> None:
    file = read_elevation(npz(tmp_path, elevation=south_low(), cell_size=0.5))
    assert file.elevation_m[0, 0] == 0.0
    assert file.elevation_m[-1, 0] == pytest.approx(5.9)
    assert file.elevation_m[0, -1] == pytest.approx(0.79)
    assert file.cell_m == 0.5


def test_a_window_keeps_its_place_in_the_files_frame(tmp_path: Path) -> None:
    path = npz(tmp_path, elevation=south_low(), cell_size=np.float64(0.5))
    terrain = window(path, 0.1, window_m=10.0)
    west, east, south, north = terrain.frame.extent_m
    assert east - west == pytest.approx(10.0, abs=0.2)
    for x, y in np.random.default_rng(1).uniform((west, south), (east, north), (50, 2)):
        if min(x - west, east - x, y - south, north - y) > 0.1:
            want = 0.1 * (y / 0.5 - 0.5) + 0.01 * (x / 0.5 - 0.5)
            assert terrain.height_m(x, y) == pytest.approx(want, abs=1e-5)


def test_scale_keeps_slopes_and_a_small_file_is_taken_whole(tmp_path: Path) -> None:
    path = npz(tmp_path, elevation=south_low(), cell_size=50.0)
    terrain = window(path, 0.1, cell_m=0.25)
    # 79 x 59 cells of 0.25 m between the outer centres; heights shrink by 200
    assert terrain.frame.cols == pytest.approx(79 * 2.5, abs=2)
    assert terrain.frame.rows == pytest.approx(59 * 2.5, abs=2)
    rise = terrain.elevation_m[100, 50] - terrain.elevation_m[0, 50]
    assert rise == pytest.approx(100 * 0.1 * (0.1 / 50), rel=1e-4)


def test_finer_files_are_averaged_not_skipped_over(tmp_path: Path) -> None:
    rough = np.random.default_rng(0).normal(0, 0.02, (400, 400)).astype(np.float32)
    terrain = window(npz(tmp_path, elevation=rough, cell_size=0.05), 0.5, window_m=18.0)
    assert terrain.elevation_m.std() < 0.02 / 5


def test_unknown_stays_unknown_and_spoils_only_its_neighbours(tmp_path: Path) -> None:
    heights = south_low()
    heights[20:30, 40:50] = np.nan
    terrain = window(npz(tmp_path, elevation=heights, cell_size=0.5), 0.1)
    unknown = np.isnan(terrain.elevation_m)
    assert unknown.any()
    assert unknown.sum() * 0.1**2 <= (5.0 + 1.1) ** 2
    x, y = 45 * 0.5, (60 - 25) * 0.5
    assert np.isnan(terrain.height_m(x, y))
    assert not np.isnan(terrain.height_m(x, y - 3.5))


def test_a_geotiff_reads_like_the_npz_of_the_same_heights(tmp_path: Path) -> None:
    heights = south_low()
    heights[5, 7] = np.nan
    with_nodata = np.where(np.isnan(heights), -9999, heights).astype(np.float32)
    a = read_elevation(npz(tmp_path, elevation=heights, cell_size=0.5))
    b = read_elevation(tif(tmp_path, with_nodata, nodata=-9999))
    assert np.array_equal(a.elevation_m, b.elevation_m, equal_nan=True)
    assert b.cell_m == 0.5


@given(row=st.floats(0, 19), col=st.floats(0, 19), a=st.floats(-3, 3), b=st.floats(-3, 3))
@settings(max_examples=50, deadline=None)
def test_interpolation_is_exact_on_planes_and_at_the_samples(
    row: float, col: float, a: float, b: float
) -> None:
    rows, cols = np.mgrid[0:20, 0:20].astype(float)
    got = resample(a * rows + b * cols, (row, col), 1.0, (1, 1))[0, 0]
    assert got == pytest.approx(a * row + b * col, abs=1e-4)
    noise = np.random.default_rng(0).normal(size=(20, 20))
    assert np.allclose(resample(noise, (0.0, 0.0), 1.0, (20, 20)), noise, atol=1e-6)


@needs("mars_gale_hirise_1m.npz")
def test_a_window_of_mars_holds_the_files_own_heights_at_its_posts() -> None:
    path = str(DEMS / "mars_gale_hirise_1m.npz")
    raw = np.load(path)["elevation"][::-1]
    terrain = window(path, 0.1)
    west, east, south, north = terrain.frame.extent_m
    errors = [
        terrain.height_m(col + 0.5, row + 0.5) - raw[row, col]
        for row in range(int(south) + 1, int(north) - 1)
        for col in range(int(west) + 1, int(east) - 1)
    ]
    assert len(errors) > 600
    assert np.abs(errors).max() < 0.02  # float32 at 4 km, and bilinear between 0.1 m samples


@pytest.mark.parametrize(
    ("arrays", "sentence"),
    [
        ({"height": np.zeros((9, 9))}, "has no 'elevation'"),
        ({"elevation": np.zeros((9, 9))}, "has no 'cell_size'"),
        ({"elevation": np.zeros(9), "cell_size": 1.0}, "1-D"),
        ({"elevation": np.zeros((2, 9)), "cell_size": 1.0}, "at least 4 x 4"),
        ({"elevation": np.zeros((9, 9)), "cell_size": -1.0}, "cell size is -1"),
        ({"elevation": np.zeros((9, 9)), "cell_size": np.ones(2)}, "one number above 0"),
        ({"elevation": np.full((9, 9), np.nan), "cell_size": 1.0}, "no cell has a known height"),
        ({"elevation": np.array([["a"] * 9] * 9), "cell_size": 1.0}, "allowed is 2-D numbers"),
        ({"elevation": np.array([[{}] * 9] * 9), "cell_size": 1.0}, "no readable .npz"),
        ({"elevation": 99 * np.eye(40), "cell_size": 1.0}, "no known ground is flatter"),
        ({"elevation": np.zeros((9, 9)), "cell_size": 0.1}, "a team needs at least 4 x 4 m"),
    ],
)
def test_a_bad_npz_is_named_with_what_is_wrong(
    tmp_path: Path, arrays: dict[str, Any], sentence: str
) -> None:
    path = npz(tmp_path, **arrays)
    if "flatter" in sentence:
        jagged = np.random.default_rng(0).normal(0, 50, (40, 40))
        path = npz(tmp_path, elevation=jagged, cell_size=1.0)
    with pytest.raises(WorldError, match=r"ground\.npz") as caught:
        window(path, 0.1)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_bad_files_are_named_with_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match=r"nowhere\.npz' does not exist"):
        window(str(tmp_path / "nowhere.npz"), 0.1)
    text = tmp_path / "ground.csv"
    text.write_text("1,2")
    with pytest.raises(WorldError, match=r"kind '.csv' can't be read"):
        window(str(text), 0.1)
    for name in ("ground.npz", "ground.tif"):
        path = tmp_path / name
        path.write_bytes(b"not what it says")
        with pytest.raises(WorldError, match="no readable"):
            window(str(path), 0.1)
    in_degrees = tif(
        tmp_path, south_low(), crs="EPSG:4326", transform=Affine(1e-5, 0, 8, 0, -1e-5, 47)
    )
    with pytest.raises(WorldError, match="not given in m"):
        window(in_degrees, 0.1)
    assert read_elevation(in_degrees, 0.5).cell_m == 0.5
    oblong = tif(tmp_path, south_low(), transform=Affine(0.5, 0, 5e5, 0, -0.7, 5e6))
    with pytest.raises(WorldError, match="square cells"):
        window(oblong, 0.1)
