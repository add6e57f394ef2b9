"""Mapping space: what a robot with a voxel occupancy map expects, fuses and chooses."""

import asyncio
import math
from typing import TYPE_CHECKING, cast

import numpy as np

from agents.anchoring import submap_name
from agents.fusion import offset_between, rotate_covariance
from agents.geometry import Floats, Ints, Pose, wrap_angle
from agents.localising import GATE
from agents.mapper import Expected, NextLook
from agents.maps.planar import MAPPED
from agents.maps.voxellook import chances, look_odds
from agents.ports import Exposure
from agents.voxel.choosing import method
from agents.voxel.frame import CUBE, Block, VoxelFrame, VoxelSet, by_block
from agents.voxel.matching import match
from agents.voxel.scene import Scene
from agents.voxel.view import Means, VoxelView

if TYPE_CHECKING:
    from agents.robot import Robot

LEAST_P = 0.05
"""A cell that was less likely to be seen has lost no interest by not being seen."""


class VoxelMapper:
    """`agents.mapper.Mapper` of voxel maps."""

    def __init__(self, robot: "Robot") -> None:
        """Serve a robot."""
        self.robot = robot
        self.settings = s = robot.settings
        self.frame = cast("VoxelFrame", s.frame)
        self.method = method(s.method, s.sensor, s.drive, s.planner)
        self._interest: dict[Block, Floats] = {}
        nowhere = np.zeros((0, 3), dtype=np.int64)
        self._stood = self._way = nowhere
        """Cells where its wheels have been, and those of the way that it goes."""
        self._expected: tuple[Ints, Floats] = nowhere, np.zeros(0)

    @property
    def first_looks(self) -> tuple[tuple[float, float], ...]:
        """All round, once at each tilt: from there on every look is chosen."""
        planner = self.settings.planner
        count = planner.first_looks
        tilt_rad = math.radians(planner.tilts_deg[0])
        return tuple((2.0 * math.pi * n / count, tilt_rad) for n in range(count))

    async def expect(self, pan_rad: float, tilt_rad: float) -> Expected:
        """Return the cells that the look's rays reach on the map as it is (Eq. 5)."""
        self._stood = np.unique(np.concatenate((self._stood, self._way)), axis=0)
        scene = Scene(self.view(), self._means)
        cells, p = chances(
            scene.packed.index,
            scene.through,
            1.0 - scene.stop_p,
            _panned(self.robot.pose, pan_rad),
            tilt_rad,
            self.frame,
            self.settings.sensor,
        )
        self._expected = cells, p
        return Expected(float(p.sum()), p)

    async def localise(self, exposure: Exposure) -> None:
        """Hold the look against the map, and correct the pose by it.

        The map lies no better than its anchors do: what is corrected is where the robot stands
        against the newest of them.
        """
        robot = self.robot
        if not robot.own.submaps:
            return
        scene = Scene(self.view(), self._means)
        found = await asyncio.to_thread(
            match,
            scene.packed.index,
            scene.charted,
            self.frame,
            _panned(robot.pose, exposure.pan_rad),
            exposure.tilt_rad,
            robot.filter.covariance,
            exposure.ranges_m,
            self.settings.sensor,
        )
        name = submap_name(len(robot.own.submaps) - 1)
        if found is not None and robot.filter.holds(name):
            stood = _panned(found.pose, -exposure.pan_rad)
            offset, _, turn = offset_between(robot.filter.pose_of(name), stood)
            covariance = rotate_covariance(found.covariance, turn)
            robot.filter.fix_against(name, offset, covariance, gate=GATE)
            robot.correct_anchors()

    async def fuse(self, exposure: Exposure, expected: Expected) -> None:
        """Add one look's log-odds to the own layer."""
        robot = self.robot
        index, submap = robot.current_submap()
        known_before = robot.team.fused().known
        drawn_at, beyond = robot.placing()
        look = look_odds(
            exposure.ranges_m,
            _panned(drawn_at, exposure.pan_rad),
            exposure.tilt_rad,
            self.frame,
            self.settings.sensor,
            extra_variance=beyond,
        )
        submap.observe(look)
        measured = VoxelSet.of(look.cells)
        robot.looked(
            index,
            exposure,
            expected.cells,
            drawn=measured,
            measured=measured,
            new=measured & ~known_before,
        )
        self._lose_interest()

    def _lose_interest(self) -> None:
        """Lose interest in what the look was expected to map, and did not (Eq. 9).

        A cell in which rays are now stopped and now not is measured by every look, and mapped by
        none: so being measured does not win interest back, as on other maps; mapped cells need
        none.
        """
        beta = self.settings.planner.beta
        cells, p = self._expected
        likely = p > LEAST_P
        cubes = self.robot.team.fused().cubes
        for block, which, places in by_block(cells[likely]):
            share = self._interest.setdefault(block, np.ones(CUBE)).ravel()
            cube = cubes.get(block)
            if cube is None:
                missed = np.ones(len(places), dtype=np.bool_)
            else:
                missed = np.abs(cube.log_odds.ravel()[places]) <= MAPPED
            share[places[missed]] *= np.exp(-beta * p[likely][which[missed]])

    @property
    def _means(self) -> Means:
        s = self.settings
        return Means(s.sensor, s.drive, s.planner)

    def view(self) -> VoxelView:
        """Return what the planner sees: the team map and where everybody is."""
        robot = self.robot
        x, y, z, yaw = (float(v) for v in np.diag(robot.filter.covariance))
        return VoxelView(
            frame=self.frame,
            map=robot.team.fused(),
            pose=robot.pose,
            interest=self._interest,
            stood=self._stood,
            others=tuple(mate.status.pose for _, mate in sorted(robot.mates.items())),
            claims=tuple(robot.regions(wished=False)),
            variance=(x, y, z, yaw),
        )

    async def choose(self) -> NextLook | None:
        """Choose the next look, by the method that is set."""
        look = await asyncio.to_thread(self.method.choose, self.view(), self.robot.rng)
        if look is None:
            return None
        self._way = look.cells
        return NextLook(look.path_m, look.yaw_rad, look.tilt_rad, look.claim)

    def halted(self) -> float | None:
        """Look at what stands ahead; how far it came on its way is not known."""
        self._way = self._way[:1]
        return 0.0


def _panned(pose: Pose, pan_rad: float) -> Pose:
    """Return the pose with the camera's yaw: where it points."""
    return Pose(pose.x_m, pose.y_m, pose.z_m, wrap_angle(pose.yaw_rad + pan_rad))
