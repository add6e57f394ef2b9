"""What planners on occupancy maps are told, whatever the map, and what they have."""

from dataclasses import dataclass

from agents.geometry import Pose
from agents.settings import DriveSettings, PlannerSettings, SensorSettings


@dataclass(frozen=True)
class Means:
    """What a robot has to see and drive with, and how it plans."""

    sensor: SensorSettings
    drive: DriveSettings
    planner: PlannerSettings


@dataclass(frozen=True, kw_only=True)
class Situation:
    """Where a robot and its team-mates are, and what these will look at."""

    pose: Pose
    others: tuple[Pose, ...] = ()
    """Where team-mates stand, as last heard."""
    claims: tuple[tuple[float, float, float], ...] = ()
    """(x_m, y_m, radius_m) that team-mates said they will look at."""
    variance: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """Variances of the pose's x, y, z (m^2) and yaw (rad^2)."""
