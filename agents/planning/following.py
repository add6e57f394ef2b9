"""Where to look at a team-mate from: the nearest place that shows it.

Who hangs in a face is hidden by the lip above it from most places on the plateau; a look at where
it must be that shows only the lip tells it nothing.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agents.geometry import Bools, Floats, GridFrame, Pose
from agents.planning.looks import eye_at
from agents.planning.scene import BODY_M, Scene, View
from agents.planning.waydown import Point, within

CLEAR_M = 0.1
"""A line of sight passes the ground at least so far above it,"""
ABOUT_EYE_M, ABOUT_MATE_M = 0.3, 0.45
"""but for so much about both its ends, where the robots themselves stand."""
NEAR_M, FAR_M = 7.0, 12.0
"""Nearer than the first a tag tells a place well; beyond the second it is not found. Between them
a metre farther off is as bad as `WORSE` metres to drive."""
WORSE = 2.0
SAME_PLACE_M = 0.7
"""From less far away than this it looks the same."""


def way_to_see(view: View, mate: Pose, vain: Sequence[Point] = ()) -> Floats | None:
    """Return the way (N, 2) to where a team-mate's body shows; one point: from here.

    Args:
        view: what the planner sees.
        mate: where the team-mate stands, team frame.
        vain: from where it was looked at and not found.

    Returns None where no place that can be reached shows it.
    """
    if not view.frame.holds(*view.frame.cell_of(mate.x_m, mate.y_m)):
        return None
    about = within(view.frame, (mate.x_m, mate.y_m), view.drive.footprint_m)
    scene = Scene(replace(view, questions=about.astype(np.float64)))
    cells = scene.candidates
    eyes_m = np.array([eye_at(scene, (row, col)) for row, col in cells.tolist()])
    target_m = np.array((mate.x_m, mate.y_m, mate.z_m + BODY_M))
    away_m = np.linalg.norm(eyes_m - target_m, axis=1)
    may = (away_m < FAR_M) & in_sight(scene.ground_m, view.frame, eyes_m, target_m)
    for x_m, y_m in vain:
        may &= np.hypot(eyes_m[:, 0] - x_m, eyes_m[:, 1] - y_m) > SAME_PLACE_M
    if not may.any():
        return None
    drive_m = scene.travel[0][cells[:, 0], cells[:, 1]]
    cost = np.where(may, drive_m + WORSE * np.maximum(away_m - NEAR_M, 0.0), np.inf)
    best = int(np.argmin(cost))
    if best == 0:
        return np.array(((view.pose.x_m, view.pose.y_m),))
    return scene.path_m((int(cells[best, 0]), int(cells[best, 1])))


def in_sight(ground_m: Floats, frame: GridFrame, eyes_m: Floats, target_m: Floats) -> Bools:
    """Say from which eyes (N, 3) nothing of the ground (H, W) hides a point (3,)."""
    longest_m = float(np.hypot(*(eyes_m - target_m)[:, :2].T).max())
    share = np.linspace(0.0, 1.0, 2 + math.ceil(longest_m / frame.cell_m))
    line_m = eyes_m[:, None] + share[:, None] * (target_m - eyes_m)[:, None]
    cols = np.clip((line_m[..., 0] - frame.x_m) / frame.cell_m, 0, frame.cols - 1).astype(np.int64)
    rows = np.clip((line_m[..., 1] - frame.y_m) / frame.cell_m, 0, frame.rows - 1).astype(np.int64)
    hidden = line_m[..., 2] < ground_m[rows, cols] + CLEAR_M
    hidden &= np.hypot(*(line_m - target_m)[..., :2].T).T > ABOUT_MATE_M
    hidden &= np.hypot(*(line_m - eyes_m[:, None])[..., :2].T).T > ABOUT_EYE_M
    return np.asarray(~hidden.any(axis=1), dtype=np.bool_)
