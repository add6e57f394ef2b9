"""What fails of a robot's own: camera, wheels, disk, computer; for a while, by the scenario."""

import asyncio
import errno
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from agents.files import Files
from agents.ports import Body, Camera, Exposure, Guide, Hardware, Odometry, Step
from comms.timebase import now_ns

TroubleKind = Literal["blind", "stuck", "full", "slow"]
STUCK_S = 10.0
"""A robot whose wheels don't turn pulls for so long before it gives up."""
STUCK_VARIANCE = 1e-8
"""Of what the wheel encoders say then, in m^2 and rad^2."""


@dataclass(frozen=True)
class Trouble:
    """One part that fails, in a span of the run."""

    kind: TroubleKind
    from_ns: int
    until_ns: int
    think_ns: int = 0
    """What each computation takes (slow)."""


class Troubles:
    """All that fails of one robot; more may come while it runs."""

    def __init__(self) -> None:
        """Begin with a sound robot."""
        self._all: list[Trouble] = []

    def add(self, trouble: Trouble) -> None:
        """Let something fail."""
        self._all.append(trouble)

    def has(self, kind: TroubleKind, t_ns: int) -> bool:
        """Say whether a part fails at a time."""
        return bool(self._at(kind, t_ns))

    def think_ns(self, t_ns: int) -> int:
        """Return how long a computation takes that begins at a time."""
        return max((trouble.think_ns for trouble in self._at("slow", t_ns)), default=0)

    def _at(self, kind: TroubleKind, t_ns: int) -> list[Trouble]:
        return [t for t in self._all if t.kind == kind and t.from_ns <= t_ns < t.until_ns]


class FailingCamera:
    """`agents.ports.Camera` whose picture may stay black; a look takes as long as ever."""

    def __init__(self, camera: Camera, troubles: Troubles) -> None:
        """Look through another camera."""
        self._camera, self._troubles = camera, troubles

    async def look(self, pan_rad: float, tilt_rad: float) -> Exposure:
        """Expose once; where the camera is blind by then, nothing is on it."""
        exposure = await self._camera.look(pan_rad, tilt_rad)
        return _black(exposure) if self._troubles.has("blind", now_ns()) else exposure


class FailingGuide:
    """`agents.ports.Guide` of a robot whose sensor may be blind."""

    def __init__(self, guide: Guide, troubles: Troubles) -> None:
        """Follow another guide."""
        self._guide, self._troubles = guide, troubles

    async def step(self) -> Step | None:
        """Go one look on; where the sensor is blind by then, nothing is in it."""
        step = await self._guide.step()
        if step is None or step.exposure is None or not self._troubles.has("blind", now_ns()):
            return step
        return replace(step, exposure=_black(step.exposure))


def _black(exposure: Exposure) -> Exposure:
    return replace(exposure, points_m=np.zeros((0, 3)), sigma_m=np.zeros(0), sightings=())


class FailingBody:
    """`agents.ports.Body` whose wheels may be stuck; a leg that was begun is driven to its end."""

    def __init__(self, body: Body, troubles: Troubles) -> None:
        """Drive another body."""
        self._body, self._troubles = body, troubles

    async def drive(self, turn_rad: float, forward_m: float) -> Odometry:
        """Drive; where the wheels are stuck, pull for a while and stay."""
        if not self._troubles.has("stuck", now_ns()):
            return await self._body.drive(turn_rad, forward_m)
        await asyncio.sleep(STUCK_S)
        return Odometry(0.0, 0.0, 0.0, 0.0, STUCK_VARIANCE * np.eye(4), halted="wheels stuck")


def failing(hardware: Hardware, troubles: Troubles) -> Hardware:
    """Return hardware that fails when its robot's troubles say so."""
    body, camera, guide = hardware.body, hardware.camera, hardware.guide
    return replace(
        hardware,
        body=None if body is None else FailingBody(body, troubles),
        camera=None if camera is None else FailingCamera(camera, troubles),
        guide=None if guide is None else FailingGuide(guide, troubles),
    )


class FailingFiles:
    """`agents.files.Files` of a disk that may be full: it can be read, and takes nothing."""

    def __init__(self, files: Files, troubles: Troubles, clock_ns: Callable[[], int]) -> None:
        """Use other files; `clock_ns` tells the run's time."""
        self._files, self._troubles, self._clock_ns = files, troubles, clock_ns

    def read(self, path: Path) -> bytes | None:
        """Return what a file holds, or None where there is none."""
        return self._files.read(path)

    def append(self, path: Path, data: bytes) -> None:
        """Write behind what a file holds; of what does not fit any more, a part."""
        if self._is_full():
            self._files.append(path, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._files.append(path, data)

    def replace(self, path: Path, data: bytes, *, durable: bool = False) -> None:
        """Write a file whole or not at all."""
        if self._is_full():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._files.replace(path, data, durable=durable)

    def cut(self, path: Path, length_bytes: int) -> None:
        """Shorten a file, which a full disk allows."""
        self._files.cut(path, length_bytes)

    def _is_full(self) -> bool:
        return self._troubles.has("full", self._clock_ns())
