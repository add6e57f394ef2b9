"""Messages into ROS 2 over Zenoh, in the form in which `rmw_zenoh` sends them; no ROS is needed.

As `ros2/rmw_zenoh` (docs/design.md) has it: a topic's key is its domain, name, type and type hash;
each message has an attachment of its number, its time and its sender's id; liveliness tokens say
which nodes and publishers there are, so that `ros2 topic list` shows them. ROS's own router
(`ros2 run rmw_zenoh_cpp rmw_zenohd`) has to run: it is what we connect to.

Nothing of the team's own traffic goes through here, and nothing that is sent here ever waits: what
the network can't take is dropped.
"""

import hashlib
import socket
import struct
from typing import Any

import zenoh

from comms.errors import CommsError
from comms.zenoh_air import client_config, open_session

ROUTER = "tcp/127.0.0.1:7447"
"""Where ROS's router listens, if nothing else is said."""
LEASE_MS = 10_000
CONNECT_S = 1.0
_ATTACHMENT = struct.Struct("<qqB16s")
_QOS = "::,10:,:,:,,"
"""Reliable, volatile, keep the last 10; the rest is ROS's default."""


class RosError(CommsError):
    """ROS's router can't be reached."""


def dds_name(kind: str) -> str:
    """Return how a type (pkg/msg/Name) is called in keys."""
    package, middle, name = kind.split("/")
    return f"{package}::{middle}::dds_::{name}_"


def topic_key(domain: int, topic: str, kind: str, type_hash: str) -> str:
    """Return the key on which a topic's messages are put."""
    return f"{domain}/{topic.strip('/')}/{dds_name(kind)}/RIHS01_{type_hash}"


def node_token(domain: int, session: str, node: str) -> str:
    """Return the token of a node that is the first of its session."""
    return f"@ros2_lv/{domain}/{session}/0/0/NN/%/%/{node}"


def publisher_token(
    domain: int, session: str, node: str, number: int, topic: str, kind: str, type_hash: str
) -> str:
    """Return the token of a publisher, which is the `number`th thing of its session."""
    name = topic.replace("/", "%")
    where = f"@ros2_lv/{domain}/{session}/0/{number}/MP/%/%/{node}"
    return f"{where}/{name}/{dds_name(kind)}/RIHS01_{type_hash}/{_QOS}"


def attachment(number: int, t_ns: int, sender: bytes) -> bytes:
    """Return a message's attachment: its number, its time (Unix, ns), its sender's id (16 B)."""
    return _ATTACHMENT.pack(number, t_ns, len(sender), sender)


def check_router(endpoint: str) -> None:
    """Refuse an endpoint at which nobody listens.

    Raises:
        SecurityError: it may not be used (see `comms.zenoh_security.client_settings`).
        RosError: nobody listens there.

    """
    client_config(LEASE_MS, endpoint, None)
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_S).close()
    except OSError as error:
        raise RosError(
            f"no Zenoh router of ROS 2 answers at {endpoint} ({error.strerror or error}); start one"
            " with: ros2 run rmw_zenoh_cpp rmw_zenohd"
        ) from error


class RosNode:
    """A ROS 2 node that only publishes. Close it, or the process never ends."""

    def __init__(self, endpoint: str = ROUTER, *, name: str = "ropeteam", domain: int = 0) -> None:
        """Connect to ROS's router, and tell the graph of the node.

        Raises:
            SecurityError: the endpoint may not be used.
            RosError: nobody answers there.

        """
        check_router(endpoint)
        try:
            self._session = open_session(client_config(LEASE_MS, endpoint, None))
        except zenoh.ZError as error:
            raise RosError(f"no Zenoh router of ROS 2 answers at {endpoint}: {error}") from error
        self._name, self._domain = name, domain
        self._zid = str(self._session.info.zid())
        self._publishers: dict[str, _Publisher] = {}
        token = node_token(domain, self._zid, name)
        self._token = self._session.liveliness().declare_token(token)

    def publish(self, topic: str, kind: str, type_hash: str, data: bytes, t_ns: int) -> None:
        """Send a message (CDR, with its header) on a topic; `t_ns` is the Unix time, in ns."""
        if topic not in self._publishers:
            number = len(self._publishers) + 1
            identity = (self._domain, self._zid, self._name, number)
            token = publisher_token(*identity, topic, kind, type_hash)
            key = topic_key(self._domain, topic, kind, type_hash)
            self._publishers[topic] = _Publisher(self._session, key, token)
        self._publishers[topic].put(data, t_ns)

    def close(self) -> None:
        """Take the node out of the graph and disconnect."""
        for publisher in self._publishers.values():
            publisher.close()
        self._token.undeclare()
        self._session.close()


class _Publisher:
    def __init__(self, session: zenoh.Session, key: str, token: str) -> None:
        self._token: Any = session.liveliness().declare_token(token)
        drop = zenoh.CongestionControl.DROP
        self._publisher: Any = session.declare_publisher(key, congestion_control=drop)
        self._sender = hashlib.blake2b(token.encode(), digest_size=16).digest()
        self._number = 0

    def put(self, data: bytes, t_ns: int) -> None:
        self._number += 1
        self._publisher.put(data, attachment=attachment(self._number, t_ns, self._sender))

    def close(self) -> None:
        self._publisher.undeclare()
        self._token.undeclare()
