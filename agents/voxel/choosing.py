"""The methods that choose looks on voxel maps, by name."""

from collections.abc import Callable

from agents.occupancy.view import Means
from agents.voxel import methods, team
from agents.voxel.methods import VoxelMethod
from comms.plugins import Plugins

METHODS: Plugins[Callable[[Means], VoxelMethod]] = Plugins(
    "ropeteam.voxel_strategies",
    {
        "random": methods.Random,
        "raster": methods.Raster,
        "max-new": methods.MaxNew,
        "min-old": methods.MinOld,
        "information": methods.Histogrammed,
        "information-entropy": methods.Stretched,
        "information-voxel": methods.Voxel,
        "team-information": team.TeamInformation,
    },
)
"""By name; each is called for every robot, with the means that it has."""


def method(name: str, means: Means) -> VoxelMethod:
    """Return a new method for one robot.

    Raises:
        PluginError: there is none of that name.
    """
    return METHODS.find(name)(means)
