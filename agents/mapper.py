"""What a robot does with its camera, by its kind of map: expect, fuse, and choose where to look.

`agents.robot` tells the cycle (look, localise, fuse, share, plan, move) once for all kinds.
"""

from dataclasses import dataclass
from typing import Protocol

from agents.geometry import Floats, Pose, Singles
from agents.ports import Exposure


@dataclass(frozen=True)
class NextLook:
    """A look to take, the way to where it is taken, and what is said of it to team-mates."""

    path_m: Floats
    """(N, 2) corners from the robot's position; one point if it stays."""
    heading_rad: float
    """Where the camera shall point, counter-clockwise from +x of the map's frame."""
    tilt_rad: float
    claim: tuple[float, float, float]
    """(x_m, y_m, radius_m) of what it will look at."""


@dataclass(frozen=True)
class Expected:
    """How many cells a look was expected to measure, and which (in the mapper's own form)."""

    cells: float
    chances: Floats | Singles
    """(rows, cols) probability that the look measures a cell."""


class Mapper(Protocol):
    """One robot's dealings with its own kind of map."""

    @property
    def first_looks(self) -> tuple[tuple[float, float], ...]:
        """Pans and tilts, from ahead, of the looks that are taken before anything is chosen."""
        ...

    @property
    def all_round(self) -> tuple[tuple[float, float], ...]:
        """Pans and tilts, from ahead, of looks that leave out no direction."""
        ...

    async def expect(self, pan_rad: float, tilt_rad: float) -> Expected:
        """Return what a look from here is expected to measure."""
        ...

    async def localise(self, exposure: Exposure) -> None:
        """Correct the pose by what a look shows of the map that is there."""
        ...

    async def fuse(self, exposure: Exposure, expected: Expected) -> None:
        """Take one look into the own layer, and log it."""
        ...

    async def choose(self) -> NextLook | None:
        """Return the next look, or None when no look is worth taking."""
        ...

    async def way_to_see(self, mate: Pose) -> Floats | None:
        """Return the way (N, 2) to where a team-mate can be seen from; None: from nowhere."""
        ...

    def relocated(self) -> None:
        """Forget what was planned in the frame of its own that the robot had until now."""
        ...

    def halted(self) -> float | None:
        """Note that the body halted; return the pan to look at there, None as was planned."""
        ...
