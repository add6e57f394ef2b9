"""Carrying bytes over Eclipse Zenoh: one router inside the runner, every robot a client of it.

The only file that knows Zenoh. Both planes go through here: `team/**` (what robots say to each
other, every byte of it charged by a link before it comes here) and `world/**` (the simulation's
own: grants, reports). Everything stays on loopback. What is put by one session arrives in the order
in which it was put, so a report of a robot's arrives behind the packets that it speaks of.
"""

import collections
import contextlib
import json
import threading
from collections.abc import Callable
from typing import Any

import zenoh

from comms.errors import CommsError

CHANNEL_DEPTH = 1_000_000
"""Messages that may wait in a channel: more than any run sends between two wake-ups."""
WAIT_BEFORE_CLOSE_US = 60_000_000
"""How long a put waits for a receiver that hangs before Zenoh gives the connection up."""


class TransportError(CommsError):
    """Zenoh could not be opened or reached."""


def _config(mode: str, listen: list[str], connect: list[str], lease_ms: int) -> zenoh.Config:
    block = {"congestion_control": {"block": {"wait_before_close": WAIT_BEFORE_CLOSE_US}}}
    settings: dict[str, Any] = {
        "mode": mode,
        "listen": {"endpoints": listen},
        "connect": {
            "endpoints": connect,
            "timeout_ms": 5000,
            "retry": {"period_init_ms": 50, "period_max_ms": 500},
        },
        "scouting": {"multicast": {"enabled": False}},
        "transport": {
            "shared_memory": {"enabled": False},
            "link": {"tx": {"lease": lease_ms, "queue": block}},
        },
    }
    if mode == "router":
        settings["scouting"]["delay"] = 0
        settings["adminspace"] = {"enabled": True}
    return zenoh.Config.from_json5(json.dumps(settings))


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

    def put(self, key: str, data: bytes) -> None:
        """Send a message; it is never dropped, and keeps its order.

        A plain put goes to the router whether or not a receiver is known here: a declared publisher
        would drop what it sends before news of a fresh subscription has reached it.
        """
        self._session.put(key, data, congestion_control=zenoh.CongestionControl.BLOCK)

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

        def drain() -> None:
            nonlocal armed
            with lock:
                armed = False
            while waiting:
                handle(*waiting.popleft())

        def arrived(sample: Any) -> None:
            nonlocal armed
            waiting.append((str(sample.key_expr), sample.payload.to_bytes()))
            with lock:
                wake, armed = not armed, True
            if wake:
                # The loop may have ended already: then nobody is left to be told.
                with contextlib.suppress(RuntimeError):
                    call_soon(drain)

        self._kept.append(self._session.declare_subscriber(key_expr, arrived))

    def close(self) -> None:
        """Send what is queued and disconnect."""
        for subscriber in self._kept:
            subscriber.undeclare()
        self._session.close()


def open_hub(lease_ms: int = 600_000) -> Wire:
    """Open the router, on a free port of the loopback interface.

    Raises:
        TransportError: no port could be opened.

    """
    zenoh.init_log_from_env_or("error")
    try:
        session = zenoh.open(_config("router", ["tcp/127.0.0.1:0"], [], lease_ms))
        zid = session.info.zid()
        replies = [r.ok for r in session.get(f"@/{zid}/router") if r.ok is not None]
        endpoint = json.loads(replies[0].payload.to_string())["locators"][0]
    except (zenoh.ZError, IndexError, KeyError, ValueError) as error:
        raise TransportError(f"Zenoh could not listen on 127.0.0.1: {error}") from error
    return Wire(session, str(endpoint))


def open_client(endpoint: str, lease_ms: int = 600_000) -> Wire:
    """Connect to a hub.

    Raises:
        TransportError: nobody answers there.

    """
    zenoh.init_log_from_env_or("error")
    try:
        session = zenoh.open(_config("client", [], [endpoint], lease_ms))
    except zenoh.ZError as error:
        raise TransportError(f"Zenoh: no hub answers at {endpoint}: {error}") from error
    return Wire(session, endpoint)
