"""Things that a page is told, in one piece of bytes: JSON, and the bytes that it points to.

    uint32 (little-endian)   length of the JSON text
    JSON                     UTF-8; {"blob": [offset, length]} stands for bytes
    bytes                    of all blobs, one after another

The page's `data.js` reads it; so does `unpack`.
"""

import json
import struct
from typing import Any, cast

_HEAD = struct.Struct("<I")
BLOB = "blob"


def pack(value: Any) -> bytes:
    """Return a value of dicts, lists, numbers, strings, None and bytes in one piece."""
    blobs: list[bytes] = []
    end = 0

    def lay(blob: object) -> dict[str, list[int]]:
        nonlocal end
        if not isinstance(blob, bytes):
            raise TypeError(f"{type(blob).__name__} can't be packed")
        blobs.append(blob)
        end += len(blob)
        return {BLOB: [end - len(blob), len(blob)]}

    text = json.dumps(value, default=lay, separators=(",", ":"), allow_nan=False).encode()
    return b"".join((_HEAD.pack(len(text)), text, *blobs))


def unpack(data: bytes) -> Any:
    """Return the value in one piece of bytes.

    Raises:
        ValueError: it is none that `pack` made.

    """
    if len(data) < _HEAD.size:
        raise ValueError("too short")
    (length,) = _HEAD.unpack_from(data)
    blobs = memoryview(data)[_HEAD.size + length :]

    def bytes_of(table: dict[str, Any]) -> Any:
        if set(table) != {BLOB}:
            return table
        offset, size = cast("list[int]", table[BLOB])
        if not 0 <= offset <= offset + size <= len(blobs):
            raise ValueError("a blob lies outside")
        return bytes(blobs[offset : offset + size])

    return json.loads(data[_HEAD.size : _HEAD.size + length], object_hook=bytes_of)
