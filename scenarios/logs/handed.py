"""What a robot was handed, kept in its own log, so that it can be replayed alone.

On the virtual clock a robot is a function of what it is handed: its plan, and of each window the
grant (motion of the others, what happens to it) and the packets that were on the air for it. All
else, its camera's noise included, follows from the scenario's seed. So this is all that its log
keeps for a replay, as MessagePack: "born" once for each life, "handed" for each window.
"""

import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import msgpack
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import NonSeekingReader

from agents.geometry import Pose
from comms.air import Packet
from comms.errors import CommsError
from scenarios.errors import StudyError
from scenarios.wire import Grant, Plan

BORN = "born"
HANDED = "handed"


class LogError(StudyError):
    """A robot's log can't be read."""


@dataclass(frozen=True)
class Message:
    """One message of a robot's log."""

    topic: str
    t_ns: int
    data: bytes


@dataclass(frozen=True)
class Window:
    """What a robot was handed for one window."""

    grant: Grant
    packets: list[Packet]


@dataclass
class Life:
    """One life of a robot by its log."""

    born: bytes
    windows: list[Window] = field(default_factory=list[Window])
    messages: list[Message] = field(default_factory=list[Message])
    """All of its log, in order."""

    @property
    def ended_in_order(self) -> bool:
        """Whether it lived to the end of the run."""
        last = self.windows[-1].grant.commands if self.windows else []
        return any(command[0] == "finish" for command in last)

    def plan(self, whole: Plan) -> Plan:
        """Return a plan as it was for this life; scenario, ground and starts are the given one's.

        Raises:
            LogError: the log's first message is no such thing.

        """
        try:
            start_ns, pose, tether_m, number, segments, links, troubles = msgpack.unpackb(self.born)
            return replace(
                whole,
                start_ns=start_ns,
                pose=None if pose is None else Pose(*pose),
                tether_m=tether_m,
                first_number=number,
                segments=tuple(segments),
                link_events=tuple(links),
                trouble_events=tuple(troubles),
            )
        except (ValueError, TypeError, msgpack.exceptions.UnpackException) as error:
            raise LogError(f"{whole.name}'s log does not tell how it was born: {error}") from error


def pack_born(plan: Plan) -> bytes:
    """Return what a life began with, as far as the scenario does not tell it."""
    pose = plan.pose
    place = None if pose is None else (pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad)
    return _packed(
        (
            plan.start_ns,
            None if place is None else [float(value) for value in place],
            plan.tether_m,
            plan.first_number,
            plan.segments,
            plan.link_events,
            plan.trouble_events,
        )
    )


def pack_handed(grant: Grant, packets: Sequence[Packet]) -> bytes:
    """Return what was handed for one window."""
    wires = [packet.to_wire() for packet in packets]
    return _packed((grant.end_ns, grant.floor_ns, grant.segments, grant.commands, wires))


def _packed(value: object) -> bytes:
    return cast("bytes", msgpack.packb(value))


def _unpack_handed(data: bytes) -> Window:
    end_ns, floor_ns, segments, commands, wires = msgpack.unpackb(data)
    grant = Grant(end_ns, floor_ns, segments=segments, commands=commands)
    return Window(grant, [Packet.from_wire(wire) for wire in wires])


def read_life(path: Path) -> Life:
    """Read the log of one life; a record that was cut short by its death ends it.

    Raises:
        LogError: it can't be read, or does not tell what the robot was handed.

    """
    try:
        with path.open("rb") as stream:
            return _life(path, _messages(NonSeekingReader(stream)))
    except OSError as error:
        raise LogError(f"{path}: can't be read: {error.strerror}") from error
    except (McapError, CommsError, ValueError, TypeError) as error:
        raise LogError(f"{path}: is no log of a robot: {error}") from error


def _life(path: Path, messages: Iterable[Message]) -> Life:
    life: Life | None = None
    for message in messages:
        if message.topic == BORN:
            life = Life(message.data)
        if life is None:
            break
        if message.topic == HANDED:
            life.windows.append(_unpack_handed(message.data))
        life.messages.append(message)
    if life is None:
        raise LogError(
            f"{path}: does not tell what the robot was handed; only a run on the virtual clock,"
            " by this version or a later one, can be replayed"
        )
    return life


def _messages(reader: Any) -> Iterator[Message]:
    """Yield a log's messages as they stand in it, up to its end or to where it was cut."""
    found = reader.iter_messages(log_time_order=False)
    while True:
        try:
            _, channel, message = next(found)
        except (StopIteration, EndOfFile, struct.error):
            return
        yield Message(channel.topic, message.log_time, bytes(message.data))
