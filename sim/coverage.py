"""What a team could see of a window at best: the yardstick of coverage."""

from collections.abc import Sequence

import numpy as np

from agents.geometry import Bools, Floats
from sim.ground import Footing, Terrain, region_of
from sim.raycast import grid_point, mark_seen
from sim.scene import BLIND_FACING, BLIND_TEXTURE


def observable_cells(
    terrain: Terrain,
    positions_xy: Floats,
    height_m: float,
    range_m: float,
    near_m: float = 0.0,
    *,
    footprint_m: float = 0.8,
) -> Bools:
    """Return the cells (rows, cols) that noise-free looks from any of the positions (N, 2) measure.

    The eye is `height_m` over the footprint at each position (world frame) and looks over all pans
    and tilts. Ground that gives no return (too little texture, seen too flatly) is left out.
    """
    ground = np.ascontiguousarray(terrain.elevation_m, dtype=np.float32)
    seen = np.zeros(terrain.frame.shape, dtype=np.bool_)
    footing = Footing(terrain, footprint_m, footprint_m)
    for x, y in positions_xy:
        eye = grid_point(
            terrain.frame, float(x), float(y), footing.ground_m(float(x), float(y)) + height_m
        )
        mark_seen(ground, terrain.frame.cell_m, eye, near_m, range_m, BLIND_FACING, seen)
    return seen & (terrain.texture > BLIND_TEXTURE) & np.isfinite(terrain.elevation_m)


def reachable_positions(
    terrain: Terrain,
    start_xy: Sequence[float],
    max_slope_deg: float,
    footprint_m: float,
    lattice_m: float = 2.0,
    *,
    wheel_m: float = 0.2,
) -> Floats:
    """Return the start and the points (N, 2) of a lattice that a robot can drive to from it.

    A lattice point counts where its cell belongs to the same connected ground as the start, on
    which the robot's circle touches no rock, step, border or unknown cell and the slope under it
    is at most `max_slope_deg`: so never over a cliff. World frame, west to east, south to north.
    """
    safe = Footing(terrain, footprint_m, wheel_m).standable(max_slope_deg)
    frame = terrain.frame
    region = region_of(safe, *frame.cell_of(start_xy[0], start_xy[1]))
    west, east, south, north = frame.extent_m
    x, y = np.meshgrid(
        np.arange(west + lattice_m / 2, east, lattice_m),
        np.arange(south + lattice_m / 2, north, lattice_m),
    )
    points = np.column_stack((x.ravel(), y.ravel()))
    cells = frame.cells_of(points)
    inside = (cells[:, 0] < frame.rows) & (cells[:, 1] < frame.cols)
    points, cells = points[inside], cells[inside]
    joined = region[cells[:, 0], cells[:, 1]]
    start = np.array([[start_xy[0], start_xy[1]]], dtype=np.float64)
    return np.concatenate((start, points[joined]))
