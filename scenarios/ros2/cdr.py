"""Messages as plain CDR (XCDR1, little-endian), as ROS 2 sends and stores them.

A message is a dict by field name; what is left out is zero or empty. Arrays of numbers may be numpy
arrays and are copied whole: encoders that take element after element need some 0.1 s for one map.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from scenarios.ros2.types import fields_of, full_name

HEADER = b"\x00\x01\x00\x00"
"""CDR, little-endian, no options. What follows is aligned to its own beginning."""

CODES = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_NUMBERS = {name: struct.Struct(f"<{code}") for name, code in CODES.items()}
_DTYPES = {name: np.dtype(f"<{code}") for name, code in CODES.items()}
_COUNT = struct.Struct("<I")

Write = Callable[[bytearray, Any], None]


def encode(name: str, message: Mapping[str, Any]) -> bytes:
    """Return a message of a type (pkg/msg/Name) as bytes.

    Raises:
        KeyError: the message has a field that its type has not.
        ValueError: an array of fixed length is of another.

    """
    out = bytearray(HEADER)
    _writer(full_name(name) if "/msg/" not in name else name)(out, message)
    return bytes(out)


def _align(out: bytearray, size: int) -> None:
    gap = (len(HEADER) - len(out)) % size
    if gap:
        out.extend(bytes(gap))


def _number(kind: str) -> Write:
    number = _NUMBERS[kind]

    def write(out: bytearray, value: Any) -> None:
        _align(out, number.size)
        out.extend(number.pack(value or 0))

    return write


def _count(out: bytearray, count: int) -> None:
    _align(out, 4)
    out.extend(_COUNT.pack(count))


def _text(out: bytearray, value: Any) -> None:
    data = str(value or "").encode() + b"\0"
    _count(out, len(data))
    out.extend(data)


def _numbers(kind: str, fixed: int | None) -> Write:
    dtype = _DTYPES[kind]

    def write(out: bytearray, values: Any) -> None:
        if isinstance(values, bytes):
            values = np.frombuffer(values, dtype)
        empty = np.zeros(fixed or 0, dtype)
        array = empty if values is None else np.ascontiguousarray(values, dtype).ravel()
        if fixed is not None and array.size != fixed:
            raise ValueError(f"{array.size} numbers where there must be {fixed}")
        if fixed is None:
            _count(out, array.size)
        if array.size:
            _align(out, dtype.itemsize)
            out.extend(array.tobytes())

    return write


def _items(one: Write) -> Write:
    def write(out: bytearray, values: Sequence[Any] | None) -> None:
        _count(out, len(values or ()))
        for value in values or ():
            one(out, value)

    return write


def _struct(name: str) -> Write:
    fields = [(field, _field(kind)) for kind, field in fields_of(name)]
    known = {field for field, _ in fields}

    def write(out: bytearray, message: Mapping[str, Any] | None) -> None:
        told = message or {}
        if not known.issuperset(told):
            raise KeyError(f"{name} has no {min(set(told) - known)!r}")
        for field, one in fields:
            one(out, told.get(field))

    return write


def _field(kind: str) -> Write:
    base, _, length = kind.partition("[")
    if base in _DTYPES and length:
        return _numbers(base, int(length[:-1]) if length != "]" else None)
    one = _number(base) if base in _DTYPES else _text if base == "string" else None
    one = one or _writer(full_name(base))
    return _items(one) if length else one


_writers: dict[str, Write] = {}


def _writer(name: str) -> Write:
    if name not in _writers:
        _writers[name] = _struct(name)
    return _writers[name]
