"""A computer that is offered to a runner: it starts robots there, and sends back what they left.

It obeys orders (`scenarios.hosts.crew.order`): one runner's at a time. A process that ends without
having been told to is announced; where the runner falls silent, all processes are ended.
"""

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import msgpack

from comms.zenoh_air import Wire
from comms.zenoh_security import Credentials
from scenarios.crews.processes import (
    CLOSE_S,
    LAST_WORDS_S,
    LocalProcess,
    obituary,
    start_fork_server,
)
from scenarios.crews.robotprocess import robot_main
from scenarios.hosts.plans import unpack_plan

OFFER_S = 0.5
"""How often (wall) an idle computer says that it is there."""
RUNNER_GONE_S = 300.0
"""A runner that was not heard for so long (wall) is taken for dead, and its robots are ended."""
PIECE_BYTES = 1 << 18
"""Files are sent in pieces of this."""
POLL_S = 0.005


def hosted_main(data: bytes, folder: Path, endpoint: str, credentials: Credentials | None) -> None:
    """Be one robot's process on an offered computer."""
    robot_main(unpack_plan(data, folder, endpoint), credentials)


@dataclass
class _Robot:
    name: str
    process: LocalProcess
    told: bool = False


class Machine:
    """This computer, in the hands of a runner."""

    def __init__(
        self, wire: Wire, name: str, *, credentials: Credentials | None, say: Callable[[str], None]
    ) -> None:
        """Offer this computer under a name, over a wire to the router."""
        self._wire, self.name, self._credentials, self._say = wire, name, credentials, say
        self._orders = wire.channel(f"world/host/{name}")
        self._robots: dict[int, _Robot] = {}
        self._folder: Path | None = None
        self._heard_s = self._offered_s = -1e9
        self.runs = 0
        """Runs that are over."""

    def serve(self, most_runs: int | None = None) -> None:
        """Serve runners, one after another: for ever, or so many runs."""
        start_fork_server()
        try:
            while most_runs is None or self.runs < most_runs:
                self._turn()
        finally:
            self._clear()

    def _turn(self) -> None:
        message = self._orders.poll()
        if message is not None:
            self._obey(*cast("tuple[Any, ...]", msgpack.unpackb(message[1], use_list=False)))
            return
        now_s = time.monotonic()
        if self._folder is None and now_s - self._offered_s >= OFFER_S:
            self._offered_s = now_s
            self._wire.put(f"world/offer/{self.name}", b"")
        self._announce()
        if self._folder is not None and now_s - self._heard_s > RUNNER_GONE_S:
            self._say("the runner has fallen silent: its robots are ended")
            self._clear()
        time.sleep(POLL_S)

    def _obey(self, word: str, number: int, name: str, data: bytes) -> None:
        self._heard_s = time.monotonic()
        robot = self._robots.get(number)
        match word:
            case "begin":
                self._clear()
                self._folder = Path(tempfile.mkdtemp(prefix="ropeteam-"))
                self._say("a run begins")
            case "start" if self._folder is not None:
                args = (data, self._folder, self._wire.endpoint, self._credentials)
                self._robots[number] = _Robot(name, LocalProcess(name, hosted_main, *args))
                self._say(f"{name} starts")
            case "kill" if robot is not None:
                self._end(number)
            case "let end" if robot is not None:
                robot.process.join(CLOSE_S)
            case "stop" if robot is not None:
                robot.process.stop()
            case "resume" if robot is not None:
                robot.process.resume()
            case "end":
                self._send_files()
                self._clear()
                self.runs += 1
                self._say("the run is over")
            case _:
                pass  # the runner is there; or the order is for a process that is gone

    def _end(self, number: int) -> None:
        process = self._robots.pop(number).process
        process.kill()
        process.forget()

    def _announce(self) -> None:
        """Tell the runner of processes that have ended by themselves."""
        for number, robot in list(self._robots.items()):
            why = None if robot.told else robot.process.ended()
            if why is not None:
                robot.told = True
                time.sleep(LAST_WORDS_S)
                said = obituary(number, f"{why}, at {self.name}")
                self._wire.put(f"world/report/{robot.name}", said)

    def _send_files(self) -> None:
        for path, piece in _pieces(self._folder) if self._folder is not None else ():
            self._put_file(path, piece)
        self._put_file("", b"")

    def _put_file(self, path: str, piece: bytes) -> None:
        data = cast("bytes", msgpack.packb((path, piece)))
        self._wire.put(f"world/file/{self.name}", data)

    def _clear(self) -> None:
        """End all processes, and forget the run."""
        for number in list(self._robots):
            with suppress(ValueError):  # it has ended and was cleared away
                self._end(number)
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None


def _pieces(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Yield all files below a folder, piece by piece: the path in it, and the next bytes."""
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder)
        if path.is_file() and not any(part.startswith(".") for part in inside.parts):
            name = inside.as_posix()
            yield name, b""
            with path.open("rb") as stream:
                while piece := stream.read(PIECE_BYTES):
                    yield name, piece
