"""How a map is placed on another, whatever both are of: search, refine, judge, doubt."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Self

from agents.geometry import Bools, GridFrame, wrap_angle
from agents.joining.fitting import Fit, Moving, Reading, fit
from agents.joining.searching import Comparing, Strewn, around, search
from agents.joining.verdict import Joined, Judged, Needs, NotFound, is_elsewhere, verdict

GUESSES = 60
"""So many places of the search are looked at closely ..."""
FINALISTS = 8
"""... and so many of them by all cells."""
FEW = 600
"""Cells by which they are looked at first."""
STEPS = (8, 15)
"""Of Gauss and Newton, then and now."""


@dataclass(frozen=True)
class Pair(ABC):
    """A late-comer's map, a team's, and what the two say of a place."""

    own: Strewn
    team: Strewn
    cell_m: float
    """Of both maps."""

    @cached_property
    @abstractmethod
    def times(self) -> int:
        """Side of the cells of the search, in those of the maps."""

    @cached_property
    def grid(self) -> GridFrame:
        """The cells of the search that hold the team's map."""
        return around(self.team, self.cell_m, self.times)

    @cached_property
    @abstractmethod
    def comparing(self) -> Comparing:
        """What cells say in the search."""

    @cached_property
    @abstractmethod
    def field(self) -> Reading:
        """The team's map, to be read between its cells."""

    @cached_property
    @abstractmethod
    def broad(self) -> Reading:
        """The same drawn more broadly, of which noise has hardly any slopes left."""

    @cached_property
    @abstractmethod
    def moving(self) -> Moving:
        """The own map, to be held against it."""

    @cached_property
    @abstractmethod
    def alike(self) -> float:
        """How many cells tell no more than one."""

    @cached_property
    @abstractmethod
    def needs(self) -> Needs:
        """What a place must have."""

    @abstractmethod
    def poor(self) -> str:
        """Return why there is nothing to match, or nothing."""

    @abstractmethod
    def judge(self, found: Fit) -> Judged:
        """Return what speaks for a place."""

    @abstractmethod
    def shared(self, found: Fit) -> Bools:
        """Return which of the own cells (N,) the team knows too."""

    def of(self, own: Strewn, team: Strewn) -> Self:
        """Return two other maps of the kind."""
        return type(self)(own, team, self.cell_m)

    def place(self) -> Joined | NotFound:
        """Return where the own map lies on the team's, if that is sure."""
        poor = self.poor()
        if poor:
            return NotFound(poor)
        found = verdict(self.places(), self.own, self.needs)
        if isinstance(found, NotFound):
            return found
        doubt = self._likeness(found.judged)
        return NotFound(doubt) if doubt else found

    def places(self, most: int = GUESSES) -> list[Judged]:
        """Return the best places, no two of them the same; of so many guesses."""
        least = 0.5 * self.needs.overlap_m2 / self.grid.cell_m**2
        guesses = search(self.own, self.team, self.grid, self.comparing, least)[:most]
        few = self.moving.thinned(FEW)
        begin = [(guess.turn_rad, guess.x_m, guess.y_m) for guess in guesses]
        near = [fit(few, self.field, start, steps=STEPS[0]) for start in begin]
        judged = [self.judge(found) for found in near if found is not None]
        kept: list[Judged] = []
        for one in sorted(judged, key=lambda place: (bool(place.contradiction), -place.evidence)):
            is_new = all(is_elsewhere(one, other, self.own, self.needs) for other in kept)
            if is_new and len(kept) < FINALISTS:
                kept.append(one)
        starts = [(one.fit.turn_rad, one.fit.x_m, one.fit.y_m) for one in kept]
        close = [
            fit(self.moving, self.field, start, steps=STEPS[1], broad=self.broad)
            for start in starts
        ]
        return [self.judge(found) for found in close if found is not None]

    def _likeness(self, found: Judged) -> str:
        """Return whether what was matched is like something else on the own map, or nothing.

        Of rooms that are alike the team may have seen another one, and no more than that.
        """
        part = self.shared(found.fit)
        again = self.of(Strewn(self.own.xy_m[part], self.own.planes[:, part]), self.own)
        if again.poor():
            return ""
        least = self.needs.rival * found.evidence * self.alike / again.alike
        for other in sorted(again.places(GUESSES // 2), key=lambda place: -place.evidence):
            moved_m = math.dist(other.fit.carried(again.own.middle_m[None])[0], again.own.middle_m)
            turned_rad = abs(wrap_angle(other.fit.turn_rad))
            is_itself = moved_m <= self.needs.apart_m and turned_rad <= self.needs.apart_rad
            is_like = other.agreement >= self.needs.alike and not other.contradiction
            if is_like and not is_itself and other.evidence > least:
                return f"what it matches is like another place of its own map, {moved_m:.0f} m off"
        return ""
