"""What must not wait for a map: a few payloads that go out first, and only while they are news."""

from dataclasses import dataclass

from comms.errors import CommsError
from comms.frames import URGENT, WIDEST_ENVELOPE_BYTES, Kind
from comms.profiles import MIN_FRAME_BYTES

URGENT_BYTES = MIN_FRAME_BYTES - WIDEST_ENVELOPE_BYTES
"""Longest urgent payload: it fits every link, also one that changes while it waits."""
URGENT_SLOTS = 32
"""Payloads (kinds times keys) that may wait at once."""


class UrgentError(CommsError):
    """The caller's payload can't be sent as urgent."""


@dataclass(frozen=True)
class _Waiting:
    payload: bytes
    until_ns: int | None

    def stale(self, t_ns: int) -> bool:
        return self.until_ns is not None and t_ns > self.until_ns


class UrgentQueue:
    """At most one payload per kind and key, the newest; first come, first out."""

    def __init__(self) -> None:
        """Start empty."""
        self._waiting: dict[tuple[Kind, str], _Waiting] = {}

    def put(self, kind: Kind, payload: bytes, key: str, until_ns: int | None = None) -> None:
        """Add a payload; an older one of the same kind and key gives it its place.

        Args:
            kind: an urgent one.
            payload: at most `URGENT_BYTES`.
            key: whom or what it concerns.
            until_ns: not to be sent later than this; None: never stale.

        Raises:
            UrgentError: the kind is not urgent, the payload too long, or too many others wait.
        """
        if kind not in URGENT:
            allowed = ", ".join(k.name for k in sorted(URGENT))
            raise UrgentError(f"kind {kind.name} is not urgent; {allowed} are")
        if len(payload) > URGENT_BYTES:
            raise UrgentError(
                f"urgent payload has {len(payload)} bytes; {URGENT_BYTES} fit every link"
            )
        if (kind, key) not in self._waiting and len(self._waiting) >= URGENT_SLOTS:
            raise UrgentError(f"{URGENT_SLOTS} urgent payloads wait already; no more may")
        self._waiting[kind, key] = _Waiting(payload, until_ns)

    def take(self, t_ns: int) -> tuple[Kind, bytes] | None:
        """Return the next payload that is not stale at `t_ns`, and forget it."""
        while self._waiting:
            kind, key = next(iter(self._waiting))
            waiting = self._waiting.pop((kind, key))
            if not waiting.stale(t_ns):
                return kind, waiting.payload
        return None
