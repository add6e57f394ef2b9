"""What a robot needs of its body: hardware implements these, or `sim` does.

A robot knows nothing of the world but what comes through these protocols and its radio. All
calls that take time are awaited on the running event loop, whose clock is the robot's clock.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Floats


@dataclass(frozen=True)
class Sighting:
    """A team-mate (or the landmark) found in a look, by the fiducials that it carries."""

    name: str
    offset_m: tuple[float, float, float]
    """Where it stands, in the levelled robot frame (x forward, y left, z up)."""
    bearing_rad: float
    """Its yaw less the observer's."""
    covariance: Floats
    """(4, 4) of (x, y, z, yaw) in the levelled robot frame, metres and radians."""


@dataclass(frozen=True)
class Exposure:
    """What one look at one heading gave."""

    t_s: float
    pan_rad: float
    tilt_rad: float
    points_m: Floats
    """(N, 3) measured points in the levelled robot frame: x forward, y left, z up, origin at the
    ground contact below the mast, z along gravity."""
    sigma_m: Floats
    """(N,) standard deviation along the ray (Sujan & Meggiolaro, Eq. 4)."""
    sightings: tuple[Sighting, ...] = ()
    ranges_m: Floats = field(default_factory=lambda: np.zeros(0))
    """(columns,) of a planar camera, which gives ranges instead of points: along the rays of its
    fan, right to left; inf where nothing came back from within its depth of field."""
    ill: tuple[str, ...] = ()
    """Why the look gave less than it should, in words: no texture, too dark, a tag edge-on."""


@dataclass(frozen=True)
class Odometry:
    """What the robot's own sensors say that a drive did, in the frame of the pose before it."""

    forward_m: float
    left_m: float
    up_m: float
    turn_rad: float
    covariance: Floats
    """(4, 4) of (forward, left, up, turn): the error that the robot's makers state."""
    halted: str = ""
    """Why the drive ended early ("tether taut", "tipped"), or empty."""


@dataclass(frozen=True)
class Step:
    """How far a robot was led, and what its sensor saw at the end of that."""

    odometry: Odometry | None
    """Since the step before; None: it stood."""
    exposure: Exposure | None = None


@dataclass(frozen=True)
class Glance:
    """A rectified pair of grey images, taken to see how the robot moves."""

    pan_rad: float
    tilt_rad: float
    left: NDArray[np.uint8]
    """(H, W)."""
    right: NDArray[np.uint8]


class Camera(Protocol):
    """A ranging camera on a pan/tilt arm; the arm keeps it level with gravity."""

    async def look(self, pan_rad: float, tilt_rad: float) -> Exposure:
        """Point the arm (pan counter-clockwise from ahead, tilt positive up) and expose once."""
        ...


class Eyes(Protocol):
    """A pair of cameras on the same arm, whose images themselves are wanted."""

    async def glance(self, pan_rad: float, tilt_rad: float) -> Glance:
        """Point the arm, and take a pair at `sensor.stereo.glanced()`'s size."""
        ...


class Body(Protocol):
    """Wheels and wheel encoders (with whatever else measures motion)."""

    async def drive(self, turn_rad: float, forward_m: float) -> Odometry:
        """Turn on the spot, then drive straight; return what was measured of it."""
        ...


class Guide(Protocol):
    """Whoever leads a robot that does not drive itself: a recording, or a person with a remote."""

    async def step(self) -> Step | None:
        """Wait for the next look, or for the end of a part of the way; None: nothing more comes."""
        ...


class Winch(Protocol):
    """A tether drum on an Anchor-bot, with a brake that closes by itself."""

    @property
    def length_m(self) -> float:
        """Length of tether that is out, by the drum's encoder."""
        ...

    def pay_out(self, target_m: float, rate_mps: float) -> None:
        """Release the brake and run the drum towards a length at a rate (in either direction)."""
        ...

    def brake(self) -> None:
        """Stop the drum now."""
        ...


@dataclass(frozen=True)
class Hardware:
    """All that one robot has of a body; what it lacks is None."""

    body: Body | None = None
    camera: Camera | None = None
    eyes: Eyes | None = None
    winch: Winch | None = None
    guide: Guide | None = None
    """A robot that has one chooses no look and no way; it has neither body nor camera then."""
