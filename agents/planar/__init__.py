"""Choosing where to look on planar occupancy maps: the paper's methods by name, and ours."""

from collections.abc import Callable

from agents.occupancy.view import Means
from agents.planar import methods, team
from agents.planar.methods import PlanarMethod
from agents.planar.view import PlanarLook, PlanarView
from comms.plugins import Plugins

__all__ = ["METHODS", "Means", "PlanarLook", "PlanarMethod", "PlanarView", "method"]

METHODS: Plugins[Callable[[Means], PlanarMethod]] = Plugins(
    "ropeteam.planar_strategies",
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


def method(name: str, means: Means) -> PlanarMethod:
    """Return a new method for one robot.

    Raises:
        PluginError: there is none of that name.
    """
    return METHODS.find(name)(means)
