"""The air between robots: what every carrier of frames (memory, Zenoh) promises.

A packet is put on the air at the end of its transmission, and comes to each receiver that its
`arrivals` name at the arrival time stated there, packets of one instant in the order of (sender's
roster index, number). An air loses nothing, delays nothing and decides nothing: the links did.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, cast

import msgpack

from comms.errors import CommsError


class PacketError(CommsError):
    """What another process sent is no packet."""


@dataclass(frozen=True)
class Packet:
    """A frame that was transmitted, with the times that its link gave it."""

    sender: str
    number: int
    """The sender's count of its frames."""
    start_ns: int
    end_ns: int
    arrivals: tuple[tuple[str, int], ...]
    """(receiver, arrival in ns)."""
    urgent: bool
    """Whether it wakes its receivers; others may be taken when the receiver next acts."""
    data: bytes
    """The sealed frame."""

    def to_wire(self) -> bytes:
        """Return the packet as MessagePack bytes."""
        fields = (
            self.sender,
            self.number,
            self.start_ns,
            self.end_ns,
            self.arrivals,
            self.urgent,
            self.data,
        )
        return cast("bytes", msgpack.packb(fields))

    @staticmethod
    def from_wire(wire: bytes) -> "Packet":
        """Return the packet in `wire`; raise PacketError where there is none."""
        try:
            fields = msgpack.unpackb(wire, use_list=False)
        except (ValueError, msgpack.exceptions.UnpackException) as error:
            raise PacketError(f"{len(wire)} bytes are no MessagePack: {error}") from error
        if not _is_packet(fields):
            raise PacketError(f"{len(wire)} bytes of MessagePack are no packet")
        return Packet(*fields)


_FIELDS: list[type] = [str, int, int, int, tuple, bool, bytes]


def _types(values: Any) -> list[type]:
    """Return the types of a tuple's elements; nothing of anything else."""
    return [type(value) for value in values] if isinstance(values, tuple) else []


def _is_packet(fields: Any) -> bool:
    """Say whether unpacked data has a packet's shape."""
    return _types(fields) == _FIELDS and all(_types(a) == [str, int] for a in fields[4])


Handler = Callable[[Packet, int], None]
"""Takes a packet and its arrival (ns), at that time of the receiver's clock."""


class Air(Protocol):
    """One robot's end of the air."""

    def put(self, packet: Packet) -> None:
        """Send a packet to its receivers; called at the end of its transmission."""
        ...

    def listen(self, handler: Handler) -> None:
        """Have every packet that comes from now on handed to `handler`."""
        ...
