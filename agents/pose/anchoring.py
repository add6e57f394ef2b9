"""Submaps hang on the robot's way: what is learnt of the way later moves them.

A submap's cells are drawn once, by the way that the robot believed then. Its anchor says where the
drawing lies; when the pose filter knows that place better, the anchor moves, and only it is told.
"""

from dataclasses import dataclass

from agents.briefing import AgentSettings
from agents.fusion import Gaussian
from agents.geometry import Pose, wrap_angle
from agents.layers import UNLOCATED_M2, Anchor, OwnLayer, Submap, variances
from agents.pose.posefilter import PoseFilter, Remembered

Variances = tuple[float, float, float, float]
UNLOCATED: Variances = (2 * UNLOCATED_M2, 2 * UNLOCATED_M2, 2 * UNLOCATED_M2, 2 * UNLOCATED_M2)
"""What a robot says of a place in a frame of its own."""
TURN_RAD = 0.02
"""A pose that is less sure than this against its submap's anchor begins a new one."""
SURER = 0.7
"""An anchor is told again when it is surer by this share."""


def submap_name(index: int) -> Remembered:
    """Return the name under which the pose filter keeps a submap's anchor."""
    return Remembered("submap", index)


@dataclass(frozen=True)
class Tolerance:
    """By how much an anchor may be wrong before it is worth telling again."""

    shift_m: float
    """Of any cell, sideways."""
    lift_m: float
    reach_m: float
    """Cells lie about so far from their anchor: a turn moves them by that lever."""

    @classmethod
    def of(cls, settings: AgentSettings) -> "Tolerance":
        """Return a quarter of a cell, and half of what the codec may be wrong by."""
        half_m = 0.5 * settings.sensor.range_m
        return cls(0.25 * settings.frame.cell_m, 0.5 * settings.map.max_error_m, half_m)

    def better(self, anchor: Anchor, believed: Gaussian) -> Anchor | None:
        """Return the anchor as it is believed now, or None where that is not worth telling."""
        x, y, z, yaw = (float(v) for v in believed.mean)
        told, variance = anchor.corrected, variances(believed.covariance)
        shift_m = told.distance_m(Pose(x, y, z, yaw))
        shift_m += self.reach_m * abs(wrap_angle(yaw - told.yaw_rad))
        surer = self._is_surer(self._spread(variance), self._spread(anchor.variance), self.shift_m)
        surer |= self._is_surer(variance[2], anchor.variance[2], self.lift_m)
        if shift_m <= self.shift_m and abs(z - told.z_m) <= self.lift_m and not surer:
            return None
        return anchor.moved_to(Pose(x, y, z, yaw), variance)

    def _spread(self, variance: Variances) -> float:
        """Return the variance of where a cell lies."""
        return 0.5 * (variance[0] + variance[1]) + self.reach_m**2 * variance[3]

    def _is_surer(self, now: float, told: float, matters_m: float) -> bool:
        return told > matters_m**2 and now < SURER**2 * told


def placing(own: OwnLayer[Submap], index: int, way: PoseFilter) -> tuple[Pose, Variances]:
    """Return where a look from here is drawn in a submap, and its variance against the anchor.

    What the anchor was corrected by since does not count in its drawing.
    """
    offset = way.from_remembered(submap_name(index))
    forward, left, up, turn = (float(v) for v in offset.mean)
    anchor = own.submaps[index].anchor
    return anchor.pose.moved(forward, left, up, turn), variances(offset.covariance)


def needs_submap(own: OwnLayer[Submap], way: PoseFilter, shift_m: float) -> bool:
    """Say whether the pose has grown so unsure against the anchor that a new submap is due.

    One is due too where the drawing lies far off: it might reach over the edge of the grid.
    """
    name = submap_name(len(own.submaps) - 1)
    if not way.holds(name):
        return True
    anchor = own.submaps[-1].anchor
    far = anchor.pose.distance_m(anchor.corrected) > 10 * shift_m
    x, y, z, yaw = variances(way.from_remembered(name).covariance)
    return far or max(x, y, z) > shift_m**2 or yaw > TURN_RAD**2


def corrected(own: OwnLayer[Submap], way: PoseFilter, tolerance: Tolerance) -> dict[int, Anchor]:
    """Return the anchors of own submaps that the way now puts elsewhere, or surer, by index."""
    found: dict[int, Anchor] = {}
    for index, submap in enumerate(own.submaps):
        if way.holds(submap_name(index)):
            anchor = tolerance.better(submap.anchor, way.remembered(submap_name(index)))
            if anchor is not None:
                found[index] = anchor
    return found
