"""Ways over a floor that a robot's circle fits through, by a planar map.

Planners choose places on a grid and straighten their ways over it; here each straight leg is held
against the squares that are not known to be free, so that it does not shave a corner.
"""

import math

import numpy as np

from agents.geometry import Bools, Floats, GridFrame, Pose
from agents.ground.paths import path_to, travel_field
from comms import kernels
from comms.kernels import kernel

MARGIN_M = 0.03
"""Room that a way leaves besides the robot's own, where there is some: it knows its place no
better."""
ASIDE = 1.0
"""By how much a metre costs more on a cell beside one that is not free."""
BARRED = 12.0
"""By how much it costs more where the robot was stopped before."""
STEP = 0.125
"""A leg is held against the map this often, in cells."""


@kernel
def gap(solid: np.ndarray, x: float, y: float, reach: float) -> float:
    """Return the distance from a point to the nearest solid cell, at most `reach`; in cells.

    What lies beyond the grid is solid.
    """
    rows, cols = solid.shape
    best = reach
    n = int(reach) + 1
    row, col = math.floor(y), math.floor(x)
    for i in range(row - n, row + n + 1):
        for j in range(col - n, col + n + 1):
            if 0 <= i < rows and 0 <= j < cols and not solid[i, j]:
                continue
            dx = max(j - x, 0.0, x - (j + 1.0))
            dy = max(i - y, 0.0, y - (i + 1.0))
            best = min(best, math.sqrt(dx * dx + dy * dy))
    return best


def gap_m(solid: Bools, frame: GridFrame, x_m: float, y_m: float, reach_m: float) -> float:
    """Return how far a point is from the nearest solid cell, in metres, at most `reach_m`."""
    x, y = (x_m - frame.x_m) / frame.cell_m, (y_m - frame.y_m) / frame.cell_m
    return gap(solid, x, y, reach_m / frame.cell_m) * frame.cell_m


@kernel
def _fits(solid: np.ndarray, ends: np.ndarray, radius: float) -> bool:
    """Say whether a disc fits through all along a leg (2, 2) of (x, y), after its first step."""
    dx, dy = ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1]
    steps = max(1, math.ceil(math.sqrt(dx * dx + dy * dy) / STEP))
    for k in range(1, steps + 1):
        x, y = ends[0, 0] + dx * k / steps, ends[0, 1] + dy * k / steps
        if gap(solid, x, y, radius) < radius:
            return False
    return True


@kernel
def _corners(solid: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
    """Mark the points (N,) to keep: from each, the farthest to which a straight leg fits."""
    keep = np.zeros(len(points), dtype=np.bool_)
    keep[0] = True
    at = 0
    ends = np.empty((2, 2))
    while at < len(points) - 1:
        best = at + 1
        ends[0] = points[at]
        for k in range(at + 2, len(points)):
            ends[1] = points[k]
            if _fits(solid, ends, radius):
                best = k
        keep[best] = True
        at = best
    return keep


def way_to(
    free: Bools,
    frame: GridFrame,
    pose: Pose,
    goal_m: tuple[float, float],
    footprint_m: float,
    barred: Bools,
) -> Floats | None:
    """Return the corners (N, 2) of a way from a pose to a point, or None where none is known.

    `free` (rows, cols) are the cells known to be free; what the robot stands on is so, too. Where
    it is `barred` (rows, cols) the robot was stopped before: it goes there where nothing else is.
    """
    cell_m, radius_m = frame.cell_m, 0.5 * footprint_m
    start, goal = frame.cell_of(pose.x_m, pose.y_m), frame.cell_of(*goal_m)
    if not (frame.holds(*start) and frame.holds(*goal)):
        return None
    solid = ~free
    rows, cols = np.indices(frame.shape)
    away_m = np.hypot(
        frame.x_m + (cols + 0.5) * cell_m - pose.x_m, frame.y_m + (rows + 0.5) * cell_m - pose.y_m
    )
    solid[away_m <= radius_m] = False
    solid[start] = False
    cost = _cost(solid, radius_m / cell_m)
    cost[barred] += BARRED
    cost[start] = 1.0
    distance_m, parent = travel_field(cost, np.array([start]), cell_m)
    if not math.isfinite(distance_m[goal]):
        return None
    cells = path_to(parent, goal)
    # In cells, a cell's centre at a half; its own centre first, in case it stands in a corner.
    here = np.array([[(pose.x_m - frame.x_m) / cell_m, (pose.y_m - frame.y_m) / cell_m]])
    points: Floats = np.concatenate((here, cells[:, ::-1] + 0.5)).astype(np.float64)
    kept = points[_corners(solid | barred, points, (radius_m + MARGIN_M) / cell_m)]
    return np.column_stack((frame.x_m + kept[:, 0] * cell_m, frame.y_m + kept[:, 1] * cell_m))


def _cost(solid: Bools, radius: float) -> Floats:
    """Return what a metre costs on each cell (rows, cols); inf where the disc does not fit."""
    near = np.pad(solid, 1, constant_values=True)
    sides = near[:-2, 1:-1] | near[2:, 1:-1] | near[1:-1, :-2] | near[1:-1, 2:]
    corners = near[:-2, :-2] | near[2:, 2:] | near[:-2, 2:] | near[2:, :-2]
    blocked = solid.copy()
    if radius > 0.5:
        reach = math.ceil(radius - 0.5)
        rows, cols = np.nonzero(np.pad(solid, reach, constant_values=True))
        grown = np.pad(solid, reach, constant_values=True)
        for i in range(-reach, reach + 1):
            for j in range(-reach, reach + 1):
                if math.hypot(max(abs(i) - 0.5, 0.0), max(abs(j) - 0.5, 0.0)) < radius:
                    r = np.clip(rows + i, 0, grown.shape[0] - 1)
                    c = np.clip(cols + j, 0, grown.shape[1] - 1)
                    grown[r, c] = True
        blocked = grown[reach:-reach, reach:-reach]
    return np.where(blocked, np.inf, np.where(sides | corners, 1.0 + ASIDE, 1.0))


@kernels.warmer
def _warm() -> None:
    free = np.ones((6, 6), dtype=np.bool_)
    frame = GridFrame(0.0, 0.0, 1.0, 6, 6)
    way_to(free, frame, Pose(1.2, 1.2, 0.0, 0.0), (4.5, 4.5), 0.5, ~free)
    gap_m(free, frame, 2.0, 2.0, 1.0)
