"""What a robot's map is worth, held against the truth that only the study knows."""

from typing import Any

import numpy as np

from agents.geometry import Floats
from agents.robot import Robot
from comms.timebase import to_s
from scenarios.records.tables import MapRow
from scenarios.scores.kinds import scorer_of
from scenarios.wire import Plan


class Scales:
    """Weighs one robot's team map; what has not changed since is not weighed anew."""

    def __init__(self, plan: Plan, robot: Robot) -> None:
        """Take the truth, and the robot."""
        self._observable = plan.observable
        self._robot = robot
        self._scorer = scorer_of(plan.terrain)
        self._scored: object = None
        self._score: tuple[float, float | None, int, float, float] = (0.0, None, 0, 0.0, 0.0)

    @property
    def heard(self) -> Any:
        """The team map, the own layer as others have it."""
        return self._robot.team.as_heard()

    def weigh(self, t_ns: int) -> tuple[MapRow, bool]:
        """Return what the robot knows, and whether its map has changed since it was last asked."""
        robot, team, heard = self._robot, self._robot.team, self.heard
        is_new = heard is not self._scored
        if is_new:
            self._scored = heard
            bits, error_m = team.kind.bits(heard), self._scorer.error_m(heard)
            self._score = (bits, error_m, int(heard.known.sum()), *self._layers())
        bits, error_m, cells, own_bits, heard_bits = self._score
        own, known = robot.own.known_cells(), team.known_entries()
        name = robot.settings.name
        row = MapRow(to_s(t_ns), name, own, known, bits, error_m, cells, own_bits, heard_bits)
        return row, is_new

    def _layers(self) -> tuple[float, float]:
        """Return the information of the own layer, and what is here of all others'."""
        bits = self._robot.team.layer_bits()
        me = self._robot.me.robot
        own = sum(value for origin, value in bits.items() if origin.robot == me)
        return own, sum(bits.values()) - own

    def coverage(self) -> float:
        """Return the share of the observable cells that its team map has."""
        done = self._scorer.done(self._robot.team.fused())
        every = int(np.count_nonzero(self._observable))
        return int(np.count_nonzero(done & self._observable)) / every if every else 0.0

    def done(self) -> Any:
        """Return the mask of the cells that count as mapped."""
        return self._scorer.done(self.heard)

    def charts(self) -> dict[str, Floats]:
        """Return the map as the robot's log keeps it."""
        return self._scorer.charts(self.heard)

    def grids(self) -> dict[str, Floats]:
        """Return the map as it is drawn and scored at the end, by name."""
        return self._scorer.grids(self.heard)
