"""What the world does to radio waves between robots: distance, and ground in the way."""

from functools import cached_property

import numpy as np

from agents.geometry import Floats, Pose
from sim.motion import Motions
from sim.planar import PlanarScene
from sim.planar_world import PlanarWorld
from sim.scene import Scene
from sim.voxel.robot import VoxelScene
from sim.voxel.world import VoxelWorld
from sim.worlds import World


class Propagation:
    """The radio waves that come to one robot (`comms.ears.Propagation`).

    Everybody is taken to be where they were one world delay before: what happens elsewhere is known
    here no sooner, and so one process and many see the same.
    """

    def __init__(self, me: str, motions: Motions, world: World, delay_ns: int) -> None:
        """Take the robot that hears, everybody's motion, and the true ground or floor."""
        self._me = me
        self._motions = motions
        self._world = world
        self._delay_ns = delay_ns
        self._known: dict[str, tuple[tuple[Pose, Pose, float, float], bool]] = {}

    def distance_m(self, sender: str, t_ns: int) -> float | None:
        """Return the horizontal distance to a sender at a time; None: one of both is unknown."""
        ends = self._ends(sender, t_ns)
        return None if ends is None else ends[0].distance_m(ends[1])

    def hides(self, sender: str, t_ns: int, antenna_m: float, mate_antenna_m: float) -> bool:
        """Say whether ground or a wall cuts the straight line between the antennas of two robots.

        Unknown ground, and all beyond the window, hides nothing.
        """
        ends = self._ends(sender, t_ns)
        if ends is None:
            return False
        question = (*ends, antenna_m, mate_antenna_m)
        known = self._known.get(sender)
        if known is None or known[0] != question:
            known = (question, self._hidden(*question))
            self._known[sender] = known
        return known[1]

    def _ends(self, sender: str, t_ns: int) -> tuple[Pose, Pose] | None:
        theirs = self._motions.pose_at(sender, t_ns - self._delay_ns)
        mine = self._motions.pose_at(self._me, t_ns - self._delay_ns)
        return None if theirs is None or mine is None else (theirs, mine)

    @cached_property
    def _scene(self) -> Scene | PlanarScene | VoxelScene:
        """Made when it is first needed: most links have no need of it."""
        world = self._world
        if isinstance(world, VoxelWorld):
            return VoxelScene(world)
        return PlanarScene(world) if isinstance(world, PlanarWorld) else Scene(world)

    def _hidden(self, theirs: Pose, mine: Pose, antenna_m: float, mate_antenna_m: float) -> bool:
        """Ask from the same end whoever asks, so that sight is mutual to the last bit."""
        one, other = sorted((_top(theirs, antenna_m), _top(mine, mate_antenna_m)))
        if one == other:
            return False
        return not self._scene.clear(_point(one), _point(other))


def _top(pose: Pose, height_m: float) -> tuple[float, float, float]:
    return (pose.x_m, pose.y_m, pose.z_m + height_m)


def _point(top: tuple[float, float, float]) -> Floats:
    return np.array(top, dtype=np.float64)
