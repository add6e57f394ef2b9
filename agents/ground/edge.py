"""The cliff edge as a closed polygon: Sujan & Meggiolaro, section 2.2, Figs. 8 and 9.

Threshold about the wheels' height, region growing from the robot's cell, closing, outer contour,
and a polygon that is split until no boundary pixel is farther from its segment than one wheel.

Departures. On undulating ground a height band about the contact height breaks the plateau in
pieces, so ground also counts when it is gentle: the plane through a patch as large as the
robot is not steeper than `max_slope_deg`. A cell farther than one wheel from measured ground
never counts. Where there is no cliff, the polygon is therefore the rim of the known, gentle ground.
A polygon that crosses itself after splitting is split further until it is simple.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from agents.errors import AgentError
from agents.geometry import Bools, Floats
from agents.ground import markov, polygon, surface


class EdgeError(AgentError):
    """An edge that can't be found."""


@dataclass(frozen=True)
class Edge:
    """The rim of the plateau that the robot stands on."""

    vertices: Floats
    """(V, 2) row, column in cells, centres at whole numbers; closed (the first is not repeated)."""
    mean_px: float
    """Mean distance of the boundary pixels from their segments, in cells."""
    max_px: float
    """Largest of them; at most wheel / cell."""
    plateau: Bools
    """(H, W) the plateau itself, before the polygon; its holes are filled."""


def find_edge(
    completed_m: Floats,
    known_distance_m: Floats,
    cell: tuple[int, int],
    *,
    contact_m: float,
    wheel_m: float,
    cell_m: float,
    band_m: float,
    max_slope_deg: float = 25.0,
    patch_m: float = 0.8,
) -> Edge:
    """Return the edge polygon of the plateau that holds a cell.

    Args:
        completed_m: (H, W) Markov-completed elevation, border "low".
        known_distance_m: (H, W) distance to measured ground.
        cell: the robot's (row, column); it and its 8 neighbours count as plateau.
        contact_m: elevation of the wheels' contact.
        wheel_m: wheel diameter: reach beyond measured ground, closing, and the polygon's tolerance.
        cell_m: cell size.
        band_m: half width of the height threshold about `contact_m`.
        max_slope_deg: ground gentler than this counts whatever its height.
        patch_m: side of the patch whose slope is meant.

    Raises:
        EdgeError: the cell lies outside the map.
    """
    height, width = completed_m.shape
    if not (0 <= cell[0] < height and 0 <= cell[1] < width):
        raise EdgeError(f"cell {cell} lies outside the map of {height} x {width} cells")
    plateau = _plateau(
        completed_m,
        known_distance_m <= wheel_m,
        cell,
        (contact_m, band_m),
        math.tan(math.radians(max_slope_deg)),
        (wheel_m, patch_m, cell_m),
    )
    boundary = _boundary(plateau)
    corners = polygon.split(boundary, wheel_m / cell_m)
    errors = polygon.errors(boundary, corners)
    return Edge(
        boundary[corners],
        float(errors.mean()),
        float(errors.max()),
        plateau,
    )


def _plateau(
    completed_m: Floats,
    near_known: Bools,
    cell: tuple[int, int],
    contact: tuple[float, float],
    max_rise: float,
    sizes_m: tuple[float, float, float],
) -> Bools:
    wheel_m, patch_m, cell_m = sizes_m
    gentle = surface.plane_slope(completed_m, patch_m, cell_m) <= max_rise
    level = np.abs(completed_m - contact[0]) <= contact[1]
    ground = (gentle | level) & near_known
    row, col = cell
    ground[max(0, row - 1) : row + 2, max(0, col - 1) : col + 2] = True
    closed = _closed(_grown(ground, cell), wheel_m / cell_m) & near_known
    closed[max(0, row - 1) : row + 2, max(0, col - 1) : col + 2] = True
    return _outline(_grown(closed, cell))


def _grown(ground: Bools, cell: tuple[int, int]) -> Bools:
    """Return the part of `ground` that is connected (by sides) to a cell."""
    _, labels = cv2.connectedComponents(ground.astype(np.uint8), connectivity=4)
    return labels == labels[cell]


def _closed(region: Bools, width_cells: float) -> Bools:
    """Morphological closing (dilation, erosion) with a disc of a diameter in cells."""
    reach = math.ceil(width_cells / 2)
    padded = np.pad(region, reach).astype(np.uint8)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, surface.disc(width_cells / 2))
    return closed[reach:-reach, reach:-reach] > 0


def _outline(region: Bools) -> Bools:
    """Fill the holes, and the corners where cells touch by a corner only (so rims are simple)."""
    filled = np.zeros(region.shape, dtype=np.uint8)
    contours, _ = cv2.findContours(
        region.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    cv2.drawContours(filled, contours, -1, 1, thickness=cv2.FILLED)
    solid = filled > 0
    while True:
        a, b, c, d = solid[:-1, :-1], solid[:-1, 1:], solid[1:, :-1], solid[1:, 1:]
        rising, falling = b & c & ~a & ~d, a & d & ~b & ~c
        if not (rising.any() or falling.any()):
            return solid
        a |= rising
        b |= falling


def _boundary(plateau: Bools) -> Floats:
    """Return the outer contour (N, 2) in cells, half a cell outside the centres at most.

    It is traced on a grid twice as fine, where even a spur one cell wide has two sides.
    """
    fine = np.kron(plateau.astype(np.uint8), np.ones((2, 2), dtype=np.uint8))
    contours, _ = cv2.findContours(fine, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    traced = max(contours, key=len)[:, 0, ::-1].astype(np.float64)
    return traced / 2 - 0.25


def inside(edge: Edge, shape: tuple[int, int]) -> Bools:
    """Return the cells (H, W) whose centres lie inside the polygon."""
    mask = np.zeros(shape, dtype=np.uint8)
    shift = 8
    points = np.round(edge.vertices[:, ::-1] * (1 << shift)).astype(np.int32)
    cv2.fillPoly(mask, [points.reshape(-1, 1, 2)], 1, shift=shift)
    return mask > 0


@dataclass(frozen=True)
class GroundLayers:
    """What bars the way on a plateau; all (H, W)."""

    rim_m: Floats
    """Distance to the polygon's rim, the plateau's end or the map's border."""
    passable: Bools
    """Inside, gentle, measured, and half a footprint clear of rocks and ledges."""
    roomy: Bools
    """Those with room besides, and clear of what is almost a rock or a ledge, too."""

    def drivable(self, inset_m: float) -> Bools:
        """Return the passable cells that lie farther than `inset_m` from the rim."""
        return self.passable & (self.rim_m > inset_m)


def ground_layers(
    edge: Edge,
    completed_m: Floats,
    known_distance_m: Floats,
    sigma_m: Floats,
    *,
    cell_m: float,
    wheel_m: float,
    footprint_m: float,
    max_slope_deg: float,
) -> GroundLayers:
    """Return what `drivable` is made of; arguments as there."""
    within = inside(edge, completed_m.shape) & edge.plateau
    gentle = surface.plane_slope(completed_m, footprint_m, cell_m) <= math.tan(
        math.radians(max_slope_deg)
    )
    rough = surface.roughness(completed_m, wheel_m, footprint_m, cell_m, sigma_m)
    gap_m = markov.distance_to_known_m(rough.hazard | (known_distance_m > wheel_m), cell_m)
    passable = within & gentle & (gap_m > 0.5 * footprint_m)
    near_m = markov.distance_to_known_m(rough.likely, cell_m)
    roomy = passable & (gap_m > 0.5 * footprint_m + surface.CLEARANCE_M)
    roomy &= near_m > 0.5 * footprint_m
    return GroundLayers(_distance_to_false_m(within, cell_m), passable, roomy)


def drivable(
    edge: Edge,
    completed_m: Floats,
    known_distance_m: Floats,
    sigma_m: Floats,
    *,
    cell_m: float,
    wheel_m: float,
    footprint_m: float,
    max_slope_deg: float,
    inset_m: float,
) -> Bools:
    """Return the cells (H, W) where the robot's centre may be.

    Inside the polygon inset by `inset_m` (tolerance plus half the footprint: the polygon's chords
    may cut beyond the edge by the tolerance), on the plateau, not steeper than `max_slope_deg`
    over the footprint, half a footprint clear of rocks and ledges higher than half
    a wheel, and of ground farther than one wheel from measured ground. The map's border is a rim.
    """
    layers = ground_layers(
        edge,
        completed_m,
        known_distance_m,
        sigma_m,
        cell_m=cell_m,
        wheel_m=wheel_m,
        footprint_m=footprint_m,
        max_slope_deg=max_slope_deg,
    )
    return layers.drivable(inset_m)


def _distance_to_false_m(mask: Bools, cell_m: float) -> Floats:
    """Return each cell's distance to the nearest cell that is not in the mask, or off the map."""
    return markov.distance_to_known_m(np.pad(~mask, 1, constant_values=True), cell_m)[1:-1, 1:-1]
