"""A closed chain of boundary pixels turned into a simple polygon within a tolerance."""

import itertools

import numpy as np

from agents.geometry import Bools, Floats, Ints


def split(boundary: Floats, tolerance: float) -> Ints:
    """Return the indices (V,) of the boundary points (N, 2) that are the polygon's corners.

    Each piece between two corners is divided at its farthest point until no point is farther
    than `tolerance` from its segment (Sujan & Meggiolaro, Fig. 8). Pieces whose segments cross are
    divided further until the polygon is simple, which it is at the latest when every
    point of a simple chain is a corner.
    """
    count = len(boundary)
    other = int(np.argmax(((boundary - boundary[0]) ** 2).sum(axis=1)))
    halves = [_farthest(boundary, 0, other)[0], _farthest(boundary, other, count)[0]]
    corners = _refined(boundary, np.unique(np.array([0, other, *halves])), tolerance)
    while (crossing := _crossing(boundary[corners])).any():
        corners = _refined(boundary, _divided(boundary, corners, crossing), tolerance)
    return corners


def _refined(boundary: Floats, corners: Ints, tolerance: float) -> Ints:
    """Return the corners with more of them, until every point is within tolerance."""
    found = corners.tolist()
    pieces = list(itertools.pairwise([*found, len(boundary)]))
    while pieces:
        a, b = pieces.pop()
        at, error = _farthest(boundary, a, b)
        if error > tolerance:
            found.append(at)
            pieces += [(a, at), (at, b)]
    return np.array(sorted(found), dtype=np.int64)


def errors(boundary: Floats, corners: Ints) -> Floats:
    """Return the distance (N,) of every boundary point from its own segment."""
    out = np.zeros(len(boundary))
    ends = np.append(corners[1:], len(boundary))
    for a, b in zip(corners.tolist(), ends.tolist(), strict=True):
        out[a:b] = _distances(boundary[a:b], boundary[a], boundary[b % len(boundary)])
    return out


def _divided(boundary: Floats, corners: Ints, which: Bools) -> Ints:
    """Return the corners with one more in each of the segments marked, where there is room."""
    ends = np.append(corners[1:], len(boundary))
    added: list[int] = []
    for a, b in zip(corners[which].tolist(), ends[which].tolist(), strict=True):
        at, error = _farthest(boundary, a, b)
        if b - a > 1:
            added.append(at if error > 0 else (a + b) // 2)
    assert added, "the boundary itself crosses itself"
    return np.unique(np.concatenate((corners, np.array(added, dtype=np.int64))))


def _farthest(boundary: Floats, a: int, b: int) -> tuple[int, float]:
    """Return the index of the point of piece a..b farthest from its chord, and how far."""
    if b - a < 2:
        return a, 0.0
    far = _distances(boundary[a + 1 : b], boundary[a], boundary[b % len(boundary)])
    at = int(np.argmax(far))
    return a + 1 + at, float(far[at])


def _distances(points: Floats, start: Floats, end: Floats) -> Floats:
    """Return the distances (N,) of points (N, 2) from the segment between two."""
    along = end - start
    length = float(along @ along)
    t = np.clip((points - start) @ along / length, 0.0, 1.0) if length > 0 else 0.0
    return np.hypot(*(points - start - np.multiply.outer(t, along)).reshape(-1, 2).T)


def _crossing(vertices: Floats) -> Bools:
    """Return which segments (V,) of a closed polygon touch one that is not their neighbour."""
    count = len(vertices)
    a, b = vertices, np.roll(vertices, -1, axis=0)
    one = _side(a[:, None], b[:, None], a[None]) * _side(a[:, None], b[:, None], b[None])
    touch = (one <= 0) & (one.T <= 0) & _boxes_meet(a, b)
    index = np.arange(count)
    apart = np.abs(index[:, None] - index[None])
    touch &= (apart > 1) & (apart < count - 1)
    return touch.any(axis=1) | _folded(a, b)


def _folded(a: Floats, b: Floats) -> Bools:
    """Return which segments (V,) run straight back along the one before them."""
    before, along = a - np.roll(a, 1, axis=0), b - a
    cross = before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0]
    return (cross == 0) & ((before * along).sum(axis=1) < 0)


def _side(a: Floats, b: Floats, p: Floats) -> Floats:
    """Return on which side of the line a-b the points lie: the sign of the cross product."""
    cross = (b[..., 0] - a[..., 0]) * (p[..., 1] - a[..., 1])
    return np.sign(cross - (b[..., 1] - a[..., 1]) * (p[..., 0] - a[..., 0]))


def _boxes_meet(a: Floats, b: Floats) -> Bools:
    low, high = np.minimum(a, b), np.maximum(a, b)
    meet = (low[:, None] <= high[None]) & (low[None] <= high[:, None])
    return meet[..., 0] & meet[..., 1]


def is_simple(vertices: Floats) -> bool:
    """Say whether no two segments of a closed polygon (V, 2) meet but at their shared corner."""
    return not bool(_crossing(vertices).any())
