"""The envelope of a frame on a thin link: who, which, what, and a proof that a team-mate made it.

    byte 0      version (high nibble) and kind (low nibble)
    1..2 bytes  sender: index in the team's roster, seven bits a byte as below
    1 byte      incarnation of the sender (one more after each restart)
    1..3 bytes  sequence number, seven bits a byte, lowest first, high bit = more follow
    payload
    6 bytes     BLAKE2s, keyed with the team's key, over all bytes before it

At 2400 bps a byte is 3.3 ms of radio, hence the nibbles and the short code.
"""

import hashlib
import hmac
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar, Literal

from comms.errors import CommsError

VERSION = 0xB
"""High nibble of the first byte: magic and version in one; a change of layout takes another."""
MAC_BYTES = 6
"""Length of the authentication code.

Truncation to 48 bits: a blind forgery passes with probability 2^-48 a try. Over a radio an attacker
gets no more tries than the link carries frames: some 1300 a second of the shortest at 128 kbps,
hence one success in about 7000 years, and it can't be tried off the air without the key. The full
32 bytes would cost 87 ms a frame at 2400 bps. The same odds hold for noise that slips past.
"""
MAX_SEQ = (1 << 21) - 1
"""Largest sequence number that three bytes of seven bits hold."""
ENVELOPE_BYTES = 3 + 3 + MAC_BYTES
"""Bytes around a payload at the worst (sequence numbers of 16384 and above), of the first 128."""
WIDEST_ENVELOPE_BYTES = ENVELOPE_BYTES + 1
"""The same of all others in a larger team."""
MAX_FRAME_BYTES = 4096
"""No longer frame is opened or sealed, whatever the link."""
WINDOW = 256
"""Sequence numbers behind the newest that may still come late, each once."""
MAX_TEAM = 1 << 14
MIN_KEY_BYTES = 16
MAX_KEY_BYTES = 32

Reason = Literal["damaged", "stranger", "replayed", "old-incarnation", "bad-version", "oversized"]


class Kind(IntEnum):
    """What a payload is."""

    MAP = 1
    ANCHOR = 2
    DIGEST = 3
    STATUS = 4
    TETHER = 5
    FIX = 6
    STOP = 7


URGENT = frozenset({Kind.TETHER, Kind.STOP})
"""Kinds that go before all others and wake their receiver."""


class SealError(CommsError):
    """The caller asked for a frame that can't be made."""


class FrameError(CommsError):
    """What came off the air is no frame of a team-mate's; `reason` says why, in a fixed word."""

    reason: ClassVar[Reason]


class DamagedError(FrameError):
    """Cut short, altered, or sealed with another key."""

    reason = "damaged"


class StrangerError(FrameError):
    """Sealed with the team's key, by an index that is not in the roster."""

    reason = "stranger"


class ReplayedError(FrameError):
    """Heard before, or too old to know."""

    reason = "replayed"


class OldIncarnationError(FrameError):
    """From before the sender's last known restart."""

    reason = "old-incarnation"


class BadVersionError(FrameError):
    """Another layout, or a kind that this version doesn't know."""

    reason = "bad-version"


class OversizedError(FrameError):
    """Longer than any frame may be."""

    reason = "oversized"


@dataclass(frozen=True)
class Frame:
    """A frame that was opened: its code held, and it was not seen before."""

    sender: int
    incarnation: int
    seq: int
    kind: Kind
    payload: bytes


def _checked_key(key: bytes) -> bytes:
    if not MIN_KEY_BYTES <= len(key) <= MAX_KEY_BYTES:
        raise SealError(
            f"team key has {len(key)} bytes; {MIN_KEY_BYTES} to {MAX_KEY_BYTES} are allowed"
        )
    return key


def _mac(key: bytes, body: bytes) -> bytes:
    return hashlib.blake2s(body, key=key, digest_size=MAC_BYTES, person=b"ropeteam").digest()


def _bytes_of(number: int) -> bytes:
    out = bytearray()
    while number > 0x7F:
        out.append(0x80 | number & 0x7F)
        number >>= 7
    out.append(number)
    return bytes(out)


def _take(body: bytes, at: int, most_bytes: int, what: str) -> tuple[int, int]:
    """Return (number, offset behind it)."""
    number = 0
    for place in range(most_bytes):
        if at >= len(body):
            break
        byte = body[at]
        at += 1
        number |= (byte & 0x7F) << (7 * place)
        if byte < 0x80:
            return number, at
    raise DamagedError(f"the {what} does not end within {most_bytes} bytes")


def _take_byte(body: bytes, at: int) -> tuple[int, int]:
    if at >= len(body):
        raise DamagedError("the frame ends before its incarnation")
    return body[at], at + 1


class Sealer:
    """Seals one incarnation's frames, numbered from 0."""

    def __init__(self, key: bytes, sender: int, incarnation: int) -> None:
        """Take the team's key (16 to 32 bytes), the roster index and the incarnation.

        Raises SealError where one of them is out of bounds.
        """
        if not 0 <= sender < MAX_TEAM:
            raise SealError(f"sender index is {sender}; 0 to {MAX_TEAM - 1} are allowed")
        if not 0 <= incarnation <= 255:
            raise SealError(f"incarnation is {incarnation}; 0 to 255 are allowed")
        self._key = _checked_key(key)
        self._identity = _bytes_of(sender) + bytes((incarnation,))
        self._next_seq = 0

    @property
    def envelope_bytes(self) -> int:
        """Bytes around this sender's payloads at the worst."""
        return ENVELOPE_BYTES + len(self._identity) - 2

    @property
    def next_seq(self) -> int:
        """The number of the next frame."""
        return self._next_seq

    def seal(self, kind: Kind, payload: bytes) -> bytes:
        """Return the next frame; raise SealError if it is too long or the numbers are used up."""
        most_bytes = MAX_FRAME_BYTES - self.envelope_bytes
        if len(payload) > most_bytes:
            raise SealError(f"payload has {len(payload)} bytes; {most_bytes} are allowed")
        if self._next_seq > MAX_SEQ:
            raise SealError(
                f"sequence number is {self._next_seq}; an incarnation has 0 to {MAX_SEQ}"
            )
        head = bytes((VERSION << 4 | kind,)) + self._identity + _bytes_of(self._next_seq)
        self._next_seq += 1
        body = head + payload
        return body + _mac(self._key, body)


@dataclass
class _Heard:
    """What was heard of one sender: bit k of `seen` stands for sequence number `newest - k`."""

    incarnation: int
    newest: int
    seen: int

    def takes(self, seq: int) -> bool:
        """Note a sequence number; return False if it was noted before or is behind the window."""
        if seq > self.newest:
            # A jump is cut at the window's width: a far number must not build a huge integer.
            jump = min(seq - self.newest, WINDOW)
            self.seen = (self.seen << jump | 1) & ((1 << WINDOW) - 1)
            self.newest = seq
            return True
        back = self.newest - seq
        if back >= WINDOW or self.seen >> back & 1:
            return False
        self.seen |= 1 << back
        return True


class Opener:
    """Opens frames from the air, and lets each through once.

    It holds a few bytes per member of the roster, and no more, whatever comes. Its memory of what
    was heard dies with it: a robot that restarts can be played frames from before. Merging a map
    twice changes nothing; commands carry their own time for that reason.
    """

    def __init__(self, key: bytes, team_size: int, own: int | None = None) -> None:
        """Take the team's key, the roster's length, and one's own index in it (if any).

        Raises SealError where the key or the team's size is out of bounds.
        """
        if not 1 <= team_size <= MAX_TEAM:
            raise SealError(f"team size is {team_size}; 1 to {MAX_TEAM} are allowed")
        self._key = _checked_key(key)
        self._team_size = team_size
        self._own = own
        self._heard: list[_Heard | None] = [None] * team_size

    def open(self, data: bytes) -> Frame:
        """Return the frame in `data`; raise a FrameError that says why there is none.

        Nothing is believed before the code holds; the version alone is looked at first, because
        it says where the code is.
        """
        kind_bits, body = self._authentic(data)
        sender, at = _take(body, 1, 2, "sender index")
        incarnation, at = _take_byte(body, at)
        seq, start = _take(body, at, 3, "sequence number")
        if kind_bits not in Kind.__members__.values():
            raise BadVersionError(f"kind is {kind_bits}; 1 to {max(Kind)} are known")
        if sender >= self._team_size:
            raise StrangerError(f"sender index is {sender}; the roster has {self._team_size}")
        if sender == self._own:
            raise ReplayedError(f"frame {seq} is this robot's own, come back")
        self._admit(sender, incarnation, seq)
        return Frame(sender, incarnation, seq, Kind(kind_bits), body[start:])

    def _authentic(self, data: bytes) -> tuple[int, bytes]:
        """Return (kind bits, all but the code) of data whose code holds."""
        if len(data) > MAX_FRAME_BYTES:
            raise OversizedError(f"frame has {len(data)} bytes; {MAX_FRAME_BYTES} are allowed")
        if len(data) < 4 + MAC_BYTES:
            raise DamagedError(f"frame has {len(data)} bytes; the shortest has {4 + MAC_BYTES}")
        if data[0] >> 4 != VERSION:
            raise BadVersionError(f"version is {data[0] >> 4}; {VERSION} is understood")
        body, mac = data[:-MAC_BYTES], data[-MAC_BYTES:]
        if not hmac.compare_digest(mac, _mac(self._key, body)):
            raise DamagedError("the authentication code does not hold")
        return data[0] & 0x0F, body

    def _admit(self, sender: int, incarnation: int, seq: int) -> None:
        heard = self._heard[sender]
        if heard is None or incarnation > heard.incarnation:
            self._heard[sender] = _Heard(incarnation, seq, 1)
        elif incarnation < heard.incarnation:
            raise OldIncarnationError(
                f"incarnation of robot {sender} is {incarnation}; {heard.incarnation} was heard"
            )
        elif not heard.takes(seq):
            raise ReplayedError(f"frame {seq} of robot {sender} was heard, or is out of the window")
