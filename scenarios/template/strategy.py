"""A way to choose the next look, for robots that map ground."""

import numpy as np

from agents.planning.looks import look_gains, plan
from agents.planning.strategies import LookPlan, Rated, Scene, View


class Strategy(Rated):
    """Most new information for each metre of the way: the near looks first."""

    def choose(self, view: View, rng: np.random.Generator) -> LookPlan | None:
        """Return the next look, or None when none is worth taking: then the robot is done.

        `view` is all that the robot knows: the team's map, where everybody is, its own sensor.
        Draw numbers from `rng` only, so that a run can be made again.
        """
        scene = Scene(view)  # the map with what can be driven to, and the cliff's edge
        gains = look_gains(scene)  # (positions, headings, tilts) in bits, and the ways there
        if gains.best_bits < view.planner.min_gain_cells:
            return None
        worth = gains.bits / (2.0 + gains.path_m[:, None, None])
        n, k, t = (int(i) for i in np.unravel_index(np.argmax(worth), worth.shape))
        return plan(scene, gains, (n, k, t), float(worth[n, k, t]))
