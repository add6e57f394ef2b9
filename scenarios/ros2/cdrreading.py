"""Plain CDR (XCDR1, either byte order) back into messages: dicts by field name.

The other way round than `scenarios.ros2.cdr`. What comes from a file is a stranger's: no length in
it is believed beyond the bytes that are there.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from scenarios.ros2.cdr import CODES, HEADER
from scenarios.ros2.types import fields_of, full_name

BIG, LITTLE = 0, 1
"""Representation identifiers of plain CDR."""


class CdrError(Exception):
    """Bytes that are no message of the type that they are said to be."""


@dataclass
class _Stream:
    data: memoryview
    order: str
    """`<` or `>`."""
    at: int = 0

    def take(self, size: int, align: int = 1) -> memoryview:
        start = self.at + (-self.at) % align
        if size > len(self.data) - start:
            raise CdrError(f"it ends after {len(self.data)} bytes, in the middle of a field")
        self.at = start + size
        return self.data[start : self.at]


Read = Callable[[_Stream], Any]


def decode(name: str, data: bytes) -> dict[str, Any]:
    """Return a message of a type (pkg/msg/Name); arrays of numbers are numpy arrays.

    Raises:
        CdrError: these bytes are none.
        KeyError: the type is not known here.

    """
    head = data[: len(HEADER)]
    if len(head) < len(HEADER) or head[0] != 0 or head[1] not in (BIG, LITTLE):
        raise CdrError(f"its header {head.hex()} is not that of plain CDR")
    stream = _Stream(memoryview(data)[len(HEADER) :], "<" if head[1] == LITTLE else ">")
    return _reader(name)(stream)


def _number(kind: str) -> Read:
    code = CODES[kind]
    size = struct.calcsize(f"<{code}")

    def read(stream: _Stream) -> Any:
        return struct.unpack(f"{stream.order}{code}", stream.take(size, size))[0]

    return read


def _count(stream: _Stream) -> int:
    return int(struct.unpack(f"{stream.order}I", stream.take(4, 4))[0])


def _text(stream: _Stream) -> str:
    return bytes(stream.take(_count(stream))).rstrip(b"\0").decode(errors="replace")


def _numbers(kind: str, fixed: int | None) -> Read:
    size = struct.calcsize(f"<{CODES[kind]}")

    def read(stream: _Stream) -> Any:
        count = _count(stream) if fixed is None else fixed
        taken = stream.take(count * size, size if count else 1)
        return np.frombuffer(taken, np.dtype(f"{stream.order}{CODES[kind]}"))

    return read


def _items(one: Read, fixed: int | None) -> Read:
    def read(stream: _Stream) -> list[Any]:
        return [one(stream) for _ in range(_count(stream) if fixed is None else fixed)]

    return read


def _struct(name: str) -> Read:
    fields = [(field, _field(kind)) for kind, field in fields_of(name)]

    def read(stream: _Stream) -> dict[str, Any]:
        return {field: one(stream) for field, one in fields}

    return read


def _field(kind: str) -> Read:
    base, _, length = kind.partition("[")
    fixed = int(length[:-1]) if length not in ("", "]") else None
    if base in CODES and length:
        return _numbers(base, fixed)
    one = _number(base) if base in CODES else _text if base == "string" else None
    one = one or _reader(full_name(base))
    return _items(one, fixed) if length else one


_readers: dict[str, Read] = {}


def _reader(name: str) -> Read:
    if name not in _readers:
        _readers[name] = _struct(name)
    return _readers[name]
