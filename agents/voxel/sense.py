"""How a robot with a voxel occupancy map sees and plans (`agents.occupancy.mapper.Sense`)."""

import math
from typing import cast

import numpy as np

from agents.briefing import AgentSettings
from agents.geometry import Floats, Ints, Pose
from agents.mapper import Expected, NextLook
from agents.maps.occupancy import MAPPED
from agents.maps.voxel import VoxelOccupancy
from agents.maps.voxellook import VoxelLook, chances, look_odds
from agents.occupancy.matching import Match
from agents.occupancy.view import Means, Situation
from agents.ports import Exposure
from agents.voxel.choosing import method
from agents.voxel.frame import CUBE, Block, VoxelFrame, VoxelSet, by_block
from agents.voxel.matching import match
from agents.voxel.scene import Scene
from agents.voxel.view import VoxelView

ALL_MISSED = 0.3
"""What stands and falls together: of a look that shows nothing of what it was expected to, each
cell is blamed as if it had been seen with this chance at least, however unlikely it was. Else many
cells with a small chance each, behind a gap that is none, would hold a robot for ever ..."""
MISSED_POWER = 4
"""... and of a look that missed a share, by this power of it: most looks miss some."""


class VoxelSense:
    """One robot's, in space."""

    def __init__(self, settings: AgentSettings) -> None:
        """Take what it has to see and drive with, and its method."""
        self.settings = s = settings
        self.frame = cast("VoxelFrame", s.frame)
        self.means = Means(s.sensor, s.drive, s.planner)
        self.method = method(s.method, self.means)
        self._interest: dict[Block, Floats] = {}
        nowhere = np.zeros((0, 3), dtype=np.int64)
        self._stood = self._way = nowhere
        """Cells where its wheels have been, and those of the way that it goes."""
        self._expected: tuple[Ints, Floats] = nowhere, np.zeros(0)

    @property
    def first_looks(self) -> tuple[tuple[float, float], ...]:
        """All round, at the first tilt: from there on every look is chosen."""
        planner = self.settings.planner
        count = planner.first_looks
        tilt_rad = math.radians(planner.tilts_deg[0])
        return tuple((2.0 * math.pi * n / count, tilt_rad) for n in range(count))

    @property
    def all_round(self) -> tuple[tuple[float, float], ...]:
        """The same."""
        return self.first_looks

    def view(self, fused: VoxelOccupancy, situation: Situation) -> VoxelView:
        """Return all of space."""
        return VoxelView(self.frame, fused, self._interest, self._stood, **vars(situation))

    def arrived(self) -> None:
        """Take the way that it went for floor: no camera sees what is under the robot."""
        self._stood = np.unique(np.concatenate((self._stood, self._way)), axis=0)

    def expect(self, view: VoxelView, camera: Pose, tilt_rad: float) -> Expected:
        """Return the cells that the look's rays reach (Eq. 5)."""
        scene = Scene(view, self.means)
        cells, p = chances(
            scene.packed.index,
            scene.through,
            1.0 - scene.stop_p,
            camera,
            tilt_rad,
            self.frame,
            self.settings.sensor,
        )
        fresh = ~scene.mapped_at(cells)
        self._expected = cells[fresh], p[fresh]
        return Expected(float(p.sum()), p)

    def match(
        self, view: VoxelView, camera: Pose, covariance: Floats, exposure: Exposure
    ) -> Match | None:
        """See `agents.voxel.matching`."""
        scene = Scene(view, self.means)
        return match(
            scene.packed.index,
            scene.charted,
            self.frame,
            camera,
            exposure.tilt_rad,
            covariance,
            exposure.ranges_m,
            self.settings.sensor,
        )

    def measured(
        self, exposure: Exposure, camera: Pose, extra_variance: tuple[float, float, float, float]
    ) -> tuple[VoxelLook, VoxelSet]:
        """Return the log-odds of a look, and the set of its cells."""
        look = look_odds(
            exposure.ranges_m,
            camera,
            exposure.tilt_rad,
            self.frame,
            self.settings.sensor,
            extra_variance=extra_variance,
        )
        return look, VoxelSet.of(look.cells)

    def fused(self, fused: VoxelOccupancy) -> None:
        """Lose interest in what the look was expected to map, and did not (Eq. 9).

        A cell in which rays are now stopped and now not is measured by every look, and mapped by
        none: so being measured does not win interest back, as on other maps; mapped cells need
        none.
        """
        beta, (cells, p) = self.settings.planner.beta, self._expected
        missed = np.ones(len(cells), dtype=np.bool_)
        parts = by_block(cells)
        for block, which, places in parts:
            cube = fused.cubes.get(block)
            if cube is not None:
                missed[which] = np.abs(cube.log_odds.ravel()[places]) <= MAPPED
        share_missed = float(p[missed].sum()) / max(float(p.sum()), 1e-9)
        blamed = np.maximum(p, ALL_MISSED * share_missed**MISSED_POWER)
        for block, which, places in parts:
            share, lost = self._interest.setdefault(block, np.ones(CUBE)).ravel(), missed[which]
            share[places[lost]] *= np.exp(-beta * blamed[which[lost]])

    def choose(self, view: VoxelView, rng: np.random.Generator) -> NextLook | None:
        """Choose a look, and remember the way there."""
        look = self.method.choose(view, rng)
        if look is None:
            return None
        self._way = look.cells
        return NextLook(look.path_m, look.yaw_rad, look.tilt_rad, look.claim)

    def halted(self, pose: Pose) -> None:
        """Forget the way but its beginning: how far it came is not known."""
        del pose
        self._way = self._way[:1]
