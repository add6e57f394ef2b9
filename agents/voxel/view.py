"""What a planner on voxel maps is told, and what it answers."""

from dataclasses import dataclass, field

import numpy as np

from agents.geometry import Floats, Ints
from agents.maps.voxel import VoxelOccupancy
from agents.occupancy.view import Means, Situation
from agents.voxel.frame import Block, VoxelFrame

__all__ = ["Means", "VoxelChoice", "VoxelView"]


@dataclass(frozen=True)
class VoxelView(Situation):
    """All that a robot knows of a voxel world when it chooses a look."""

    frame: VoxelFrame
    map: VoxelOccupancy
    interest: dict[Block, Floats] = field(default_factory=dict[Block, Floats])
    """By block (16, 16, 16), the weight of each cell's worth (Eq. 9); 1 where there is none."""
    stood: Ints = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    """(N, 3) cells in which its wheels have stood: floor, whatever looks said of them."""


@dataclass(frozen=True)
class VoxelChoice:
    """A look to take, and the way to where it is taken."""

    path_m: Floats
    """(N, 2) corners from the robot's position to the look's; one point if it stays."""
    cells: Ints
    """(M, 3) cells in which its wheels will stand on the way, ends included."""
    yaw_rad: float
    tilt_rad: float
    gain: float
    """Cells that it is expected to map."""
    claim: tuple[float, float, float]
    """(x_m, y_m, radius_m) of what the look will show, to be said to team-mates."""
