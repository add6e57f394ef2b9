"""What every candidate look of a scene promises, and the plan that one of them becomes.

All headings and tilts of a position share one sweep of its bearings (`sight.sweep`). Candidates
are rated on a grid made coarser (2x2 means) where the sensor's range is more than
`FINE_RANGE_CELLS` cells; the look chosen is worked out again on the map itself.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from agents.geometry import Floats, GridFrame, Ints, Pose, Singles, wrap_angle
from agents.ground import surface
from agents.ground.markov import Border
from agents.planning.scene import Scene, View
from agents.settings import SensorSettings
from agents.sight import gaze, sweep, visibility
from agents.sight.gaze import Ground, Lens
from agents.sight.visibility import Patch

FINE_RANGE_CELLS = 160
"""Candidates are rated on the map's own cells if the sensor reaches no more of them than this."""


@dataclass(frozen=True)
class LookPlan:
    """A look to take and the way to where it is taken."""

    target_m: tuple[float, float]
    path_m: Floats
    """(N, 2) corners from the robot's position to the target; one point if it stays."""
    heading_rad: float
    """Where the camera shall point, counter-clockwise from +x of the map's frame."""
    pan_rad: float
    """The same, from ahead of the robot as it arrives along the path's last leg."""
    tilt_rad: float
    expected_cells: int
    """Cells that the look is expected to measure, known before or not."""
    gain_bits: float
    """New information expected (Eq. 3)."""
    rating: float
    """Eq. 23."""


@dataclass(frozen=True)
class Gains:
    """Bits (Eq. 3) of every candidate look."""

    cells: Ints
    """(N, 2) positions; the robot's own first."""
    headings_rad: Floats
    tilts_rad: Floats
    bits: Floats
    """(N, headings, tilts)."""
    path_m: Floats
    """(N,) length of the way."""

    @property
    def best_bits(self) -> float:
        """The largest gain."""
        return float(self.bits.max())


@dataclass(frozen=True)
class Stage:
    """The scene on the grid on which looks are rated."""

    frame: GridFrame
    ground: Ground
    sigma_m: Floats

    def inside(self, eye_m: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return an eye, moved on the grid if coarsening cut it off."""
        west, east, south, north = self.frame.extent_m
        x_m = min(max(eye_m[0], west), math.nextafter(east, west))
        y_m = min(max(eye_m[1], south), math.nextafter(north, south))
        return (x_m, y_m, eye_m[2])

    def patch(self, eye_m: tuple[float, float, float], sensor: SensorSettings) -> Patch:
        """Return the visibility about an eye."""
        return visibility.predict(
            self.ground.height_m,
            self.sigma_m,
            self.frame,
            self.inside(eye_m),
            range_m=sensor.range_m,
            near_m=sensor.near_m,
        )

    def gains(self, eyes_m: Floats, headings: Floats, tilts: Floats, view: View) -> Floats:
        """Return the bits (N, headings, tilts) of looks from eyes (N, 3)."""
        xyz = np.array([self.inside((x, y, z)) for x, y, z in eyes_m.tolist()])
        cols = (xyz[:, 0] - self.frame.x_m) / self.frame.cell_m - 0.5
        rows = (xyz[:, 1] - self.frame.y_m) / self.frame.cell_m - 0.5
        return sweep.look_gains(
            self.ground,
            self.sigma_m,
            np.column_stack((rows, cols, xyz[:, 2])),
            headings,
            tilts,
            Lens.of(view.sensor),
            (view.sensor.near_m, view.sensor.range_m),
        )


def stage_of(scene: Scene) -> Stage:
    """Return a scene on the grid on which its candidates are rated."""
    view = scene.view
    fine = view.sensor.range_m / view.frame.cell_m <= FINE_RANGE_CELLS
    return _stage(scene, 1 if fine or min(view.frame.shape) < 4 else 2, scene.worth)


def _stage(scene: Scene, factor: int, worth: Floats) -> Stage:
    """Join factor x factor cells: mean heights, root mean square sigma, summed worth."""
    frame = scene.view.frame
    joined = GridFrame(
        frame.x_m,
        frame.y_m,
        frame.cell_m * factor,
        frame.rows // factor,
        frame.cols // factor,
    )

    def mean(values: Floats) -> Floats:
        if factor == 1:
            return values
        blocks = values[: joined.rows * factor, : joined.cols * factor]
        return blocks.reshape(joined.rows, factor, joined.cols, factor).mean(axis=(1, 3))

    north, east = surface.gradient(surface.smoothed(mean(scene.sight_m)), joined.cell_m)
    ground = Ground(
        mean(scene.obstacles_m),
        north,
        east,
        mean(worth) * factor * factor,
        joined.cell_m,
        frame.cell_m,
    )
    return Stage(joined, ground, np.sqrt(mean(scene.sigma_m**2)))


def eye_at(scene: Scene, cell: tuple[int, int]) -> tuple[float, float, float]:
    """Return the camera's centre over a cell; over the robot's own cell, where it is now."""
    view = scene.view
    if cell == scene.cell:
        return (view.pose.x_m, view.pose.y_m, view.pose.z_m + view.sensor.height_m)
    x_m, y_m = view.frame.centre_of(*cell)
    return (x_m, y_m, float(scene.ground_m[cell]) + view.sensor.height_m)


def look_gains(scene: Scene) -> Gains:
    """Return the new information of every candidate look of a scene.

    A robot that can drive nowhere yet is offered the steepest tilt only: it has to see the ground
    before its wheels, or it would look at the distance from where it stands until that is full.
    """
    view, planner = scene.view, scene.view.planner
    turn = 2.0 * math.pi / planner.headings
    headings = np.arange(planner.headings, dtype=np.float64) * turn
    tilts = np.radians(np.array(planner.tilts_deg, dtype=np.float64))
    cells = scene.candidates
    if len(cells) == 1:
        tilts = tilts.min(keepdims=True)
    stage = stage_of(scene)
    eyes_m = np.array([eye_at(scene, (row, col)) for row, col in cells.tolist()])
    bits = stage.gains(eyes_m, headings, tilts, view)
    return Gains(cells, headings, tilts, bits, scene.travel[0][cells[:, 0], cells[:, 1]])


def expected_visibility(
    view: View, pose: Pose, pan_rad: float, tilt_rad: float, *, sight: Border = "low"
) -> Singles:
    """Return each cell's probability (H, W) of being measured in a look from a pose.

    Eq. 5 inside the field of view, times the chance that a ray falls on the cell at all. Its sum is
    the look's expected cells; `Interest.update` takes it as P of Eq. 9. `sight` as of `Scene`.
    """
    scene = Scene(replace(view, pose=pose), sight=sight)
    eye = (pose.x_m, pose.y_m, pose.z_m + view.sensor.height_m)
    return _expected(scene, eye, wrap_angle(pose.yaw_rad + pan_rad), tilt_rad)


def _expected(
    scene: Scene, eye_m: tuple[float, float, float], heading_rad: float, tilt_rad: float
) -> Singles:
    view, lens = scene.view, Lens.of(scene.view.sensor)
    unrated = np.broadcast_to(0.0, view.frame.shape)  # what is seen does not hang on its worth
    stage = _stage(scene, 1, unrated)
    patch = stage.patch(eye_m, view.sensor)
    h, w = patch.p.shape
    cut = (slice(patch.row0, patch.row0 + h), slice(patch.col0, patch.col0 + w))
    seen = gaze.measured_chance(patch, stage.ground, lens)
    seen[~gaze.in_view(patch, heading_rad, tilt_rad, lens)] = 0.0
    seen[(scene.obstacles_m > scene.sight_m)[cut]] = 0.0
    whole = np.zeros(view.frame.shape, dtype=np.float32)
    whole[cut] = seen
    return whole


def plan(scene: Scene, gains: Gains, choice: tuple[int, int, int], rating: float) -> LookPlan:
    """Return the plan for one of the candidate looks: (position, heading, tilt) indices."""
    n, k, t = choice
    cell = (int(gains.cells[n, 0]), int(gains.cells[n, 1]))
    pose = scene.view.pose
    way = scene.path_m(cell) if n else np.array(((pose.x_m, pose.y_m),))
    last = way[-1] - way[-2] if len(way) > 1 else None
    yaw = math.atan2(last[1], last[0]) if last is not None else pose.yaw_rad
    heading, tilt = float(gains.headings_rad[k]), float(gains.tilts_rad[t])
    expected = _expected(scene, eye_at(scene, cell), heading, tilt)
    return LookPlan(
        (float(way[-1, 0]), float(way[-1, 1])),
        way,
        wrap_angle(heading),
        wrap_angle(heading - yaw),
        tilt,
        round(float(expected.sum())),
        float(gains.bits[n, k, t]),
        rating,
    )
