"""What a planner makes of a view: completed ground, where it may stand, and how it gets there."""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from agents.errors import AgentError
from agents.geometry import Bools, Floats, GridFrame, Ints, Pose
from agents.ground import edge, markov, paths, surface
from agents.outlook.line import behind_line
from agents.settings import DriveSettings, PlannerSettings, SensorSettings
from agents.sight.visibility import phi

BODY_M = 0.6
"""Height of a team-mate's body, which hides what is behind it."""
CLAIMED = 0.3
"""What a cell is still worth that a team-mate said it will look at."""
WISHED = 3.0
"""How much more a cell is worth on ground that a team-mate waits to know."""
ASKED = 40.0
"""How much more it is worth where it keeps a team-mate's most hopeful way from being safe ..."""
ALL_ASKED = 40.0
"""... and all such cells together, in looks that are just worth taking."""
RIM_STEP_M, RIM_MOST = 0.3, 80
"""Where a team-mate has questions, looks are also offered from the very rim of the ground that can
be driven, so far apart, and so many: what lies below a lip is seen from nowhere else."""
SHARP = 0.25
"""Wished ground is known well enough when its sigma is this share of a wheel."""
TRAIL_WIDTH = 0.6
"""Share of a robot's width in which the way that it came may be gone back."""
NEAR_COST = 4.0
"""Cost of a metre on ground that a robot would rather not drive on, but may."""


class ViewError(AgentError):
    """A view that no plan can be made from."""


@dataclass(frozen=True)
class View:
    """All that a look is planned from; grids (H, W) have row 0 at the south."""

    frame: GridFrame
    elevation_m: Floats
    """Fused team map, NaN where unknown."""
    sigma_m: Floats
    """Standard deviation of known cells; ignored elsewhere."""
    looks: Ints
    """In how many looks of the whole team a cell was measured."""
    interest: Floats
    """Eq. 9, in [0, 1]."""
    pose: Pose
    pose_sigma_m: float
    others: list[Pose]
    sensor: SensorSettings
    drive: DriveSettings
    planner: PlannerSettings
    claims: list[tuple[float, float, float]]
    """(x, y, radius) in metres that team-mates said they will look at."""
    wishes: tuple[tuple[float, float, float], ...] = ()
    """(x, y, radius) of ground that a team-mate waits to know."""
    barred: tuple[tuple[float, float, float], ...] = ()
    """(x, y, radius) of ground on which the wheels came to a halt, whatever the map shows there."""
    questions: Floats | None = None
    """(H, W) in [0, 1]: above 0 is what keeps a team-mate's most hopeful way down from being safe;
    less than 1, what was asked before."""
    trail_m: Floats | None = None
    """(N, 2) where the robot has been: it can always go back the way it came."""


class Scene:
    """What follows from one view, each part worked out once and only when asked for."""

    def __init__(
        self,
        view: View,
        *,
        straight_edge: bool = False,
        again: float = 1.0,
        trust: Floats | None = None,
        sight: markov.Border = "low",
    ) -> None:
        """Check the view; raise `ViewError` if the robot is off the map or a grid's shape wrong.

        With `straight_edge` the robot stays behind a straight line instead of inside the polygon.
        What a cell is worth is multiplied by `again` if it was measured, by `trust` (H, W) if not.
        `sight` is the border of the completed ground on which looks are foretold; whoever drives
        reckons with a low one.
        """
        row, col = view.frame.cell_of(view.pose.x_m, view.pose.y_m)
        if not view.frame.holds(row, col):
            raise ViewError(f"the robot at {view.pose} lies outside the map {view.frame.extent_m}")
        for name in ("elevation_m", "sigma_m", "looks", "interest"):
            if getattr(view, name).shape != view.frame.shape:
                raise ViewError(
                    f"{name} has shape {getattr(view, name).shape}, the map {view.frame.shape}"
                )
        self.view = view
        self.cell = (row, col)
        self._straight_edge = straight_edge
        self._again = again
        self._trust = trust
        self._sight: markov.Border = sight

    @cached_property
    def seeded_m(self) -> Floats:
        """(H, W) elevation with the cells under the robot known by its wheels."""
        seeded = self.view.elevation_m.copy()
        row, col = self.cell
        below = seeded[max(0, row - 1) : row + 2, max(0, col - 1) : col + 2]
        below[np.isnan(below)] = self.view.pose.z_m
        return seeded

    @cached_property
    def ground_m(self) -> Floats:
        """(H, W) completed elevation, outer border low (Eq. M)."""
        return markov.complete(self.seeded_m, border="low")

    @cached_property
    def sight_m(self) -> Floats:
        """(H, W) completed elevation, as it is taken to be for looks."""
        if self._sight == "low":
            return self.ground_m
        return markov.complete(self.seeded_m, border=self._sight)

    @cached_property
    def known_distance_m(self) -> Floats:
        """(H, W) distance to measured ground, wheels included."""
        return markov.distance_to_known_m(~np.isnan(self.seeded_m), self.view.frame.cell_m)

    @cached_property
    def sigma_m(self) -> Floats:
        """(H, W) standard deviation of every cell, estimated ones included."""
        view = self.view
        far_cells = self.known_distance_m / view.frame.cell_m
        guessed = markov.variogram_sigma(view.elevation_m, far_cells)
        return np.where(np.isnan(view.elevation_m), guessed, view.sigma_m)

    @cached_property
    def obstacles_m(self) -> Floats:
        """(H, W) the ground, as it is taken to be for looks, with team-mates standing on it."""
        raised = self.sight_m.copy()
        for mate in self.view.others:
            body = self._cells(mate.x_m, mate.y_m, 0.5 * self.view.drive.footprint_m)
            raised[body] = np.maximum(raised[body], mate.z_m + BODY_M)
        return raised

    @cached_property
    def worth(self) -> Floats:
        """(H, W) bits that a cell gives if it is seen for certain: Eq. 3 without P, times Eq. 9."""
        view = self.view
        filled = np.minimum(view.looks / view.planner.n_max, 1.0)
        worth = (1.0 - filled) * view.interest
        worth[view.looks > 0] *= self._again
        if self._trust is not None:
            worth[view.looks == 0] *= self._trust[view.looks == 0]
        for x_m, y_m, radius_m in view.claims:
            worth[self._cells(x_m, y_m, radius_m)] *= CLAIMED
        for x_m, y_m, radius_m in view.wishes:
            wished = self._within(x_m, y_m, radius_m)
            # Who is to drive there has to see rocks: looks go on until the relief is sharp.
            blurred = wished & (self.sigma_m > SHARP * view.drive.wheel_m)
            worth[blurred] = view.interest[blurred]
            worth[wished] *= WISHED
        if view.questions is not None and self.asked:
            each = max(ASKED, ALL_ASKED * view.planner.min_gain_cells / self.asked)
            worth = np.maximum(worth, each * view.interest * view.questions)
        for mate in view.others:
            worth[self._cells(mate.x_m, mate.y_m, 0.5 * view.drive.footprint_m)] = 0.0
        return worth

    @cached_property
    def asked(self) -> int:
        """How many cells are open questions."""
        return 0 if self.view.questions is None else int((self.view.questions > 0).sum())

    def _within(self, x_m: float, y_m: float, radius_m: float) -> Bools:
        """Return the mask (H, W) of the cells about a place."""
        within = np.zeros(self.view.frame.shape, dtype=np.bool_)
        within[self._cells(x_m, y_m, radius_m)] = True
        return within

    def _cells(self, x_m: float, y_m: float, radius_m: float) -> tuple[Ints, Ints]:
        """Return rows and columns of the cells about a place."""
        frame = self.view.frame
        x2 = (frame.x_m + (np.arange(frame.cols) + 0.5) * frame.cell_m - x_m) ** 2
        y2 = (frame.y_m + (np.arange(frame.rows) + 0.5) * frame.cell_m - y_m) ** 2
        # Most of the map is farther off along one axis alone.
        rows, cols = (np.flatnonzero(d2 <= radius_m * radius_m) for d2 in (y2, x2))
        near = np.nonzero(x2[cols][None] + y2[rows][:, None] <= radius_m * radius_m)
        return rows[near[0]], cols[near[1]]

    @cached_property
    def trusted_distance_m(self) -> Floats:
        """(H, W) as `known_distance_m`; about a robot on unmeasured ground the blind ring counts.

        The camera can't see the ground below the steepest look. Where the robot was put down it
        has to trust what lies between its wheels and the seen ground, estimated from both sides;
        wherever it has driven since was measured before, and nothing is trusted.
        """
        view = self.view
        under = self._within(view.pose.x_m, view.pose.y_m, 0.5 * view.drive.footprint_m)
        if np.isnan(view.elevation_m[under]).mean() < 0.5:
            return self.known_distance_m
        down_deg = 0.5 * view.sensor.fov_vertical_deg - min(view.planner.tilts_deg)
        blind_m = view.sensor.height_m / math.tan(math.radians(min(80.0, max(10.0, down_deg))))
        blind_m = min(blind_m, 2.0 * view.drive.footprint_m) + view.drive.wheel_m
        ring = self._within(view.pose.x_m, view.pose.y_m, blind_m)
        return np.where(
            ring, np.minimum(self.known_distance_m, view.drive.wheel_m), self.known_distance_m
        )

    @cached_property
    def edge(self) -> edge.Edge:
        """The polygon about the plateau that the robot stands on (Figs. 8, 9)."""
        drive = self.view.drive
        return edge.find_edge(
            self.ground_m,
            self.trusted_distance_m,
            self.cell,
            contact_m=self.view.pose.z_m,
            wheel_m=drive.wheel_m,
            cell_m=self.view.frame.cell_m,
            band_m=drive.wheel_m,
            max_slope_deg=drive.max_slope_deg,
            patch_m=drive.footprint_m,
        )

    @cached_property
    def cost(self) -> Floats:
        """(H, W) cost of a metre: 1 where the robot may drive, inf elsewhere and at team-mates.

        Beside rocks, and what is almost one, it goes only where there is no way round.
        A robot that has come outside the inset polygon (the map has changed, or its pose) may
        cross the passable ground beside it that is no nearer to the rim than it is.
        """
        view, drive = self.view, self.view.drive
        sizes = {
            "cell_m": view.frame.cell_m,
            "wheel_m": drive.wheel_m,
            "footprint_m": drive.footprint_m,
            "max_slope_deg": drive.max_slope_deg,
        }
        layers = edge.ground_layers(
            self.edge, self.ground_m, self.trusted_distance_m, self.sigma_m, **sizes
        )
        inset_m = drive.wheel_m + 0.5 * drive.footprint_m
        free = layers.drivable(inset_m)
        if self._straight_edge:
            free &= behind_line(
                self.edge.plateau,
                view.elevation_m,
                self.cell,
                wheel_m=drive.wheel_m,
                cell_m=view.frame.cell_m,
            )
        cost = np.where(free, np.where(layers.roomy, 1.0, NEAR_COST), np.inf)
        if np.isinf(cost[self.cell]):
            beside = self._within(view.pose.x_m, view.pose.y_m, drive.footprint_m)
            inward = layers.rim_m >= min(inset_m, layers.rim_m[self.cell])
            cost[beside & inward & layers.passable & np.isinf(cost)] = NEAR_COST
        cost[self._trail(TRAIL_WIDTH * drive.footprint_m) & np.isinf(cost)] = NEAR_COST
        for x_m, y_m, radius_m in view.barred:
            cost[self._cells(x_m, y_m, radius_m)] = np.inf
        cost[self._trail(0.0) & np.isinf(cost)] = NEAR_COST
        for mate in view.others:
            # Two that stand beside each other may part: each may go where it comes no nearer.
            apart_m = math.hypot(mate.x_m - view.pose.x_m, mate.y_m - view.pose.y_m)
            kept_m = min(1.25 * drive.footprint_m, apart_m - 0.75 * view.frame.cell_m)
            if kept_m > 0.0:
                cost[self._cells(mate.x_m, mate.y_m, kept_m)] = np.inf
        return cost

    def _trail(self, width_m: float) -> Bools:
        """(H, W) the cells of the way that the robot has come, at least two cells wide.

        Its circle has covered more than the line, seen or not: about where it was put down the
        ground mostly is not, and a way that ended there would be an island.
        """
        frame, way = self.view.frame, self.view.trail_m
        trail = np.zeros(frame.shape, dtype=np.uint8)
        if way is not None and len(way) > 1:
            cells = frame.cells_of(way)[:, ::-1].astype(np.int32)
            width = max(2, round(width_m / frame.cell_m))
            cv2.polylines(trail, [cells.reshape(-1, 1, 2)], False, 1, width)
        return trail > 0

    @cached_property
    def travel(self) -> tuple[Floats, Ints]:
        """Distance and parent of every cell from the robot's (`paths.travel_field`)."""
        return paths.travel_field(self.cost, np.array((self.cell,)), self.view.frame.cell_m)

    @cached_property
    def candidates(self) -> Ints:
        """(N, 2) cells that a look may be taken from, the robot's own first.

        Points of a lattice fixed to the map that can be reached over open ground; if
        there are more than `max_candidates`, evenly many of them by distance.
        """
        view = self.view
        step = max(1, round(view.planner.candidate_step_m / view.frame.cell_m))
        lattice = np.zeros(view.frame.shape, dtype=np.bool_)
        lattice[step // 2 :: step, step // 2 :: step] = True
        distance = self.travel[0]
        rows, cols = np.nonzero(lattice & np.isfinite(distance) & (self.cost <= 1.0))
        order = np.argsort(distance[rows, cols], kind="stable")
        room = view.planner.max_candidates - 1
        if len(order) > room:
            order = order[np.linspace(0, len(order) - 1, room).astype(np.int64)]
        here = np.array((self.cell,), dtype=np.int64)
        others = np.column_stack((rows[order], cols[order])).astype(np.int64)
        if self.asked:
            others = np.concatenate((others, self._rim()))
        return np.concatenate((here, others[(others != here).any(axis=1)]))

    def _rim(self) -> Ints:
        """Return cells (N, 2) at the rim of the ground that can be driven, nearest to questions."""
        view = self.view
        assert view.questions is not None
        may = np.isfinite(self.travel[0]) & (self.cost <= 1.0)
        rim = may & ~(cv2.erode(may.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
        away_m = markov.distance_to_known_m(view.questions > 0, view.frame.cell_m)
        rim &= away_m < view.sensor.range_m
        rows, cols = np.nonzero(rim)
        order = np.argsort(away_m[rows, cols], kind="stable")
        taken = np.zeros(rim.shape, dtype=np.bool_)
        kept: list[tuple[int, int]] = []
        for row, col in np.column_stack((rows, cols))[order].tolist():
            if not taken[row, col] and len(kept) < RIM_MOST:
                kept.append((row, col))
                taken |= self._within(*view.frame.centre_of(row, col), RIM_STEP_M)
        return np.array(kept, dtype=np.int64).reshape(-1, 2)

    @cached_property
    def unsafe_p(self) -> Floats:
        """(H, W) P of Eq. 23: mean over the footprint of the chance to err by half a wheel."""
        drive = self.view.drive
        z = 0.5 * drive.wheel_m / np.maximum(self.sigma_m, 1e-6)
        table = np.array([2.0 * (1.0 - phi(v / 50.0)) for v in range(251)])
        chance = np.interp(z, np.arange(251) / 50.0, table)
        side = surface.odd_cells(drive.footprint_m, self.view.frame.cell_m)
        return surface.mean_over(chance, side)

    def path_m(self, cell: tuple[int, int]) -> Floats:
        """Return the corners (N, 2), metres, of the way from the robot to a cell."""
        cells = paths.straight_legs(paths.path_to(self.travel[1], cell), self.cost)
        frame = self.view.frame
        xy = np.array([frame.centre_of(int(r), int(c)) for r, c in cells])
        xy[0] = (self.view.pose.x_m, self.view.pose.y_m)
        return xy

    def arrival_sigma_m(self, path_m: Floats) -> Floats:
        """Return LE of Eq. 23: the robot's standard deviation after driving so far.

        Its present one, with odometry's drift along the way and a heading error that grows with it.
        """
        drive = self.view.drive
        yaw = np.radians(drive.yaw_sigma_deg_per_m) * path_m
        along = drive.odometry_sigma * path_m
        return np.sqrt(self.view.pose_sigma_m**2 + along**2 + (0.5 * yaw * path_m) ** 2)
