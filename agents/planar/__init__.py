"""Choosing where to look on planar occupancy maps: the paper's methods by name, and ours."""

from collections.abc import Callable

from agents.errors import AgentError
from agents.planar import methods, team
from agents.planar.methods import PlanarMethod
from agents.planar.scene import Means
from agents.planar.view import PlanarLook, PlanarView
from agents.settings import DriveSettings, PlannerSettings, SensorSettings

__all__ = ["MethodError", "PlanarLook", "PlanarMethod", "PlanarView", "method", "names"]


class MethodError(AgentError):
    """A method that doesn't exist."""


_METHODS: dict[str, Callable[[Means], PlanarMethod]] = {
    "random": methods.Random,
    "raster": methods.Raster,
    "max-new": methods.MaxNew,
    "min-old": methods.MinOld,
    "information": methods.Histogrammed,
    "information-entropy": methods.Stretched,
    "information-voxel": methods.Voxel,
    "team-information": team.TeamInformation,
}


def names() -> tuple[str, ...]:
    """Return the names of all methods."""
    return tuple(_METHODS)


def method(
    name: str, sensor: SensorSettings, drive: DriveSettings, planner: PlannerSettings
) -> PlanarMethod:
    """Return a new method for one robot.

    Raises:
        MethodError: there is none of that name.
    """
    if name not in _METHODS:
        raise MethodError(f'no method is named "{name}"; there are: {", ".join(names())}')
    return _METHODS[name](Means(sensor, drive, planner))
