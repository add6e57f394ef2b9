"""The ground of a run: made from a seed, or a window of somebody's elevation file."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from agents.geometry import GridFrame
from comms.plugins import Plugins
from sim.errors import WorldError
from sim.ground import Footing, Terrain, hazard_mask
from sim.placing import descent_goal, place_team, wants_drop
from sim.relief import make_relief, texture
from sim.settings import KINDS, TerrainSettings, WorldSettings
from sim.terrain_files import choose_window, read_elevation, window_of

__all__ = [
    "TERRAINS",
    "Footing",
    "Terrain",
    "TerrainSettings",
    "WorldSettings",
    "descent_goal",
    "hazard_mask",
    "make_terrain",
    "place_team",
]

Maker = Callable[[TerrainSettings, GridFrame, np.random.Generator], Terrain]

TERRAINS: Plugins[Maker] = Plugins(
    "ropeteam.terrains", dict.fromkeys(("cliff", "plain", *KINDS), make_relief)
)
"""Made-up ground by `world.terrain.kind`: from its settings, the cells to fill, and dice."""

MAX_CELLS = 4_200_000
"""Cells of a window: 2048 x 2048."""


def make_terrain(
    world: WorldSettings,
    cell_m: float,
    rng: np.random.Generator,
    roles: Sequence[str] = (),
    footprint_m: float = 0.8,
) -> Terrain:
    """Return the true ground of a run, sampled at the centres of cells of `cell_m`.

    World frame: x east, y north, origin at the south-west corner of the window (made-up ground) or
    of the file's whole grid, in its own metres or those that `terrain.cell_m` gives it. `roles`
    and `footprint_m` say for whom a window of a file is chosen: with a cliff team it lies round
    a drop. The ground of a seed depends on the cell size only by its sampling.

    Raises WorldError for a bad file, a window of too many cells, or one that is too small.
    """
    settings = world.terrain
    _check_size(world, cell_m)
    if settings.file:
        file = read_elevation(settings.file, settings.cell_m, settings.grey_m)
        extent_m = choose_window(file, world.window_m, footprint_m, wants_drop(roles))
        _check_room(settings.file, extent_m, cell_m)
        frame, elevation_m = window_of(file, extent_m, cell_m)
        return Terrain(frame, elevation_m, texture(settings.texture_poor, frame, rng))
    cols, rows = (max(1, math.floor(side / cell_m + 1e-6)) for side in world.window_m)
    frame = GridFrame(0.0, 0.0, cell_m, rows, cols)
    return TERRAINS.find(settings.kind)(settings, frame, rng)


def _check_size(world: WorldSettings, cell_m: float) -> None:
    width_m, height_m = world.window_m
    cells = (width_m / cell_m) * (height_m / cell_m)
    if cells > MAX_CELLS:
        raise WorldError(
            f"world.window_m of {width_m:g} x {height_m:g} m at map.cell_m {cell_m:g} has"
            f" {cells:.3g} cells, allowed are at most {MAX_CELLS}"
        )
    if min(width_m, height_m) < 16 * cell_m:
        raise WorldError(
            f"world.window_m of {width_m:g} x {height_m:g} m is too small for map.cell_m"
            f" {cell_m:g}, allowed is at least 16 cells a side"
        )


def _check_room(path: str, extent_m: tuple[float, float, float, float], cell_m: float) -> None:
    west, east, south, north = extent_m
    least_m = max(4.0, 17 * cell_m)
    if min(east - west, north - south) < least_m:
        raise WorldError(
            f"{path}: is {east - west:.3g} x {north - south:.3g} m between its outer cell centres,"
            f" a team needs at least {least_m:g} x {least_m:g} m; set world.terrain.cell_m to read"
            " it larger"
        )
