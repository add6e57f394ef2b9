"""One directed link as its receiver knows it, and what the world tells it of radio waves."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from comms.faults import NO_FAULTS, Fate, Luck, Weather
from comms.profiles import LinkProfile

DOUBLED_FATES = 256
"""Frames of one sender whose copies may be under way at once."""


class Propagation(Protocol):
    """What the world does to radio waves, as the receiving robot's side knows it."""

    def distance_m(self, sender: str, t_ns: int) -> float | None:
        """Return how far off a sender is at a time (ns); None: not known, taken as near."""
        ...

    def hides(self, sender: str, t_ns: int, antenna_m: float, mate_antenna_m: float) -> bool:
        """Say whether ground stands between a sender's antenna and this robot's, at a time.

        The antennas' heights over the ground are the sender's and this robot's.
        """
        ...


class OpenSpace:
    """A world in which everybody is near and in sight."""

    def distance_m(self, sender: str, t_ns: int) -> float | None:
        """Return None: not known."""
        del sender, t_ns

    def hides(self, sender: str, t_ns: int, antenna_m: float, mate_antenna_m: float) -> bool:
        """Return False."""
        del sender, t_ns, antenna_m, mate_antenna_m
        return False


@dataclass(frozen=True)
class Passing:
    """A frame that has come, or would have."""

    sender: str
    number: int
    start_ns: int
    end_ns: int
    at_ns: tuple[int, ...]
    """When it arrives here: the first, and then its copies."""
    frame_bytes: int


class Ear:
    """One directed link as its receiver knows it."""

    def __init__(self, profile: LinkProfile, rng: np.random.Generator) -> None:
        """Take the link and its source of luck.

        Raises:
            TraceError: the link follows a recorded trace, and that can't be read.

        """
        self.profile = profile
        self.up_since_ns = 0
        self.luck = Luck(rng)
        self._weather = Weather(profile.faults, self.luck)
        self._doubled: dict[int, Fate] = {}

    def turn(self, profile: LinkProfile, now_ns: int) -> None:
        """Go over to another profile."""
        if profile.carries and not self.profile.carries:
            self.up_since_ns = now_ns
        if profile.faults != self.profile.faults:
            self._weather = Weather(profile.faults, self.luck, now_ns, self._weather)
        self.profile = profile

    def loss(self, start_ns: int, end_ns: int) -> float | None:
        """Return the probability that a frame is lost; None: it can't pass."""
        if self.profile.faults is NO_FAULTS:
            return self.profile.loss
        return self._weather.loss(self.profile.loss, start_ns, end_ns)

    def once(self, passing: Passing, decide: Callable[["Ear", Passing], Fate]) -> Fate:
        """Have a frame decided about at its first arrival, and return that again for its copy."""
        if len(passing.at_ns) == 1:
            return decide(self, passing)
        fate = self._doubled.pop(passing.number, None)
        if fate is None:
            while len(self._doubled) >= DOUBLED_FATES:
                del self._doubled[next(iter(self._doubled))]
            fate = self._doubled[passing.number] = decide(self, passing)
        return fate
