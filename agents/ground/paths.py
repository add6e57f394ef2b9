"""Ways over the ground: what can be driven, how far everything is, and straight legs."""

import math

import numpy as np

from agents.errors import AgentError
from agents.geometry import Floats, Ints
from comms import kernels
from comms.kernels import kernel

LEG_EXCESS = 1.02
"""A straight leg may cost that much more than the grid path it replaces: it is smoother."""


class PathError(AgentError):
    """A way that doesn't exist."""


@kernel
def _push(heap_key: np.ndarray, heap_cell: np.ndarray, size: int, key: float, cell: int) -> int:
    """Add to a binary heap; return its new size."""
    i = size
    while i > 0:
        up = (i - 1) >> 1
        if heap_key[up] <= key:
            break
        heap_key[i], heap_cell[i] = heap_key[up], heap_cell[up]
        i = up
    heap_key[i], heap_cell[i] = key, cell
    return size + 1


@kernel
def _pop(heap_key: np.ndarray, heap_cell: np.ndarray, size: int) -> int:
    """Remove the least of a binary heap; return its new size."""
    size -= 1
    key, cell = heap_key[size], heap_cell[size]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size:
            break
        if child + 1 < size and heap_key[child + 1] < heap_key[child]:
            child += 1
        if heap_key[child] >= key:
            break
        heap_key[i], heap_cell[i] = heap_key[child], heap_cell[child]
        i = child
    heap_key[i], heap_cell[i] = key, cell
    return size


@kernel
def _dijkstra(
    cost: np.ndarray, starts: np.ndarray, distance: np.ndarray, parent: np.ndarray
) -> None:
    """Fill distance (in cells, weighted by cost) and parent; 8 neighbours, no cut corners."""
    h, w = cost.shape
    heap_key = np.empty(8 * h * w + len(starts))
    heap_cell = np.empty(8 * h * w + len(starts), dtype=np.int64)
    size = 0
    for k in range(len(starts)):
        i, j = starts[k, 0], starts[k, 1]
        if distance[i, j] > 0.0:
            distance[i, j] = 0.0
            parent[i, j] = i * w + j
            size = _push(heap_key, heap_cell, size, 0.0, i * w + j)
    while size > 0:
        key, at = heap_key[0], heap_cell[0]
        size = _pop(heap_key, heap_cell, size)
        i, j = at // w, at % w
        if key > distance[i, j]:
            continue
        here = cost[i, j]
        if not here < np.inf:
            here = 1.0
        for di in range(-1, 2):
            for dj in range(-1, 2):
                a, b = i + di, j + dj
                if (di == 0 and dj == 0) or a < 0 or b < 0 or a >= h or b >= w:
                    continue
                if not cost[a, b] < np.inf:
                    continue
                length = 1.0
                if di != 0 and dj != 0:
                    if not (cost[a, j] < np.inf and cost[i, b] < np.inf):
                        continue
                    length = 1.4142135623730951
                there = key + length * 0.5 * (here + cost[a, b])
                if there < distance[a, b]:
                    distance[a, b] = there
                    parent[a, b] = at
                    size = _push(heap_key, heap_cell, size, there, a * w + b)


def travel_field(cost: Floats, starts: Ints, cell_m: float) -> tuple[Floats, Ints]:
    """Return how far every cell is from the nearest start, and the way back (Dijkstra).

    Args:
        cost: (H, W) cost of a metre, >= 0; inf where nobody may go. A start may lie on such a
            cell: a robot is where it is, and may leave it.
        starts: (N, 2) rows and columns.
        cell_m: cell size.

    Returns:
        distance (H, W), metres times cost, inf where unreachable; parent (H, W) int64, the flat
        index of the cell before on the way, a start's own at a start, -1 where unreachable.

    Raises:
        PathError: a start lies outside the grid, or a cost is negative or NaN.
    """
    starts = np.asarray(starts, dtype=np.int64).reshape(-1, 2)
    bad = ((starts < 0) | (starts >= np.array(cost.shape))).any(axis=1)
    if bad.any():
        raise PathError(f"start cell {starts[bad][0].tolist()} lies outside the {cost.shape} grid")
    if not (cost >= 0).all():
        raise PathError("a cost is negative or NaN: it must be >= 0, or inf where nobody may go")
    distance = np.full(cost.shape, np.inf)
    parent = np.full(cost.shape, -1, dtype=np.int64)
    _dijkstra(np.ascontiguousarray(cost, dtype=np.float64), starts, distance, parent)
    return distance * cell_m, parent


def path_to(parent: Ints, goal: tuple[int, int]) -> Ints:
    """Return the cells (N, 2) from a start to a goal, both included.

    Raises:
        PathError: the goal can't be reached, or lies outside the grid.
    """
    height, width = parent.shape
    row, col = goal
    if not (0 <= row < height and 0 <= col < width) or parent[row, col] < 0:
        raise PathError(f"no way leads to cell {(row, col)} of the {height} x {width} grid")
    at, way = row * width + col, [row * width + col]
    flat = parent.ravel()
    while int(flat[at]) != at:
        at = int(flat[at])
        way.append(at)
    cells = np.array(way[::-1], dtype=np.int64)
    return np.column_stack((cells // width, cells % width))


@kernel
def _leg_cost(cost: np.ndarray, i0: int, j0: int, i1: int, j1: int) -> float:
    """Return the cost of a straight leg between two cells, in cells; inf if it leaves the allowed.

    It is walked in steps of half a cell, and a step may not pass between two forbidden corners.
    """
    length = math.sqrt(float((i1 - i0) ** 2 + (j1 - j0) ** 2))
    steps = max(1, math.ceil(2.0 * length))
    total = 0.0
    before_i, before_j = i0, j0
    for k in range(1, steps + 1):
        t = k / steps
        i = math.floor(i0 + t * (i1 - i0) + 0.5)
        j = math.floor(j0 + t * (j1 - j0) + 0.5)
        total += cost[i, j]
        corner = i != before_i and j != before_j
        if corner and not (cost[i, before_j] < np.inf and cost[before_i, j] < np.inf):
            return np.inf
        before_i, before_j = i, j
    return total * length / steps


@kernel
def _straighten(cost: np.ndarray, cells: np.ndarray, excess: float, keep: np.ndarray) -> None:
    """Mark the cells to keep: from each, the farthest that a straight leg may reach."""
    n = len(cells)
    along = np.zeros(n)
    for k in range(1, n):
        along[k] = along[k - 1] + _leg_cost(
            cost, cells[k - 1, 0], cells[k - 1, 1], cells[k, 0], cells[k, 1]
        )
    keep[0] = True
    at = 0
    while at < n - 1:
        best = at + 1
        for k in range(at + 2, n):
            leg = _leg_cost(cost, cells[at, 0], cells[at, 1], cells[k, 0], cells[k, 1])
            if leg <= excess * (along[k] - along[at]):
                best = k
        keep[best] = True
        at = best


def straight_legs(cells: Ints, cost: Floats) -> Ints:
    """Return the corners (M, 2) of straight legs that stay on allowed cells, ends kept.

    A leg is taken where it costs no more than 1.02 times the cells' own way. The first cell may be
    a forbidden one that the robot stands on; it counts as open ground.
    """
    if len(cells) < 3:
        return cells.copy()
    open_cost = np.ascontiguousarray(cost, dtype=np.float64)
    if not np.isfinite(open_cost[tuple(cells[0])]):
        open_cost = open_cost.copy()
        open_cost[tuple(cells[0])] = 1.0
    keep = np.zeros(len(cells), dtype=np.bool_)
    _straighten(open_cost, np.ascontiguousarray(cells), LEG_EXCESS, keep)
    return cells[keep]


def length_m(points_m: Floats) -> float:
    """Return the length of a way through points (N, 2), metres."""
    return float(np.hypot(*np.diff(points_m, axis=0).T).sum())


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    cost = np.ones((6, 6))
    cost[2, 2] = np.inf
    _, parent = travel_field(cost, np.array([[0, 0]]), 1.0)
    straight_legs(path_to(parent, (5, 5)), cost)
