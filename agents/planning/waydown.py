"""The way down for a robot on tethers: where the map shows one, and what is still to be asked.

Where no way is safe yet, the most hopeful one is planned over ground that is not known to be bad.
What keeps it from being safe are its open questions: who maps looks there first.
"""

import itertools
import math
from dataclasses import dataclass

import cv2
import numpy as np

from agents.geometry import Bools, Floats, GridFrame, Pose
from agents.ground import descent, markov, surface
from agents.ground.paths import path_to, straight_legs, travel_field
from agents.settings import DriveSettings

GOAL_M = 1.0
"""The Cliff-bot has arrived when it stands this near its goal: the goal itself may be barred."""
STAND_M = 0.25
"""It stands where it stands, so one can stand there, and so far about it."""
STAND_COST = 10.0
"""Cost of a metre at its own stand, where the map would forbid it."""
CALM_RISK, MOST_RISK, LAST_RISK = 0.5, 2.0, 3.0
"""How many cells with a rock a way may be expected to meet (`Way.risk`) that is taken at once; that
is taken when looking on has not shown a better one; and where nobody will map any more."""
KEEP = 1.15
"""Who is on a way keeps to it as long as that costs no more than this times the best one."""
UNSEEN_ODDS = 1e-3
"""Odds of a rock on ground that nobody has seen, or not sharply, in a hopeful plan."""
VAGUE_ODDS = 3e-3
"""What has greater odds of a rock than this is worth asking about,"""
SHARP, SHARPEST = 0.25, 0.15
"""unless it is a rock that was measured to the first share of a wheel, or anything measured to the
second: it will not look otherwise."""
LEAST_SIGMA_M = 1e-3
TIRED = 3.0
"""After so many looks that were to show a place and did not, it costs twice as much."""

Point = tuple[float, float]


@dataclass(frozen=True)
class Descent:
    """Somebody who waits to go down, or is on the way."""

    stand: Pose
    goal_m: Point
    asked: Floats
    """(H, W) for how many looks a cell was an open question."""


@dataclass(frozen=True)
class Relief:
    """Ground as coarse as rocks need it; see `relief_of`."""

    frame: GridFrame
    elevation_m: Floats
    """(h, w), NaN where unknown."""
    sigma_m: Floats
    """(h, w) against the ground next to each cell, inf where unknown."""


@dataclass(frozen=True)
class Way:
    """A way down."""

    path_m: Floats
    """(N, 2)."""
    risk: float
    """How many cells with a rock it is expected to meet, after it has left its stand."""


@dataclass(frozen=True)
class Hope:
    """The most hopeful way down, and what is not known of it."""

    path_m: Floats
    """(N, 2)."""
    relief: Relief
    """On which it was planned."""
    unseen: Bools
    """(h, w) cells of that beside it that nobody has seen; `blurred`, `rock` and `vague` likewise:
    seen, not sharply; surely a rock; of which that is not known well enough."""
    blurred: Bools
    rock: Bools
    vague: Bools

    def told(self) -> str:
        """Return in words what keeps it from being safe."""
        names = {
            "unseen": self.unseen,
            "blurred": self.blurred,
            "rock": self.rock,
            "that may be rock": self.vague,
        }
        cell_m2 = self.relief.frame.cell_m**2
        parts = [f"{cells.sum() * cell_m2:.1f} m2 {name}" for name, cells in names.items()]
        length_m = float(np.hypot(*np.diff(self.path_m, axis=0).T).sum())
        return f"the best way left is {length_m:.1f} m long: {', '.join(parts)}"


def safe_path(
    frame: GridFrame,
    drive: DriveSettings,
    elevation_m: Floats,
    sigma_m: Floats,
    stand: Pose,
    goal_m: Point,
    *,
    most_risk: float = MOST_RISK,
) -> Floats | None:
    """Return the way (N, 2) of `least_risky`, or None where it is expected to meet more rocks."""
    way = least_risky(frame, drive, elevation_m, sigma_m, stand, goal_m)
    return None if way is None or way.risk > most_risk else way.path_m


def least_risky(
    frame: GridFrame,
    drive: DriveSettings,
    elevation_m: Floats,
    sigma_m: Floats,
    stand: Pose,
    goal_m: Point,
    *,
    former_m: Floats | None = None,
) -> Way | None:
    """Return the way over known ground that weighs length against rocks best, or None.

    Args:
        frame: the map's grid.
        drive: the robot's sizes.
        elevation_m: (H, W), NaN where unknown.
        sigma_m: (H, W) of each cell against the ground next to it.
        stand: where it stands; what the map forbids there is allowed.
        goal_m: where it is to go; it is enough to come within `GOAL_M`.
        former_m: (N, 2) the way that it is on: kept, unless another is better by more than maps
            change from look to look.
    """
    stand_m = (stand.x_m, stand.y_m)
    relief = relief_of(frame, drive, elevation_m, sigma_m, stand)
    if not _may_lead(relief, drive, stand_m, goal_m):
        return None
    sizes, joined = _sizes(relief.frame, drive), relief.frame
    bars = descent.barred(relief.elevation_m, relief.sigma_m, **sizes)
    footprint_m = sizes["footprint_m"]
    cost = descent.descent_cost(bars, cell_m=joined.cell_m, footprint_m=footprint_m)
    path_m = _way(joined, cost, stand_m, goal_m)
    if path_m is None:
        return None
    if former_m is not None:
        rest_m = _rest_of(former_m, stand_m)
        may_cost = KEEP * _cost_along(joined, cost, path_m, stand_m)
        if _cost_along(joined, cost, rest_m, stand_m) <= may_cost:
            path_m = rest_m
    beside_m = markov.distance_to_known_m(_on(joined, path_m), joined.cell_m)
    met = bars.odds * descent.met_at(beside_m, footprint_m)
    met[within(joined, stand_m, drive.footprint_m / 2 + STAND_M)] = 0.0
    return Way(path_m, float(met.sum()))


def hopeful(
    frame: GridFrame, drive: DriveSettings, elevation_m: Floats, sigma_m: Floats, down: Descent
) -> Hope | None:
    """Return the most hopeful way down; None where it would begin or end off the map.

    Ground that was not seen, or not sharply, costs more, and more the oftener it was asked about.
    """
    relief = relief_of(frame, drive, elevation_m, sigma_m, down.stand)
    cell_m, sizes = relief.frame.cell_m, _sizes(relief.frame, drive)
    bars = descent.barred(relief.elevation_m, relief.sigma_m, **sizes)
    unknown = bars.unseen | bars.blurred
    tries = _blocks(down.asked, _factor(frame, drive), 0.0).max(axis=(1, 3))
    odds = np.where(unknown, UNSEEN_ODDS, bars.odds) * (1.0 + tries / TIRED)
    met = descent.met_per_metre(odds, sizes["footprint_m"], cell_m)
    stand_m = (down.stand.x_m, down.stand.y_m)
    path_m = _way(relief.frame, 1.0 + descent.RISK_WEIGHT * met, stand_m, down.goal_m)
    if path_m is None:
        return None
    beside = markov.distance_to_known_m(_on(relief.frame, path_m), cell_m)
    along = beside <= 0.5 * sizes["footprint_m"]
    along &= ~within(relief.frame, stand_m, STAND_M)
    seen = along & ~unknown
    sharp = relief.sigma_m <= SHARP * drive.wheel_m
    rock = seen & bars.rock & sharp
    vague = seen & ~rock & (bars.odds > VAGUE_ODDS)
    vague &= relief.sigma_m > SHARPEST * drive.wheel_m
    return Hope(path_m, relief, bars.unseen & along, bars.blurred & along, rock, vague)


def open_questions(
    frame: GridFrame, drive: DriveSettings, elevation_m: Floats, sigma_m: Floats, down: Descent
) -> Bools:
    """Return the cells (H, W) at which to look so that somebody may go down; none if it may now."""
    ground = (frame, drive, elevation_m, sigma_m)
    if safe_path(*ground, down.stand, down.goal_m, most_risk=CALM_RISK) is None:
        hope = hopeful(*ground, down)
        if hope is not None:
            asked = hope.unseen | hope.blurred | hope.vague
            factor = _factor(frame, drive)
            return asked.repeat(factor, 0).repeat(factor, 1)[: frame.rows, : frame.cols]
    return np.zeros(frame.shape, dtype=np.bool_)


def relief_of(
    frame: GridFrame, drive: DriveSettings, elevation_m: Floats, sigma_m: Floats, stand: Pose
) -> Relief:
    """Return the ground about a robot in cells of about half a wheel, its own stand known.

    Finer cells are joined: what they err each for itself would look like rocks everywhere, and
    nothing smaller is a rock to a wheel. Known is a cell that is known in part.
    """
    elevation_m, sigma_m = with_stand(frame, drive, elevation_m, sigma_m, stand)
    factor = _factor(frame, drive)
    if factor == 1:
        return Relief(frame, elevation_m, sigma_m)
    known = ~np.isnan(elevation_m)
    weight = np.where(known, 1.0 / np.maximum(sigma_m, LEAST_SIGMA_M) ** 2, 0.0)
    total = _blocks(weight, factor, 0.0).sum(axis=(1, 3))
    sums = _blocks(np.where(known, weight * elevation_m, 0.0), factor, 0.0).sum(axis=(1, 3))
    with np.errstate(divide="ignore", invalid="ignore"):
        heights_m, spread_m = sums / total, np.sqrt(1.0 / total)
    joined = GridFrame(frame.x_m, frame.y_m, factor * frame.cell_m, *total.shape)
    return Relief(joined, heights_m, spread_m)


def _factor(frame: GridFrame, drive: DriveSettings) -> int:
    """Return how many cells a side make one of at most half a wheel."""
    return max(1, int(0.5 * drive.wheel_m / frame.cell_m + 1e-9))


def _blocks(grid: Floats, factor: int, beyond: float) -> Floats:
    """Return a grid (H, W) as blocks (h, factor, w, factor), filled up beyond its border."""
    rows, cols = (-side % factor for side in grid.shape)
    whole = np.pad(grid, ((0, rows), (0, cols)), constant_values=beyond)
    return whole.reshape(whole.shape[0] // factor, factor, whole.shape[1] // factor, factor)


def with_stand(
    frame: GridFrame, drive: DriveSettings, elevation_m: Floats, sigma_m: Floats, stand: Pose
) -> tuple[Floats, Floats]:
    """Return elevation and sigma with the ground under a robot's wheels known.

    No camera sees the ground that a robot stands on, but it stands there: what the map shows within
    its circle is the robot itself, or wrong. Its height is completed from the ground about it: one
    height for all of it would be a terrace on a slope, with a step all round that no wheel may
    take. Where nothing is known about it, it is the robot's own.
    """
    away_m = distance_to(frame, (stand.x_m, stand.y_m))
    under = away_m <= 0.75 * drive.footprint_m
    if not under.any():
        return elevation_m, sigma_m
    unseen = (under & np.isnan(elevation_m)) | (away_m <= 0.5 * drive.footprint_m)
    elevation_m, sigma_m = elevation_m.copy(), sigma_m.copy()
    rows, cols = np.nonzero(under)
    margin = math.ceil(0.5 * drive.footprint_m / frame.cell_m)
    window = (
        slice(max(0, int(rows.min()) - margin), int(rows.max()) + margin + 1),
        slice(max(0, int(cols.min()) - margin), int(cols.max()) + margin + 1),
    )
    about = np.where(unseen[window], np.nan, elevation_m[window])
    known = not np.isnan(about).all()
    whole = markov.complete(about) if known else np.full(about.shape, stand.z_m)
    elevation_m[window] = np.where(unseen[window], whole, about)
    sigma_m[unseen] = 0.25 * drive.wheel_m
    return elevation_m, sigma_m


def within(frame: GridFrame, point_m: Point, radius_m: float) -> Bools:
    """Return the cells (H, W) within a radius of a point."""
    return distance_to(frame, point_m) <= radius_m


def distance_to(frame: GridFrame, point_m: Point) -> Floats:
    """Return each cell's distance (H, W) to a point, metres."""
    x_m = frame.x_m + (np.arange(frame.cols) + 0.5) * frame.cell_m - point_m[0]
    y_m = frame.y_m + (np.arange(frame.rows) + 0.5) * frame.cell_m - point_m[1]
    return np.hypot(x_m[None], y_m[:, None])


def _sizes(frame: GridFrame, drive: DriveSettings) -> dict[str, float]:
    return {
        "cell_m": frame.cell_m,
        "footprint_m": drive.footprint_m + 2 * surface.CLEARANCE_M,
        "wheel_m": drive.wheel_m,
        "climb_m": drive.climb_m,
    }


def _may_lead(relief: Relief, drive: DriveSettings, stand_m: Point, goal_m: Point) -> bool:
    """Say whether seen ground joins the two at all: where it does not, nothing else need be asked.

    It is the cheapest part of `descent.barred`, and bars no more than that does.
    """
    frame, known = relief.frame, ~np.isnan(relief.elevation_m)
    start = frame.cell_of(*stand_m)
    if not frame.holds(*start):
        return False
    unseen = markov.distance_to_known_m(known, frame.cell_m) > drive.wheel_m
    gap_m = markov.distance_to_known_m(unseen, frame.cell_m)
    wide = gap_m > 0.5 * _sizes(frame, drive)["footprint_m"]
    may = wide | within(frame, stand_m, STAND_M)
    _, labels = cv2.connectedComponents(may.astype(np.uint8), connectivity=8)
    return bool((labels[within(frame, goal_m, GOAL_M)] == labels[start]).any())


def _way(frame: GridFrame, cost: Floats, stand_m: Point, goal_m: Point) -> Floats | None:
    """Return the cheapest way (N, 2) from a stand to where it comes nearest to the goal."""
    start = frame.cell_of(*stand_m)
    if not frame.holds(*start):
        return None
    cost = _open_stand(frame, cost, stand_m)
    distance_m, parent = travel_field(cost, np.array([start]), frame.cell_m)
    near = np.where(np.isfinite(distance_m), distance_to(frame, goal_m), np.inf)
    end = np.unravel_index(int(np.argmin(near)), frame.shape)
    if near[end] > GOAL_M:
        return None
    cells = straight_legs(path_to(parent, (int(end[0]), int(end[1]))), cost)
    return np.array([frame.centre_of(int(row), int(col)) for row, col in cells])


def _open_stand(frame: GridFrame, cost: Floats, stand_m: Point) -> Floats:
    """Return costs (H, W) by which a robot may leave where it stands."""
    stands = within(frame, stand_m, STAND_M)
    return np.where(stands, np.minimum(cost, STAND_COST), cost)


def _rest_of(path_m: Floats, stand_m: Point) -> Floats:
    """Return what is left of a way (N, 2) for who stands somewhere on it, or beside it."""
    if len(path_m) < 2:
        return path_m
    begin, end = path_m[:-1], path_m[1:]
    along = end - begin
    squared = np.maximum((along**2).sum(axis=1), 1e-12)
    share = np.clip(((np.array(stand_m) - begin) * along).sum(axis=1) / squared, 0.0, 1.0)
    away_m = np.hypot(*(begin + share[:, None] * along - stand_m).T)
    return np.vstack((stand_m, end[int(np.argmin(away_m)) :]))


def _cost_along(frame: GridFrame, cost: Floats, path_m: Floats, stand_m: Point) -> float:
    """Return what a way (N, 2) costs; inf where it leads over what is forbidden."""
    cost = _open_stand(frame, cost, stand_m)
    total = 0.0
    for a, b in itertools.pairwise(path_m):
        cells = frame.cells_of(_points(frame, a, b))
        total += math.dist(a, b) * float(cost[cells[:, 0], cells[:, 1]].mean())
    return total


def _points(frame: GridFrame, a: Floats, b: Floats) -> Floats:
    """Return points (N, 2) half a cell apart from one to another."""
    count = 1 + math.ceil(2.0 * math.dist(a, b) / frame.cell_m)
    return np.asarray(a + np.linspace(0.0, 1.0, count)[:, None] * (b - a), dtype=np.float64)


def _on(frame: GridFrame, path_m: Floats) -> Bools:
    """Return the cells (H, W) that a way (N, 2) leads over."""
    on = np.zeros(frame.shape, dtype=np.bool_)
    for a, b in itertools.pairwise(path_m):
        on |= frame.mask_of(_points(frame, a, b))
    return on
