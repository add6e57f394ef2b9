"""The ground as it is, and the robots' true ways over it: the large panel of the overview."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.geometry import Floats, GridFrame, Singles
from scenarios.palette import INK, MANY, MUTED, marker_of, short
from scenarios.pictures.shading import UNKNOWN_RGB, colours, relief

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

_CONTOUR_STEPS_M = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_MAX_CONTOURS = 9


@dataclass(frozen=True)
class Way:
    """What is drawn of one robot on the ground."""

    name: str
    role: str
    colour: str
    track_m: Floats
    """(N, 2) true positions in the world frame, start first; N = 0: nothing is known."""
    looks_m: Floats
    """(L, 2) where it looked from."""

    @property
    def label(self) -> str:
        """Its line in the legend."""
        return f"{self.name}, {len(self.looks_m)} looks" if len(self.looks_m) else self.name


@dataclass(frozen=True)
class Scale:
    """The heights that the ends of the colour scale stand for."""

    low_m: float
    high_m: float


def scale_of(elevation_m: Singles) -> Scale:
    """Return a scale on which all but the odd cell of a map (H, W; NaN unknown) have colours."""
    heights = elevation_m[np.isfinite(elevation_m)]
    if heights.size == 0:
        return Scale(0.0, 1.0)
    low_m, high_m = np.percentile(heights, [0.5, 99.5])
    return Scale(float(low_m), max(float(high_m), float(low_m) + 0.01))


def show_map(axes: "Axes", elevation_m: Singles, frame: GridFrame, scale: Scale) -> None:
    """Draw an elevation map (H, W; row 0 south, NaN unknown) as a relief."""
    picture = relief(elevation_m, frame.cell_m, scale.low_m, scale.high_m)
    axes.imshow(picture, origin="lower", extent=frame.extent_m, interpolation="nearest")


def draw_ground(
    figure: "SubFigure",
    elevation_m: Singles,
    frame: GridFrame,
    ways: Sequence[Way],
    goal_m: tuple[float, float] | None,
) -> None:
    """Draw the truth (H, W), the ways of the robots, their tethers and the goal."""
    axes = figure.subplots()
    scale = scale_of(elevation_m)
    show_map(axes, elevation_m, frame, scale)
    _draw_contours(axes, elevation_m, frame, scale)
    _draw_tethers(axes, ways)
    draw_ways(axes, ways)
    if goal_m is not None:
        star: dict[str, Any] = {
            "color": "#ffe34d",
            "markersize": 17,
            "markeredgecolor": INK,
            "ls": "none",
        }
        axes.plot(*goal_m, "*", label="where the Cliff-bot is to go", zorder=6, **star)
    axes.set_title("The ground as it is; true ways and looks of the robots")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    _draw_scale(figure, axes, scale)
    name_ways(axes)


def _draw_contours(axes: "Axes", elevation_m: Singles, frame: GridFrame, scale: Scale) -> None:
    span_m = scale.high_m - scale.low_m
    step_m = next((step for step in _CONTOUR_STEPS_M if span_m / step <= _MAX_CONTOURS), span_m)
    levels = np.arange(np.ceil(scale.low_m / step_m), np.floor(scale.high_m / step_m) + 1) * step_m
    if levels.size == 0 or min(frame.shape) < 2:
        return
    east = frame.x_m + (np.arange(frame.cols) + 0.5) * frame.cell_m
    north = frame.y_m + (np.arange(frame.rows) + 0.5) * frame.cell_m
    heights = np.ma.masked_invalid(elevation_m)
    axes.contour(east, north, heights, levels=levels, colors=INK, linewidths=0.5, alpha=0.3)


def draw_ways(axes: "Axes", ways: Sequence[Way]) -> None:
    """Draw the ways of all robots; many are told apart by the ends of their names."""
    many = len(ways) > MANY
    for way in ways:
        _draw_way(axes, way, label="" if many else way.label)
        if many and len(way.track_m):
            box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8}
            style: dict[str, Any] = {"fontsize": 8, "zorder": 7, "bbox": box}
            style["textcoords"] = "offset points"
            axes.annotate(short(way.name), way.track_m[-1], (6, 3), color=way.colour, **style)


def name_ways(axes: "Axes") -> None:
    """Say what is drawn on the ground, where it has names."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper left", fontsize=10, frameon=True, facecolor="white", framealpha=0.88)


def _draw_way(axes: "Axes", way: Way, label: str) -> None:
    """Draw a robot's way, where it looked from, and where it ended."""
    if len(way.track_m) == 0:
        return
    east, north = way.track_m[:, 0], way.track_m[:, 1]
    axes.plot(east, north, color="white", linewidth=4.4, solid_capstyle="round", zorder=4)
    axes.plot(east, north, color=way.colour, linewidth=2.3, solid_capstyle="round", zorder=4)
    dots = {"facecolor": "white", "edgecolor": way.colour, "linewidths": 1.7}
    axes.scatter(*way.looks_m.T, s=24, zorder=5, **dots)
    show_robot(axes, way, size=11, label=label)


def show_robot(axes: "Axes", way: Way, *, size: float, label: str = "") -> None:
    """Draw where a robot ended."""
    if len(way.track_m) == 0:
        return
    style: dict[str, Any] = {"color": way.colour, "markersize": size, "markeredgecolor": "white"}
    end = way.track_m[-1]
    shape = marker_of(way.role)
    axes.plot(end[0], end[1], shape, ls="none", mew=1.5, zorder=6, label=label or None, **style)


def _draw_tethers(axes: "Axes", ways: Sequence[Way]) -> None:
    ends: Mapping[str, list[Floats]] = {
        role: [way.track_m[-1] for way in ways if way.role == role and len(way.track_m)]
        for role in ("cliffbot", "anchor")
    }
    for bot in ends["cliffbot"]:
        for anchor in ends["anchor"]:
            east, north = (anchor[0], bot[0]), (anchor[1], bot[1])
            axes.plot(east, north, color="white", linewidth=2.4, zorder=3)
            axes.plot(east, north, color=INK, linewidth=1.0, zorder=3)


def _draw_scale(figure: "SubFigure", axes: "Axes", scale: Scale) -> None:
    """Draw the scale of heights, and the colour of what is unknown, beside the ground."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    stops: Any = colours(np.linspace(0, 1, 256))
    colourmap = ListedColormap(stops).with_extremes(under=UNKNOWN_RGB)
    heights = ScalarMappable(Normalize(scale.low_m, scale.high_m), colourmap)
    bar = figure.colorbar(heights, ax=axes, shrink=0.8, pad=0.015, aspect=34, extend="min")
    bar.set_label("elevation, m (grey: unknown)")
    bar.ax.tick_params(color=MUTED)
