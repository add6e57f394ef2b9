"""Files of stereo pairs: images, calibrations, disparities, clouds and pictures."""

import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from agents.geometry import Floats, Singles
from agents.stereo.calibration import Calibration, CalibrationError
from agents.stereo.matching import Grey
from agents.stereo.points import Cloud
from scenarios.errors import StudyError

UNMATCHED_BGR = (60, 50, 45)


class StereoError(StudyError):
    """A file of a stereo pair that can't be read, written or used."""


def read_grey(path: str) -> Grey:
    """Return an image file as grey levels (H, W); 16 bits are scaled down to 8.

    Raises StereoError where it can't be read.
    """
    if not Path(path).is_file():
        raise StereoError(f"{path}: no such file, needed is an image")
    image = cv2.imread(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    if image is None:
        raise StereoError(f"{path}: can't be read as an image")
    if image.dtype == np.uint16:
        top = max(float(image.max()), 1.0)
        return np.asarray(np.rint(image * (255 / max(top, 255.0))), dtype=np.uint8)
    if image.dtype != np.uint8:
        raise StereoError(f"{path}: has pixels of {image.dtype}, allowed are 8 or 16 bits")
    return np.asarray(image, dtype=np.uint8)


def read_calibration(path: str, width_px: int, height_px: int) -> Calibration:
    """Return the calibration in a file, for images of this size.

    Raises StereoError where the file can't be read, says too little or the impossible.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise StereoError(f"{path}: can't be read as a calibration ({error})") from error
    try:
        values = _values(path, text)
    except (ValueError, KeyError, TypeError, IndexError, cv2.error) as error:
        raise StereoError(
            f"{path}: is no calibration of a pair ({error}); needed are focal_px, cx_px, cy_px and"
            " baseline_m in .json, or a calibration of Middlebury, KITTI or OpenCV"
        ) from error
    try:
        return Calibration(width_px=width_px, height_px=height_px, **values)
    except CalibrationError as error:
        raise StereoError(f"{path}: {error}") from error


def _values(path: str, text: str) -> dict[str, float]:
    """Return focal length, centre, offset and baseline, by what kind of file it is."""
    if Path(path).suffix.lower() == ".json":
        return _from_json(json.loads(text))
    if re.search(r"^\s*cam0\s*=", text, re.MULTILINE):
        return _from_middlebury(text)
    if text.lstrip().startswith(("%YAML", "<?xml")):
        return _from_opencv(text)
    return _from_kitti(text)


def _from_json(read: Any) -> dict[str, float]:
    if not isinstance(read, dict):
        raise TypeError("it holds no object")
    needed = ("focal_px", "cx_px", "cy_px", "baseline_m")
    missing = [key for key in needed if key not in read]
    if missing:
        raise KeyError(f"without {', '.join(missing)}")
    optional = ("doffs_px", "focal_sigma", "baseline_sigma", "offset_sigma_px")
    kept = [*needed, *(key for key in optional if key in read)]
    return {key: float(read[key]) for key in kept}


def _from_middlebury(text: str) -> dict[str, float]:
    said = dict(re.findall(r"^\s*(\w+)\s*=\s*(.+?)\s*$", text, re.MULTILINE))
    left = [float(v) for v in re.findall(r"[-+.\deE]+", said["cam0"])]
    return {
        "focal_px": left[0],
        "cx_px": left[2],
        "cy_px": left[5],
        "doffs_px": float(said.get("doffs", "0")),
        "baseline_m": float(said["baseline"]) / 1000,
    }


def _from_kitti(text: str) -> dict[str, float]:
    said = dict(re.findall(r"^\s*(\w+)\s*:\s*(.+?)\s*$", text, re.MULTILINE))
    for one, other in (
        ("P2", "P3"),
        ("P_rect_02", "P_rect_03"),
        ("P0", "P1"),
        ("P_rect_00", "P_rect_01"),
    ):
        if one in said and other in said:
            return _from_projections(_twelve(said[one]), _twelve(said[other]))
    raise KeyError("without P0 and P1, or P2 and P3")


def _twelve(text: str) -> Floats:
    return np.array([float(v) for v in text.split()]).reshape(3, 4)


def _from_opencv(text: str) -> dict[str, float]:
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    nodes = [storage.getNode(name) for name in ("P1", "P2")]
    if any(node.empty() for node in nodes):
        raise KeyError("without P1 and P2")
    left, right = (np.asarray(node.mat(), dtype=np.float64) for node in nodes)
    return _from_projections(left, right)


def _from_projections(left: Floats, right: Floats) -> dict[str, float]:
    """Return the values in two projection matrices (3, 4) of a rectified pair, in metres."""
    focal = float(left[0, 0])
    return {
        "focal_px": focal,
        "cx_px": float(left[0, 2]),
        "cy_px": float(left[1, 2]),
        "doffs_px": float(right[0, 2] - left[0, 2]),
        "baseline_m": float(left[0, 3] - right[0, 3]) / focal,
    }


def write_disparity(path: str, disparity_px: Singles) -> None:
    """Write disparities (H, W), float32, NaN where unmatched, as .npy.

    Raises StereoError where that can't be.
    """
    try:
        with open(path, "wb") as file:
            np.save(file, disparity_px)
    except OSError as error:
        raise StereoError(f"{path}: can't be written ({error})") from error


def depth_picture(disparity_px: Singles) -> Grey:
    """Return a picture (H, W, 3), BGR: near is red, far is blue, unmatched is dark grey."""
    known = np.isfinite(disparity_px)
    low, high = np.quantile(disparity_px[known], (0.01, 0.99)) if known.any() else (0.0, 1.0)
    share = (np.nan_to_num(disparity_px) - low) / max(high - low, 1e-6)
    levels = np.rint(np.clip(share, 0, 1) * 255).astype(np.uint8)
    coloured = np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_TURBO), dtype=np.uint8)
    coloured[~known] = UNMATCHED_BGR
    return coloured


def write_picture(path: Path, disparity_px: Singles) -> None:
    """Write `depth_picture` to an image file.

    Raises StereoError where that can't be.
    """
    try:
        done = cv2.imwrite(str(path), depth_picture(disparity_px))
    except cv2.error as error:
        raise StereoError(f"{path}: no known kind of picture, allowed is .png or .jpg") from error
    if not done:
        raise StereoError(f"{path}: can't be written")


def write_cloud(path: str, found: Cloud, left: Grey) -> None:
    """Write points as binary .ply: x right, y down, z ahead in m, sigma along the ray in m, grey.

    Raises StereoError where that can't be.
    """
    kind = [("xyz", "<f4", 3), ("sigma", "<f4"), ("grey", "u1", 3)]
    rows = np.empty(found.points_m.shape[0], dtype=kind)
    rows["xyz"] = found.points_m
    rows["sigma"] = found.sigma_along_m()
    rows["grey"] = left[found.pixels[:, 0], found.pixels[:, 1]][:, None]
    names = [*(f"float {n}" for n in ("x", "y", "z", "sigma_m")), "uchar red", "uchar green"]
    head = [
        "ply",
        "format binary_little_endian 1.0",
        "comment metres; camera frame: x right, y down, z ahead",
        f"element vertex {rows.size}",
        *(f"property {name}" for name in (*names, "uchar blue")),
        "end_header\n",
    ]
    try:
        Path(path).write_bytes("\n".join(head).encode() + rows.tobytes())
    except OSError as error:
        raise StereoError(f"{path}: can't be written ({error})") from error
