"""Carrying bytes over Eclipse Zenoh: one router inside the runner, every robot a client of it.

The only file of a run that knows Zenoh (`comms.ros2_zenoh` tells ROS 2 of one). Both planes go
through here: `team/**` (what robots say to each other, every byte of it charged by a link before it
comes here) and `world/**` (the simulation's own: grants, reports). Everything stays on loopback,
but for team planes between computers, which need certificates (`comms.zenoh_security`). What is put
by one session arrives in the order in which it was put, so a report of a robot's arrives behind the
packets that it speaks of.
"""

import collections
import contextlib
import json
import threading
from collections.abc import Callable, Sequence
from typing import Any

import zenoh

from comms.errors import CommsError
from comms.zenoh_security import (
    LOOPBACK,
    Credentials,
    Tree,
    client_settings,
    hub_settings,
)

CHANNEL_DEPTH = 1_000_000
"""Messages that may wait in a channel: more than any run sends between two wake-ups."""
WAIT_BEFORE_CLOSE_US = 60_000_000
"""How long a put waits for a receiver that hangs before Zenoh gives the connection up."""

CONNECT_MS = 5000
"""How long a client tries to reach its hub. One that is refused is not told so: it finds nobody."""


class TransportError(CommsError):
    """Zenoh could not be opened or reached."""


def hub_config(
    lease_ms: int,
    listen: str,
    credentials: Credentials | None,
    robots: Sequence[str],
    machines: Sequence[str] = (),
) -> Tree:
    """Return the whole configuration of a hub, as Zenoh's own router takes it too.

    Raises:
        SecurityError: see `comms.zenoh_security.hub_settings`.

    """
    security = hub_settings(listen, credentials, robots, machines)
    config = _merged(_plain("router", [listen], [], lease_ms), security)
    config["scouting"]["delay"] = 0  # milliseconds that a router would wait for others
    config["adminspace"] = {"enabled": True}
    return config


def client_config(lease_ms: int, endpoint: str, credentials: Credentials | None) -> Tree:
    """Return the whole configuration of a client.

    Raises:
        SecurityError: see `comms.zenoh_security.client_settings`.

    """
    security = client_settings(endpoint, credentials)
    return _merged(_plain("client", [], [endpoint], lease_ms), security)


def _merged(below: Tree, above: Tree) -> Tree:
    """Lay one tree of settings over another."""
    merged = dict(below)
    for key, value in above.items():
        both = isinstance(value, dict) and key in below
        merged[key] = _merged(below[key], value) if both else value
    return merged


def _plain(mode: str, listen: list[str], connect: list[str], lease_ms: int) -> Tree:
    block = {"congestion_control": {"block": {"wait_before_close": WAIT_BEFORE_CLOSE_US}}}
    return {
        "mode": mode,
        "listen": {"endpoints": listen},
        "connect": {
            "endpoints": connect,
            "timeout_ms": CONNECT_MS,
            "retry": {"period_init_ms": 50, "period_max_ms": 500},
        },
        "scouting": {"multicast": {"enabled": False}},
        "transport": {
            "shared_memory": {"enabled": False},
            "link": {"tx": {"lease": lease_ms, "queue": block}},
        },
    }


def open_session(config: Tree) -> zenoh.Session:
    """Open a session; raise ZError where Zenoh can't."""
    zenoh.init_log_from_env_or("error")
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


class Channel:
    """Messages of one subscription, oldest first."""

    def __init__(self, session: zenoh.Session, key_expr: str) -> None:
        """Subscribe; messages that come from now on wait here."""
        self._subscriber = session.declare_subscriber(
            key_expr, zenoh.handlers.FifoChannel(CHANNEL_DEPTH)
        )

    def wait(self) -> tuple[str, bytes]:
        """Return the next message (key, data); wait until there is one."""
        sample: Any = self._subscriber.recv()
        return str(sample.key_expr), sample.payload.to_bytes()

    def poll(self) -> tuple[str, bytes] | None:
        """Return the next message, or None when none is here."""
        sample: Any = self._subscriber.try_recv()
        return None if sample is None else (str(sample.key_expr), sample.payload.to_bytes())


class Wire:
    """One process's connection: puts and subscriptions. Close it, or the process never ends."""

    def __init__(self, session: zenoh.Session, endpoint: str) -> None:
        """Made by `open_hub` and `open_client`."""
        self._session = session
        self.endpoint = endpoint
        self._kept: list[Any] = []

    def put(self, key: str, data: bytes, *, may_drop: bool = False) -> None:
        """Send a message; it is never dropped, and keeps its order.

        A plain put goes to the router whether or not a receiver is known here: a declared publisher
        would drop what it sends before news of a fresh subscription has reached it. What `may_drop`
        does not wait where the way is blocked: a robot must not hang because a cable was cut.
        """
        control = zenoh.CongestionControl.DROP if may_drop else zenoh.CongestionControl.BLOCK
        self._session.put(key, data, congestion_control=control)

    def channel(self, key_expr: str) -> Channel:
        """Return a channel of all messages on some keys."""
        return Channel(self._session, key_expr)

    def listen(
        self,
        key_expr: str,
        handle: Callable[[str, bytes], None],
        call_soon: Callable[[Callable[[], None]], object],
    ) -> None:
        """Hand messages to `handle` on an event loop, by its thread-safe `call_soon`.

        One wake-up takes all messages that have come: a wake-up each would cost more than the
        messages.
        """
        waiting: collections.deque[tuple[str, bytes]] = collections.deque()
        lock = threading.Lock()
        armed = False

        def wake() -> None:
            nonlocal armed
            with lock:
                was_armed, armed = armed, True
            if not was_armed:
                # The loop may have ended already: then nobody is left to be told.
                with contextlib.suppress(RuntimeError):
                    call_soon(drain)

        def drain() -> None:
            nonlocal armed
            with lock:
                armed = False
            try:
                while waiting:
                    handle(*waiting.popleft())
            finally:
                if waiting:  # one that `handle` could not stand holds up none of those behind it
                    wake()

        def arrived(sample: Any) -> None:
            waiting.append((str(sample.key_expr), sample.payload.to_bytes()))
            wake()

        self._kept.append(self._session.declare_subscriber(key_expr, arrived))

    def close(self) -> None:
        """Send what is queued and disconnect."""
        for subscriber in self._kept:
            subscriber.undeclare()
        self._session.close()


def open_hub(
    lease_ms: int = 600_000,
    *,
    listen: str = LOOPBACK,
    credentials: Credentials | None = None,
    robots: Sequence[str] = (),
    machines: Sequence[str] = (),
) -> Wire:
    """Open the router: on a free port of the loopback interface, if nothing else is said.

    Args:
        lease_ms: after so long a silence a client counts as gone.
        listen: where to listen; port 0 is any free one.
        credentials: the hub's own. With them clients need certificates of the same authority, and
            may do only what `comms.zenoh_security.access_control` allows to `robots`.
        robots: who may speak; of no meaning without credentials.
        machines: which computers may run simulated robots, and speak for any; likewise.

    Raises:
        SecurityError: the credentials can't be used, or `listen` may not be used without.
        TransportError: the port could not be opened.

    """
    config = hub_config(lease_ms, listen, credentials, robots, machines)
    try:
        session = open_session(config)
    except zenoh.ZError as error:
        raise TransportError(f"Zenoh could not listen on {listen}: {error}") from error
    try:
        zid = session.info.zid()
        replies = [r.ok for r in session.get(f"@/{zid}/router") if r.ok is not None]
        endpoint = json.loads(replies[0].payload.to_string())["locators"][0]
    except (zenoh.ZError, IndexError, KeyError, ValueError) as error:
        session.close()
        raise TransportError(f"Zenoh does not say where it listens ({listen}): {error}") from error
    return Wire(session, str(endpoint))


def open_client(
    endpoint: str, lease_ms: int = 600_000, *, credentials: Credentials | None = None
) -> Wire:
    """Connect to a hub.

    Raises:
        SecurityError: the credentials can't be used, or `endpoint` may not be used without.
        TransportError: nobody answers there, or not to these credentials.

    """
    config = client_config(lease_ms, endpoint, credentials)
    try:
        session = open_session(config)
    except zenoh.ZError as error:
        raise TransportError(f"Zenoh: no hub answers at {endpoint}: {error}") from error
    return Wire(session, endpoint)
