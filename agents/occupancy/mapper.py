"""Mapping by occupancy: what a robot expects of a look, fuses, and where it looks next.

On a floor and in space it goes about it alike; how it sees and plans there is its `Sense`.
"""

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from agents.briefing import AgentSettings
from agents.fusion import offset_between, rotate_covariance
from agents.geometry import Floats, Pose, wrap_angle
from agents.layers import Mask
from agents.mapper import Expected, NextLook
from agents.occupancy.matching import Match
from agents.occupancy.view import Situation
from agents.ports import Exposure
from agents.pose.anchoring import submap_name
from agents.pose.localising import GATE

if TYPE_CHECKING:
    from agents.robot import Robot


class Sense(Protocol):
    """One robot's seeing and planning on one kind of occupancy map.

    Cameras' poses are the robot's, with the yaw where the camera points.
    """

    @property
    def first_looks(self) -> tuple[tuple[float, float], ...]:
        """Pans and tilts, from ahead, of the looks that are taken before anything is chosen."""
        ...

    @property
    def all_round(self) -> tuple[tuple[float, float], ...]:
        """Pans and tilts, from ahead, of looks that leave out no direction."""
        ...

    def view(self, fused: Any, situation: Situation) -> Any:
        """Return what the planner sees of a team map."""
        ...

    def arrived(self) -> None:
        """Note that it stands where it last chose to look from."""
        ...

    def expect(self, view: Any, camera: Pose, tilt_rad: float) -> Expected:
        """Return what a look is expected to measure."""
        ...

    def match(
        self, view: Any, camera: Pose, covariance: np.ndarray, exposure: Exposure
    ) -> Match | None:
        """Return from where a look's ranges fit the map, None where they don't tell."""
        ...

    def measured(
        self, exposure: Exposure, camera: Pose, extra_variance: tuple[float, float, float, float]
    ) -> tuple[Any, Mask]:
        """Return what a look adds to a submap, and the cells that it measured.

        `extra_variance` is that of (x, y, z, yaw) against the submap's anchor.
        """
        ...

    def fused(self, fused: Any) -> None:
        """Note how the team map is once a look was taken in."""
        ...

    def choose(self, view: Any, rng: np.random.Generator) -> NextLook | None:
        """Return the next look, or None when no look is worth taking."""
        ...

    def halted(self, pose: Pose) -> None:
        """Note that the robot was stopped at a pose."""
        ...


class OccupancyMapper:
    """`agents.mapper.Mapper` of occupancy maps."""

    def __init__(self, robot: "Robot", sense: Callable[[AgentSettings], Sense]) -> None:
        """Serve a robot by its seeing and planning, as `sense` makes them."""
        self.robot = robot
        self._make = sense
        self.relocated()

    def relocated(self) -> None:
        """Begin with nothing planned or remembered of places."""
        self.sense = self._make(self.robot.settings)

    @property
    def first_looks(self) -> tuple[tuple[float, float], ...]:
        """See `Sense.first_looks`."""
        return self.sense.first_looks

    @property
    def all_round(self) -> tuple[tuple[float, float], ...]:
        """See `Sense.all_round`."""
        return self.sense.all_round

    async def expect(self, pan_rad: float, tilt_rad: float) -> Expected:
        """Return the cells that the look's rays reach on the map as it is."""
        self.sense.arrived()
        return self.sense.expect(self.view(), panned(self.robot.pose, pan_rad), tilt_rad)

    async def localise(self, exposure: Exposure) -> None:
        """Hold the look against the map, and correct the pose by it.

        What fits the map says where the robot is on it, not where the map is: the map lies no
        better than its anchors do. So it is a measurement against the newest of them.
        """
        robot = self.robot
        if not (robot.own.submaps and robot.settings.map.matching):
            return
        camera = panned(robot.pose, exposure.pan_rad)
        found = await asyncio.to_thread(
            self.sense.match, self.view(), camera, robot.filter.covariance, exposure
        )
        name = submap_name(len(robot.own.submaps) - 1)
        if found is not None and robot.filter.holds(name):
            stood = panned(found.pose, -exposure.pan_rad)
            offset, _, turn = offset_between(robot.filter.pose_of(name), stood)
            covariance = rotate_covariance(found.covariance, turn)
            robot.filter.fix_against(name, offset, covariance, gate=GATE)
            robot.correct_anchors()

    async def fuse(self, exposure: Exposure, expected: Expected) -> None:
        """Add one look's log-odds to the own layer."""
        robot = self.robot
        index, submap = robot.current_submap()
        known_before = robot.charted().known
        drawn_at, beyond = robot.placing()
        camera = panned(drawn_at, exposure.pan_rad)
        look, measured = self.sense.measured(exposure, camera, beyond)
        submap.observe(look)
        robot.looked(
            index,
            exposure,
            expected.cells,
            drawn=measured,
            measured=measured,
            new=measured & ~known_before,
        )
        self.sense.fused(robot.charted())

    def view(self) -> Any:
        """Return what the planner sees: the team map and where everybody is.

        Of a robot that does not know where it is, its own map and nobody.
        """
        robot = self.robot
        mates = sorted(robot.mates.items()) if robot.located else []
        x, y, z, yaw = (float(v) for v in np.diag(robot.filter.covariance))
        situation = Situation(
            pose=robot.pose,
            others=tuple(mate.status.pose for _, mate in mates),
            claims=tuple(robot.interest.regions(wished=False)) if robot.located else (),
            variance=(x, y, z, yaw),
        )
        return self.sense.view(robot.charted(), situation)

    async def choose(self) -> NextLook | None:
        """Choose the next look, by the method that is set."""
        return await asyncio.to_thread(self.sense.choose, self.view(), self.robot.rng)

    async def way_to_see(self, mate: Pose) -> Floats | None:
        """Stay: nobody goes down here, nor asks to be seen."""
        del mate
        return np.array(((self.robot.pose.x_m, self.robot.pose.y_m),))

    def halted(self) -> float | None:
        """Look at what stands ahead."""
        self.sense.halted(self.robot.pose)
        return 0.0


def panned(pose: Pose, pan_rad: float) -> Pose:
    """Return a pose turned to where its camera points."""
    return Pose(pose.x_m, pose.y_m, pose.z_m, wrap_angle(pose.yaw_rad + pan_rad))
