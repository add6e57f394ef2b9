"""Streams of bits in bytes, highest bit first, for compiled coders."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comms.parts import part, whole

Bytes = NDArray[np.uint8]
Words = NDArray[np.int64]

_AT, _END = 0, 1


class Bits(NamedTuple):
    """A stream that is being written or read."""

    state: Words
    """The bit that comes next; the number of bits that there are."""
    buffer: Bytes


def reader(data: bytes) -> Bits:
    """Return a stream that reads `data`, and zeros after its end."""
    return Bits(np.array([0, 8 * len(data)]), np.frombuffer(data or b"\0", np.uint8).copy())


def writer(capacity_bits: int) -> Bits:
    """Return an empty stream that holds at most so many bits."""
    size = (capacity_bits + 7) // 8
    return Bits(np.array([0, 8 * size]), np.zeros(max(size, 1), np.uint8))


def written(bits: Bits) -> bytes:
    """Return the bytes of what was written, the last one filled up with zeros."""
    assert not has_run_out(bits), "more bits than were allowed for"
    return bits.buffer[: (int(bits.state[_AT]) + 7) // 8].tobytes()


@part
def put(bits: Bits, value: int, count: int) -> None:
    """Write the lowest `count` bits of a value; what does not fit is counted and dropped."""
    state, buffer = bits.state, bits.buffer
    for k in range(count - 1, -1, -1):
        at = state[_AT]
        if at < state[_END] and (value >> k) & 1:
            buffer[at >> 3] |= np.uint8(128 >> (at & 7))
        state[_AT] = at + 1


@part
def take(bits: Bits, count: int) -> int:
    """Read `count` bits; zeros after the end."""
    state, buffer = bits.state, bits.buffer
    value = whole(0)
    for _ in range(count):
        at = state[_AT]
        bit = whole(0)
        if at < state[_END]:
            bit = (whole(buffer[at >> 3]) >> (7 - (at & 7))) & 1
        value = (value << 1) | bit
        state[_AT] = at + 1
    return value


@part
def has_run_out(bits: Bits) -> bool:
    """Say whether more bits were written or read than there are."""
    return bits.state[_AT] > bits.state[_END]


@part
def bit_length(value: int) -> int:
    """Return how many bits a whole number >= 0 takes."""
    n = whole(0)
    while value:
        value >>= 1
        n += 1
    return n
