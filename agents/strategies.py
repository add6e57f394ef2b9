"""Where to look next: strategies by name, the paper's method 5 first.

A strategy turns a `View` into a `LookPlan`. The paper's (methods 4 and 5 of section 3) rate
candidate poses by Eq. 23: positions on a lattice inside the cliff-edge polygon, inset, that can be
driven to, each with a cycle of headings and tilts; a look's worth is Eq. 3 with Eq. 5 and
(method 5) Eq. 9. Method 3, a straight edge, belongs to the experiments.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from agents.geometry import Ints, Pose, Singles
from agents.looks import LookPlan, expected_visibility, look_gains, plan
from agents.rating import rate
from agents.scene import Scene, View
from comms.plugins import Plugins

__all__ = [
    "STRATEGIES",
    "LookPlan",
    "Rated",
    "Scene",
    "Strategy",
    "View",
    "expected_visibility",
    "strategy",
]


class Strategy(Protocol):
    """Chooses looks for one robot."""

    def choose(self, view: View, rng: np.random.Generator) -> LookPlan | None:
        """Return the next look, or None when no look is worth `min_gain_cells` bits."""
        ...

    def expect(self, view: View, pose: Pose, pan_rad: float, tilt_rad: float) -> Singles:
        """Return each cell's probability (H, W) of being measured in a look from a pose."""
        ...


class Rated:
    """What all strategies expect of a look that rate looks by what they would show."""

    def expect(self, view: View, pose: Pose, pan_rad: float, tilt_rad: float) -> Singles:
        """Return each cell's probability (H, W) of being measured in a look from a pose."""
        return expected_visibility(view, pose, pan_rad, tilt_rad)


class Information(Rated):
    """The paper's method: the look that the rating function likes best (methods 4 and 5)."""

    def __init__(self, *, interest: bool) -> None:
        self._interest = interest

    def choose(self, view: View, rng: np.random.Generator) -> LookPlan | None:
        """Return the best rated look whose gain is at least `min_gain_cells`."""
        if not self._interest:
            view = replace(view, interest=np.ones(view.frame.shape))
        scene = Scene(view)
        gains = look_gains(scene)
        worthy = gains.bits >= max(view.planner.min_gain_cells, 1e-9)
        if not worthy.any():
            return None
        rows, cols = gains.cells[:, 0], gains.cells[:, 1]
        unsafe = scene.unsafe_p[rows, cols]
        unsafe[0] = 0.0
        ratings = rate(
            gains.bits,
            gains.path_m[:, None, None],
            scene.arrival_sigma_m(gains.path_m)[:, None, None],
            unsafe[:, None, None],
            best_bits=gains.best_bits,
            range_m=view.sensor.range_m,
            cell_m=view.frame.cell_m,
            planner=view.planner,
        )
        best = int(np.argmax(np.where(worthy, ratings, -np.inf)))
        n, k, t = (int(i) for i in np.unravel_index(best, ratings.shape))
        return plan(scene, gains, (n, k, t), float(ratings[n, k, t]))


class Random(Rated):
    """A candidate look drawn by lot, until none is worth taking."""

    def choose(self, view: View, rng: np.random.Generator) -> LookPlan | None:
        """Return any candidate look, all equally likely."""
        scene = Scene(view)
        gains = look_gains(scene)
        if gains.best_bits < view.planner.min_gain_cells:
            return None
        drawn = int(rng.integers(gains.bits.size))
        n, k, t = (int(i) for i in np.unravel_index(drawn, gains.bits.shape))
        return plan(scene, gains, (n, k, t), 0.0)


class Raster(Rated):
    """Positions row by row, to and fro, one look at each (method 1); the heading goes round."""

    def __init__(self) -> None:
        self._been: list[tuple[float, float]] = []

    def choose(self, view: View, rng: np.random.Generator) -> LookPlan | None:
        """Return the first position in raster order where no look was taken yet."""
        scene = Scene(view)
        gains = look_gains(scene)
        count, spacing = len(self._been), view.planner.candidate_step_m
        if gains.best_bits < view.planner.min_gain_cells:
            return None
        for n in _serpentine(gains.cells, max(1, round(spacing / view.frame.cell_m))):
            x, y = view.frame.centre_of(int(gains.cells[n, 0]), int(gains.cells[n, 1]))
            if all(math.hypot(x - a, y - b) >= 0.9 * spacing for a, b in self._been):
                break
        else:
            n = 0
            x, y = view.pose.x_m, view.pose.y_m
        self._been.append((x, y))
        k, t = count % len(gains.headings_rad), count % len(gains.tilts_rad)
        return plan(scene, gains, (n, k, t), 0.0)


class Wander:
    """A step somewhere and a look that way, whatever the map says: costs next to no computing.

    For trials in which it does not matter what is looked at (`ropeteam chaos --small`).
    """

    def choose(self, view: View, rng: np.random.Generator) -> LookPlan | None:
        """Return a look a step away, in a direction drawn by lot."""
        heading_rad = float(rng.uniform(-math.pi, math.pi))
        step_m = view.planner.candidate_step_m
        here = (view.pose.x_m, view.pose.y_m)
        there = (
            here[0] + step_m * math.cos(heading_rad),
            here[1] + step_m * math.sin(heading_rad),
        )
        tilt_rad = math.radians(view.planner.tilts_deg[0])
        return LookPlan(there, np.array((here, there)), heading_rad, 0.0, tilt_rad, 0, 0.0, 0.0)

    def expect(self, view: View, pose: Pose, pan_rad: float, tilt_rad: float) -> Singles:
        """Expect nothing."""
        del pose, pan_rad, tilt_rad
        return np.zeros(view.frame.shape, dtype=np.float32)


def _serpentine(cells: Ints, step: int) -> list[int]:
    """Return the order of cells row by row, every other row backwards."""
    band = cells[:, 0] // step
    along = np.where(band % 2 == 0, cells[:, 1], -cells[:, 1])
    return [int(i) for i in np.lexsort((along, band))]


STRATEGIES: Plugins[Callable[[], Strategy]] = Plugins(
    "ropeteam.strategies",
    {
        "information-interest": lambda: Information(interest=True),
        "information-edge": lambda: Information(interest=False),
        "raster": Raster,
        "random": Random,
        "wander": Wander,
    },
)
"""By name; each is called without arguments for every robot."""


def strategy(name: str) -> Strategy:
    """Return a new strategy for one robot.

    Raises:
        PluginError: there is none of that name.
    """
    return STRATEGIES.find(name)()
