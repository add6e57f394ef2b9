"""Run lengths, as Macintosh's PackBits has them.

A byte 0..127 is followed by that many symbols and one more; a byte 129..255 by one symbol that
comes 257 less that byte times.
"""

import numpy as np

from comms.errors import CodecError
from comms.kernels import kernel, warmer
from comms.paper.bits import Bytes, Words
from comms.parts import whole

_LONGEST = 128


def run_length_pack(symbols: Bytes, alphabet: int) -> bytes:
    """Return the bytes of symbols (N,); the alphabet makes no difference."""
    del alphabet
    out = np.empty(2 * symbols.size + 2, np.uint8)
    return out[: _pack(symbols, out)].tobytes()


def run_length_unpack(data: bytes, alphabet: int, count: int) -> Bytes:
    """Return the `count` symbols whose bytes these are.

    Raises `CodecError` for bytes that are not what `count` symbols of this alphabet take.
    """
    out = np.empty(count, np.uint8)
    if _unpack(np.frombuffer(data or b"\0", np.uint8), len(data), out) != count:
        raise CodecError(f"{len(data)} bytes are no runs of {count} symbols")
    if out.size and int(out.max()) >= alphabet:
        raise CodecError(f"a symbol {int(out.max())} is outside an alphabet of {alphabet}")
    return out


def runs(symbols: Words) -> Words:
    """Return the runs (R, 2) of symbols (N,): what comes, and how many times."""
    if symbols.size == 0:
        return np.zeros((0, 2), np.int64)
    begins = np.flatnonzero(np.concatenate(([True], symbols[1:] != symbols[:-1])))
    lengths = np.diff(np.append(begins, symbols.size))
    return np.column_stack((symbols[begins], lengths)).astype(np.int64)


@kernel
def _pack(symbols: Bytes, out: Bytes) -> int:
    at, n, size = whole(0), whole(0), symbols.size
    while at < size:
        run = whole(1)
        while run < _LONGEST and at + run < size and symbols[at + run] == symbols[at]:
            run += 1
        if run >= 2:
            out[n], out[n + 1] = 257 - run, symbols[at]
            n += 2
            at += run
            continue
        end = at + 1
        # Two alike are cheaper inside a literal than as a run between two literals.
        while end < size and end - at < _LONGEST:
            if end + 2 < size and symbols[end] == symbols[end + 1] == symbols[end + 2]:
                break
            end += 1
        out[n] = end - at - 1
        n += 1
        for k in range(at, end):
            out[n] = symbols[k]
            n += 1
        at = end
    return n


@kernel
def _unpack(data: Bytes, length: int, out: Bytes) -> int:
    """Fill `out`; return how many symbols the bytes hold, -1 where they are torn or too many."""
    at, n = whole(0), whole(0)
    while at < length:
        head = whole(data[at])
        at += 1
        size = head + 1 if head < 128 else 257 - head
        taken = size if head < 128 else whole(1)
        if head == 128 or at + taken > length or n + size > out.size:
            return -1
        for k in range(size):
            out[n + k] = data[at + k] if head < 128 else data[at]
        n += size
        at += taken
    return n


@warmer
def _warm() -> None:
    symbols = np.array([0, 1, 0, 2, 2, 2, 2, 1, 1], np.uint8)
    run_length_unpack(run_length_pack(symbols, 3), 3, symbols.size)
