"""Which cells an eye is likely to see: Sujan & Meggiolaro, Eq. 5, and how it is mended.

The paper multiplies Phi((ray_z(j) - h_j) / sigma_j) over the cells j under the ray to a target,
as if each cell erred and hid by itself. On open ground every cell just in front of a grazing
target then counts about 0.5, and a dozen of them hide everything. `law="product"` is the paper's
(`agents.sight.rayproduct`); robots use `law="crest"`, where the worst obstruction decides
(`agents.sight.crests`). Its lengths were set by what a simulated camera did measure;
`benchmarks/visibility_calibration.py` compares both laws with it on other ground, and
`docs/information.md` has the figure.

Heights under the ray are those of the cells that the ray's points, one cell length apart, fall
in; the ray's bearing is the nearest of a fan whose neighbours are one cell apart at full range, so
it passes a target's centre within half a cell. The fan is laid once per eye.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from agents.errors import AgentError
from agents.geometry import Floats, GridFrame, Singles
from agents.sight import crests, rayproduct
from agents.sight.crests import LIFT_CELLS, chance_past, phi, shared_points
from agents.sight.rayproduct import Fan
from comms import kernels
from comms.kernels import kernel

__all__ = ["Eye", "Law", "Patch", "VisibilityError", "phi", "predict"]

Law = Literal["crest", "product"]


class VisibilityError(AgentError):
    """An eye or a range that no visibility can be predicted for."""


class Eye(NamedTuple):
    """An eye in a grid: row and column in cells (centres at whole numbers), height in metres."""

    row: float
    col: float
    z_m: float


@dataclass(frozen=True)
class Patch:
    """The part of a map that an eye can reach, with each cell's probability of being seen."""

    row0: int
    col0: int
    p: Singles
    """(h, w) Eq. 5; 0 beyond the range and nearer than the sensor's near limit."""
    surface_m: Floats
    """(h, w) heights of the targets."""
    eye: Eye
    cell_m: float

    @cached_property
    def _offsets_m(self) -> tuple[Floats, Floats, Floats]:
        h, w = self.p.shape
        dx = (self.col0 + np.arange(w) - self.eye.col) * self.cell_m
        dy = (self.row0 + np.arange(h) - self.eye.row) * self.cell_m
        east, north = np.meshgrid(dx, dy)
        return east, north, self.surface_m - self.eye.z_m

    @cached_property
    def azimuth_rad(self) -> Floats:
        """(h, w) bearing of each cell from the eye, counter-clockwise from +x."""
        dx, dy, _ = self._offsets_m
        return np.arctan2(dy, dx)

    @cached_property
    def elevation_angle_rad(self) -> Floats:
        """(h, w) angle of each cell above the eye's horizon."""
        dx, dy, dz = self._offsets_m
        return np.arctan2(dz, np.hypot(dx, dy))

    @cached_property
    def range_m(self) -> Floats:
        """(h, w) distance from the eye."""
        dx, dy, dz = self._offsets_m
        return np.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def window(
    eye: Eye, far_m: float, cell: float, shape: tuple[int, int]
) -> tuple[int, int, int, int]:
    """Return first and past-last rows and columns that an eye can reach on the map."""
    side = math.ceil(far_m / cell)
    row, col = math.floor(eye.row + 0.5), math.floor(eye.col + 0.5)
    return (
        max(0, row - side),
        min(shape[0], row + side + 1),
        max(0, col - side),
        min(shape[1], col + side + 1),
    )


@kernel
def _predict(
    surface: np.ndarray,
    sigma: np.ndarray,
    eye: Eye,
    cell: float,
    limits: tuple[float, float],
    crest: np.ndarray,
    fan: Fan,
) -> np.ndarray:
    """Return the chance of every cell in the square about an eye that lies on the map.

    `limits` are near and far; `fan` is empty for the crest law, `crest` for the product law.
    """
    near, far = limits
    row0, row1, col0, col1 = window(eye, far, cell, surface.shape)
    bearings = max(crest.shape[0], fan.slope.shape[0])
    turn = bearings / (2.0 * math.pi)
    out = np.zeros((row1 - row0, col1 - col0), dtype=np.float32)
    for i in range(row0, row1):
        dy = i - eye.row
        for j in range(col0, col1):
            dx = j - eye.col
            flat = math.sqrt(dx * dx + dy * dy)
            run = flat * cell
            rise = surface[i, j] - eye.z_m
            squared = run * run + rise * rise
            if squared > far * far or squared < near * near:
                continue
            if flat < 1.0:
                out[i - row0, j - col0] = 1.0
                continue
            b = math.floor(math.atan2(dy, dx) * turn + 0.5)
            b += bearings if b < 0 else 0
            k = int(flat + 0.5) - 1
            if crest.shape[0] == 0:
                out[i - row0, j - col0] = rayproduct.chance_along(fan, b, rise / run, k)
            else:
                slope = (rise + LIFT_CELLS * cell) / run
                if slope >= crest[b, k, 4]:
                    out[i - row0, j - col0] = chance_past(
                        slope,
                        sigma[i, j] / run,
                        crest[b, k, 0],
                        crest[b, k, 1],
                        crest[b, k, 2],
                        crest[b, k, 3],
                    )
    return out


def predict(
    completed_m: Floats,
    sigma_m: Floats,
    frame: GridFrame,
    eye_xyz: tuple[float, float, float],
    *,
    range_m: float,
    near_m: float,
    law: Law = "crest",
) -> Patch:
    """Return each cell's probability of being visible from an eye, over all bearings (Eq. 5).

    Args:
        completed_m: (H, W) elevation without NaN, row 0 south.
        sigma_m: (H, W) standard deviation of each cell's elevation.
        frame: where the grid lies.
        eye_xyz: the camera's centre, metres.
        range_m: depth of field, along the ray.
        near_m: nearest distance at which the sensor measures.
        law: "crest", ours, which says how often cells are in fact seen; "product", the paper's
            Eq. 5 to within 1e-3.

    Raises:
        VisibilityError: the eye lies outside the map, or `range_m` is not positive.
    """
    row, col = frame.cell_of(eye_xyz[0], eye_xyz[1])
    if not frame.holds(row, col):
        raise VisibilityError(f"the eye at {eye_xyz} lies outside the map {frame.extent_m}")
    if not range_m > 0:
        raise VisibilityError(f"a range of {range_m} m sees nothing: it must be more than 0")
    eye = Eye(
        (eye_xyz[1] - frame.y_m) / frame.cell_m - 0.5,
        (eye_xyz[0] - frame.x_m) / frame.cell_m - 0.5,
        float(eye_xyz[2]),
    )
    bearings, points = fan_size(range_m, frame.cell_m)
    crest = np.empty((bearings if law == "crest" else 0, points + 1, 5), dtype=np.float32)
    fan = rayproduct.empty_fan(bearings if law == "product" else 0, points)
    if law == "crest":
        crests.lay(completed_m, sigma_m, eye, frame.cell_m, shared_points(frame.cell_m), crest)
    else:
        rayproduct.lay(completed_m, sigma_m, eye, frame.cell_m, fan)
    p = _predict(completed_m, sigma_m, eye, frame.cell_m, (near_m, range_m), crest, fan)
    row0, row1, col0, col1 = window(eye, range_m, frame.cell_m, frame.shape)
    return Patch(row0, col0, p, completed_m[row0:row1, col0:col1], eye, frame.cell_m)


def fan_size(range_m: float, cell_m: float) -> tuple[int, int]:
    """Return bearings (one cell apart at full range, at least 16) and points of a fan."""
    return max(16, math.ceil(2.0 * math.pi * range_m / cell_m)), math.ceil(range_m / cell_m) + 1


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    frame = GridFrame(0.0, 0.0, 1.0, 8, 8)
    ground = np.zeros(frame.shape)
    laws: tuple[Law, ...] = ("crest", "product")
    for law in laws:
        predict(ground, ground + 0.1, frame, (4.0, 4.0, 1.0), range_m=4.0, near_m=0.1, law=law)
