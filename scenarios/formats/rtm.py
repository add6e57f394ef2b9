"""Elevation maps in few bytes: `.rtm`, our codec behind a small header.

An `.rtm` is: `RTM` and a version (1 byte); the CRC-32 of all that follows (4 bytes); what there is
of origin and CRS (1 byte); cell size and stated largest error in metres (8 bytes each); then, where
there are such, the south-west corner's east and north (8 bytes each) and the length of the CRS in
bytes (2 bytes) and its UTF-8; then the payload of `comms.codec.encode_grid`. Numbers are
little-endian. A file that is torn or changed anywhere is refused.
"""

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comms.codec import decode_grid_sigma, encode_grid
from comms.errors import CodecError
from scenarios.errors import StudyError

Floats = NDArray[np.float64]

MAGIC = b"RTM"
VERSION = 1
_HAS_ORIGIN, _HAS_CRS = 1, 2
_SIZES = struct.Struct("<Bdd")
_ORIGIN = struct.Struct("<dd")
_LENGTH = struct.Struct("<H")
_BODY_AT = len(MAGIC) + 1 + 4


class MapFileError(StudyError):
    """A map file that can't be read or written: one sentence with its path."""


@dataclass(frozen=True)
class ElevationMap:
    """A map as files hold it, row 0 south."""

    elevation_m: Floats
    """(H, W), NaN unknown."""
    cell_m: float
    origin_m: tuple[float, float] | None = None
    """East and north of the south-west corner, in the CRS."""
    crs: str | None = None
    sigma_m: Floats | None = None
    """(H, W) standard deviations, read where the elevation is known."""


@dataclass(frozen=True)
class Packed:
    """An `.rtm` as read: what it holds and what its header states."""

    map: ElevationMap
    max_error_m: float
    bytes: int


def pack(elevations: ElevationMap, max_error_m: float) -> bytes:
    """Return a map as the bytes of an `.rtm`, every known cell within `max_error_m`.

    Raises MapFileError for what the codec can't hold.
    """
    known = np.isfinite(elevations.elevation_m)
    sigma_m = elevations.sigma_m
    try:
        payload = encode_grid(elevations.elevation_m, known, max_error_m, sigma_m=sigma_m)
    except CodecError as error:
        raise MapFileError(f"the map can't be packed: {error}") from error
    has = _HAS_ORIGIN * (elevations.origin_m is not None) | _HAS_CRS * (elevations.crs is not None)
    body = _SIZES.pack(has, elevations.cell_m, max_error_m)
    if elevations.origin_m is not None:
        body += _ORIGIN.pack(*elevations.origin_m)
    if elevations.crs is not None:
        text = elevations.crs.encode()
        if len(text) > 0xFFFF:
            raise MapFileError(f"the map's CRS has {len(text)} bytes, allowed are 65535")
        body += _LENGTH.pack(len(text)) + text
    body += payload
    return MAGIC + bytes([VERSION]) + struct.pack("<I", zlib.crc32(body)) + body


def unpack(data: bytes, name: str) -> Packed:
    """Return the map in the bytes of an `.rtm`; `name` is what errors call it.

    Raises MapFileError for anything else.
    """
    if data[: len(MAGIC)] != MAGIC or len(data) < _BODY_AT + _SIZES.size:
        raise MapFileError(f"{name}: is no .rtm map")
    if data[len(MAGIC)] != VERSION:
        raise MapFileError(f"{name}: is an .rtm of version {data[len(MAGIC)]}, known is {VERSION}")
    body = data[_BODY_AT:]
    if struct.unpack_from("<I", data, len(MAGIC) + 1)[0] != zlib.crc32(body):
        raise MapFileError(f"{name}: is damaged (its checksum does not fit its bytes)")
    try:
        return Packed(*_parsed(body), bytes=len(data))
    except (CodecError, struct.error, UnicodeDecodeError) as error:
        raise MapFileError(f"{name}: holds no map ({error})") from error


def _parsed(body: bytes) -> tuple[ElevationMap, float]:
    has, cell_m, max_error_m = _SIZES.unpack_from(body)
    at, origin_m, crs = _SIZES.size, None, None
    if has & _HAS_ORIGIN:
        east, north = _ORIGIN.unpack_from(body, at)
        origin_m = (float(east), float(north))
        at += _ORIGIN.size
    if has & _HAS_CRS:
        (length,) = _LENGTH.unpack_from(body, at)
        at += _LENGTH.size + length
        crs = body[at - length : at].decode()
    elevation_m, _, sigma_m = decode_grid_sigma(body[at:])
    found = ElevationMap(
        elevation_m.astype(np.float64),
        float(cell_m),
        origin_m,
        crs,
        None if sigma_m is None else sigma_m.astype(np.float64),
    )
    return found, float(max_error_m)


def is_packed(path: Path) -> bool:
    """Say whether a file begins as an `.rtm` does."""
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def write_file(path: Path, data: bytes) -> None:
    """Write a file, whole or not at all; raises MapFileError where it can't be written."""
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_bytes(data)
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise MapFileError(f"{path}: can't be written: {error.strerror}") from error


def read_packed(path: Path) -> Packed:
    """Return the map of an `.rtm` file; raises MapFileError where it is none."""
    return unpack(read_bytes(path), str(path))


def read_bytes(path: Path) -> bytes:
    """Return a file's bytes; raises MapFileError where it can't be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise MapFileError(f"{path}: can't be read: {error.strerror}") from error
