"""Elevation files of others: reading them, and choosing the window on which a team can work."""

import math
import warnings
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from agents.geometry import Bools, Floats, GridFrame, Singles
from sim.errors import WorldError
from sim.ground import dilated, filled, largest_regions, plane_fit
from sim.heightmaps import read_ascii, read_png
from sim.resample import resample

KINDS = ".npz, .tif (GeoTIFF), .asc (ASCII grid), .png"
MAX_FILE_CELLS = 32_000_000
SURVEY_CELLS = 1_000_000
"""A file is looked over for a window at no more cells than these."""
STANDABLE_DEG = 15.0
"""Ground on which a team is put down."""
REACH_M = 8.0
"""A drop counts where it is reached within this distance."""


@dataclass(frozen=True)
class ElevationFile:
    """A file's heights as read: row 0 south, metres, NaN unknown."""

    path: str
    elevation_m: Floats
    cell_m: float

    def scaled(self, cell_m: float | None) -> "ElevationFile":
        """Return the same shapes with another cell size; heights are scaled alike."""
        if cell_m is None or cell_m == self.cell_m:
            return self
        return ElevationFile(self.path, self.elevation_m * (cell_m / self.cell_m), cell_m)


def read_elevation(
    path: str,
    scale_cell_m: float | None = None,
    grey_m: tuple[float, float] | None = None,
) -> ElevationFile:
    """Read an .npz, a GeoTIFF, an ASCII grid or a PNG.

    `scale_cell_m` is the cell size that it shall be taken to have; `grey_m` are the heights of a
    PNG's black and white.

    Raises WorldError where the file is absent, of another kind, or holds no elevation grid.
    """
    file = Path(path)
    if not file.is_file():
        raise WorldError(f"world.terrain.file {path!r} does not exist; allowed: {KINDS}")
    suffix = file.suffix.lower()
    if suffix == ".npz":
        elevation_m, cell_m = _read_npz(file)
    elif suffix in (".tif", ".tiff"):
        elevation_m, cell_m = _read_tiff(file, scale_cell_m)
    elif suffix == ".asc":
        elevation_m, cell_m = read_ascii(file, MAX_FILE_CELLS)
    elif suffix == ".png":
        elevation_m, cell_m = read_png(file, grey_m, MAX_FILE_CELLS), scale_cell_m
    else:
        raise WorldError(f"{path}: files of kind {suffix!r} can't be read; allowed: {KINDS}")
    if cell_m is None:
        raise WorldError(_no_cell_size(file))
    _check(path, elevation_m, cell_m)
    south_up = np.ascontiguousarray(elevation_m[::-1]).astype(np.float64)
    south_up[~np.isfinite(south_up)] = np.nan
    return ElevationFile(path, south_up, cell_m).scaled(scale_cell_m)


def _read_npz(file: Path) -> tuple[Floats, float]:
    try:
        with np.load(file, allow_pickle=False) as archive:
            missing = [k for k in ("elevation", "cell_size") if k not in archive.files]
            if missing:
                raise WorldError(
                    f"{file}: has no {missing[0]!r}; needed: elevation (2-D, m), cell_size (m)"
                )
            elevation, size = archive["elevation"], archive["cell_size"]
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise WorldError(f"{file}: is no readable .npz ({error})") from None
    if elevation.ndim != 2 or elevation.dtype.kind not in "fiu":
        raise WorldError(
            f"{file}: elevation is {elevation.ndim}-D of {elevation.dtype}, allowed is 2-D numbers"
        )
    if size.size != 1 or size.dtype.kind not in "fiu":
        raise WorldError(f"{file}: cell_size is {size!r}, allowed is one number above 0, in m")
    return elevation, float(size.reshape(-1)[0])


def _read_tiff(file: Path, scale_cell_m: float | None) -> tuple[Floats, float]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(file) as opened:
                raster = cast("Any", opened)
                if raster.width * raster.height > MAX_FILE_CELLS:
                    raise WorldError(_too_large(str(file), raster.height, raster.width))
                band = raster.read(1, masked=True)
                transform, crs = raster.transform, raster.crs
    except (RasterioError, OSError, ValueError) as error:
        raise WorldError(f"{file}: is no readable GeoTIFF ({error})") from None
    if np.iscomplexobj(band):
        raise WorldError(f"{file}: holds complex numbers, allowed are heights in m")
    elevation = np.ma.filled(band.astype(np.float64), np.nan)
    if transform.e > 0:  # row 0 south, against the custom
        elevation = elevation[::-1]
    return elevation, _tiff_cell_m(file, transform, crs, scale_cell_m)


def _tiff_cell_m(file: Path, transform: Any, crs: Any, scale_cell_m: float | None) -> float:
    in_metres = crs is not None and (crs.is_projected or _is_local_in_metres(crs))
    if crs is None or transform.is_identity or not in_metres:
        if scale_cell_m is None:
            raise WorldError(_no_cell_size(file))
        return scale_cell_m
    width, height = abs(transform.a), abs(transform.e)
    if transform.b != 0 or transform.d != 0 or abs(width - height) > 0.01 * width:
        raise WorldError(
            f"{file}: its cells are {width:g} x {height:g} (rotation {transform.b:g}), allowed are"
            " square cells along east and north"
        )
    return float(width * crs.linear_units_factor[1]) if crs.is_projected else float(width)


def _is_local_in_metres(crs: Any) -> bool:
    """Say whether coordinates are metres of a frame that lies nowhere on a planet."""
    text = str(crs.to_wkt())
    return text.startswith(("LOCAL_CS", "ENGCRS")) and 'UNIT["metre",1' in text


def _no_cell_size(file: Path) -> str:
    return f"{file}: its cell size is not given in m; set world.terrain.cell_m to it"


def _too_large(path: str, rows: int, cols: int) -> str:
    return f"{path}: has {rows} x {cols} cells, allowed are at most {MAX_FILE_CELLS}"


def _check(path: str, elevation_m: Floats, cell_m: float) -> None:
    rows, cols = elevation_m.shape
    if rows * cols > MAX_FILE_CELLS:
        raise WorldError(_too_large(path, rows, cols))
    if min(rows, cols) < 4:
        raise WorldError(f"{path}: has {rows} x {cols} cells, needed are at least 4 x 4")
    if not (math.isfinite(cell_m) and cell_m > 0):
        raise WorldError(f"{path}: its cell size is {cell_m:g} m, allowed is a number above 0")
    if not np.isfinite(elevation_m).any():
        raise WorldError(f"{path}: no cell has a known height")


@dataclass(frozen=True)
class _Survey:
    """A file seen from afar: where a team could stand, and how far it falls from there."""

    cell_m: float
    standable: Bools
    drop_m: Floats
    known: Bools


def _survey(file: ElevationFile, footprint_m: float) -> _Survey:
    """Look a file over at cells no finer than half a footprint."""
    rows, cols = file.elevation_m.shape
    by_size = math.sqrt(rows * cols / SURVEY_CELLS)
    stride = max(1, math.ceil(by_size), round(footprint_m / 2 / file.cell_m))
    coarse = smoothed(file.elevation_m, stride)[stride // 2 :: stride, stride // 2 :: stride]
    cell_m = file.cell_m * stride
    known = np.isfinite(coarse)
    full = filled(coarse)
    _, east, north = plane_fit(full, cell_m, max(footprint_m, 2 * cell_m))
    flat = np.hypot(east, north) <= math.tan(math.radians(STANDABLE_DEG))
    flat &= ~dilated(~known, 1)
    standable = largest_regions(np.asarray(flat, dtype=np.bool_), 40.0 / cell_m**2)
    n = max(1, round(REACH_M / cell_m))
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * n + 1, 2 * n + 1))
    lowest = np.asarray(cv2.erode(np.where(known, full, np.inf), reach), dtype=np.float64)
    return _Survey(cell_m, standable, np.where(known, full - lowest, 0.0), known)


def smoothed(elevation_m: Floats, width: int) -> Floats:
    """Return the mean of the known cells in a square of `width` cells; NaN stays NaN."""
    if width < 2:
        return elevation_m
    known = np.isfinite(elevation_m)
    low = float(np.nanmean(elevation_m))
    size = (width, width)
    total = cv2.blur(np.where(known, elevation_m - low, 0.0), size, borderType=cv2.BORDER_REFLECT)
    weight = cv2.blur(known.astype(np.float64), size, borderType=cv2.BORDER_REFLECT)
    with np.errstate(invalid="ignore"):
        mean = np.asarray(total) / np.maximum(np.asarray(weight), 1e-12) + low
    return np.where(known, mean, np.nan)


def choose_window(
    file: ElevationFile, window_m: tuple[float, float], footprint_m: float, wants_drop: bool
) -> tuple[float, float, float, float]:
    """Return (west, east, south, north) of the window, in metres from the file's south-west corner.

    The window lies within the file's cell centres, or is all of them where the file is smaller.
    With `wants_drop` it is laid round flat ground beside the best drop that the file has within
    reach, otherwise round the middle of much flat, known ground. Raises WorldError where nothing
    is flat enough for a team to stand.
    """
    rows, cols = file.elevation_m.shape
    hull_m = ((cols - 1) * file.cell_m, (rows - 1) * file.cell_m)
    width_m, height_m = min(window_m[0], hull_m[0]), min(window_m[1], hull_m[1])
    survey = _survey(file, footprint_m)
    if not survey.standable.any():
        raise WorldError(
            f"{file.path}: at {file.cell_m:g} m per cell no known ground is flatter than"
            f" {STANDABLE_DEG:g} deg; try another world.terrain.cell_m or file"
        )
    row, col = np.unravel_index(
        int(np.argmax(_merit(survey, width_m, height_m, wants_drop))), survey.standable.shape
    )
    middle = ((col + 0.5) * survey.cell_m, (row + 0.5) * survey.cell_m)
    half = file.cell_m / 2
    west = min(max(middle[0] - width_m / 2, half), half + hull_m[0] - width_m)
    south = min(max(middle[1] - height_m / 2, half), half + hull_m[1] - height_m)
    return west, west + width_m, south, south + height_m


def _merit(survey: _Survey, width_m: float, height_m: float, wants_drop: bool) -> Floats:
    """Return how good a window's middle each survey cell is; -1 where a team can't stand."""
    size = (max(1, round(width_m / survey.cell_m)), max(1, round(height_m / survey.cell_m)))

    def share(mask: Bools) -> Floats:
        return np.asarray(
            cv2.blur(mask.astype(np.float64), size, borderType=cv2.BORDER_CONSTANT),
            dtype=np.float64,
        )

    merit = share(survey.known) * (0.2 + np.minimum(share(survey.standable) / 0.4, 1.0))
    if wants_drop:
        merit *= 0.1 + np.minimum(survey.drop_m, REACH_M)
    return np.where(survey.standable, merit, -1.0)


def window_of(
    file: ElevationFile, extent_m: tuple[float, float, float, float], cell_m: float
) -> tuple[GridFrame, Singles]:
    """Sample a window at a cell size; its corner is snapped to whole cells of the world frame.

    A file of finer cells is averaged first, so that no rock is skipped between two samples.
    """
    west, east, south, north = extent_m
    first_col, first_row = math.ceil(west / cell_m - 1e-6), math.ceil(south / cell_m - 1e-6)
    cols, rows = math.floor(east / cell_m + 1e-6), math.floor(north / cell_m + 1e-6)
    frame = GridFrame(
        first_col * cell_m, first_row * cell_m, cell_m, rows - first_row, cols - first_col
    )
    source = smoothed(file.elevation_m, round(cell_m / file.cell_m))
    row0 = (frame.y_m + cell_m / 2) / file.cell_m - 0.5
    col0 = (frame.x_m + cell_m / 2) / file.cell_m - 0.5
    return frame, resample(source, (row0, col0), cell_m / file.cell_m, frame.shape)
