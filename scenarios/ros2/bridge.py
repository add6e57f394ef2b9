"""A run as it goes on, live into ROS 2: maps, poses and the clock, as its robots' logs tell them.

It only reads files, in a process of its own and at low priority: the robots know nothing of it, and
a run with it leaves the same records as one without. What came faster than it can be sent is
skipped: the newest counts. Maps are sent again now and then, for who subscribes late.
"""

import contextlib
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from pathlib import Path

from comms.ros2_zenoh import ROUTER, RosNode
from scenarios.logs import diary
from scenarios.logs.diary import LogTail, Note
from scenarios.ros2 import messages
from scenarios.ros2.bag import Stamped, Teller, check_names
from scenarios.ros2.cdr import encode
from scenarios.ros2.types import HASHES
from scenarios.schema import load

ROUND_S = 0.5
AGAIN_S = 5.0
END_S = 20.0
"""How long the last messages may take once the run has ended."""
NICENESS = 10


@dataclass
class Follower:
    """Follows one robot's logs, life after life."""

    run: Path
    robot: str
    tails: list[LogTail] = field(default_factory=list[LogTail])
    teller: Teller = field(init=False)

    def __post_init__(self) -> None:
        """Begin before its first life."""
        self.teller = Teller(self.robot)

    def news(self) -> list[Stamped]:
        """Return what is new, of each topic only the newest."""
        notes = self._notes()
        newest = {note.topic: i for i, note in enumerate(notes)}
        told: list[Stamped] = []
        for i, note in enumerate(notes):
            if newest[note.topic] == i:
                told.extend(self.teller.tell(note))
            else:
                self.teller.skip(note)
        return told

    def _notes(self) -> list[Note]:
        life = len(self.tails)
        path = self.run / (f"{self.robot}-{life}.mcap" if life else f"{self.robot}.mcap")
        if path.is_file():
            self.tails.append(LogTail(path, self.robot))
        return [note for tail in self.tails[-2:] for note in tail.read(diary.TOPICS)]


class Bridge:
    """Turns what a run's logs tell into messages, round by round."""

    def __init__(self, run: Path, robots: list[str], send: Callable[[Stamped], None]) -> None:
        """Begin before the run does."""
        self._followers = [Follower(run, robot) for robot in robots]
        self._send = send
        self._kept: dict[str, Stamped] = {}
        self._clock_ns = -1
        self._again_s = 0.0

    def round(self, now_s: float) -> None:
        """Send what is new at a moment of the wall clock."""
        told = [one for follower in self._followers for one in follower.news()]
        newest_ns = max([self._clock_ns, *(one.t_ns for one in told)])
        if newest_ns > self._clock_ns:
            self._clock_ns = newest_ns
            clock = encode("rosgraph_msgs/msg/Clock", {"clock": messages.stamp(newest_ns)})
            self._send(Stamped(newest_ns, "/clock", "rosgraph_msgs/msg/Clock", clock))
        self._kept.update({one.topic: one for one in told if one.topic != "/tf"})
        if now_s >= self._again_s + AGAIN_S:
            self._again_s = now_s
            told = [*(one for one in told if one.topic == "/tf"), *self._kept.values()]
        for one in told:
            self._send(one)


def serve(run: Path, endpoint: str, domain: int, *, until_eof: bool = False) -> None:
    """Publish a run until Ctrl-C, or until standard input is closed; the rest is still sent.

    Raises:
        StudyError: this is no run.
        CommsError: the router can't be reached.

    """
    os.nice(NICENESS)
    robots = list(load(str(run / "scenario.toml")).robots)
    check_names(robots)
    node = RosNode(endpoint, domain=domain)

    def send(one: Stamped) -> None:
        node.publish(one.topic, one.kind, HASHES[one.kind], one.data, time.time_ns())

    bridge = Bridge(run, robots, send)
    try:
        while not (until_eof and _has_ended(ROUND_S)):
            bridge.round(time.monotonic())
            if not until_eof:
                time.sleep(ROUND_S)
        bridge.round(time.monotonic())
    finally:
        node.close()


def _has_ended(wait_s: float) -> bool:
    """Wait for so long at most; say whether standard input was closed."""
    return bool(select.select([sys.stdin], [], [], wait_s)[0]) and not sys.stdin.read(1)


@contextlib.contextmanager
def beside(run: Path, endpoint: str = ROUTER, domain: int = 0) -> Generator[None]:
    """Publish a run from a process of its own while it goes on."""
    command = [sys.executable, "-m", "scenarios.cli", "ros2", str(run), "--until-eof"]
    command += ["--router", endpoint, "--domain", str(domain)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True)
    assert process.stdin is not None
    try:
        yield
    finally:
        process.stdin.close()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
