"""When a lost robot holds its map against the team's, and what it takes for either."""

from dataclasses import replace
from functools import reduce
from typing import Any

from agents.geometry import GridFrame
from agents.joining import floors, ground
from agents.joining.verdict import Joined, NotFound
from agents.layers import OwnLayer, variances
from agents.maps.elevation import Estimate
from agents.maps.kind import EVERYWHERE, MapKind
from agents.maps.planar import Occupancy
from agents.pose.anchoring import submap_name
from agents.pose.posefilter import PoseFilter

GROWN = 1.15
"""It tries again once either map has grown by this factor ..."""
EVERY_LOOKS = 4
"""... and after so many looks whatever has grown."""


class Joiner:
    """Says when another try is worth its time: by looks and cells, never by a clock."""

    def __init__(self) -> None:
        """Have tried nothing yet."""
        self._looks, self._own, self._heard = 0, 0, 0
        self.said = ""
        """Why it was not found when it last tried."""

    def is_due(self, looks: int, own_cells: int, heard_cells: int) -> bool:
        """Say whether to try now; what is asked once is taken for tried."""
        if own_cells == 0 or heard_cells == 0:
            return False
        grown = own_cells > GROWN * self._own or heard_cells > GROWN * self._heard
        waited = looks >= self._looks + EVERY_LOOKS
        if not (grown or waited):
            return False
        self._looks, self._own, self._heard = looks, own_cells, heard_cells
        return True


def own_estimate(kind: MapKind[Any, Any], own: OwnLayer[Any], way: PoseFilter) -> Any:
    """Return all that a robot measured itself, where its pose filter now puts it.

    Of a robot that does not know where it is, that is in a frame of its own.
    """
    layers: list[Any] = []
    for index, submap in enumerate(own.submaps):
        anchor, name = submap.anchor, submap_name(index)
        if way.holds(name):
            spread = variances(way.remembered(name).covariance)
            anchor = replace(anchor, corrected=way.pose_of(name), variance=spread)
        drawing = kind.drawn(submap, EVERYWHERE)
        if anchor.is_moved:
            drawing = kind.moved(drawing, anchor, own.frame)
        layers.append(kind.blurred(drawing, anchor, own.frame) if anchor.is_located else drawing)
    return reduce(kind.surest, layers) if layers else None


def placed(own: Any, team: Any, frame: GridFrame) -> Joined | NotFound:
    """Return where a robot's own map lies on the team's; both estimates are of one kind."""
    if isinstance(own, Estimate):
        mine, theirs = (ground.strewn(frame, e.elevation_m, e.variance_m2) for e in (own, team))
        return ground.Ground(mine, theirs, frame.cell_m).place()
    if isinstance(own, Occupancy):
        mine, theirs = (floors.strewn(frame, e.log_odds) for e in (own, team))
        return floors.Floor(mine, theirs, frame.cell_m).place()
    return NotFound("maps of this kind can't be matched")
