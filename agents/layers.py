"""What one robot measured itself, and nothing else: its own layer.

A layer is made of submaps, each anchored by the pose that the robot believed when it began it,
in the robot's drifting frame; a new one is begun when the pose has grown unsure against the
anchor. A submap keeps information form: sum of 1/sigma^2, sum of z/sigma^2 and the number of
looks per cell, so that one more look is one more addition (Sujan & Meggiolaro, Eqs. 19-21, for
independent measurements).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Bools, Floats, GridFrame, Ints, Pose
from agents.ports import Exposure

YAW_STEP_RAD = 1e-4
VARIANCE_STEPS = 4.0
"""Variances travel as steps of a quarter of an octave, rounded up."""
LEAST_VARIANCE = 1e-8


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

    def cell_variance(self, frame: GridFrame, slope: Floats) -> Floats:
        """Return what the anchor's covariance adds to each cell's elevation variance, m^2.

        A shift of the map moves the elevation of a cell by the slope times the shift; a turn
        shifts a cell by its distance to the anchor.
        """
        rows, cols = np.indices(frame.shape)
        dx = frame.x_m + (cols + 0.5) * frame.cell_m - self.corrected.x_m
        dy = frame.y_m + (rows + 0.5) * frame.cell_m - self.corrected.y_m
        var_x, var_y, var_z, var_yaw = self.variance
        shift = 0.5 * (var_x + var_y) + (dx * dx + dy * dy) * var_yaw
        return var_z + slope * slope * shift


@dataclass(frozen=True)
class LookCells:
    """One look, binned: the cells that it hit, with one mean and one variance each."""

    rows: Ints
    cols: Ints
    mean_m: Floats
    variance_m2: Floats


def bin_look(
    exposure: Exposure,
    pose: Pose,
    frame: GridFrame,
    *,
    attitude_sigma_rad: float,
    extra_variance: tuple[float, float, float, float],
) -> LookCells:
    """Turn the points of one look into one measurement per cell.

    Points of one look share the error of its levelling and of the robot's pose, so however many
    fall in a cell, its variance never falls below that common part. `extra_variance` is the
    pose's variance (x, y, z, yaw) beyond that of the submap's anchor.
    """
    points = pose.team_from_robot(exposure.points_m)
    cells = frame.cells_of(points)
    inside = (
        (cells[:, 0] >= 0)
        & (cells[:, 0] < frame.rows)
        & (cells[:, 1] >= 0)
        & (cells[:, 1] < frame.cols)
    )
    local, points, cells = exposure.points_m[inside], points[inside], cells[inside]
    along_sigma = exposure.sigma_m[inside]
    flat = cells[:, 0] * frame.cols + cells[:, 1]
    used, where, count = np.unique(flat, return_inverse=True, return_counts=True)
    if used.size == 0:
        nothing = np.zeros(0, dtype=np.int64)
        return LookCells(nothing, nothing, np.zeros(0), np.zeros(0))
    range_m = np.linalg.norm(local, axis=1) + 1e-9
    ground_m = np.hypot(local[:, 0], local[:, 1])
    sine = np.minimum(1.0, np.abs(local[:, 2]) / range_m + 0.1)
    weight = 1.0 / np.maximum(along_sigma * sine, 1e-3) ** 2
    total = np.bincount(where, weight)
    z_m = points[:, 2]
    mean = np.bincount(where, weight * z_m) / total
    spread = np.bincount(where, (z_m - mean[where]) ** 2) / count
    spread = np.maximum(spread, (0.3 * frame.cell_m) ** 2)
    reach = np.bincount(where, ground_m) / count
    slope2 = np.minimum(spread * 12.0 / frame.cell_m**2, 9.0)
    var_x, var_y, var_z, var_yaw = extra_variance
    common = (
        (attitude_sigma_rad * reach) ** 2
        + var_z
        + slope2 * (0.5 * (var_x + var_y) + reach**2 * var_yaw)
    )
    return LookCells(
        used // frame.cols, used % frame.cols, mean, 1.0 / total + spread / count + common
    )


class Submap:
    """One stretch of a robot's own map, in information form on the team grid."""

    def __init__(self, frame: GridFrame, anchor: Anchor) -> None:
        """Make an empty submap anchored at a pose."""
        self.frame = frame
        self.anchor = anchor
        self.information = np.zeros(frame.shape)
        self.weighted_z = np.zeros(frame.shape)
        self.looks: NDArray[np.uint16] = np.zeros(frame.shape, dtype=np.uint16)
        self.revision = 0
        """Grows with every change of the cells."""

    @property
    def known(self) -> Bools:
        """Mask of the cells that were measured, (rows, cols)."""
        return self.information > 0

    def observe(self, look: LookCells) -> None:
        """Add one look's measurements."""
        weight = 1.0 / look.variance_m2
        self.information[look.rows, look.cols] += weight
        self.weighted_z[look.rows, look.cols] += weight * look.mean_m
        self.looks[look.rows, look.cols] += 1
        self.revision += 1

    def take(self, other: "Submap", cells: Bools) -> None:
        """Take over the cells of a mask (rows, cols) from another submap."""
        self.information[cells] = other.information[cells]
        self.weighted_z[cells] = other.weighted_z[cells]
        self.looks[cells] = other.looks[cells]
        self.revision += 1

    def estimate(self, window: tuple[slice, slice]) -> tuple[Floats, Floats]:
        """Return elevation (NaN unknown) and variance (inf unknown) of a window of cells."""
        information = self.information[window]
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.weighted_z[window] / information, 1.0 / information


class OwnLayer:
    """All submaps of one robot in one incarnation; the robot alone writes it."""

    def __init__(self, frame: GridFrame) -> None:
        """Make an empty layer."""
        self.frame = frame
        self.submaps: list[Submap] = []

    def begin_submap(self, pose: Pose, covariance: Floats) -> Submap:
        """Begin a submap at a believed pose; covariance is (4, 4) of (x, y, z, yaw)."""
        x, y, z, yaw = (float(v) for v in np.diag(covariance))
        submap = Submap(self.frame, Anchor.at(pose, (x, y, z, yaw)))
        self.submaps.append(submap)
        return submap

    def needs_submap(self, covariance: Floats, *, shift_m: float, turn_rad: float) -> bool:
        """Say whether the pose has grown so unsure against the anchor that a new one is due."""
        if not self.submaps:
            return True
        grown = np.diag(covariance) - np.array(self.submaps[-1].anchor.variance)
        return bool(max(grown[0], grown[1], grown[2]) > shift_m**2 or grown[3] > turn_rad**2)

    def beyond_anchor(self, covariance: Floats) -> tuple[float, float, float, float]:
        """Return the pose's variance (x, y, z, yaw) beyond that of the current anchor."""
        anchor = self.submaps[-1].anchor.variance
        grown = [max(0.0, float(v) - a) for v, a in zip(np.diag(covariance), anchor, strict=True)]
        return (grown[0], grown[1], grown[2], grown[3])

    def known_cells(self) -> int:
        """Count the known (submap, cell) entries."""
        return sum(int(np.count_nonzero(s.information)) for s in self.submaps)


def slope_of(elevation_m: Floats, cell_m: float) -> Floats:
    """Return the magnitude of the gradient, 0 where a neighbour is unknown; clipped at 3."""
    padded = np.pad(elevation_m, 1, mode="edge")
    dx = (padded[1:-1, 2:] - padded[1:-1, :-2]) / (2 * cell_m)
    dy = (padded[2:, 1:-1] - padded[:-2, 1:-1]) / (2 * cell_m)
    return np.minimum(np.nan_to_num(np.hypot(dx, dy)), 3.0)


def drawn_at(submap_from: Anchor, xy_m: Floats) -> Floats:
    """Return where points (N, 2) of the team frame were drawn in a submap's own drawing."""
    turn = submap_from.pose.yaw_rad - submap_from.corrected.yaw_rad
    c, s = math.cos(turn), math.sin(turn)
    dx = xy_m[:, 0] - submap_from.corrected.x_m
    dy = xy_m[:, 1] - submap_from.corrected.y_m
    return np.column_stack(
        (submap_from.pose.x_m + c * dx - s * dy, submap_from.pose.y_m + s * dx + c * dy)
    )
