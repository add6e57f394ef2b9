"""Where to look next: strategies by name, the paper's method 5 first.

A strategy turns a `View` into a `LookPlan`. The paper's (methods 3 to 5 of section 3.2) rate
candidate poses by Eq. 23: positions on a lattice inside the cliff-edge polygon, inset, that can be
driven to, each with a cycle of headings and tilts; a look's worth is Eq. 3 with Eq. 5 and
(method 5) Eq. 9; method 3 takes the edge for a straight line. Rasters (methods 1 and 2) and ours,
`team-information`, are in `agents.outlook`.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from agents.geometry import Pose, Singles
from agents.outlook.base import Rated, Strategy
from agents.outlook.raster import Raster
from agents.outlook.team import TeamInformation
from agents.planning.looks import LookPlan, expected_visibility, look_gains, plan
from agents.planning.rating import rate
from agents.planning.scene import Scene, View
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


class Information(Rated):
    """The paper's method: the look that the rating function likes best (methods 3 to 5)."""

    def __init__(self, *, interest: bool, straight_edge: bool = False) -> None:
        self._interest = interest
        self._straight_edge = straight_edge

    def choose(self, view: View, rng: np.random.Generator) -> LookPlan | None:
        """Return the best rated look whose gain is at least `min_gain_cells`."""
        if not self._interest:
            view = replace(view, interest=np.ones(view.frame.shape))
        scene = Scene(view, straight_edge=self._straight_edge)
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


STRATEGIES: Plugins[Callable[[], Strategy]] = Plugins(
    "ropeteam.strategies",
    {
        "information-interest": lambda: Information(interest=True),
        "information-edge": lambda: Information(interest=False),
        "information-line": lambda: Information(interest=False, straight_edge=True),
        "raster": lambda: Raster(yaw=False),
        "raster-yaw": lambda: Raster(yaw=True),
        "team-information": TeamInformation,
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
