"""A binary range coder in which any byte prefix says by itself how far it can be trusted.

One kernel serves both directions: `code_bit` writes its bit when the coder encodes, and ignores it
and returns the decoded one when it decodes, so that a model is written once and cannot disagree
with itself. Probabilities are integers of 16 bits; nothing here depends on a machine's arithmetic.

A decoder that has read past the end of its bytes goes on with zeros. What it decoded is certain as
long as every continuation of the bytes would decode to the same: `is_certain`. A payload therefore
needs no marks and no padding between its levels.

Source: G. N. N. Martin, "Range encoding: an algorithm for removing redundancy from a digitised
message" (1979); carries are propagated into the bytes already written.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comms.kernels import kernel, warmer
from comms.parts import part, whole

Words = NDArray[np.int64]
Bytes = NDArray[np.uint8]


class Coder(NamedTuple):
    """A range coder, of either direction."""

    state: Words
    """The numbers below, by their index."""
    buffer: Bytes
    """What is written, or read."""


LOW, RANGE, POSITION, DECODING, OFFSET, LENGTH = 0, 1, 2, 3, 4, 5
_WINDOW_BYTES = 5
_TOP = 1 << 40
_BOTTOM = 1 << 32
_EVEN = 1 << 15


def encoder(capacity_bytes: int) -> Coder:
    """Return a coder that writes at most so many bytes."""
    state = np.zeros(6, np.int64)
    state[RANGE] = _TOP
    return Coder(state, np.zeros(capacity_bytes + 256, np.uint8))


def decoder(data: bytes) -> Coder:
    """Return a coder that reads `data`, and zeros after its end."""
    state = np.zeros(6, np.int64)
    state[RANGE], state[DECODING], state[LENGTH] = _TOP, 1, len(data)
    window = data[:_WINDOW_BYTES].ljust(_WINDOW_BYTES, b"\0")
    state[OFFSET] = int.from_bytes(window, "big")
    state[POSITION] = _WINDOW_BYTES
    return Coder(state, np.frombuffer(data or b"\0", np.uint8).copy())


@part
def code_bit(coder: Coder, chance: int, bit: int) -> int:
    """Code one bit that is 1 with probability chance / 65536 (0 < chance < 65536)."""
    state = coder.state
    bound = (state[RANGE] >> 16) * chance
    if state[DECODING]:
        bit = 1 if state[OFFSET] < bound else 0
    if bit:
        state[RANGE] = bound
    else:
        state[RANGE] -= bound
        state[OFFSET] -= bound
        state[LOW] += bound
    while state[RANGE] < _BOTTOM:
        if state[DECODING]:
            _read_byte(coder)
        else:
            _write_byte(coder)
        state[RANGE] <<= 8
    return bit


@part
def _read_byte(coder: Coder) -> None:
    state = coder.state
    at = state[POSITION]
    byte = whole(coder.buffer[at]) if at < state[LENGTH] else whole(0)
    state[OFFSET] = (state[OFFSET] << 8) | byte
    state[LOW] = 0
    state[POSITION] = at + 1


@part
def _write_byte(coder: Coder) -> None:
    state, buffer = coder.state, coder.buffer
    at = state[POSITION]
    if at >= buffer.size:
        at = buffer.size - 1
    if state[LOW] >= _TOP:
        state[LOW] -= _TOP
        back = at - 1
        while buffer[back] == 255:
            buffer[back] = 0
            back -= 1
        buffer[back] += 1
    buffer[at] = state[LOW] >> 32
    state[LOW] = (state[LOW] & (_BOTTOM - 1)) << 8
    state[OFFSET] = 0
    state[POSITION] += 1


@kernel
def code_even_bits(coder: Coder, count: int, value: int) -> int:
    """Code an integer of `count` bits, all values equally likely, highest bit first."""
    out = whole(0)
    for k in range(count - 1, -1, -1):
        out = (out << 1) | code_bit(coder, _EVEN, (value >> k) & 1)
    return out


@part
def has_run_out(coder: Coder) -> bool:
    """Say whether a decoder has gone on for long after the end of its bytes."""
    state = coder.state
    return state[DECODING] != 0 and state[POSITION] > state[LENGTH] + 2 * _WINDOW_BYTES


@kernel
def code_words(coder: Coder, words: Words) -> None:
    """Code integers of 32 bits in place, all values equally likely."""
    for k in range(words.size):
        if has_run_out(coder):
            return
        words[k] = code_even_bits(coder, 32, words[k])


def bits_written(coder: Coder) -> float:
    """Return how much information an encoder has taken so far."""
    return 8 * int(coder.state[POSITION]) + 40 - math.log2(int(coder.state[RANGE]))


def is_certain(coder: Coder) -> bool:
    """Say whether all that was decoded so far holds for every continuation of the bytes."""
    state = coder.state
    missing = int(state[POSITION] - state[LENGTH])
    if missing <= 0:
        return True
    if missing > _WINDOW_BYTES:
        return False
    return int(state[OFFSET]) + (1 << 8 * missing) <= int(state[RANGE])


def is_whole(coder: Coder) -> bool:
    """Say whether a decoder has come to the very end of what `finish` wrote (length known)."""
    beyond = int(coder.state[POSITION] - coder.state[LENGTH])
    return 0 <= beyond <= _WINDOW_BYTES + 1


class Mark:
    """A place between two symbols of a stream that is being written."""

    def __init__(self, coder: Coder) -> None:
        """Note where the coder is now."""
        position = int(coder.state[POSITION])
        assert position <= coder.buffer.size, "a symbol took more than was allowed for"
        self._bytes = position + _WINDOW_BYTES
        written = int.from_bytes(coder.buffer[:position].tobytes(), "big")
        self._low = (written << 8 * _WINDOW_BYTES) + int(coder.state[LOW])
        self._end = self._low + int(coder.state[RANGE])

    def finish(self, *, length_is_known: bool) -> bytes:
        """Return the shortest stream that ends here.

        Where the reader does not know the length, every continuation of the bytes decodes to the
        same; where it does, it is enough that zeros do.
        """
        count = self._fewest_bytes()
        while True:
            shift = 8 * (self._bytes - count)
            value = -(-self._low >> shift)
            end = (value << shift) + (1 if length_is_known else 1 << shift)
            if end <= self._end:
                return value.to_bytes(count, "big")
            count += 1

    def bytes_needed(self, data: bytes) -> int:
        """Return the length of the shortest prefix of the finished stream that holds this mark."""
        count = self._fewest_bytes()
        while True:
            shift = 8 * (self._bytes - count)
            value = int.from_bytes(data[:count].ljust(count, b"\0"), "big") << shift
            if value >= self._low and value + (1 << shift) <= self._end:
                return count
            count += 1

    def _fewest_bytes(self) -> int:
        return max(self._bytes - _WINDOW_BYTES - 1, 0)


@warmer
def _warm() -> None:
    for coder in (encoder(64), decoder(b"\1\2\3")):
        code_even_bits(coder, 3, 5)
        code_bit(coder, 1 << 12, 1)
        has_run_out(coder)
        code_words(coder, np.zeros(1, np.int64))
