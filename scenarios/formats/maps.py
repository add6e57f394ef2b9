"""Other people's elevation maps: `.npz` and GeoTIFF with all that we keep of them, and `.npz` out.

An `.npz` has `elevation` (2-D, m, NaN unknown, row 0 north) and `cell_size` (m), and may have
`origin` (east and north of the south-west corner), `crs` (text) and `sigma` (as `elevation`, m).
"""

import io
import warnings
from pathlib import Path
from typing import Any, cast

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from scenarios.formats.rtm import ElevationMap, MapFileError
from sim.errors import WorldError
from sim.heightmaps import SET_GREY
from sim.terrain_files import ElevationFile, read_elevation

Floats = NDArray[np.float64]


def read_map(path: Path, cell_m: float | None = None) -> ElevationMap:
    """Return the map of an .npz, a GeoTIFF or an ASCII grid.

    Args:
        path: the file.
        cell_m: cell size of a GeoTIFF that does not give it in metres (its place is then not kept);
            refused where a file gives its own.

    Raises MapFileError, one sentence, for what can't be read.

    """
    file = _elevations(path, cell_m)
    if path.suffix.lower() == ".npz":
        return _npz(path, file)
    origin_m, crs = (None, None) if cell_m is not None else _georeference(path)
    return ElevationMap(file.elevation_m, file.cell_m, origin_m, crs)


def _elevations(path: Path, cell_m: float | None) -> ElevationFile:
    try:
        file = read_elevation(str(path))
    except WorldError as error:
        if cell_m is None:
            raise MapFileError(_in_words_of_maps(error)) from error
    else:
        if cell_m is not None and cell_m != file.cell_m:
            raise MapFileError(
                f"{path}: gives its own cell size of {file.cell_m:g} m; --cell-m {cell_m:g} is for"
                " files that don't"
            )
        return file
    try:
        return read_elevation(str(path), cell_m)
    except WorldError as error:
        raise MapFileError(_in_words_of_maps(error)) from error


def _in_words_of_maps(error: WorldError) -> str:
    """Return a reader's sentence with our option in place of a scenario's keys."""
    return (
        str(error)
        .replace("world.terrain.file ", "")
        .replace("set world.terrain.cell_m to it", "give it by --cell-m")
        .replace(SET_GREY, "make an .npz or a GeoTIFF of it")
    )


def _npz(path: Path, file: ElevationFile) -> ElevationMap:
    with np.load(path, allow_pickle=False) as archive:
        more = {name: archive[name] for name in ("origin", "crs", "sigma") if name in archive.files}
    origin_m, crs, sigma_m = None, None, None
    if "origin" in more:
        origin = more["origin"]
        if origin.shape != (2,) or origin.dtype.kind not in "fiu" or not np.isfinite(origin).all():
            raise MapFileError(f"{path}: origin is {origin!r}, allowed are two numbers, in m")
        origin_m = (float(origin[0]), float(origin[1]))
    if "crs" in more:
        if more["crs"].dtype.kind != "U" or more["crs"].size != 1:
            raise MapFileError(f"{path}: crs is {more['crs']!r}, allowed is one text")
        crs = str(more["crs"].reshape(-1)[0])
    if "sigma" in more:
        sigma_m = _sigma(path, more["sigma"], file.elevation_m.shape)
    return ElevationMap(file.elevation_m, file.cell_m, origin_m, crs, sigma_m)


def _sigma(path: Path, sigma: NDArray[Any], shape: tuple[int, ...]) -> Floats:
    if sigma.shape != shape or sigma.dtype.kind not in "fiu":
        raise MapFileError(
            f"{path}: sigma is {sigma.shape} of {sigma.dtype}, allowed are numbers, {shape} as"
            " elevation"
        )
    return np.ascontiguousarray(sigma[::-1]).astype(np.float64)


def _georeference(path: Path) -> tuple[tuple[float, float] | None, str | None]:
    """Return a GeoTIFF's south-west corner and CRS."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path) as opened:
            raster = cast("Any", opened)
            transform, height, crs = raster.transform, raster.height, raster.crs
    south = min(transform.f, transform.f + height * transform.e)
    return (float(transform.c), float(south)), None if crs is None else str(crs.to_string())


def place_of(path: Path) -> tuple[tuple[float, float] | None, str | None]:
    """Return the south-west corner and the CRS of an .npz or a GeoTIFF, None if it tells none."""
    try:
        if path.suffix.lower() in (".tif", ".tiff"):
            return _georeference(path)
        found = read_map(path)
    except (MapFileError, RasterioError):
        return None, None
    return found.origin_m, found.crs


def npz_bytes(elevations: ElevationMap) -> bytes:
    """Return a map as the bytes of an .npz (deflate): float32, row 0 north."""
    arrays: dict[str, Any] = {
        "elevation": elevations.elevation_m[::-1].astype(np.float32),
        "cell_size": np.float64(elevations.cell_m),
    }
    if elevations.origin_m is not None:
        arrays["origin"] = np.array(elevations.origin_m)
    if elevations.crs is not None:
        arrays["crs"] = np.array(elevations.crs)
    if elevations.sigma_m is not None:
        arrays["sigma"] = elevations.sigma_m[::-1].astype(np.float32)
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()
