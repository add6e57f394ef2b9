"""Kernels that follow lines of sight over the ground, bilinear between cell centres.

Grid coordinates: u along columns, v along rows, integers at cell centres, row 0 south. NaN ground
neither stops a ray nor gives a point; a ray that comes out of it under the ground is lost.
"""

import math

import numpy as np

from agents.geometry import Bools, Floats, GridFrame, Singles
from comms import kernels

BLOCK = 8
"""Side of the blocks, in cells, whose highest point lets a ray skip them."""
HALVINGS = 12
"""Refinements of a hit: half a cell over 2^12."""


@kernels.kernel
def surface(ground: Singles, u: float, v: float) -> float:
    """Return the bilinear height at (u, v); NaN beyond the outermost centres."""
    rows, cols = ground.shape
    if not (u >= 0.0 and v >= 0.0 and u <= cols - 1.0 and v <= rows - 1.0):
        return np.nan
    c, r = min(int(u), cols - 2), min(int(v), rows - 2)
    a, b = u - c, v - r
    south = ground[r, c] + a * (ground[r, c + 1] - ground[r, c])
    north = ground[r + 1, c] + a * (ground[r + 1, c + 1] - ground[r + 1, c])
    return float(south + b * (north - south))


@kernels.kernel
def facing(ground: Singles, u: float, v: float, cell_m: float, ray: Floats) -> float:
    """Return the cosine between a ray and the normal of the ground that it meets at (u, v)."""
    rows, cols = ground.shape
    c = min(max(int(u), 0), cols - 2)
    r = min(max(int(v), 0), rows - 2)
    a, b = u - c, v - r
    sw, se, nw, ne = ground[r, c], ground[r, c + 1], ground[r + 1, c], ground[r + 1, c + 1]
    east = ((1.0 - b) * (se - sw) + b * (ne - nw)) / cell_m
    north = ((1.0 - a) * (nw - sw) + a * (ne - se)) / cell_m
    return float(
        (ray[0] * east + ray[1] * north - ray[2]) / math.sqrt(1.0 + east * east + north * north)
    )


@kernels.kernel
def block_tops(ground: Singles) -> Floats:
    """Return the highest point of every block and the cells next to it; -inf where unknown."""
    rows, cols = ground.shape
    tops = np.full((rows // BLOCK + 1, cols // BLOCK + 1), -np.inf)
    for i in range(tops.shape[0]):
        for j in range(tops.shape[1]):
            for r in range(i * BLOCK, min((i + 1) * BLOCK + 1, rows)):
                for c in range(j * BLOCK, min((j + 1) * BLOCK + 1, cols)):
                    # Not max(): that would take a NaN for the top.
                    if ground[r, c] > tops[i, j]:  # noqa: PLR1730  (a NaN)
                        tops[i, j] = ground[r, c]
    return tops


@kernels.kernel
def block_exit(at: float, speed: float) -> float:
    """Return the way along a ray, per axis, to the end of the block that holds `at`."""
    if speed > 0.0:
        return ((math.floor(at / BLOCK) + 1.0) * BLOCK - at) / speed
    if speed < 0.0:
        return (at - math.floor(at / BLOCK) * BLOCK) / -speed
    return np.inf


@kernels.kernel
def cast_one(
    ground: Singles, tops: Floats, cell_m: float, eye: Floats, ray: Floats, limit_m: float
) -> float:
    """Return the distance along one ray to the ground, in m; NaN where it meets none.

    `eye` is (u, v, z), `ray` a unit vector (east, north, up). Steps of at most half a cell on the
    ground between which the surface is compared with the ray, then halving; blocks that lie wholly
    under the ray are passed in one step.
    """
    du, dv, dz = ray[0] / cell_m, ray[1] / cell_m, ray[2]
    rows, cols = ground.shape
    step = 0.5 / max(math.hypot(du, dv), 0.125 / cell_m)
    s, above_at = 0.0, -1.0
    while True:
        u, v, z = eye[0] + s * du, eye[1] + s * dv, eye[2] + s * dz
        if not (u >= 0.0 and v >= 0.0 and u <= cols - 1.0 and v <= rows - 1.0):
            return np.nan
        gap = z - surface(ground, u, v)
        if gap <= 0.0:
            if above_at < 0.0:
                return np.nan
            low, high = above_at, s
            for _ in range(HALVINGS):
                half = 0.5 * (low + high)
                gap = eye[2] + half * dz - surface(ground, eye[0] + half * du, eye[1] + half * dv)
                if gap > 0.0:
                    low = half
                else:
                    high = half
            return 0.5 * (low + high)
        if s >= limit_m:
            return np.nan
        above_at = s if gap > 0.0 else -1.0
        jump = step
        leave = min(block_exit(u, du), block_exit(v, dv))
        if leave > step and min(z, z + leave * dz) > tops[int(v) // BLOCK, int(u) // BLOCK]:
            jump = leave
            above_at = s + leave if gap > 0.0 else -1.0
        s = min(s + jump, limit_m)


@kernels.kernel
def cast(
    ground: Singles, tops: Floats, cell_m: float, eye: Floats, rays: Floats, limits_m: Floats
) -> Floats:
    """Return (N, 4) of distance in m, cosine of incidence, u and v of the ground that rays meet.

    NaN where a ray (N, 3) meets no ground within its limit (N,).
    """
    found = np.full((rays.shape[0], 4), np.nan)
    for i in range(rays.shape[0]):
        distance = cast_one(ground, tops, cell_m, eye, rays[i], limits_m[i])
        if distance <= limits_m[i]:
            u = eye[0] + distance * rays[i, 0] / cell_m
            v = eye[1] + distance * rays[i, 1] / cell_m
            found[i, 0] = distance
            found[i, 1] = facing(ground, u, v, cell_m, rays[i])
            found[i, 2] = u
            found[i, 3] = v
    return found


@kernels.kernel
def cylinder_limits(
    eye_m: Floats, rays: Floats, feet_m: Floats, radius_m: float, height_m: float, limit_m: float
) -> Floats:
    """Return (N,) how far each ray goes before it meets an upright cylinder, at most `limit_m`.

    `feet_m` (K, 3) are the centres of the cylinders' lower ends, in the frame of `eye_m`.
    """
    limits = np.full(rays.shape[0], limit_m)
    for i in range(rays.shape[0]):
        dx, dy, dz = rays[i, 0], rays[i, 1], rays[i, 2]
        flat = dx * dx + dy * dy
        for k in range(feet_m.shape[0]):
            ox, oy = eye_m[0] - feet_m[k, 0], eye_m[1] - feet_m[k, 1]
            oz = eye_m[2] - feet_m[k, 2]
            b, c = ox * dx + oy * dy, ox * ox + oy * oy - radius_m * radius_m
            root = b * b - flat * c
            if root >= 0.0 and flat > 0.0:
                side = (-b - math.sqrt(root)) / flat
                if side >= 0.0 and 0.0 <= oz + side * dz <= height_m:
                    limits[i] = min(limits[i], side)
            if dz < 0.0:
                lid = (height_m - oz) / dz
                if lid >= 0.0 and (ox + lid * dx) ** 2 + (oy + lid * dy) ** 2 <= radius_m**2:
                    limits[i] = min(limits[i], lid)
    return limits


@kernels.kernel
def mark_seen(
    ground: Singles,
    cell_m: float,
    eye: Floats,
    near_m: float,
    range_m: float,
    least_facing: float,
    seen: Bools,
) -> None:
    """Mark the cells of which some point is in the eye's sight, over all bearings.

    Along each bearing the steepest sight line so far hides what lies below it. `eye` is (u, v, z).
    """
    reach = range_m / cell_m
    bearings = int(2.0 * math.pi * reach * 1.25) + 8
    ray = np.empty(3)
    for k in range(bearings):
        angle = 2.0 * math.pi * k / bearings
        east, north = math.cos(angle), math.sin(angle)
        steepest = -np.inf
        for n in range(1, int(2.0 * reach) + 1):
            u, v = eye[0] + 0.5 * n * east, eye[1] + 0.5 * n * north
            z = surface(ground, u, v)
            if np.isnan(z):
                continue
            flat_m, up_m = 0.5 * n * cell_m, z - eye[2]
            tangent = up_m / flat_m
            if tangent < steepest:
                continue
            steepest = tangent
            distance = math.hypot(flat_m, up_m)
            if not near_m <= distance <= range_m:
                continue
            row, col = int(v + 0.5), int(u + 0.5)
            if seen[row, col]:
                continue
            ray[0], ray[1] = east * flat_m / distance, north * flat_m / distance
            ray[2] = up_m / distance
            if facing(ground, u, v, cell_m, ray) >= least_facing:
                seen[row, col] = True


def grid_point(frame: GridFrame, x_m: float, y_m: float, z_m: float) -> Floats:
    """Return (u, v, z) of a point of the frame."""
    return np.array(
        [
            (x_m - frame.x_m) / frame.cell_m - 0.5,
            (y_m - frame.y_m) / frame.cell_m - 0.5,
            z_m,
        ]
    )


@kernels.warmer
def _warm() -> None:
    ground = np.zeros((10, 10), dtype=np.float32)
    eye, rays = np.array([4.0, 4.0, 1.0]), np.array([[0.0, 0.6, -0.8]])
    tops = block_tops(ground)
    cast(ground, tops, 0.1, eye, rays, np.ones(1))
    cylinder_limits(eye, rays, np.zeros((1, 3)), 0.4, 0.6, 10.0)
    mark_seen(ground, 0.1, eye, 0.0, 1.0, 0.0, np.zeros((10, 10), dtype=np.bool_))
