"""The methods that choose looks on voxel maps, by name."""

from collections.abc import Callable

from agents.planar import MethodError
from agents.settings import DriveSettings, PlannerSettings, SensorSettings
from agents.voxel import methods
from agents.voxel.methods import VoxelMethod
from agents.voxel.view import Means

_METHODS: dict[str, Callable[[Means], VoxelMethod]] = {
    "random": methods.Random,
    "raster": methods.Raster,
    "max-new": methods.MaxNew,
    "min-old": methods.MinOld,
    "information": methods.Histogrammed,
    "information-entropy": methods.Stretched,
    "information-voxel": methods.Voxel,
}


def names() -> tuple[str, ...]:
    """Return the names of all methods."""
    return tuple(_METHODS)


def method(
    name: str, sensor: SensorSettings, drive: DriveSettings, planner: PlannerSettings
) -> VoxelMethod:
    """Return a new method for one robot.

    Raises:
        MethodError: there is none of that name.
    """
    if name not in _METHODS:
        raise MethodError(f'no method is named "{name}"; there are: {", ".join(names())}')
    return _METHODS[name](Means(sensor, drive, planner))
