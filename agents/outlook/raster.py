"""Raster scanning, methods 1 and 2 of Sujan & Meggiolaro, section 3.2.

Positions row by row, to and fro, `candidate_step_m` apart, whatever the map shows: only where the
robot may drive, and whether anything at all is left to gain, is asked of it. The paper does not
say how the camera goes; here method 1 ("without yaw") keeps the heading with which the robot began
and takes one look at each position, method 2 ("with yaw") looks all round at each, one field of
view after another, before it goes on.
"""

import math

import numpy as np

from agents.geometry import Ints
from agents.outlook.base import Rated
from agents.planning.looks import Gains, LookPlan, look_gains, plan
from agents.planning.scene import Scene, View


class Raster(Rated):
    """Methods 1 and 2."""

    def __init__(self, *, yaw: bool) -> None:
        """Look all round at each position (`yaw`), or ahead only."""
        self._yaw = yaw
        self._been: list[tuple[float, float]] = []
        self._ahead_rad: float | None = None
        self._turns = 0

    def choose(self, view: View, rng: np.random.Generator) -> LookPlan | None:
        """Return the next look of the raster, None where no look anywhere is worth it."""
        scene = Scene(view)
        gains = look_gains(scene)
        if gains.best_bits < view.planner.min_gain_cells:
            return None
        if self._ahead_rad is None:
            self._ahead_rad = view.pose.yaw_rad
        turns = self._round(view)
        n = 0 if self._yaw and 0 < self._turns < turns else self._next(scene, gains.cells)
        if n > 0 or self._turns == turns:
            self._turns = 0
        heading_rad = self._ahead_rad + self._turns * 2.0 * math.pi / turns
        self._turns += 1
        bits = float(gains.bits[n].max())
        looks = np.full((len(gains.cells), 1, 1), bits)
        look = (np.array((heading_rad,)), gains.tilts_rad[:1])
        return plan(scene, Gains(gains.cells, *look, looks, gains.path_m), (n, 0, 0), 0.0)

    def _round(self, view: View) -> int:
        """Return how many looks are taken at one position."""
        return math.ceil(360.0 / view.sensor.fov_deg) if self._yaw else 1

    def _next(self, scene: Scene, cells: Ints) -> int:
        """Return the first position in raster order where no look was taken yet, else 0."""
        view = scene.view
        spacing_m = view.planner.candidate_step_m
        for n in serpentine(cells, max(1, round(spacing_m / view.frame.cell_m))):
            x, y = view.frame.centre_of(int(cells[n, 0]), int(cells[n, 1]))
            if all(math.hypot(x - a, y - b) >= 0.9 * spacing_m for a, b in self._been):
                self._been.append((x, y))
                return n
        return 0


def serpentine(cells: Ints, step: int) -> list[int]:
    """Return the order of cells (N, 2) row by row, every other row backwards."""
    band = cells[:, 0] // step
    along = np.where(band % 2 == 0, cells[:, 1], -cells[:, 1])
    return [int(i) for i in np.lexsort((along, band))]
