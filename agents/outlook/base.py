"""What a way to choose looks at the ground has to answer."""

from typing import Protocol

import numpy as np

from agents.geometry import Pose, Singles
from agents.planning.looks import LookPlan, expected_visibility
from agents.planning.scene import View


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
