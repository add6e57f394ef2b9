"""LZW with codes of growing width.

Source: T. A. Welch, "A Technique for High-Performance Data Compression" (1984). Codes are as wide
as the dictionary of the moment asks for, from the width of the alphabet that occurs to 16 bits; a
full dictionary is begun anew. Both sides know when, so no code is spent on it, nor on the end.
"""

import numpy as np
from numpy.typing import NDArray

from comms.errors import CodecError
from comms.kernels import kernel, warmer
from comms.paper.bits import (
    Bits,
    Bytes,
    bit_length,
    has_run_out,
    put,
    reader,
    take,
    writer,
    written,
)
from comms.parts import whole

Codes = NDArray[np.int64]

LARGEST_DICTIONARY = 1 << 16


def lzw_codes(symbols: Bytes, alphabet: int) -> Codes:
    """Return the codes (M,) that stand for symbols (N,) below `alphabet`."""
    out = np.empty(symbols.size, np.int64)
    places = 4 << min(symbols.size, LARGEST_DICTIONARY).bit_length()
    return out[: _codes_of(symbols, alphabet, places, out)]


def lzw_pack(symbols: Bytes, alphabet: int) -> bytes:
    """Return the bytes of symbols (N,) below `alphabet` (1..256)."""
    codes = lzw_codes(symbols, alphabet)
    bits = writer(17 * codes.size)
    _write_codes(bits, codes, alphabet)
    return written(bits)


def lzw_unpack(data: bytes, alphabet: int, count: int) -> Bytes:
    """Return the `count` symbols whose bytes these are.

    Raises `CodecError` for bytes that are not what `count` symbols of this alphabet take.
    """
    out = np.empty(count, np.uint8)
    bits = reader(data)
    if _read_codes(bits, alphabet, out) < 0 or has_run_out(bits):
        raise CodecError(f"{len(data)} bytes are no LZW of {count} symbols")
    return out


@kernel
def _codes_of(symbols: Bytes, alphabet: int, places: int, out: Codes) -> int:
    """Write the codes of symbols, with a hash table of so many places; return how many."""
    keys = np.full(places, -1, np.int64)
    values = np.zeros(places, np.int64)
    used, n, size = whole(alphabet), whole(0), symbols.size
    if size == 0:
        return n
    prefix = whole(symbols[0])
    for k in range(1, size):
        symbol = whole(symbols[k])
        key = (prefix << 8) | symbol
        slot = ((key * 0x9E3779B1) >> 12) & (places - 1)
        while keys[slot] != -1 and keys[slot] != key:
            slot = (slot + 1) & (places - 1)
        if keys[slot] == key:
            prefix = values[slot]
            continue
        out[n] = prefix
        n += 1
        prefix = symbol
        keys[slot] = key
        values[slot] = used
        used += 1
        if used == LARGEST_DICTIONARY:
            keys[:] = -1
            used = whole(alphabet)
    out[n] = prefix
    return n + 1


@kernel
def _write_codes(bits: Bits, codes: Codes, alphabet: int) -> None:
    # Every code adds an entry, for the sender as for the receiver; so the widths are a count.
    used = whole(alphabet)
    for k in range(codes.size):
        put(bits, codes[k], bit_length(used - 1))
        used += 1
        if used == LARGEST_DICTIONARY:
            used = whole(alphabet)


@kernel
def _read_codes(bits: Bits, alphabet: int, out: Bytes) -> int:
    """Fill `out`; return -1 for a code that can't be."""
    prefix = np.zeros(LARGEST_DICTIONARY, np.int64)
    last = np.zeros(LARGEST_DICTIONARY, np.uint8)
    length = np.ones(LARGEST_DICTIONARY, np.int64)
    for k in range(alphabet):
        last[k] = k
    used, n, before = whole(alphabet), whole(0), whole(-1)
    while n < out.size:
        code = take(bits, bit_length(used - 1))
        if code >= used or has_run_out(bits):
            return -1
        # The newest entry is still without its last symbol: the first one of what comes now.
        walk = code
        if before >= 0:
            first = code if code < used - 1 else before
            while first >= alphabet:
                first = prefix[first]
            last[used - 1] = last[first]
        end = n + length[code]
        if end > out.size:
            return -1
        for at in range(end - 1, n - 1, -1):
            out[at] = last[walk]
            walk = prefix[walk]
        n = end
        before = code
        if used < LARGEST_DICTIONARY - 1:
            prefix[used] = code
            length[used] = length[code] + 1
            used += 1
        else:
            used = whole(alphabet)
            before = whole(-1)
    return n


@warmer
def _warm() -> None:
    symbols = np.array([0, 1, 0, 1, 0, 1, 1], np.uint8)
    lzw_unpack(lzw_pack(symbols, 2), 2, symbols.size)
