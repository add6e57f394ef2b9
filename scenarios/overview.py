"""One picture of a run that a person can read: the truth, each robot's map, and what it cost.

Matplotlib is imported when something is drawn, without a screen and without its global state.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.geometry import Floats, GridFrame
from scenarios.charts import draw_bytes_by_robot, draw_bytes_over_time, draw_information
from scenarios.palette import INK, MUTED, marker_of, robot_colours
from scenarios.record import Records
from scenarios.shading import UNKNOWN_RGB, colours, relief
from scenarios.summary import RobotFinal, Truth, elevation_error_m

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

MAX_MAPS = 6
"""More robots than these are told of in words."""
_STYLE: dict[str, Any] = {
    "font.size": 10.5,
    "axes.titlesize": 11.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
}


@dataclass(frozen=True)
class Overview:
    """What the picture shows."""

    title: str
    summary: Mapping[str, Any]
    """As `summary.json` has it."""
    frame: GridFrame
    """Of the truth and of all robots' maps."""
    truth: Truth
    robots: Sequence[RobotFinal]
    records: Records
    tracks: Mapping[str, Floats] = field(default_factory=dict[str, Floats])
    """True way (N, 2) of each robot in the world frame, metres, start first."""
    goal_m: tuple[float, float] | None = None
    """Where the Cliff-bot is to go, world frame."""


def draw(path: Path, overview: Overview) -> None:
    """Write the picture of a run as a PNG."""
    import matplotlib as mpl  # noqa: PLC0415  (takes half a second, and only a drawing needs it)
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(16, 11.4), dpi=110, layout="constrained", facecolor="white")
        FigureCanvasAgg(figure)
        figure.get_layout_engine().set(w_pad=0.08, h_pad=0.08)  # pyright: ignore[reportOptionalMemberAccess]  (constrained: asked for above)
        _draw_all(figure, overview)
        part = path.with_name(f".{path.name}.part")
        figure.savefig(part, format="png")
    part.replace(path)


def _draw_all(figure: "Figure", overview: Overview) -> None:
    figure.suptitle(overview.title, x=0.012, ha="left", fontsize=17, fontweight="bold")
    figure.supxlabel(caption(overview.summary), x=0.012, ha="left", fontsize=12)
    upper, lower = figure.subfigures(2, 1, height_ratios=[2.35, 1])
    _draw_maps(upper, overview)
    over_time, by_robot, known = lower.subplots(1, 3, width_ratios=[1.15, 1, 1.15])
    end_s = float(overview.summary["simulated_s"])
    draw_bytes_over_time(over_time, overview.records, end_s)
    draw_bytes_by_robot(by_robot, overview.records)
    draw_information(known, overview.records, end_s)


def caption(summary: Mapping[str, Any]) -> str:
    """Return the run's outcome in one line."""
    team = summary["team"]
    sent = sum(robot["sent_bytes"] for robot in summary["robots"].values())
    parts = [
        f"{str(summary['outcome']).capitalize()}: {summary['outcome_reason']}",
        f"{summary['simulated_s'] / 60:.1f} simulated minutes, seed {summary['seed']}",
        f"{100 * team['coverage']:.0f} % of what can be seen is mapped",
        f"{sent / 1000:.1f} kB sent",
    ]
    if team["elevation_rmse_m"] is not None:
        parts.insert(3, f"elevation error {100 * team['elevation_rmse_m']:.1f} cm rms")
    return "   |   ".join(parts)


def _draw_maps(figure: "SubFigure", overview: Overview) -> None:
    shown = list(overview.robots)[:MAX_MAPS]
    columns = max(1, (len(shown) + 1) // 2)
    left, right = figure.subfigures(1, 2, width_ratios=[1.22, max(1.0, 0.56 * columns)])
    heights = overview.truth.elevation_m[np.isfinite(overview.truth.elevation_m)]
    low_m, high_m = np.percentile(heights, [0.5, 99.5]) if heights.size else (0.0, 1.0)
    scale = (float(low_m), float(high_m))
    _draw_truth(left, overview, scale)
    rows = min(2, len(shown))
    panels: list[Axes] = list(np.atleast_1d(right.subplots(rows, columns)).ravel())
    for axes, robot in zip(panels, shown, strict=False):
        _draw_robot_map(axes, overview, robot, scale)
    for axes in panels[len(shown) :]:
        axes.set_axis_off()
    if len(overview.robots) > len(shown):
        right.supxlabel(f"and {len(overview.robots) - len(shown)} more robots", fontsize=10.5)


def _draw_truth(figure: "SubFigure", overview: Overview, scale: tuple[float, float]) -> None:
    axes = figure.subplots()
    frame = overview.frame
    picture = relief(overview.truth.elevation_m, frame.cell_m, *scale)
    axes.imshow(picture, origin="lower", extent=frame.extent_m, interpolation="bilinear")
    _draw_contours(axes, overview, scale)
    _draw_ways(axes, overview)
    axes.set_title("The ground as it is, with the robots' true ways and looks")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    _draw_scale(figure, axes, scale)
    axes.legend(
        loc="upper left", fontsize=9.5, frameon=True, facecolor="white", framealpha=0.85, ncols=1
    )


def _draw_contours(axes: "Axes", overview: Overview, scale: tuple[float, float]) -> None:
    frame, heights = overview.frame, np.ma.masked_invalid(overview.truth.elevation_m)
    span_m = scale[1] - scale[0]
    if span_m <= 0 or min(frame.shape) < 2:
        return
    steps = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]
    step_m = next((step for step in steps if span_m / step <= 9), span_m)
    levels = np.arange(np.ceil(scale[0] / step_m), np.floor(scale[1] / step_m) + 1) * step_m
    if levels.size == 0:
        return
    east = frame.x_m + (np.arange(frame.cols) + 0.5) * frame.cell_m
    north = frame.y_m + (np.arange(frame.rows) + 0.5) * frame.cell_m
    axes.contour(east, north, heights, levels=levels, colors="#2b1512", linewidths=0.5, alpha=0.35)


def _draw_ways(axes: "Axes", overview: Overview) -> None:
    halo = _halo()
    palette = robot_colours([robot.name for robot in overview.robots])
    roles = {name: robot["role"] for name, robot in overview.summary["robots"].items()}
    _draw_tethers(axes, overview, roles)
    for name, colour in palette.items():
        way = overview.tracks.get(name)
        looks = sorted(
            (look for look in overview.records.looks if look.robot == name),
            key=lambda look: look.t_s,
        )
        if way is None and looks:
            way = np.array([(look.x_m, look.y_m) for look in looks])
        if way is None or len(way) == 0:
            continue
        axes.plot(way[:, 0], way[:, 1], color=colour, linewidth=2.2, path_effects=halo, zorder=4)
        label = f"{name}: {len(looks)} looks" if looks else name
        axes.plot(
            *way[-1][:2],
            marker_of(roles.get(name, "")),
            color=colour,
            markersize=11,
            markeredgecolor="white",
            markeredgewidth=1.4,
            linestyle="none",
            label=label,
            zorder=6,
        )
        if looks:
            spots = np.array([(look.x_m, look.y_m) for look in looks])
            style = {"facecolor": "white", "edgecolor": colour, "linewidths": 1.6}
            axes.scatter(spots[:, 0], spots[:, 1], s=20, zorder=5, **style)
    if overview.goal_m is not None:
        axes.plot(
            *overview.goal_m,
            "*",
            color="#ffe34d",
            markersize=17,
            markeredgecolor=INK,
            linestyle="none",
            label="goal of the Cliff-bot",
            zorder=6,
        )


def _draw_tethers(axes: "Axes", overview: Overview, roles: Mapping[str, str]) -> None:
    ends = {name: way[-1] for name, way in overview.tracks.items() if len(way)}
    bots = [end for name, end in ends.items() if roles.get(name) == "cliffbot"]
    anchors = [end for name, end in ends.items() if roles.get(name) == "anchor"]
    for bot in bots:
        for anchor in anchors:
            axes.plot([anchor[0], bot[0]], [anchor[1], bot[1]], color="white", lw=1.2, zorder=3)
            axes.plot([anchor[0], bot[0]], [anchor[1], bot[1]], ":", color=INK, lw=1.2, zorder=3)


def _halo() -> list[Any]:
    from matplotlib import patheffects  # noqa: PLC0415

    return [patheffects.Stroke(linewidth=4.2, foreground="white"), patheffects.Normal()]


def _draw_robot_map(
    axes: "Axes", overview: Overview, robot: RobotFinal, scale: tuple[float, float]
) -> None:
    frame = overview.frame
    elevation_m = robot.elevation_m
    if elevation_m is None:
        elevation_m = np.full(frame.shape, np.nan, np.float32)
    picture = relief(elevation_m, frame.cell_m, *scale)
    axes.imshow(picture, origin="lower", extent=frame.extent_m, interpolation="nearest")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    colour = robot_colours([one.name for one in overview.robots])[robot.name]
    axes.set_title(f"{robot.name}'s map", color=colour)
    if not np.isfinite(elevation_m).any():
        centre = (frame.extent_m[0] + frame.extent_m[1]) / 2, sum(frame.extent_m[2:]) / 2
        axes.text(*centre, "knows nothing", ha="center", va="center", color=MUTED, fontsize=12)
    axes.set_xlabel(_map_facts(overview, robot), fontsize=9.5, loc="left")
    way = overview.tracks.get(robot.name)
    if way is not None and len(way):
        role = overview.summary["robots"][robot.name]["role"]
        style = {"color": colour, "markersize": 8, "markeredgecolor": "white"}
        axes.plot(*way[-1][:2], marker_of(role), **style)


def _map_facts(overview: Overview, robot: RobotFinal) -> str:
    if robot.elevation_m is None:
        return robot.state
    seen = overview.truth.observable
    share = float(np.isfinite(robot.elevation_m[seen]).mean()) if seen.any() else 0.0
    errors = elevation_error_m(robot.elevation_m, overview.truth.elevation_m)
    facts = [f"{100 * share:.0f} % of what can be seen"]
    if errors.size:
        facts.append(f"{100 * float(np.sqrt(np.mean(errors**2))):.1f} cm rms")
    return ", ".join(facts if robot.state == "alive" else [*facts, robot.state])


def _draw_scale(figure: "SubFigure", axes: "Axes", scale: tuple[float, float]) -> None:
    """Draw the scale of heights, and the colour of what is unknown, beside the truth."""
    from matplotlib.cm import ScalarMappable  # noqa: PLC0415
    from matplotlib.colors import ListedColormap, Normalize  # noqa: PLC0415
    from matplotlib.patches import Patch  # noqa: PLC0415

    colourmap = ListedColormap(colours(np.linspace(0, 1, 256)))
    high_m = scale[1] if scale[1] > scale[0] else scale[0] + 1.0
    heights = ScalarMappable(Normalize(scale[0], high_m), colourmap)
    bar = figure.colorbar(heights, ax=axes, shrink=0.85, pad=0.015, aspect=32)
    bar.set_label("elevation, m")
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]  (typed as a bare artist)
    axes.add_patch(Patch(facecolor=UNKNOWN_RGB, edgecolor=MUTED, label="unknown", visible=False))
