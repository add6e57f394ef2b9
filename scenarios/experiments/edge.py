"""The cliff edge as a polygon on ground strewn with rocks: Sujan & Meggiolaro, Figs. 8 and 9.

A cliff with rocks as the Viking landers saw them, at 2 cm and at 1 cm to a pixel, wheels of 10 cm,
a fifth of the map unknown. The edge is found the paper's way (a threshold about the wheels' height)
and ours (gentle ground counts whatever its height). Deviations are measured here anew, from the
plateau's pixels and the polygon's corners alone.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import ConvexHull, KDTree

from agents.geometry import Bools, Floats
from agents.ground import edge, polygon
from scenarios.errors import UsageError
from scenarios.experiments.edge_claims import conclude
from scenarios.experiments.edge_figure import draw
from scenarios.experiments.edge_ground import (
    ROCKS,
    WAYS,
    Site,
    Trial,
    found_edge,
    outer_pixels,
    site_of,
)
from scenarios.experiments.frame import Experiment, Options
from scenarios.experiments.tables import Row

CELLS_M = (0.02, 0.01)
WHEEL_M = 0.1
UNKNOWN_SHARE = 0.2
MOST_UNKNOWN = 0.9


def trials(options: Options) -> Sequence[Trial]:
    """Return a trial for each seed, site and cell size.

    Raises UsageError for a share of unknown ground that leaves no edge to be found.
    """
    wheel_m = options.number("wheel_m", WHEEL_M)
    unknown = options.number("unknown_share", UNKNOWN_SHARE)
    if unknown > MOST_UNKNOWN:
        raise UsageError(f"--set unknown_share={unknown:g}: must be at most {MOST_UNKNOWN:g}")
    return [
        Trial(site, cell_m, seed, wheel_m, unknown)
        for site in ROCKS
        for cell_m in CELLS_M
        for seed in range(1, options.seeds + 1)
    ]


def measure(trial: Trial) -> Sequence[Row]:
    """Return a row for each way to find the edge."""
    site = site_of(trial)
    base: Row = {
        "site": trial.site,
        "cell_m": trial.cell_m,
        "seed": trial.seed,
        "bound_px": trial.wheel_m / trial.cell_m,
        "wheel_m": trial.wheel_m,
        "unknown_share": trial.unknown_share,
    }
    return [base | _measured(site, trial, way) for way in WAYS]


def _measured(site: Site, trial: Trial, way: str) -> Row:
    found = found_edge(site, trial, way)
    inside = edge.inside(found, site.ground_m.shape)
    hull = edge.inside(replace(found, vertices=_hull(found.vertices)), site.ground_m.shape)
    return {
        "way": way,
        "corners": len(found.vertices),
        "mean_px": found.mean_px,
        "max_px": found.max_px,
        **deviations(found),
        "simple": polygon.is_simple(found.vertices),
        "hull_share": float(inside.sum() / hull.sum()),
        "overlap": _overlap(inside, found.plateau),
        "hull_overlap": _overlap(hull, found.plateau),
        "true_overlap": _overlap(inside, _true_plateau(site)),
        "beyond_px": _beyond_m(site, inside) / trial.cell_m,
    }


def _hull(vertices: Floats) -> Floats:
    return vertices[ConvexHull(vertices).vertices]


def _overlap(one: Bools, other: Bools) -> float:
    """Return intersection over union."""
    return float((one & other).sum() / (one | other).sum())


def deviations(found: edge.Edge) -> Row:
    """Return how far the plateau's outermost pixels lie from the polygon, in cells.

    Of all of them; of those that are not at the map's border, where straight lines fit any edge;
    and the largest of each segment, averaged.
    """
    pixels = outer_pixels(found.plateau)
    far, segment = _to_polygon(pixels, found.vertices)
    last = np.array(found.plateau.shape) - 1
    rim = ((pixels > 0) & (pixels < last)).all(axis=1)
    worst = [float(far[segment == k].max()) for k in np.unique(segment[rim])]
    return {
        "anew_max_px": float(far.max()),
        "rim_mean_px": float(far[rim].mean()),
        "segment_mean_px": float(np.mean(worst)),
    }


def _to_polygon(points: Floats, vertices: Floats) -> tuple[Floats, np.ndarray]:
    """Return each point's distance (N,) to the nearest side of a polygon, and which side it is."""
    along = np.roll(vertices, -1, axis=0) - vertices
    from_start = points[:, None] - vertices
    length = np.maximum((along**2).sum(axis=1), 1e-12)
    share = np.clip((from_start * along).sum(axis=2) / length, 0.0, 1.0)
    far = np.linalg.norm(from_start - share[:, :, None] * along, axis=2)
    return far.min(axis=1), far.argmin(axis=1)


def _lip_y_m(site: Site) -> Floats:
    """Return the lip's y (W,) in each column of the map."""
    x = site.frame.x_m + (np.arange(site.frame.cols) + 0.5) * site.frame.cell_m
    return np.interp(x, site.lip_m[:, 0], site.lip_m[:, 1])


def _true_plateau(site: Site) -> Bools:
    y = site.frame.y_m + (np.arange(site.frame.rows) + 0.5) * site.frame.cell_m
    return y[:, None] >= _lip_y_m(site)[None, :]


def _beyond_m(site: Site, inside: Bools) -> float:
    """Return how far the polygon reaches beyond the true lip; 0 where it doesn't."""
    rows, cols = np.nonzero(inside & ~_true_plateau(site))
    if rows.size == 0:
        return 0.0
    cell_m = site.frame.cell_m
    corner_m = np.array((site.frame.x_m, site.frame.y_m))
    points = corner_m + np.column_stack((cols + 0.5, rows + 0.5)) * cell_m
    distance, _ = KDTree(site.lip_m).query(points)
    return float(np.max(distance))


EXPERIMENT = Experiment(
    trials=trials,
    measure=measure,
    conclude=conclude,
    draw=draw,
    settings={
        "wheel_m": f"diameter of the wheels ({WHEEL_M:g})",
        "unknown_share": f"share of the map that is unknown, at most 0.9 ({UNKNOWN_SHARE:g})",
    },
)
