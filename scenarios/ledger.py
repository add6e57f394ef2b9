"""What the sensors of a team measured, kept by the world and not by the robots.

A map is held against it: it must not be surer of a cell than all that was ever measured there. Kept
only where somebody is going to ask (`scenarios.chaos`).
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.geometry import Floats
from agents.maps.elevationlook import bin_look
from agents.ports import Exposure
from agents.robot import Robot

Entry = tuple[bytes, bytes]
"""One look: the cells (flat indices, int32) and the information that each got (float32, 1/m^2)."""


def entry(exposure: Exposure, robot: Robot) -> Entry:
    """Return what one look of a robot measured, from the exposure itself.

    Nothing of the robot's map is used, but where the robot believes to stand.
    """
    settings = robot.settings
    drawn_at, beyond = robot.placing()
    cells = bin_look(
        exposure,
        drawn_at,
        settings.frame,
        attitude_sigma_rad=math.radians(settings.sensor.attitude_sigma_deg),
        extra_variance=beyond,
    )
    flat = cells.rows * settings.frame.cols + cells.cols
    return flat.astype(np.int32).tobytes(), (1.0 / cells.variance_m2).astype(np.float32).tobytes()


class Ledger:
    """Sums, by robot: all its lives together."""

    def __init__(self, shape: tuple[int, int]) -> None:
        """Begin with nothing measured on a grid (rows, cols)."""
        self._shape = shape
        self._sums: dict[str, Floats] = {}

    def add(self, name: str, entries: Sequence[Sequence[Any]]) -> None:
        """Enter looks of a robot."""
        for cells, information in entries:
            sums = self._sums.setdefault(name, np.zeros(self._shape))
            sums.ravel()[np.frombuffer(cells, np.int32)] += np.frombuffer(information, np.float32)

    def information(self, name: str) -> Floats:
        """Return the information (rows, cols), 1/m^2, that a robot's sensors gave in all."""
        return self._sums.get(name, np.zeros(self._shape))
