"""What a planar planner is told, and what it answers."""

from dataclasses import dataclass

from agents.geometry import Bools, Floats, GridFrame, Pose
from agents.occupancy.view import Situation


@dataclass(frozen=True)
class PlanarView(Situation):
    """All that a robot knows of a planar world when it chooses a look."""

    frame: GridFrame
    log_odds: Floats
    """(rows, cols) natural log-odds of occupancy, row 0 south; 0 where nothing was measured."""
    mapped: Bools
    """(rows, cols) cells whose occupancy is off by more than 0.4 from 0.5."""


@dataclass(frozen=True)
class PlanarLook:
    """A look to take, and the way to where it is taken."""

    pose: Pose
    """x, y, 0 and the yaw at which the camera's middle shall point."""
    path_m: Floats
    """(N, 2) corners from the robot's position to the look's; one point if it stays."""
    gain: float
    """What the method expects of the look, in its own unit."""
    claim: tuple[float, float, float]
    """(x_m, y_m, radius_m) of what the look will show, to be said to team-mates."""
