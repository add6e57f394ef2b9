"""A floor as it is, and as robots have it: the panels of the overview of a planar run."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from agents.geometry import Bools, Floats, GridFrame, Singles
from scenarios.pictures.ground import Way, draw_ways, name_ways
from scenarios.pictures.shading import UNKNOWN_RGB

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

FREE_RGB = np.array((0.965, 0.945, 0.905))
SOLID_RGB = np.array((0.306, 0.157, 0.180))
"""Light and dark ends of the colours of heights."""
HIDDEN_RGB = np.array((0.62, 0.60, 0.60))
"""Solid cells that nobody can see."""


def show_floor(axes: "Axes", log_odds: Singles, frame: GridFrame) -> None:
    """Draw a planar map (H, W; row 0 south, NaN unknown): light free, dark occupied."""
    p = 1.0 / (1.0 + np.exp(-np.nan_to_num(log_odds.astype(np.float64))))[..., None]
    picture = np.where(
        np.isfinite(log_odds)[..., None], (1.0 - p) * FREE_RGB + p * SOLID_RGB, UNKNOWN_RGB
    )
    _show(axes, picture, frame)


def draw_floor(
    figure: "SubFigure", solid: Bools, observable: Bools, frame: GridFrame, ways: Sequence[Way]
) -> None:
    """Draw the floor (H, W) as it is, what can be seen of it, and the ways of the robots."""
    axes = figure.subplots()
    seen = np.where(solid[..., None], SOLID_RGB, FREE_RGB)
    unseen = np.where(solid[..., None], HIDDEN_RGB, UNKNOWN_RGB)
    _show(axes, np.where(observable[..., None], seen, unseen), frame)
    draw_ways(axes, ways)
    axes.set_title("The floor as it is (grey: cannot be seen); true ways and looks of the robots")
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    name_ways(axes)


def _show(axes: "Axes", picture: Floats, frame: GridFrame) -> None:
    axes.imshow(picture, origin="lower", extent=frame.extent_m, interpolation="nearest")
