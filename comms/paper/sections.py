"""Streams of symbols as sections of a payload: compressed by one of four, or as they are.

A section is the number of its symbols, their alphabet, the number of its bytes and these. Where a
compressor does not pay, symbols are written with as many bits as the alphabet asks for.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comms.errors import CodecError
from comms.kernels import kernel, warmer
from comms.paper.bits import Bits, Bytes, Words, has_run_out, put, reader, take, writer, written
from comms.paper.huffman import huffman_pack, huffman_unpack
from comms.paper.lzw import lzw_pack, lzw_unpack
from comms.paper.runlength import run_length_pack, run_length_unpack
from comms.parts import whole

LONGEST_NUMBER = 9
"""Bytes of the longest number of growing width: 63 bits."""


@dataclass(frozen=True)
class Compressor:
    """A lossless compressor of symbols 0..255."""

    pack: Callable[[Bytes, int], bytes]
    unpack: Callable[[bytes, int, int], Bytes]


COMPRESSORS = {
    "lzw": Compressor(lzw_pack, lzw_unpack),
    "huffman": Compressor(huffman_pack, huffman_unpack),
    "rle": Compressor(run_length_pack, run_length_unpack),
}


class Cursor:
    """Reads a payload from its begin to its end."""

    def __init__(self, data: bytes) -> None:
        """Begin with the first byte."""
        self._data = data
        self._at = 0

    def take(self, count: int) -> bytes:
        """Return the next bytes.

        Raises `CodecError` where there are not so many.
        """
        end = self._at + count
        if end > len(self._data):
            raise CodecError(f"{len(self._data)} bytes end in the middle of a map")
        taken = self._data[self._at : end]
        self._at = end
        return taken

    def number(self) -> int:
        """Return the next number of growing width."""
        value = 0
        for k in range(LONGEST_NUMBER):
            byte = self.take(1)[0]
            value |= (byte & 127) << 7 * k
            if byte < 128:
                return value
        raise CodecError(f"a number of more than {LONGEST_NUMBER} bytes")

    def end(self) -> None:
        """Hold the payload to its end: raises `CodecError` where there is more."""
        if self._at != len(self._data):
            raise CodecError(f"{len(self._data) - self._at} bytes too many after a map")


def number_bytes(value: int) -> bytes:
    """Return a number >= 0 with growing width: 7 bits a byte, the lowest first."""
    out = bytearray()
    while value > 127:
        out.append(128 | (value & 127))
        value >>= 7
    return bytes([*out, value])


def folded(values: Words) -> Words:
    """Return integers as numbers >= 0: 0, -1, 1, -2 ... become 0, 1, 2, 3 ..."""
    return np.where(values >= 0, 2 * values, -2 * values - 1)


def unfolded(numbers: Words) -> Words:
    """Return the integers whose `folded` form this is."""
    return np.where(numbers & 1, -((numbers >> 1) + 1), numbers >> 1)


def section(symbols: Bytes, compressor: str) -> bytes:
    """Return symbols (N,) as a section, compressed where this pays."""
    if symbols.size == 0:
        return number_bytes(0)
    alphabet = int(symbols.max()) + 1
    plain = _plain_pack(symbols, alphabet)
    packed = COMPRESSORS[compressor].pack(symbols, alphabet)
    pays = len(packed) < len(plain)
    data = packed if pays else plain
    head = number_bytes(symbols.size) + bytes([alphabet - 1])
    return head + number_bytes(2 * len(data) + int(pays)) + data


def read_section(cursor: Cursor, compressor: str, most: int) -> Bytes:
    """Return the symbols (N,) of the next section.

    Raises `CodecError` for more than `most` symbols, or for bytes that are no section.
    """
    count = cursor.number()
    if count > most:
        raise CodecError(f"a section of {count} symbols where {most} is the most")
    if count == 0:
        return np.zeros(0, np.uint8)
    alphabet = cursor.take(1)[0] + 1
    size = cursor.number()
    data = cursor.take(size >> 1)
    if size & 1:
        return COMPRESSORS[compressor].unpack(data, alphabet, count)
    return _plain_unpack(data, alphabet, count)


def numbers_section(numbers: Words, compressor: str) -> bytes:
    """Return numbers >= 0 (N,) as a section of the bytes of their growing widths."""
    out = np.empty(LONGEST_NUMBER * numbers.size, np.uint8)
    return section(out[: _to_bytes(numbers, out)], compressor)


def read_numbers(cursor: Cursor, compressor: str, count: int) -> Words:
    """Return the `count` numbers of the next section.

    Raises `CodecError` for bytes that are no such section.
    """
    symbols = read_section(cursor, compressor, LONGEST_NUMBER * count)
    out = np.zeros(count, np.int64)
    if _from_bytes(symbols, out) != symbols.size:
        raise CodecError(f"{symbols.size} symbols are not {count} numbers")
    return out


def _plain_pack(symbols: Bytes, alphabet: int) -> bytes:
    width = (alphabet - 1).bit_length()
    bits = writer(width * symbols.size)
    _write_plain(bits, symbols, width)
    return written(bits) if width else b""


def _plain_unpack(data: bytes, alphabet: int, count: int) -> Bytes:
    width = (alphabet - 1).bit_length()
    if len(data) != (width * count + 7) // 8:
        raise CodecError(f"{len(data)} bytes are not {count} symbols of {width} bits")
    out = np.zeros(count, np.uint8)
    _read_plain(reader(data), out, width)
    return out


@kernel
def _write_plain(bits: Bits, symbols: Bytes, width: int) -> None:
    for k in range(symbols.size):
        put(bits, whole(symbols[k]), width)


@kernel
def _read_plain(bits: Bits, out: Bytes, width: int) -> None:
    for k in range(out.size):
        out[k] = take(bits, width)
        if has_run_out(bits):
            return


@kernel
def _to_bytes(numbers: Words, out: Bytes) -> int:
    n = whole(0)
    for k in range(numbers.size):
        value = numbers[k]
        while value > 127:
            out[n] = 128 | (value & 127)
            value >>= 7
            n += 1
        out[n] = value
        n += 1
    return n


@kernel
def _from_bytes(symbols: NDArray[np.uint8], out: Words) -> int:
    """Fill `out`; return how many symbols that took, -1 where they end too early."""
    n = whole(0)
    for k in range(out.size):
        shift = whole(0)
        while True:
            if n >= symbols.size or shift > 56:
                return whole(-1)
            byte = whole(symbols[n])
            n += 1
            out[k] |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                break
    return n


@warmer
def _warm() -> None:
    numbers = np.array([0, 3, 300, 1])
    for name in COMPRESSORS:
        read_numbers(Cursor(numbers_section(numbers, name)), name, numbers.size)
    _plain_unpack(_plain_pack(np.array([2, 1], np.uint8), 3), 3, 2)
