"""From where each part of the own map was drawn, and where a look that shows it again was taken.

A look's cells are as wrong as the pose from which they were drawn. So a look that shows them again
tells where the robot stands from *there*: the pose filter keeps those poses, with all covariances,
and what is told counts once. New ground is matched by its overlap with the last look's, and ground
that was seen long ago brings back how sure the robot was then.
"""

import itertools

import numpy as np

from agents.fusion import rotate_covariance, yaw_matrix
from agents.geometry import GridFrame, Pose
from agents.ground import matching
from agents.maps.elevation import Submap
from agents.maps.elevationlook import LookCells
from agents.ports import Exposure
from agents.pose.localising import GATE
from agents.pose.posefilter import PoseFilter, Remembered
from agents.settings import SensorSettings

KEPT = 16
"""So many stands are kept; the one that drew the fewest cells is let go first."""
HELD = 3
"""A look is held against what was drawn from so many stands at most."""
NOBODY = -1


class Stands:
    """The stands of one submap's drawing."""

    def __init__(self, frame: GridFrame, sensor: SensorSettings) -> None:
        """Begin without any."""
        self._frame, self._sensor = frame, sensor
        self._submap = NOBODY
        self._drawn_from = np.full(frame.shape, NOBODY, dtype=np.int32)
        self._poses: dict[int, Pose] = {}
        """Where looks were drawn from, in the submap's drawing, by stand; in their order."""
        self._moves = NOBODY
        """How often the robot had moved when it came to the last of them."""
        self._count = itertools.count()

    def locate(self, submap: Submap, index: int, exposure: Exposure, way: PoseFilter) -> list[str]:
        """Correct the way by a look at ground drawn before; return what was not believed."""
        if index != self._submap or not self._poses:
            return []
        elevation_m, _ = submap.estimate((slice(None), slice(None)))
        here = self._believed(self._last, way)[0]
        points = matching.points_of(exposure, self._frame, here)
        doubts: list[str] = []
        for stand in self._showing(points, here):
            pose, covariance = self._believed(stand, way)
            if stand == self._last and way.moves == self._moves:
                continue  # it stands there still
            relief = matching.relief_of(self._frame, elevation_m, self._drawn_from == stand)
            found = matching.match(relief, points, pose, covariance, self._sensor)
            if found is not None:
                offset, noise = matching.in_frame_of(
                    self._poses[stand], found.pose, found.covariance
                )
                nis = way.fix_against(_name(stand), offset, noise, gate=GATE)
                if nis > GATE:
                    doubts.append(f"{nis**0.5:.1f} sigmas")
        return doubts

    def drew(
        self,
        submap: Submap,
        index: int,
        pose: Pose,
        exposure: Exposure,
        cells: LookCells,
        way: PoseFilter,
    ) -> None:
        """Note that a look was drawn in a submap, from a pose of its drawing, as cells."""
        if index != self._submap:
            self._begin(index, way)
        is_new = not self._poses or way.moves != self._moves
        stand = next(self._count) if is_new else self._last
        owners = self._drawn_from[cells.rows, cells.cols]
        self._drawn_from[cells.rows, cells.cols] = np.where(owners == NOBODY, stand, owners)
        if is_new:
            elevation_m, _ = submap.estimate((slice(None), slice(None)))
            anything = np.ones(self._frame.shape, dtype=np.bool_)
            relief = matching.relief_of(self._frame, elevation_m, anything)
            points = matching.points_of(exposure, self._frame, pose)
            self._let_go(way)
            self._poses[stand], self._moves = pose, way.moves
            way.remember(_name(stand), matching.blur(relief, points, pose, self._sensor))

    @property
    def _last(self) -> int:
        return next(reversed(self._poses))

    def _begin(self, submap: int, way: PoseFilter) -> None:
        for stand in self._poses:
            way.forget(_name(stand))
        self._poses.clear()
        self._drawn_from.fill(NOBODY)
        self._submap = submap

    def _let_go(self, way: PoseFilter) -> None:
        """Make room for one more."""
        if len(self._poses) < KEPT:
            return
        counts = np.bincount(
            self._drawn_from[self._drawn_from >= 0], minlength=max(self._poses) + 1
        )
        fewest = min(self._poses, key=lambda stand: (int(counts[stand]), stand))
        way.forget(_name(fewest))
        del self._poses[fewest]
        self._drawn_from[self._drawn_from == fewest] = NOBODY

    def _believed(self, stand: int, way: PoseFilter) -> tuple[Pose, np.ndarray]:
        """Return the present pose in the drawing, by how it lies from a stand."""
        apart, base = way.from_remembered(_name(stand)), self._poses[stand]
        forward, left, up, turn = (float(v) for v in apart.mean)
        turned = rotate_covariance(apart.covariance, yaw_matrix(base.yaw_rad))
        return base.moved(forward, left, up, turn), turned

    def _showing(self, points: matching.Points, pose: Pose) -> list[int]:
        """Return the stands of whose cells a look shows enough, the most first."""
        cells = self._frame.cells_of(pose.team_from_robot(points.local_m))
        rows, cols = (np.clip(cells[:, k], 0, n - 1) for k, n in enumerate(self._frame.shape))
        owners = self._drawn_from[rows, cols]
        counts = np.bincount(owners[owners >= 0], minlength=1)
        order = sorted(range(len(counts)), key=lambda stand: (-int(counts[stand]), stand))
        return [s for s in order[:HELD] if counts[s] >= matching.LEAST_CELLS]


def _name(stand: int) -> Remembered:
    return Remembered("stand", stand)
