"""What the sensors of a team measured, kept by the world and not by the robots.

A map is held against it: it must not be surer of a cell than all that was ever measured there. Kept
only where somebody is going to ask (`scenarios.chaos`).
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from agents.geometry import Floats, GridFrame
from agents.layers import Anchor, drawn_cells
from agents.maps.elevationlook import bin_look
from agents.ports import Exposure
from agents.robot import Robot
from agents.store import AnchorKey

Entry = tuple[AnchorKey, bytes, bytes]
"""One look: the submap that it was drawn in, the cells (flat indices, int32) and the information
that each got (float32, 1/m^2)."""


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
    flat = (cells.rows * settings.frame.cols + cells.cols).astype(np.int32)
    submap = AnchorKey(*robot.me, len(robot.own.submaps) - 1)
    return submap, flat.tobytes(), (1.0 / cells.variance_m2).astype(np.float32).tobytes()


class Ledger:
    """Sums, by submap."""

    def __init__(self, frame: GridFrame) -> None:
        """Begin with nothing measured on the team's grid."""
        self._frame, self._shape = frame, frame.shape
        self._sums: dict[str, dict[AnchorKey, Floats]] = {}

    def add(self, name: str, entries: Sequence[Sequence[Any]]) -> None:
        """Enter looks of a robot."""
        for submap, cells, information in entries:
            of_robot = self._sums.setdefault(name, {})
            sums = of_robot.setdefault(AnchorKey(*submap), np.zeros(self._shape))
            sums.ravel()[np.frombuffer(cells, np.int32)] += np.frombuffer(information, np.float32)

    def information(self, name: str) -> Floats:
        """Return the information (rows, cols), 1/m^2, that a robot's sensors gave in all its lives.

        Where it was drawn, before any anchor was corrected.
        """
        return sum(self._sums.get(name, {}).values(), np.zeros(self._shape))

    def laid(self, name: str, moved: Mapping[AnchorKey, Anchor]) -> Floats:
        """Return the same, each submap where its anchor, if it was corrected, puts it."""
        total = np.zeros(self._shape)
        for key, drawn in self._sums.get(name, {}).items():
            if key in moved:
                rows, cols, inside = drawn_cells(moved[key], self._frame)
                total += np.where(inside, drawn[rows, cols], 0.0)
            else:
                total += drawn
        return total
