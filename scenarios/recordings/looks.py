"""Looks of a recording: point clouds, and pairs of images with their calibration."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from agents.geometry import Floats
from agents.stereo.calibration import Calibration, CalibrationError
from agents.stereo.matching import Grey
from sim.errors import WorldError

CLOUD = "sensor_msgs/msg/PointCloud2"
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CAMERA = "sensor_msgs/msg/CameraInfo"
MOST_POINTS = 20_000
"""A cloud of more is thinned."""
_REALS = {7: "f4", 8: "f8"}
"""PointField's FLOAT32 and FLOAT64."""
_PLAIN = {"mono8": (np.uint8, 1), "8UC1": (np.uint8, 1), "mono16": (np.uint16, 1)}
_COLOURS = {"bgr8": cv2.COLOR_BGR2GRAY, "rgb8": cv2.COLOR_RGB2GRAY}


def points(told: dict[str, Any], place: str) -> Floats:
    """Return the finite points (N, 3) of a PointCloud2, in its own frame.

    Raises:
        WorldError: it has no x, y and z, or fewer bytes than it says; `place` names it.

    """
    fields = {one["name"]: one for one in told["fields"]}
    order = ">" if told["is_bigendian"] else "<"
    types = {axis: _REALS.get(fields[axis]["datatype"]) for axis in "xyz" if axis in fields}
    if len(types) < 3 or None in types.values():
        raise WorldError(f"{place}: has fields {', '.join(fields)}; needed are x, y and z as reals")
    step, rows, columns = told["point_step"], told["height"], told["width"]
    offsets = [fields[axis]["offset"] for axis in "xyz"]
    data = np.ascontiguousarray(told["data"], dtype=np.uint8)
    row_step = told["row_step"] or step * columns
    fits = row_step >= step * columns and data.size >= row_step * rows
    if not fits or any(offset + 4 > step for offset in offsets):
        raise WorldError(f"{place}: has {data.size} bytes, which do not hold {rows} x {columns}")
    rows_of = data[: row_step * rows].reshape(rows, row_step)[:, : step * columns]
    dtype = np.dtype(
        {
            "names": list("xyz"),
            "formats": [order + str(types[axis]) for axis in "xyz"],
            "offsets": offsets,
            "itemsize": step,
        }
    )
    held = np.frombuffer(rows_of.tobytes(), dtype)
    found = np.column_stack([held[axis].astype(np.float64) for axis in "xyz"])
    found = found[np.isfinite(found).all(axis=1)]
    return found[:: max(1, -(-len(found) // MOST_POINTS))]


def grey(told: dict[str, Any], place: str) -> Grey:
    """Return an image as grey levels (H, W).

    Raises:
        WorldError: it can't be read, or has an encoding that is not known here.

    """
    data = np.ascontiguousarray(told["data"], dtype=np.uint8)
    if "encoding" not in told:
        image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if data.size else None
        if image is None:
            raise WorldError(f"{place}: an image of format {told['format']!r} can't be read")
        return np.asarray(image, dtype=np.uint8)
    encoding, height, width, step = (told[k] for k in ("encoding", "height", "width", "step"))
    if encoding not in _PLAIN and encoding not in _COLOURS:
        known = ", ".join((*_PLAIN, *_COLOURS))
        raise WorldError(f"{place}: has images of encoding {encoding!r}; must be one of {known}")
    dtype, channels = _PLAIN.get(encoding, (np.uint8, 3))
    order = ">" if told["is_bigendian"] else "<"
    width_bytes = width * channels * np.dtype(dtype).itemsize
    if width == 0 or step < width_bytes or data.size < step * height:
        raise WorldError(f"{place}: an image of {data.size} bytes can't be {width} x {height}")
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :width_bytes])
    image = rows.view(np.dtype(dtype).newbyteorder(order)).reshape(height, width, channels)
    if encoding in _COLOURS:
        return np.asarray(cv2.cvtColor(image, _COLOURS[encoding]), dtype=np.uint8)
    flat = image[:, :, 0]
    return np.asarray(flat >> 8 if flat.dtype.itemsize == 2 else flat, dtype=np.uint8)


def calibration(left: dict[str, Any], right: dict[str, Any], file: Path) -> Calibration:
    """Return the calibration of a rectified pair, by both cameras' projection matrices.

    Raises:
        WorldError: that of no pair.

    """
    p, q = np.asarray(left["p"]).reshape(3, 4), np.asarray(right["p"]).reshape(3, 4)
    try:
        return Calibration(
            width_px=int(left["width"]),
            height_px=int(left["height"]),
            focal_px=float(p[0, 0]),
            cx_px=float(p[0, 2]),
            cy_px=float(p[1, 2]),
            baseline_m=float((p[0, 3] - q[0, 3]) / q[0, 0]) if q[0, 0] else 0.0,
            doffs_px=float(q[0, 2] - p[0, 2]),
        )
    except CalibrationError as error:
        raise WorldError(f"{file}: camera_info is not that of a rectified pair: {error}") from error


def sibling(topic: str) -> str:
    """Return the topic that tells a camera's calibration, beside that of its images."""
    above = topic.removesuffix("/compressed").rpartition("/")[0]
    return f"{above}/camera_info"
