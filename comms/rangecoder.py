"""A binary range coder in which any byte prefix says by itself how far it can be trusted.

One kernel serves both directions: `code_bit` writes its bit when the coder encodes and ignores it
and returns the decoded one when it decodes, so that a model is written once and cannot disagree
with itself. Probabilities are integers of 16 bits; nothing here depends on a machine's arithmetic.

A decoder that has read past the end of its bytes goes on with zeros. What it decoded is certain as
long as every continuation of the bytes would decode to the same: `is_certain`. A payload therefore
needs no marks and no padding between its levels.

Source: G. N. N. Martin, "Range encoding: an algorithm for removing redundancy from a digitised
message" (1979); carries are propagated into the bytes already written.
"""

import numpy as np
from numpy.typing import NDArray

from comms.kernels import kernel, warmer

Words = NDArray[np.int64]
Bytes = NDArray[np.uint8]

# The coder's state, one int64 each.
LOW, RANGE, POSITION, DECODING, OFFSET, LENGTH = 0, 1, 2, 3, 4, 5
_STATE_WORDS = 6
_WINDOW_BYTES = 5
_TOP = 1 << 40
_BOTTOM = 1 << 32
_EVEN = 1 << 15


def encoder(capacity_bytes: int) -> tuple[Words, Bytes]:
    """Return the state and the buffer of a coder that writes at most so many bytes."""
    state = np.zeros(_STATE_WORDS, np.int64)
    state[RANGE] = _TOP
    return state, np.zeros(capacity_bytes + 16, np.uint8)


def decoder(data: bytes) -> tuple[Words, Bytes]:
    """Return the state and the buffer of a coder that reads `data`, and zeros after its end."""
    state = np.zeros(_STATE_WORDS, np.int64)
    state[RANGE], state[DECODING], state[LENGTH] = _TOP, 1, len(data)
    window = data[:_WINDOW_BYTES].ljust(_WINDOW_BYTES, b"\0")
    state[OFFSET] = int.from_bytes(window, "big")
    state[POSITION] = _WINDOW_BYTES
    return state, np.frombuffer(data or b"\0", np.uint8).copy()


@kernel
def code_bit(state: Words, buffer: Bytes, chance: int, bit: int) -> int:
    """Code one bit that is 1 with probability chance / 65536 (0 < chance < 65536)."""
    bound = (state[RANGE] >> 16) * chance
    if state[DECODING]:
        bit = 1 if state[OFFSET] < bound else 0
        if bit:
            state[RANGE] = bound
        else:
            state[OFFSET] -= bound
            state[RANGE] -= bound
        while state[RANGE] < _BOTTOM:
            at = state[POSITION]
            byte = np.int64(buffer[at]) if at < state[LENGTH] else 0
            state[OFFSET] = (state[OFFSET] << 8) | byte
            state[RANGE] <<= 8
            state[POSITION] = at + 1
        return bit
    if bit:
        state[RANGE] = bound
    else:
        state[LOW] += bound
        state[RANGE] -= bound
    while state[RANGE] < _BOTTOM:
        at = state[POSITION]
        if state[LOW] >= _TOP:
            state[LOW] -= _TOP
            back = at - 1
            while buffer[back] == 255:
                buffer[back] = 0
                back -= 1
            buffer[back] += 1
        buffer[at] = state[LOW] >> 32
        state[LOW] = (state[LOW] & (_BOTTOM - 1)) << 8
        state[RANGE] <<= 8
        state[POSITION] = at + 1
    return bit


@kernel
def code_even_bits(state: Words, buffer: Bytes, count: int, value: int) -> int:
    """Code an integer of `count` bits, all values equally likely, highest bit first."""
    out = 0
    for k in range(count - 1, -1, -1):
        out = (out << 1) | code_bit(state, buffer, _EVEN, (value >> k) & 1)
    return out


@kernel
def has_run_out(state: Words) -> bool:
    """Say whether a decoder has gone on for long after the end of its bytes."""
    return state[DECODING] != 0 and state[POSITION] > state[LENGTH] + _WINDOW_BYTES


@kernel
def code_words(state: Words, buffer: Bytes, words: Words) -> None:
    """Code integers of 32 bits in place, all values equally likely."""
    for k in range(words.size):
        if has_run_out(state):
            return
        words[k] = code_even_bits(state, buffer, 32, words[k])


def is_certain(state: Words) -> bool:
    """Say whether all that was decoded so far holds for every continuation of the bytes."""
    missing = int(state[POSITION] - state[LENGTH])
    if missing <= 0:
        return True
    if missing > _WINDOW_BYTES:
        return False
    return int(state[OFFSET]) + (1 << 8 * missing) <= int(state[RANGE])


class Mark:
    """A place between two symbols of a stream that is being written."""

    def __init__(self, state: Words, buffer: Bytes) -> None:
        """Note where the coder is now."""
        self._bytes = int(state[POSITION]) + _WINDOW_BYTES
        written = int.from_bytes(buffer[: int(state[POSITION])].tobytes(), "big")
        self._low = (written << 8 * _WINDOW_BYTES) + int(state[LOW])
        self._end = self._low + int(state[RANGE])

    def finish(self, *, length_is_known: bool) -> bytes:
        """Return the shortest stream that ends here.

        Where the reader does not know the length, every continuation of the bytes decodes to the
        same; where it does, it is enough that zeros do.
        """
        count = max(self._bytes - _WINDOW_BYTES - 1, 0)
        while True:
            shift = 8 * (self._bytes - count)
            value = -(-self._low >> shift)
            last = value if length_is_known else value + 1
            end = (last << shift) + (1 if length_is_known else 0)
            if end <= self._end:
                return value.to_bytes(count, "big")
            count += 1

    def bytes_needed(self, data: bytes) -> int:
        """Return the length of the shortest prefix of the finished stream that holds this mark."""
        count = max(self._bytes - _WINDOW_BYTES - 1, 0)
        while True:
            shift = 8 * (self._bytes - count)
            value = int.from_bytes(data[:count].ljust(count, b"\0"), "big") << shift
            if value >= self._low and value + (1 << shift) <= self._end:
                return count
            count += 1


@warmer
def _warm() -> None:
    for state, buffer in (encoder(16), decoder(b"\1\2\3")):
        code_even_bits(state, buffer, 3, 5)
        code_bit(state, buffer, 1 << 12, 1)
        has_run_out(state)
        code_words(state, buffer, np.zeros(1, np.int64))
