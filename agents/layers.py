"""What one robot measured itself, and nothing else: its own layer.

A layer is made of submaps, each anchored by the pose that the robot believed when it began it,
in the robot's drifting frame; a new one is begun when the pose has grown unsure against the
anchor. What a submap keeps of a cell is its kind's own affair (`agents.maps`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np

from agents.geometry import Bools, Floats, GridFrame, Ints, Pose
from agents.tiles import Window
from agents.voxel.frame import VoxelSet

Mask = Bools | VoxelSet
"""Cells of a map: an array (rows, cols), or a set of voxels."""

YAW_STEP_RAD = 1e-4
VARIANCE_STEPS = 4.0
"""Variances travel as steps of a quarter of an octave, rounded up."""
LEAST_VARIANCE = 1e-8
UNLOCATED_M2 = 1e8
"""A variance from which on nobody knows where a thing is."""


def rounded_pose(pose: Pose) -> Pose:
    """Return the pose to the millimetre and to a tenth of a milliradian, as poses travel."""
    yaw = round(pose.yaw_rad / YAW_STEP_RAD) * YAW_STEP_RAD
    return Pose(
        round(pose.x_m * 1000) / 1000, round(pose.y_m * 1000) / 1000,
        round(pose.z_m * 1000) / 1000, yaw,
    )  # fmt: skip


def variance_step(variance: float) -> int:
    """Return the least step, 0 to 255, that stands for a variance that is no smaller."""
    octaves = math.log2(max(variance, LEAST_VARIANCE) / LEAST_VARIANCE)
    near = max(0, round(octaves * VARIANCE_STEPS))
    # The logarithm is rounded: the steps themselves decide.
    steps = range(max(0, near - 1), min(255, near + 2))
    return next((step for step in steps if variance_of_step(step) >= variance), 255)


def variance_of_step(step: int) -> float:
    """Return the variance that a step stands for."""
    return LEAST_VARIANCE * 2.0 ** (step / VARIANCE_STEPS)


def rounded_variance(
    variance: tuple[float, float, float, float],
) -> tuple[float, float, float, float]:
    """Return variances rounded up to what travels."""
    x, y, z, yaw = (variance_of_step(variance_step(v)) for v in variance)
    return (x, y, z, yaw)


@dataclass(frozen=True)
class Anchor:
    """Where a submap lies in the team frame, and how sure that is.

    The submap's cells were laid in the team grid by the poses that the robot believed at the
    time. `pose` is the anchor pose believed then, `corrected` the best estimate since; what the
    two differ by moves the whole submap.
    """

    version: int
    pose: Pose
    corrected: Pose
    variance: tuple[float, float, float, float]
    """Variances of (x, y, z, yaw): m^2 and rad^2."""

    @property
    def is_moved(self) -> bool:
        """Say whether the submap lies elsewhere than it was drawn."""
        return self.pose != self.corrected

    @property
    def is_located(self) -> bool:
        """Say whether anybody knows where the submap lies."""
        return max(self.variance[:2]) < UNLOCATED_M2

    @staticmethod
    def at(pose: Pose, variance: tuple[float, float, float, float]) -> "Anchor":
        """Return a first anchor, rounded to what travels: the origin must not know it better."""
        rounded, coarse = rounded_pose(pose), rounded_variance(variance)
        return Anchor(0, rounded, rounded, coarse)

    def moved_to(self, pose: Pose, variance: tuple[float, float, float, float]) -> "Anchor":
        """Return the next version of this anchor, at a better pose."""
        return replace(
            self,
            version=self.version + 1,
            corrected=rounded_pose(pose),
            variance=rounded_variance(variance),
        )

    def shift_variance(
        self, frame: GridFrame, window: Window = (slice(None), slice(None))
    ) -> Floats:
        """Return how unsure the place of each cell of a window is along one axis, m^2.

        A turn of the map shifts a cell by its distance to the anchor.
        """
        rows = np.arange(frame.rows)[window[0], np.newaxis]
        cols = np.arange(frame.cols)[np.newaxis, window[1]]
        dx = frame.x_m + (cols + 0.5) * frame.cell_m - self.corrected.x_m
        dy = frame.y_m + (rows + 0.5) * frame.cell_m - self.corrected.y_m
        var_x, var_y, _, var_yaw = self.variance
        return 0.5 * (var_x + var_y) + (dx * dx + dy * dy) * var_yaw


class Submap(Protocol):
    """One stretch of a robot's own map, of whatever kind."""

    anchor: Anchor

    @property
    def known(self) -> Mask:
        """The cells that were measured."""
        ...

    @property
    def revision(self) -> int:
        """A number that grows with every change of the cells."""
        ...

    def take(self, other: Self, cells: Any) -> None:
        """Take over some cells, a mask of its own form, from another submap."""
        ...

    def cells(self) -> list[bytes]:
        """Return the cells that it knows as plain bytes, for `MapKind.restored`."""
        ...


S = TypeVar("S", bound=Submap)


class OwnLayer(Generic[S]):
    """All submaps of one robot in one incarnation; the robot alone writes it."""

    def __init__(self, frame: GridFrame, make: Callable[[GridFrame, Anchor], S]) -> None:
        """Make an empty layer of submaps as `make` makes them (`MapKind.submap`)."""
        self.frame = frame
        self.submaps: list[S] = []
        self._make = make

    def begin_submap(self, pose: Pose, covariance: Floats) -> S:
        """Begin a submap at a believed pose; covariance is (4, 4) of (x, y, z, yaw)."""
        submap = self._make(self.frame, Anchor.at(pose, variances(covariance)))
        self.submaps.append(submap)
        return submap

    def known_cells(self) -> int:
        """Count the known (submap, cell) entries."""
        return sum(int(s.known.sum()) for s in self.submaps)


def variances(covariance: Floats) -> tuple[float, float, float, float]:
    """Return the variances of a covariance (4, 4) of (x, y, z, yaw)."""
    x, y, z, yaw = (float(v) for v in np.diag(covariance))
    return (x, y, z, yaw)


def drawn_at(submap_from: Anchor, xy_m: Floats) -> Floats:
    """Return where points (N, 2) of the team frame were drawn in a submap's own drawing."""
    turn = submap_from.pose.yaw_rad - submap_from.corrected.yaw_rad
    c, s = math.cos(turn), math.sin(turn)
    dx = xy_m[:, 0] - submap_from.corrected.x_m
    dy = xy_m[:, 1] - submap_from.corrected.y_m
    return np.column_stack(
        (submap_from.pose.x_m + c * dx - s * dy, submap_from.pose.y_m + s * dx + c * dy)
    )


def drawn_cells(anchor: Anchor, frame: GridFrame) -> tuple[Ints, Ints, Bools]:
    """Return row, column and whether there is one (each (rows, cols)) of the nearest drawn cell.

    Every cell of the team grid takes what was drawn there, before the anchor was corrected.
    """
    rows, cols = np.indices(frame.shape)
    centres: Floats = np.column_stack(
        (
            frame.x_m + (cols.ravel() + 0.5) * frame.cell_m,
            frame.y_m + (rows.ravel() + 0.5) * frame.cell_m,
        )
    ).astype(np.float64)
    source = frame.cells_of(drawn_at(anchor, centres))
    row, col = (source[:, axis].reshape(frame.shape) for axis in (0, 1))
    inside = (row >= 0) & (row < frame.rows) & (col >= 0) & (col < frame.cols)
    return np.where(inside, row, 0), np.where(inside, col, 0), inside
