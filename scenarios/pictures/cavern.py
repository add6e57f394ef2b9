"""A cave as it is, and as robots have it: the panels of the overview of a voxel run."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.geometry import Floats, GridFrame, Singles
from agents.voxel.frame import VoxelFrame
from scenarios.pictures.floor import FREE_RGB, HIDDEN_RGB, SOLID_RGB
from scenarios.pictures.ground import Way, draw_ways, name_ways
from scenarios.pictures.shading import UNKNOWN_RGB, colours
from scenarios.scores.occupancy import VoxelTruth, floor_heights

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure


def _plan(heights_m: Floats, frame: VoxelFrame) -> Floats:
    """Return heights (H, W) in the colours of heights, grey where nothing is."""
    top_m = frame.layers * frame.cell_m
    picture = colours(np.clip((np.nan_to_num(heights_m) - frame.z_m) / top_m, 0.0, 1.0))
    return np.where(np.isfinite(heights_m)[..., None], picture, UNKNOWN_RGB)


def show_space(axes: "Axes", log_odds: Singles, frame: GridFrame) -> None:
    """Draw a voxel map (L, H, W; NaN unknown) from above: how low it is known to be free."""
    assert isinstance(frame, VoxelFrame)
    free = np.nan_to_num(log_odds) < 0
    picture = _plan(floor_heights(free, frame), frame)
    axes.imshow(picture, origin="lower", extent=frame.extent_m, interpolation="nearest")


def draw_cave(figure: "SubFigure", truth: VoxelTruth, ways: Sequence[Way]) -> None:
    """Draw the cave from above, the ways of the robots, and a section from west to east."""
    frame = truth.frame
    share = min(0.6, frame.layers / frame.rows + 0.12)
    above, section = figure.subplots(2, 1, height_ratios=[1.0, share])
    heights_m = floor_heights(truth.observable & ~truth.solid, frame)
    above.imshow(
        _plan(heights_m, frame), origin="lower", extent=frame.extent_m, interpolation="nearest"
    )
    draw_ways(above, ways)
    row = _busiest(truth)
    y_m = frame.y_m + (row + 0.5) * frame.cell_m
    above.axhline(y_m, color="black", linewidth=0.8, linestyle=":")
    above.set_title("The cave from above: heights of what can be seen; true ways and looks")
    above.set_ylabel("north, m")
    name_ways(above)
    _draw_section(section, truth, row)
    section.set_title(f"Section along the dotted line, {y_m:.1f} m north (grey: cannot be seen)")


def _busiest(truth: VoxelTruth) -> int:
    """Return the row with most free cells that can be seen."""
    return int(np.argmax((truth.observable & ~truth.solid).sum(axis=(0, 2))))


def _draw_section(axes: "Axes", truth: VoxelTruth, row: int) -> None:
    frame, solid = truth.frame, truth.solid[:, row]
    seen = np.where(solid[..., None], SOLID_RGB, FREE_RGB)
    unseen = np.where(solid[..., None], HIDDEN_RGB, UNKNOWN_RGB)
    picture = np.where(truth.observable[:, row][..., None], seen, unseen)
    west, east, _, _ = frame.extent_m
    extent: Any = (west, east, frame.z_m, frame.z_m + frame.layers * frame.cell_m)
    axes.imshow(picture, origin="lower", extent=extent, interpolation="nearest")
    axes.set_xlabel("east, m")
    axes.set_ylabel("up, m")
