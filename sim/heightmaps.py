"""Elevation as text and as pictures: Esri's ASCII grid, and PNG with heights for its greys."""

import math
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from agents.geometry import Floats
from sim.errors import WorldError

MAX_HEADER_LINES = 8
MAX_LINE = 1_000_000
MAX_CHARS = 40
"""Of one height and what is between it and the next; of a longer file no more is read."""
SET_GREY = "set world.terrain.grey_m to those of its black and its white, as [0.0, 12.5]"
PNG_HEAD = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"
_SIZE = struct.Struct(">II")


def read_ascii(file: Path, max_cells: int) -> tuple[Floats, float]:
    """Read an Esri ASCII grid (`.asc`): heights (rows, cols; row 0 north, NaN unknown), cell in m.

    Raises:
        WorldError: it is none, or has more cells than allowed.

    """
    try:
        with file.open(encoding="ascii") as stream:
            told, line = _header(file, stream.readline)
            rows, cols = (_whole(file, told, name) for name in ("nrows", "ncols"))
            if rows * cols > max_cells:
                raise WorldError(
                    f"{file}: has {rows} x {cols} cells, allowed are at most {max_cells}"
                )
            text = stream.read(MAX_CHARS * rows * cols + 1)
            words = f"{line}{text}".split()
    except UnicodeDecodeError:
        raise WorldError(f"{file}: is no ASCII grid: it holds bytes that are no ASCII") from None
    except OSError as error:
        raise WorldError(f"{file}: can't be read: {error.strerror}") from None
    if len(words) != rows * cols:
        raise WorldError(
            f"{file}: holds {len(words)} heights, its header says {rows} x {cols} = {rows * cols}"
        )
    try:
        heights = np.array(words, dtype=np.float64).reshape(rows, cols)
    except ValueError as error:
        raise WorldError(f"{file}: holds what is no height ({error})") from None
    heights[heights == _number(file, told, "nodata_value", -9999.0)] = np.nan
    return heights, _number(file, told, "cellsize")


def _header(file: Path, next_line: Callable[[int], str]) -> tuple[dict[str, str], str]:
    """Return the header's words by lower-case key, and the first line of heights."""
    told: dict[str, str] = {}
    for _ in range(MAX_HEADER_LINES):
        line = next_line(MAX_LINE)
        words = line.split()
        if not words or not words[0][0].isalpha() or words[0].lower() == "nan":
            break
        if len(words) != 2:
            raise WorldError(f"{file}: is no ASCII grid: its header has the line {line[:60]!r}")
        told[words[0].lower()] = words[1]
    else:
        raise WorldError(f"{file}: is no ASCII grid: its header has no end")
    for name in ("ncols", "nrows", "cellsize"):
        if name not in told:
            raise WorldError(f"{file}: is no ASCII grid: its header has no {name!r}")
    return told, line


def _number(file: Path, told: dict[str, str], name: str, default: float = math.nan) -> float:
    try:
        return float(told.get(name, default))
    except ValueError:
        raise WorldError(f"{file}: {name} is {told[name]!r}: it must be a number") from None


def _whole(file: Path, told: dict[str, str], name: str) -> int:
    if not (told[name].isdecimal() and len(told[name]) < 10):
        raise WorldError(f"{file}: {name} is {told[name]!r}: it must be a whole number above 0")
    return int(told[name])


def read_png(file: Path, grey_m: tuple[float, float] | None, max_cells: int) -> Floats:
    """Read a picture of heights, grey of 8 or 16 bit: (rows, cols), row 0 north.

    Where it is wholly transparent the ground is unknown.

    Args:
        file: the picture.
        grey_m: heights of its black and of its white; without them it says nothing.
        max_cells: how large it may be.

    Raises:
        WorldError: it is none, or has colours, more cells than allowed, or no heights are given.

    """
    try:
        with file.open("rb") as stream:
            head = stream.read(len(PNG_HEAD) + _SIZE.size)
    except OSError as error:
        raise WorldError(f"{file}: can't be read: {error.strerror}") from None
    if not head.startswith(PNG_HEAD) or len(head) < len(PNG_HEAD) + _SIZE.size:
        raise WorldError(f"{file}: is no PNG")
    cols, rows = _SIZE.unpack_from(head, len(PNG_HEAD))
    if rows * cols > max_cells:
        raise WorldError(f"{file}: has {rows} x {cols} cells, allowed are at most {max_cells}")
    if grey_m is None:
        raise WorldError(f"{file}: a PNG does not tell heights; {SET_GREY}")
    try:
        picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        picture = None
    if picture is None:
        raise WorldError(f"{file}: is no readable PNG")
    grey = picture.reshape(*picture.shape[:2], -1)
    colours = grey[..., :3] if grey.shape[2] > 2 else grey[..., :1]
    if (colours != colours[..., :1]).any():
        raise WorldError(f"{file}: has colours, allowed is a grey picture of 8 or 16 bit")
    low_m, high_m = grey_m
    share = colours[..., 0] / (255.0 if picture.dtype == np.uint8 else 65535.0)
    clear = grey[..., -1] == 0 if grey.shape[2] in (2, 4) else False
    return np.where(clear, np.nan, low_m + share * (high_m - low_m))
