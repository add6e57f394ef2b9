"""Maps as rasters: GeoTIFF, .npz, and image and yaml of `map_server`. Row 0 of a file is north."""

import io
import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio import Affine
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import MemoryFile

from agents.geometry import Singles
from agents.maps.elevation import slope_of
from scenarios.exports.kept import Kept
from scenarios.formats.maps import npz_bytes
from scenarios.formats.rtm import ElevationMap, write_file
from scenarios.logs.diary import Chart

LOCAL_CRS = 'LOCAL_CS["the run\'s own frame: x east, y north",UNIT["metre",1]]'
"""Of a map that lies nowhere on a planet."""
OCCUPIED, UNKNOWN, FREE = 0, 205, 254
"""Grey of a map_server image."""
OCCUPIED_SHARE, FREE_SHARE = 0.65, 0.196
"""Probabilities above and below which a cell of a floor is solid or free to map_server."""


def bands_of(chart: Chart) -> dict[str, Singles]:
    """Return what a chart's files hold, by band: (rows, cols), row 0 south, NaN unknown."""
    odds = chart.layers.get("log_odds")
    if odds is None:
        return chart.layers
    return {"occupied": (1.0 / (1.0 + np.exp(-odds.astype(np.float64)))).astype(np.float32)}


def write_geotiff(kept: Kept, folder: Path) -> list[Path]:
    """Write ROBOT.tif: elevation and sigma in m, or the probability that a cell is occupied."""
    chart, place = kept.chart, kept.place
    bands = bands_of(chart)
    frame = chart.frame
    west, _, _, north = frame.extent_m
    options: dict[str, Any] = {
        "driver": "GTiff",
        "height": frame.rows,
        "width": frame.cols,
        "count": len(bands),
        "dtype": "float32",
        "nodata": float("nan"),
        "compress": "deflate",
        "predictor": 3,
        "crs": place.crs or LOCAL_CRS,
        "transform": Affine(
            frame.cell_m, 0.0, west + place.east_m, 0.0, -frame.cell_m, north + place.north_m
        ),
    }
    with warnings.catch_warnings(), MemoryFile() as memory:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.Env(), memory.open(**options) as raster:
            for number, (name, values) in enumerate(bands.items(), start=1):
                raster.write(values[::-1], number)
                raster.set_band_description(number, name)
        data = memory.read()
    path = folder / f"{kept.robot}.tif"
    write_file(path, bytes(data))
    return [path]


def write_npz(kept: Kept, folder: Path) -> list[Path]:
    """Write ROBOT.npz: elevation and sigma as `world.terrain.file` takes them; or occupied."""
    chart, place = kept.chart, kept.place
    west, _, south, _ = chart.frame.extent_m
    origin_m = (west + place.east_m, south + place.north_m)
    if "elevation" in chart.layers:
        elevation_m, sigma_m = (
            chart.layers[name].astype(np.float64) for name in ("elevation", "sigma")
        )
        found = ElevationMap(elevation_m, chart.frame.cell_m, origin_m, place.crs, sigma_m)
        data = npz_bytes(found)
    else:
        file = io.BytesIO()
        occupied = bands_of(chart)["occupied"][::-1]
        cell = np.float64(chart.frame.cell_m)
        np.savez_compressed(file, occupied=occupied, cell_size=cell, origin=np.array(origin_m))
        data = file.getvalue()
    path = folder / f"{kept.robot}.npz"
    write_file(path, data)
    return [path]


def write_map_server(kept: Kept, folder: Path) -> list[Path]:
    """Write ROBOT.yaml and its ROBOT.png: what a robot's wheels may and may not stand on.

    Of ground, solid is what is steeper than the scenario's `drive.max_slope_deg`; where a
    neighbour is unknown (or beyond the edge), so is the slope.
    """
    chart = kept.chart
    ok, png = cv2.imencode(".png", trinary(chart, kept.scenario.drive.max_slope_deg)[::-1])
    assert ok
    image, yaml = folder / f"{kept.robot}.png", folder / f"{kept.robot}.yaml"
    write_file(image, png.tobytes())
    frame = chart.frame
    lines = (
        f"image: {image.name}",
        "mode: trinary",
        f"resolution: {frame.cell_m:.10g}",
        f"origin: [{frame.x_m:.10g}, {frame.y_m:.10g}, 0.0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_SHARE}",
        f"free_thresh: {FREE_SHARE}",
    )
    write_file(yaml, ("\n".join(lines) + "\n").encode())
    return [yaml, image]


def trinary(chart: Chart, max_slope_deg: float) -> NDArray[np.uint8]:
    """Return a chart (rows, cols; row 0 south) as map_server's grey."""
    odds = chart.layers.get("log_odds")
    if odds is not None:
        share = bands_of(chart)["occupied"]
        solid, free = share > OCCUPIED_SHARE, share < FREE_SHARE
    else:
        elevation_m = chart.layers["elevation"].astype(np.float64)
        padded = np.pad(np.isfinite(elevation_m), 1)
        known = padded[1:-1, 1:-1] & padded[1:-1, 2:] & padded[1:-1, :-2]
        known &= padded[2:, 1:-1] & padded[:-2, 1:-1]
        slope = slope_of(elevation_m, chart.frame.cell_m)
        solid = known & (slope > np.tan(np.radians(max_slope_deg)))
        free = known & ~solid
    return np.where(solid, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.uint8)
