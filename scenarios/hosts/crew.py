"""A crew whose robots run on computers that were offered (`ropeteam host`)."""

import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import msgpack

from comms.zenoh_air import Wire
from scenarios.crews.processes import Process, ZenohCrew
from scenarios.errors import UsageError
from scenarios.hosts.plans import pack_plan
from scenarios.wire import Plan

FIND_S = 30.0
"""So long (wall) the runner waits for the computers that it is to use."""
ALIVE_S = 1.0
"""How often (wall) the runner says that it is there."""
FILES_S = 60.0
"""So long (wall) a computer may take to send the files that its robots left."""
_PATH = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]*(/[A-Za-z0-9_-][A-Za-z0-9._-]*)*")


class HostProcess:
    """A robot's process on another computer: what is wanted of it goes there as an order."""

    def __init__(self, wire: Wire, host: str, plan: Plan, number: int) -> None:
        """Have it started."""
        self._wire, self._host, self._number = wire, host, number
        self._why: str | None = None
        self._order("start", pack_plan(plan), plan.name)

    def _order(self, word: str, data: bytes = b"", name: str = "") -> None:
        order(self._wire, self._host, word, self._number, name, data)

    def kill(self) -> None:
        """See `Process`."""
        self._why = f"it did not answer, at {self._host}"
        self._order("kill")

    def forget(self) -> None:
        """See `Process`: the other computer does."""

    def join(self, most_s: float) -> None:
        """See `Process`: the other computer waits for it before it ends it."""
        del most_s
        self._order("let end")

    def stop(self) -> None:
        """See `Process`."""
        self._order("stop")

    def resume(self) -> None:
        """See `Process`."""
        self._order("resume")

    def ended(self) -> str | None:
        """Return a reason once it was given up; the other computer tells of all other ends."""
        return self._why


def order(
    wire: Wire, host: str, word: str, number: int = 0, name: str = "", data: bytes = b""
) -> None:
    """Tell a computer what to do with the process of a number."""
    wire.put(f"world/host/{host}", cast("bytes", msgpack.packb((word, number, name, data))))


class HostedCrew(ZenohCrew):
    """A process per robot, on several computers in turn; all meet at one router."""

    def __init__(self, wire: Wire, hosts: Sequence[str]) -> None:
        """Take the wire to the router, and the names of the computers; wait until all are there.

        Raises:
            UsageError: one of them does not come.

        """
        self._wire, self._hosts = wire, tuple(hosts)
        self._placed: dict[str, str] = {}
        self._folder: Path | None = None
        self._told_s = 0.0
        self._files = wire.channel("world/file/*")
        try:
            _find(wire, self._hosts)
        except UsageError:
            wire.close()
            raise
        super().__init__(wire)
        for host in self._hosts:
            order(wire, host, "begin")

    def begin(self, plan: Plan, number: int) -> Process:
        """Start the process of one robot on the computer that is its own for the whole run."""
        self._folder = plan.folder
        team = list(plan.scenario.robots)
        host = self._hosts[team.index(plan.name) % len(self._hosts)]
        return HostProcess(self._wire, host, plan, number)

    def tend(self) -> None:
        """Say to the computers that the runner is there."""
        now_s = time.monotonic()
        if now_s - self._told_s >= ALIVE_S:
            self._told_s = now_s
            for host in self._hosts:
                order(self._wire, host, "alive")

    def close(self) -> None:
        """End what is left, and fetch what the robots wrote."""
        self.end_robots()
        for host in self._hosts:
            order(self._wire, host, "end")
        if self._folder is not None:
            self._fetch(self._folder)
        self._wire.close()

    def _fetch(self, out: Path) -> None:
        """Write the files that the computers send, until all have sent their last."""
        still = set(self._hosts)
        deadline_s = time.monotonic() + FILES_S
        while still and time.monotonic() < deadline_s:
            message = self._files.poll()
            if message is None:
                time.sleep(0.01)
                continue
            path, data = _file(message[1])
            if path:
                target = out / path
                target.parent.mkdir(parents=True, exist_ok=True)
                with target.open("ab") as stream:
                    stream.write(data)
            else:
                still.discard(message[0].rsplit("/", 1)[1])


def _file(data: bytes) -> tuple[str, bytes]:
    """Return a path inside the run's folder, and the next bytes of it; an empty path ends all."""
    path, piece = cast("tuple[Any, Any]", msgpack.unpackb(data, use_list=False))
    if path and not _PATH.fullmatch(path):
        raise ValueError(f"a file of a run can't be called {path!r}")
    return path, piece


def _find(wire: Wire, hosts: Sequence[str]) -> None:
    """Wait until all computers have offered themselves."""
    offers = wire.channel("world/offer/*")
    missing = set(hosts)
    deadline_s = time.monotonic() + FIND_S
    while missing:
        message = offers.poll()
        if message is not None:
            missing.discard(message[0].rsplit("/", 1)[1])
        elif time.monotonic() > deadline_s:
            raise UsageError(
                f"--hosts: {', '.join(sorted(missing))} did not come to {wire.endpoint} within"
                f" {FIND_S:g} s; start there: ropeteam host --connect {wire.endpoint} --name NAME"
            )
        else:
            time.sleep(0.01)
