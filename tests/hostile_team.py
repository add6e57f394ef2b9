"""A whole member of a team, fed frames that bear the team's own code and hold anything.

Only a robot that has the key can send such frames: one with a bug, or one in wrong hands. What it
says may be believed, but must break nothing.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from hostile import KEY, OWN, TEAM_SIZE, Target, in_time, promise, sealed
from robot_helpers import Log, settings_of
from team_helpers import look

from agents.disk import Disk
from agents.member import Member
from agents.ports import Hardware
from agents.store import Chunk
from comms.frames import VERSION, FrameError, Opener

FRAMES = 12
"""More frames than this in one input are left out."""
ROOM_BYTES = 200
LEAST_FRAME_BYTES = 2
NS = 1_000_000_000


class Nowhere(Disk):
    """A disk that keeps nothing."""

    def journal(self, chunk: Chunk) -> None:
        del chunk

    def confirm(self) -> None:
        pass


def member() -> Member:
    """Return a robot that has measured something, and is ready to send it."""
    robot = Member(settings_of(OWN), Hardware(), Nowhere(Path("nowhere")), Log())
    submap = robot.own.begin_submap(robot.pose, robot.filter.covariance)
    submap.observe(look(np.random.default_rng(5)))
    robot.tiles_changed(0, submap.known)
    return robot


def frames_of(data: bytes) -> Iterator[bytes]:
    """Cut an input into frames: a byte of kind and sender, one of length, so many of payload."""
    at = 0
    for seq in range(FRAMES):
        if at + LEAST_FRAME_BYTES > len(data):
            return
        what, length = data[at], data[at + 1]
        payload = data[at + 2 : at + 2 + length]
        at += 2 + length
        kind, sender, incarnation = what & 15, what >> 4 & 3, what >> 6
        yield sealed(bytes((VERSION << 4 | kind, sender, incarnation, seq)) + payload)


def as_input(frames: Sequence[tuple[int, int, bytes]]) -> bytes:
    """Return the input that holds frames of (kind, sender, payload)."""
    return b"".join(
        bytes((kind | sender << 4, len(payload))) + payload for kind, sender, payload in frames
    )


def member_target(data: bytes) -> None:
    """Hear the frames one by one, let the link ask after each, and look at the map in the end."""
    robot, opener = member(), Opener(KEY, TEAM_SIZE, OWN)
    before = robot.own.known_cells()
    for second, raw in enumerate(frames_of(data), 1):
        try:
            frame = opener.open(raw)
        except FrameError:
            continue
        robot.on_frame(frame, second * NS)
        for _ in range(2):
            outgoing = robot.choose_frame(second * NS, ROOM_BYTES)
            promise(outgoing is None or len(outgoing.payload) <= ROOM_BYTES, "a frame too long")
    robot.sharing.settled()
    for estimate in (robot.team.fused(), robot.team.as_heard()):
        known = estimate.known
        promise(bool(np.isfinite(estimate.elevation_m[known]).all()), "a known cell is not finite")
        promise(bool((estimate.variance_m2[known] > 0).all()), "a variance is not positive")
    promise(robot.own.known_cells() == before, "the own layer was changed by others")
    promise(bool(np.isfinite(robot.filter.covariance).all()), "the pose's covariance is broken")


def refusals(data: bytes) -> list[str]:
    """Return what a member writes down about the frames that it can't understand."""
    robot, opener = member(), Opener(KEY, TEAM_SIZE, OWN)
    for raw in frames_of(data):
        robot.on_frame(opener.open(raw), NS)
    assert isinstance(robot.log, Log)
    return robot.log.told("refused")


TARGETS: dict[str, Target] = {"member": in_time(member_target)}
