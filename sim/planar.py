"""A floor as robots live on it: what they run into, what hides them, and where they start.

Walls reach above everybody; robots are low and neither hide a thing nor stand in each other's way.
"""

import math

import numpy as np

from agents.floorways import gap_m
from agents.geometry import Bools, Floats, Pose
from agents.planar.rays import crossings, most_crossed
from agents.settings import DriveSettings
from comms import kernels
from comms.kernels import kernel
from sim.occupancy import BUMP, apart, facing
from sim.planar_world import PlanarWorld, reachable

SCRAPE_M, SCRAPES = 0.005, 0.8
"""A robot that touches a wall may come nearer to it by so much in a step, down to this share of its
radius: wheels slip aside."""


class PlanarTread:
    """`sim.occupancy.Tread` on a level floor: a circle that must not run into anything."""

    def __init__(self, world: PlanarWorld, drive: DriveSettings) -> None:
        """Take the floor and the robot's size."""
        self._world = world
        self._radius_m = drive.footprint_m / 2

    def refusal(self, here: Pose, there: Pose) -> str:
        """Say whether the robot's circle would run into something.

        Away from it, it always may; along it, it may scrape.
        """
        gap = self._gap_m(there)
        if gap >= self._radius_m or gap >= self._gap_m(here):
            return ""
        scrapes = gap >= SCRAPES * self._radius_m and gap >= self._gap_m(here) - SCRAPE_M
        return "" if scrapes else BUMP

    def _gap_m(self, pose: Pose) -> float:
        return gap_m(self._world.solid, self._world.frame, pose.x_m, pose.y_m, self._radius_m)

    def grounded(self, pose: Pose) -> Pose:
        """Return the pose: the floor is level."""
        return pose


@kernel
def _is_clear(
    solid: np.ndarray, x: float, y: float, angle: float, reach: float, cells: np.ndarray
) -> bool:
    rows, cols = solid.shape
    entry = np.empty(len(cells))
    for n in range(crossings(x, y, angle, reach, cells, entry)):
        i, j = cells[n, 0], cells[n, 1]
        if 0 <= i < rows and 0 <= j < cols and solid[i, j]:
            return False
    return True


class PlanarScene:
    """Walls in the way of radio waves (as `sim.scene.Scene`)."""

    def __init__(self, world: PlanarWorld) -> None:
        """Take the floor."""
        self._world = world

    def clear(self, eye_m: Floats, target_m: Floats) -> bool:
        """Say whether no wall lies between two points of the world."""
        frame = self._world.frame
        way = (target_m - eye_m)[:2] / frame.cell_m
        reach = math.hypot(way[0], way[1])
        x, y = (eye_m[0] - frame.x_m) / frame.cell_m, (eye_m[1] - frame.y_m) / frame.cell_m
        cells = np.empty((most_crossed(reach), 2), dtype=np.int64)
        angle = math.atan2(way[1], way[0])
        return _is_clear(self._world.solid, float(x), float(y), angle, reach, cells)


def place_explorers(
    world: PlanarWorld, count: int, footprint_m: float, rng: np.random.Generator
) -> list[Pose]:
    """Return start poses: the world's start, then the nearest places that leave some room.

    They face all around, the first by lot.

    Raises:
        WorldError: there is no room for so many.

    """
    cells = np.argwhere(reachable(world, footprint_m))
    order = np.argsort(((cells - np.array(world.start)) ** 2).sum(axis=1), kind="stable")
    spots = apart(cells[order], count, world.frame.cell_m)
    return [
        Pose(*world.frame.centre_of(int(row), int(col)), 0.0, yaw_rad)
        for (row, col), yaw_rad in zip(spots, facing(count, rng), strict=True)
    ]


def stands_free(world: PlanarWorld, x_m: float, y_m: float, footprint_m: float) -> bool:
    """Say whether a robot's circle at a point touches nothing solid."""
    return gap_m(world.solid, world.frame, x_m, y_m, footprint_m) >= footprint_m / 2


@kernels.warmer
def _warm() -> None:
    solid: Bools = np.zeros((4, 4), dtype=np.bool_)
    _is_clear(solid, 0.5, 0.5, 0.5, 2.0, np.empty((8, 2), dtype=np.int64))
