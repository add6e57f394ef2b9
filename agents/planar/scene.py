"""A planar view worked out: what can be driven, what rays may pass, what is worth seeing."""

from functools import cached_property

import numpy as np

from agents.geometry import Bools, Floats, Ints
from agents.ground import paths
from agents.ground.markov import complete, distance_to_known_m
from agents.occupancy.passing import StopPrior, stop_share
from agents.occupancy.view import Means
from agents.planar.casting import HALF, Star, star_of
from agents.planar.sensing import MAPPED
from agents.planar.view import PlanarView

ASIDE = 1.0
"""By how much a cell beside one that can't be driven costs more."""
PRIOR = StopPrior(0.03)

__all__ = ["Means", "Scene"]


class Scene:
    """What follows from a view; everything is worked out when it is first asked for."""

    def __init__(
        self, view: PlanarView, means: Means, interest: Floats, pass_p: Floats | None = None
    ) -> None:
        """Take a view.

        Args:
            view: what the robot knows.
            means: what it has.
            interest: (rows, cols) weight of each cell's worth (Eq. 9).
            pass_p: (rows, cols) chance that a ray passes a cell if nothing was measured there;
                None: the share of steps that did, everywhere alike. Given, cells along a ray are
                held to stand or fall together (`casting.onward`).
        """
        self.view = view
        self.means = means
        self.interest = interest
        self._pass_p = pass_p
        self.related = pass_p is not None

    @cached_property
    def rays(self) -> Star:
        """The sensor's."""
        return star_of(self.means.sensor, self.view.frame.cell_m)

    @cached_property
    def here(self) -> tuple[int, int]:
        """The robot's cell, inside the grid."""
        frame = self.view.frame
        row, col = frame.cell_of(self.view.pose.x_m, self.view.pose.y_m)
        return min(max(row, 0), frame.rows - 1), min(max(col, 0), frame.cols - 1)

    @cached_property
    def cost(self) -> Floats:
        """(rows, cols) cost of a metre: 1, more beside what is not known to be free; inf there."""
        view, footprint_m = self.view, self.means.drive.footprint_m
        cell_m = view.frame.cell_m
        blocked = ~(view.mapped & (view.log_odds < 0))
        rows, cols = np.indices(view.frame.shape)
        apart_m = np.hypot(rows - self.here[0], cols - self.here[1]) * cell_m
        # It stands there: what its body covers is free, though it never saw it.
        blocked &= (apart_m > 0.5 * footprint_m + cell_m) | (view.log_odds > 0)
        gap_m = distance_to_known_m(np.pad(blocked, 1, constant_values=True), cell_m)[1:-1, 1:-1]
        least_m = 0.5 * footprint_m + 0.5 * cell_m - 1e-3
        cost = np.where(gap_m < least_m + 0.9 * cell_m, 1.0 + ASIDE, 1.0)
        return np.where(gap_m > least_m, cost, np.inf)

    @cached_property
    def _field(self) -> tuple[Floats, Ints]:
        starts = np.array([self.here], dtype=np.int64)
        return paths.travel_field(self.cost, starts, self.view.frame.cell_m)

    @property
    def way_m(self) -> Floats:
        """(rows, cols) cost of the way to each cell in metres; inf where none leads."""
        return self._field[0]

    def path_m(self, cell: tuple[int, int]) -> Floats:
        """Return the corners (N, 2) of the way to a cell, from where the robot stands."""
        frame = self.view.frame
        here = np.array([[self.view.pose.x_m, self.view.pose.y_m]])
        if cell == self.here:
            return here
        corners = paths.straight_legs(paths.path_to(self._field[1], cell), self.cost)
        centres = [frame.centre_of(int(row), int(col)) for row, col in corners[1:]]
        return np.concatenate((here, np.array(centres)))

    def lattice(self, rng: np.random.Generator) -> Ints:
        """Return the cells (N, 2) where a look may be taken: the robot's own, then a lattice.

        It has `candidate_step_m` and an offset drawn by lot.
        """
        step = max(1, round(self.means.planner.candidate_step_m / self.view.frame.cell_m))
        offset = rng.integers(step, size=2)
        open_cells = np.argwhere(np.isfinite(self.way_m))
        return self._with_own(open_cells[((open_cells + offset) % step == 0).all(axis=1)])

    def everywhere(self) -> Ints:
        """Return the robot's own cell, and one of each square of `candidate_step_m` (N, 2).

        It is the one nearest to the square's middle that can be driven to, so that a passage that
        the lattice steps over is not left out: what is worth no look from here is worth none.
        """
        step = max(1, round(self.means.planner.candidate_step_m / self.view.frame.cell_m))
        cells = np.argwhere(np.isfinite(self.way_m))
        square, within = np.divmod(cells, step)
        aside = ((within - (step - 1) / 2) ** 2).sum(axis=1)
        order = np.argsort(aside, kind="stable")
        _, first = np.unique(square[order], axis=0, return_index=True)
        return self._with_own(cells[np.sort(order[first])])

    def _with_own(self, cells: Ints) -> Ints:
        cells = cells[(cells != np.array(self.here)).any(axis=1)]
        return np.concatenate((np.array([self.here], dtype=np.int64), cells))

    def candidates(self, rng: np.random.Generator) -> Ints:
        """Return the robot's own cell and a sample of the lattice: `max_candidates` (N, 2)."""
        return self.sampled(self.lattice(rng), rng)

    def sampled(self, cells: Ints, rng: np.random.Generator) -> Ints:
        """Return the first of some cells (N, 2) and a sample of the others: `max_candidates`."""
        most = self.means.planner.max_candidates
        if len(cells) > most:
            drawn = 1 + rng.choice(len(cells) - 1, most - 1, replace=False)
            cells = cells[np.concatenate(([0], np.sort(drawn)))]
        return cells

    @cached_property
    def occupancy_p(self) -> Floats:
        """(rows, cols) probability of occupancy; of unmeasured cells the Markov estimate."""
        p = 1.0 / (1.0 + np.exp(-self.view.log_odds))
        measured = self.measured
        if not measured.any():
            return np.full(p.shape, 0.5)
        return np.clip(complete(np.where(measured, p, np.nan)), 0.0, 1.0)

    @cached_property
    def measured(self) -> Bools:
        """(rows, cols) cells that were ever measured."""
        return self.view.log_odds != 0

    @cached_property
    def stop_p(self) -> float:
        """Probability that a step from a free cell is stopped by a solid one, on the map so far."""
        return stop_share(self.view.log_odds < 0, self.view.log_odds > 0, (0, 1), PRIOR)

    @cached_property
    def through(self) -> Floats:
        """(rows, cols) probability that a ray passes: by the map, else what was given."""
        known = np.where(self.view.log_odds < 0, 1.0, 0.0)
        blank = 1.0 - self.stop_p if self._pass_p is None else self._pass_p
        return np.where(self.measured, known, blank)

    @cached_property
    def lacking(self) -> Floats:
        """(rows, cols) log-odds by which cells fall short of being mapped."""
        return np.maximum(MAPPED + 1e-9 - np.abs(self.view.log_odds), 0.0)

    @cached_property
    def worth(self) -> Floats:
        """(rows, cols) what it counts to map a cell, weighed by interest."""
        left = np.where(self.measured, 1.0 - HALF, 1.0)
        return np.where(self.view.mapped, 0.0, left) * self.interest
