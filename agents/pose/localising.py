"""What a robot makes of those it sees: where it is itself, and where a lost one is.

Three things tell a robot its place in the team frame. A landmark's place is known to all. An
Anchor-bot stands where it was put: its error is its own, and the filter keeps it beside the robot's
pose, so that it counts once. Any other team-mate's error may be this robot's, come round: such a
sighting is taken in by covariance intersection, which holds whatever the two share.

The origin of the team is the first robot of the roster that maps, is heard and knows where it is.
It takes no correction from others that move: they come to it. When it falls silent the next is the
origin, and nothing else happens: the team frame is what everybody's poses say it is.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from agents.briefing import ACTIVITIES, AgentSettings, Mate
from agents.geometry import Floats, Pose
from agents.layers import UNLOCATED_M2
from agents.ports import Sighting
from agents.pose.posefilter import PoseFilter, Remembered

STANDING = ("waiting", "watching", "holding", "done")
"""Who says that it does one of these stands where it said."""
MAPPERS = ("recon", "explorer")
EXACT: Floats = np.zeros((4, 4))
GATE = 25.0
"""Innovations beyond this (chi-squared, 4 degrees of freedom: 5e-5) are not believed."""


@dataclass(frozen=True)
class Reference:
    """Something in sight whose place is known."""

    kind: Literal["landmark", "anchor", "mate"]
    index: int
    """In the roster; of a landmark, among the landmarks."""
    pose: Pose
    covariance: Floats
    """(4, 4)."""


def is_located(mate: Mate) -> bool:
    """Say whether a team-mate knows where it is."""
    return max(mate.status.variance[:2]) < UNLOCATED_M2


def reference(
    settings: AgentSettings, mates: Mapping[int, Mate], name: str, origin: int | None
) -> Reference | None:
    """Return what a sighting can be held against; None for one that moves, or knows nothing."""
    for number, landmark in enumerate(settings.landmarks):
        if landmark.name == name:
            return Reference("landmark", number, landmark.pose, EXACT)
    index = settings.roster.index(name)
    mate = mates.get(index)
    if mate is None or not is_located(mate):
        return None
    covariance = np.diag(mate.status.variance)
    if settings.roles[index] == "anchor":
        return Reference("anchor", index, mate.status.pose, covariance)
    stands = ACTIVITIES[mate.status.activity] in STANDING
    if stands and settings.index != origin:
        return Reference("mate", index, mate.status.pose, covariance)
    return None


def take_in(way: PoseFilter, known: Reference, sighting: Sighting) -> None:
    """Correct the way that a robot believes it came by a sighting of a known thing."""
    match known.kind:
        case "landmark":
            way.saw(known.pose, known.covariance, sighting, gate=GATE)
        case "anchor":
            name = Remembered("mate", known.index)
            if not way.holds(name):
                way.introduce(name, known.pose, known.covariance)
            way.saw_again(name, sighting, gate=GATE)
        case "mate":
            way.saw_dependent(known.pose, known.covariance, sighting, gate=GATE)


def origin_of(
    settings: AgentSettings, mates: Mapping[int, Mate], *, heard_since_s: float, located: bool
) -> int | None:
    """Return who the team's origin is, as far as this robot can hear; None: nobody is located.

    Who was not heard since a time counts as lost; who was never heard, as there until then.
    """
    for index, role in enumerate(settings.roles):
        if role not in MAPPERS:
            continue
        if index == settings.index:
            if located:
                return index
            continue
        mate = mates.get(index)
        if (mate is None and heard_since_s < 0) or (
            mate is not None and mate.heard_s >= heard_since_s and is_located(mate)
        ):
            return index
    return None
