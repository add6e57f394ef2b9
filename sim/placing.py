"""Where a team starts, and where its Cliff-bot is to go: decided by the true ground alone."""

import itertools
import math
from collections.abc import Sequence

import cv2
import numpy as np

from agents.geometry import Bools, Floats, Pose
from sim.errors import WorldError
from sim.ground import Footing, Terrain, largest_regions, region_of

STANDABLE_DEG = 15.0
"""Steepest ground on which a robot is put down."""
ANCHOR_SPREAD_M = 2.5
"""How far an Anchor-bot stands to the side of the Cliff-bot."""
RECON_BACK_M = 2.5
"""How far behind the lip a robot that looks stands."""
EXPLORER_SPACING_M = 3.0
ROOM_M = 6.0
"""What a team likes to have between itself and the window's border."""
GOAL_REACH_M = (10.0, 20.0, 35.0)
"""How far off the foot of the drop is looked for."""
GOAL_SLOPES_DEG = (STANDABLE_DEG, 20.0, 25.0, 34.0)
"""How steep it may be, at last as steep as friction holds."""
WHEEL_M = 0.2
"""Wheel of the rovers that are placed: rocks of more than half of it are kept clear."""


def place_team(
    terrain: Terrain, roles: Sequence[str], radius_m: float, rng: np.random.Generator
) -> dict[int, Pose]:
    """Return a start pose for every role, by its index: standing free of rocks, none overlapping.

    With a "cliffbot" or a "recon" among the roles the team stands round the lip of the best drop
    near the middle: the Cliff-bot at the lip and facing down, "anchor"s to its left and right, all
    others some metres behind. Without one they gather round the middle of the ground. `radius_m` is
    the radius of the circle that a robot covers. Raises WorldError where the ground has no room.
    """
    footing = Footing(terrain, 2 * radius_m, WHEEL_M)
    standable = largest_regions(
        footing.standable(STANDABLE_DEG), (12 * radius_m / terrain.frame.cell_m) ** 2
    )
    if not standable.any():
        raise WorldError(
            f"the window has no ground flatter than {STANDABLE_DEG:g} deg and free of rocks for"
            f" robots of {2 * radius_m:g} m; try another seed, window or terrain"
        )
    crew = _Crew(footing, standable, radius_m)
    if wants_drop(roles):
        return crew.at_the_lip(roles, terrain.edge_m)
    return crew.in_the_open(roles, rng)


def wants_drop(roles: Sequence[str]) -> bool:
    """Say whether a team of these roles is one for a cliff."""
    return "cliffbot" in roles or "recon" in roles


class _Crew:
    """Robots being put down one after another, each on the free ground nearest to its wish."""

    def __init__(self, footing: Footing, standable: Bools, radius_m: float) -> None:
        self.footing = footing
        self.frame = footing.frame
        self.radius_m = radius_m
        self.ground = standable
        self.free = standable.copy()
        rows, cols = np.indices(self.frame.shape)
        self.x_m = self.frame.x_m + (cols + 0.5) * self.frame.cell_m
        self.y_m = self.frame.y_m + (rows + 0.5) * self.frame.cell_m

    def put(self, x_m: float, y_m: float, yaw_rad: float) -> Pose:
        """Put a robot down near a point and take its ground from the free."""
        if not self.free.any():
            raise WorldError(
                "the ground has no room for so many robots; try fewer, or a larger world.window_m"
            )
        away = np.where(self.free, np.hypot(self.x_m - x_m, self.y_m - y_m), np.inf)
        row, col = np.unravel_index(int(np.argmin(away)), away.shape)
        x, y = self.frame.centre_of(int(row), int(col))
        self.free &= np.hypot(self.x_m - x, self.y_m - y) > 2 * self.radius_m + 0.3
        return Pose(x, y, self.footing.ground_m(x, y), yaw_rad)

    def at_the_lip(self, roles: Sequence[str], edge_m: Floats | None) -> dict[int, Pose]:
        """Place a cliff team; see `place_team`."""
        if edge_m is None:
            x, y, yaw = find_lip(self.footing, self.free)
        else:
            x, y, yaw = _middle_of_edge(self.footing, edge_m)
        ahead, left = (math.cos(yaw), math.sin(yaw)), (-math.sin(yaw), math.cos(yaw))
        # All on the ground behind the lip: the foot of a steep face may be nearer to a wish.
        self._keep_joined(x - RECON_BACK_M * ahead[0], y - RECON_BACK_M * ahead[1])

        def put(forward_m: float, left_m: float) -> Pose:
            return self.put(
                x + forward_m * ahead[0] + left_m * left[0],
                y + forward_m * ahead[1] + left_m * left[1],
                yaw,
            )

        poses: dict[int, Pose] = {}
        for i in _indices(roles, "cliffbot"):
            poses[i] = put(0.0, 0.0)
        for n, i in enumerate(_indices(roles, "anchor")):
            side = (1 if n % 2 == 0 else -1) * (n // 2 + 1)
            poses[i] = put(-0.3, side * ANCHOR_SPREAD_M)
        others = [i for i in range(len(roles)) if i not in poses]
        for n, i in enumerate(others):
            side = (n + 1) // 2 * (1 if n % 2 else -1)
            poses[i] = put(-RECON_BACK_M, side * 1.5)
        return {i: poses[i] for i in range(len(roles))}

    def in_the_open(self, roles: Sequence[str], rng: np.random.Generator) -> dict[int, Pose]:
        """Place explorers on a ring round the middle, each facing outwards."""
        west, east, south, north = self.frame.extent_m
        middle = ((west + east) / 2, (south + north) / 2)
        count = len(roles)
        ring_m = EXPLORER_SPACING_M / 2 / math.sin(math.pi / max(2, count)) if count > 1 else 0.0
        turn = float(rng.uniform(-math.pi, math.pi))
        poses: dict[int, Pose] = {}
        for i in range(count):
            yaw = math.remainder(turn + 2 * math.pi * i / count, 2 * math.pi)
            poses[i] = self.put(
                middle[0] + ring_m * math.cos(yaw), middle[1] + ring_m * math.sin(yaw), yaw
            )
            if i == 0:  # the others stay on the ground that the first can reach
                self._keep_joined(poses[0].x_m, poses[0].y_m)
        return poses

    def _keep_joined(self, x_m: float, y_m: float) -> None:
        """Keep free only what standable ground joins to a point (or to what is nearest to it)."""
        self.free &= region_of(self.ground, *self.frame.cell_of(x_m, y_m))


def _indices(roles: Sequence[str], role: str) -> list[int]:
    return [i for i, r in enumerate(roles) if r == role]


def _middle_of_edge(footing: Footing, edge_m: Floats) -> tuple[float, float, float]:
    """Return (x, y, yaw) of a made cliff's lip, mid-window; it falls to the south."""
    west, east, _, _ = footing.frame.extent_m
    x = (west + east) / 2
    return x, float(np.interp(x, edge_m[:, 0], edge_m[:, 1])), -math.pi / 2


def find_lip(footing: Footing, standable: Bools) -> tuple[float, float, float]:
    """Return (x, y, yaw) of the best lip near the middle of the window; yaw points down it.

    Best is the cell from which the ground falls most within 3 m and within 8 m, less what it lies
    off the middle, and less what it lacks of some room to the window's border. Deterministic.
    """
    frame = footing.frame
    fall_near, fall_far = _fall(footing, 3.0), _fall(footing, 8.0)
    rows, cols = np.indices(frame.shape)
    off = np.hypot(rows - frame.rows / 2, cols - frame.cols / 2) * frame.cell_m
    border = np.minimum(np.minimum(rows, frame.rows - rows), np.minimum(cols, frame.cols - cols))
    cramped = np.maximum(0.0, ROOM_M - border * frame.cell_m)
    merit = fall_near + 0.5 * fall_far - 0.05 * off - 0.5 * cramped
    merit = np.where(standable, merit, -np.inf)
    row, col = np.unravel_index(int(np.argmax(merit)), merit.shape)
    x, y = frame.centre_of(int(row), int(col))
    return x, y, _downhill_yaw(footing, x, y)


def _fall(footing: Footing, radius_m: float) -> Floats:
    """Return how far the ground falls within a radius of each cell, in m."""
    stride = max(1, round(radius_m / 12 / footing.frame.cell_m))
    n = max(1, round(radius_m / footing.frame.cell_m / stride))
    height = np.where(footing.open, footing.height_m, np.inf)[::stride, ::stride]
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * n + 1, 2 * n + 1))
    lowest = np.asarray(cv2.erode(height, reach), dtype=np.float64)
    rows, cols = (np.arange(n) // stride for n in footing.frame.shape)
    return np.where(footing.open, footing.height_m - lowest[np.ix_(rows, cols)], 0.0)


def _downhill_yaw(footing: Footing, x_m: float, y_m: float) -> float:
    """Return the heading along which the ground falls most, over 2 to 6 m."""
    here = footing.ground_m(x_m, y_m)
    best, best_fall = 0.0, -math.inf
    for k in range(36):
        yaw = 2 * math.pi * k / 36 - math.pi
        falls = [
            here - footing.ground_m(x_m + d * math.cos(yaw), y_m + d * math.sin(yaw))
            for d in (2.0, 4.0, 6.0)
        ]
        fall = sum(f for f in falls if not math.isnan(f))
        if fall > best_fall + 1e-9:
            best, best_fall = yaw, fall
    return best


def descent_goal(
    terrain: Terrain, cliffbot: Pose, footprint_m: float = 0.8, wheel_m: float = WHEEL_M
) -> tuple[float, float]:
    """Return (x, y) of the ground to which a Cliff-bot is to be let down, in the world frame.

    Flat ground (or the flattest) free of rocks, in a cone about the way that the Cliff-bot faces,
    joined to it by ground free of rocks and steps: nearly the lowest within 10 m, and of that the
    nearest; where the drop reaches farther, within 20 or 35 m. Raises WorldError where there is
    none.
    """
    footing = Footing(terrain, footprint_m, wheel_m)
    away, aside = _polar(footing, cliffbot)
    fall = cliffbot.z_m - footing.height_m
    passable = (footing.open & ~footing.contact) | (away < footprint_m / 2)
    joined = region_of(passable, *footing.frame.cell_of(cliffbot.x_m, cliffbot.y_m))
    cone = (aside < math.radians(50)) & (away >= 3.0) & footing.open
    best: Floats | None = None
    for reach_m, steepest_deg in itertools.product(GOAL_REACH_M, GOAL_SLOPES_DEG):
        near = cone & (away <= reach_m)
        good = near & joined & (footing.slope_deg <= steepest_deg)
        if not good.any():
            continue
        most = float(fall[good].max())
        share = np.minimum(fall / max(most, 0.1), 0.92)
        merit = np.where(good, 10.0 * share - 0.4 * away - aside, -np.inf)
        if best is None:
            best = merit
        if most >= 0.7 * float(fall[near].max()):
            best = merit
            break
    if best is None:
        raise WorldError(
            f"below the Cliff-bot at ({cliffbot.x_m:.1f}, {cliffbot.y_m:.1f}) m is no ground to"
            f" stand on within {GOAL_REACH_M[-1]:g} m; try another seed, window or terrain"
        )
    row, col = np.unravel_index(int(np.argmax(best)), best.shape)
    return footing.frame.centre_of(int(row), int(col))


def _polar(footing: Footing, pose: Pose) -> tuple[Floats, Floats]:
    """Return each cell's distance from a pose and its angle off the pose's heading, unsigned."""
    frame = footing.frame
    rows, cols = np.indices(frame.shape)
    dx = frame.x_m + (cols + 0.5) * frame.cell_m - pose.x_m
    dy = frame.y_m + (rows + 0.5) * frame.cell_m - pose.y_m
    aside = np.abs(np.arctan2(dy, dx) - pose.yaw_rad)
    return np.hypot(dx, dy), np.minimum(aside, 2 * np.pi - aside)
