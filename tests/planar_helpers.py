"""Floors half known, as planar planners see them."""

import math

import numpy as np

from agents.geometry import Floats, GridFrame, Pose
from agents.occupancy.view import Means
from agents.planar.scene import Scene
from agents.planar.sensing import MAPPED
from agents.planar.view import PlanarView
from agents.settings import DriveSettings, PlannerSettings, SensorSettings

SURE = 4.0
CELL_M = 0.5
SENSOR = SensorSettings(fov_deg=90.0, range_m=4.0, near_m=0.0, columns=90)
DRIVE = DriveSettings(footprint_m=0.3, speed_mps=0.3, turn_rate_radps=0.5)
PLANNER = PlannerSettings(candidate_step_m=1.0, max_candidates=60, min_gain_cells=4.0)
MEANS = Means(SENSOR, DRIVE, PLANNER)
SIGNS = {".": -SURE, "#": SURE, "?": 0.0, "-": -1.0}


def log_odds_of(plan: str) -> Floats:
    """Return a map as it is drawn, north up: free, solid, unknown, or half seen to be free."""
    lines = [line.strip() for line in plan.split()]
    return np.array([[SIGNS[sign] for sign in line] for line in lines[::-1]])


def view_of(
    log_odds: Floats,
    cell: tuple[int, int],
    *,
    others: tuple[Pose, ...] = (),
    claims: tuple[tuple[float, float, float], ...] = (),
) -> PlanarView:
    """Return what a robot knows that stands in the middle of a cell."""
    frame = GridFrame(0.0, 0.0, CELL_M, *log_odds.shape)
    x_m, y_m = frame.centre_of(*cell)
    mapped = np.abs(log_odds) > MAPPED
    return PlanarView(
        frame, log_odds, mapped, pose=Pose(x_m, y_m, 0.0, 0.0), others=others, claims=claims
    )


def scene_of(view: PlanarView, means: Means = MEANS) -> Scene:
    """Return a view worked out, every cell of full interest."""
    return Scene(view, means, np.ones(view.frame.shape))


def half_known(side: int = 40) -> Floats:
    """Return a walled square whose western half is known to be free, the other half unknown."""
    log_odds = np.zeros((side, side))
    log_odds[:, : side // 2] = -SURE
    log_odds[[0, -1], : side // 2] = log_odds[:, 0] = SURE
    return log_odds


def points_east(yaw_rad: float) -> bool:
    """Say whether a yaw points more to the east than to any other side."""
    return math.cos(yaw_rad) > math.cos(math.radians(45)) - 1e-9
