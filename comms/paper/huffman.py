"""Huffman codes, canonical, of at most 15 bits.

Sources: D. A. Huffman, "A Method for the Construction of Minimum-Redundancy Codes" (1952); lengths
within a limit by L. L. Larmore and D. S. Hirschberg's package-merge (1990). Only the lengths
travel: 4 bits per symbol of the alphabet, runs of symbols that do not occur in 8.
"""

import numpy as np
from numpy.typing import NDArray

from comms.errors import CodecError
from comms.kernels import kernel, warmer
from comms.paper.bits import Bits, Bytes, Words, has_run_out, put, reader, take, writer, written
from comms.parts import whole

LONGEST = 15
_LENGTH_BITS = 4
_RUN = 16


def code_lengths(counts: NDArray[np.int64]) -> Words:
    """Return the bits (A,) of each symbol's code for counts (A,); 0 where a symbol does not occur.

    A symbol that is alone takes no bits: only how often it comes has to be told.
    """
    lengths = np.zeros(counts.size, np.int64)
    present = np.flatnonzero(counts)
    if present.size < 2:
        return lengths
    leaves = sorted((int(counts[s]), (int(s),)) for s in present)
    packages: list[tuple[int, tuple[int, ...]]] = []
    for _ in range(LONGEST):
        merged = sorted([*leaves, *packages])
        pairs = zip(merged[::2], merged[1::2], strict=False)
        packages = [(a[0] + b[0], a[1] + b[1]) for a, b in pairs]
    for _, symbols in packages[: present.size - 1]:
        np.add.at(lengths, np.array(symbols), 1)
    return lengths


def huffman_pack(symbols: Bytes, alphabet: int) -> bytes:
    """Return the bytes of symbols (N,) below `alphabet` (1..256)."""
    lengths = code_lengths(np.bincount(symbols, minlength=alphabet))
    bits = writer(8 * alphabet + LONGEST * symbols.size)
    if lengths.any():
        _put_lengths(bits, lengths)
        _write(bits, symbols, lengths, _canonical(lengths))
    elif symbols.size:
        lengths[symbols[0]] = 1
        _put_lengths(bits, lengths)
    return written(bits)


def huffman_unpack(data: bytes, alphabet: int, count: int) -> Bytes:
    """Return the `count` symbols whose bytes these are.

    Raises `CodecError` for bytes that are no code of this alphabet, or too few.
    """
    if count == 0:
        return np.zeros(0, np.uint8)
    bits = reader(data)
    lengths = _take_lengths(bits, alphabet)
    out = np.empty(count, np.uint8)
    in_order = _in_order(lengths)
    if in_order.size == 1:
        out[:] = in_order[0]
    elif int((1 << (LONGEST - lengths[in_order])).sum()) == 1 << LONGEST:
        _read(bits, lengths, in_order, out)
    else:
        raise CodecError("the code lengths in the bytes are no Huffman code")
    if has_run_out(bits):
        raise CodecError(f"{len(data)} bytes are no Huffman code of {count} symbols")
    return out


def _in_order(lengths: Words) -> Words:
    """Return the symbols that occur, by length of their code, then by value."""
    order = np.argsort(lengths, kind="stable")
    return order[lengths[order] > 0].astype(np.int64)


def _canonical(lengths: Words) -> Words:
    """Return the code (A,) of each symbol: counted up within a length, doubled at the next."""
    codes = np.zeros(lengths.size, np.int64)
    code, width = 0, 0
    for symbol in _in_order(lengths):
        code <<= int(lengths[symbol]) - width
        width = int(lengths[symbol])
        codes[symbol] = code
        code += 1
    return codes


def _put_lengths(bits: Bits, lengths: Words) -> None:
    k = 0
    while k < lengths.size:
        put(bits, int(lengths[k]), _LENGTH_BITS)
        run = 1
        if lengths[k] == 0:
            while run < _RUN and k + run < lengths.size and lengths[k + run] == 0:
                run += 1
            put(bits, run - 1, _LENGTH_BITS)
        k += run


def _take_lengths(bits: Bits, alphabet: int) -> Words:
    lengths = np.zeros(alphabet, np.int64)
    k = 0
    while k < alphabet:
        lengths[k] = take(bits, _LENGTH_BITS)
        k += 1 if lengths[k] else 1 + take(bits, _LENGTH_BITS)
    return lengths


@kernel
def _write(bits: Bits, symbols: Bytes, lengths: Words, codes: Words) -> None:
    for k in range(symbols.size):
        symbol = symbols[k]
        put(bits, whole(codes[symbol]), whole(lengths[symbol]))


@kernel
def _read(bits: Bits, lengths: Words, in_order: Words, out: Bytes) -> None:
    """Fill `out`; stop where the bytes end. The lengths must be those of a whole code."""
    counts = np.zeros(LONGEST + 1, np.int64)
    for symbol in in_order:
        counts[lengths[symbol]] += 1
    for k in range(out.size):
        code, first, at = whole(0), whole(0), whole(0)
        for width in range(1, LONGEST + 1):
            code = (code << 1) | take(bits, 1)
            first <<= 1
            if code - first < counts[width]:
                out[k] = in_order[at + code - first]
                break
            first += counts[width]
            at += counts[width]
        if has_run_out(bits):
            return


@warmer
def _warm() -> None:
    symbols = np.array([0, 1, 0, 2, 0, 1, 1], np.uint8)
    huffman_unpack(huffman_pack(symbols, 3), 3, symbols.size)
