"""What hides a target: running crests along each bearing of an eye.

    P_i = min over cells j under the ray of Phi((s_i - s_j) / sqrt(w_i^2 + w_j^2))

with slopes s (rise over run, seen from the eye) and their standard deviations w = sigma / run. So
the worst obstruction counts, not the product of all (Sujan & Meggiolaro, Eq. 5; `sight.visibility`
says why). It is one of two, the highest crest so far and the one that is highest with `DOUBT` of
its sigmas added, and these can be carried along as a bearing is followed outwards. Against the
least Phi over all cells this is off by 1e-4 on average.

The last points before a target are no crests: they err as the target does, and hide it by geometry
alone, where they rise `RISE_SIGMAS` of their own above the ray.
"""

import math

import numpy as np

from comms.kernels import kernel

REACH_M = 0.2
"""Points this near to the target (one at least) err as it does."""
RISE_SIGMAS = 3.0
DOUBT = 2.0
LIFT_CELLS = 0.5
"""A cell is measured if any part of it is seen: its slope is that of a point so much above it."""
LEAST_SIGMA_M = 1e-3
CLEAR = 4.0
"""Sigmas of clearance that count as certainty (1 - Phi = 3e-5), and of the lack of it."""
NEVER = -1e30
"""A slope that hides nothing."""

TABLE_SIGMAS = 5.0
TABLE_STEPS = 512
"""Entries per sigma of the table of Phi; between them it is linear, off by at most 1.2e-7."""


@kernel
def phi(z: float) -> float:
    """Return the standard normal distribution function."""
    return 0.5 * math.erfc(-z * 0.7071067811865476)


PHI = np.array(
    [phi(n / TABLE_STEPS - TABLE_SIGMAS) for n in range(int(2 * TABLE_SIGMAS) * TABLE_STEPS + 2)]
)


@kernel
def table_phi(z: float) -> float:
    """Return Phi by the table, for |z| <= `TABLE_SIGMAS`."""
    at = (z + TABLE_SIGMAS) * TABLE_STEPS
    n = int(at)
    return PHI[n] + (at - n) * (PHI[n + 1] - PHI[n])


@kernel
def clearance2(slope: float, spread: float, crest: float, doubt: float) -> float:
    """Return by how many sigmas a target clears a crest, squared, with the sign of it."""
    free = slope - crest
    return free * abs(free) / (spread * spread + doubt * doubt)


@kernel
def chance_past(
    slope: float, spread: float, high: float, high_spread: float, top: float, top_spread: float
) -> float:
    """Return the chance that a target (slope, its spread) is seen past both crests (the same)."""
    least = min(
        clearance2(slope, spread, high, high_spread), clearance2(slope, spread, top, top_spread)
    )
    if least >= CLEAR * CLEAR:
        return 1.0
    if least <= -CLEAR * CLEAR:
        return 0.0
    return table_phi(math.copysign(math.sqrt(abs(least)), least))


@kernel
def raise_crests(
    slopes: np.ndarray, spreads: np.ndarray, count: int, shared: int, crests: np.ndarray
) -> None:
    """Fill `crests` (count or more, 4): the crests before each point.

    Slope and spread of the highest, the same of the one that is highest with doubt.
    """
    for k in range(min(count, shared + 1)):
        crests[k, 0], crests[k, 1], crests[k, 2], crests[k, 3] = NEVER, 1.0, NEVER, 1.0
    high, high_spread, top, top_spread, most = NEVER, 1.0, NEVER, 1.0, NEVER
    for k in range(shared + 1, count):
        slope, spread = slopes[k - 1 - shared], spreads[k - 1 - shared]
        if slope > high:
            high, high_spread = slope, spread
        if slope + DOUBT * spread > most:
            top, top_spread, most = slope, spread, slope + DOUBT * spread
        crests[k, 0], crests[k, 1], crests[k, 2], crests[k, 3] = high, high_spread, top, top_spread


@kernel
def rise_before(slopes: np.ndarray, spreads: np.ndarray, k: int, shared: int) -> float:
    """Return how steeply the last `shared` points before the k-th rise for certain."""
    rise = NEVER
    for n in range(max(0, k - shared), k):
        rise = max(rise, slopes[n] - RISE_SIGMAS * spreads[n])
    return rise


@kernel
def steps_inside(at: float, speed: float, size: int, limit: int) -> int:
    """Return how many steps from `at` stay on `size` cells (centres at whole numbers)."""
    steps = float(limit)
    if speed > 0.0:
        steps = min(steps, (size - 0.5 - at) / speed)
    elif speed < 0.0:
        steps = min(steps, (at + 0.5) / -speed)
    whole = max(0, int(steps))
    while whole > 0 and not 0.0 <= at + 0.5 + whole * speed < size:
        whole -= 1
    return whole


@kernel
def follow(
    heights: np.ndarray,
    sigmas: np.ndarray,
    eye: tuple[float, float, float],
    angle: float,
    cell: float,
    cells: np.ndarray,
    slopes: np.ndarray,
    spreads: np.ndarray,
) -> int:
    """Fill what an eye (row, column, height) meets along a bearing; return how many points it is.

    Points are one cell length apart and end at the edge of the map; `cells` are their flat indices.
    Arrays (H, W), then (points,).
    """
    h, w = heights.shape
    dy, dx = math.sin(angle), math.cos(angle)
    row, col = eye[0] + 0.5, eye[1] + 0.5
    limit = steps_inside(eye[0], dy, h, len(slopes))
    count = steps_inside(eye[1], dx, w, limit)
    for k in range(count):
        cells[k] = int(row + (k + 1.0) * dy) * w + int(col + (k + 1.0) * dx)
    flat_heights, flat_sigmas = heights.ravel(), sigmas.ravel()
    for k in range(count):
        per_run = 1.0 / ((k + 1.0) * cell)
        n = np.uint64(cells[k])
        slopes[k] = (flat_heights[n] - eye[2]) * per_run
        spreads[k] = max(flat_sigmas[n], LEAST_SIGMA_M) * per_run
    return count


@kernel
def lay(
    heights: np.ndarray,
    sigmas: np.ndarray,
    eye: tuple[float, float, float],
    cell: float,
    shared: int,
    crests: np.ndarray,
) -> None:
    """Fill `crests` (bearings, points, 5) all round an eye: see `raise_crests`; last, the rise.

    Points off the map obstruct nothing.
    """
    bearings, points = crests.shape[0], crests.shape[1]
    cells = np.empty(points, dtype=np.int64)
    slopes, spreads = np.empty(points), np.empty(points)
    for b in range(bearings):
        angle = 2.0 * math.pi * b / bearings
        count = follow(heights, sigmas, eye, angle, cell, cells, slopes, spreads)
        slopes[count:], spreads[count:] = NEVER, 1.0
        raise_crests(slopes, spreads, points, shared, crests[b])
        for k in range(points):
            crests[b, k, 4] = rise_before(slopes, spreads, k, shared)


def shared_points(cell_m: float) -> int:
    """Return how many points before a target share its error."""
    return max(1, round(REACH_M / cell_m))
