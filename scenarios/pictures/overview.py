"""One picture of a run that a person can read: the truth, each robot's map, and what it cost.

Matplotlib is imported when something is drawn, without a screen and without its global state.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.geometry import Floats, GridFrame, Singles
from scenarios.palette import INK, STYLE, robot_colours
from scenarios.pictures.cavern import draw_cave, show_space
from scenarios.pictures.charts import draw_bytes_by_robot, draw_bytes_over_time, draw_information
from scenarios.pictures.floor import draw_floor, show_floor
from scenarios.pictures.ground import Scale, Way, draw_ground, scale_of, show_map, show_robot
from scenarios.records.summary import RobotFinal, Truth, score
from scenarios.records.tables import Records
from scenarios.scores.occupancy import PlanarTruth, VoxelTruth, score_floor

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

MAX_MAPS = 6
"""More robots than these are told of in words."""


@dataclass(frozen=True)
class Overview:
    """What the picture shows."""

    title: str
    summary: Mapping[str, Any]
    """As `summary.json` has it."""
    frame: GridFrame
    """Of the truth and of all robots' maps."""
    truth: Truth | PlanarTruth
    robots: Sequence[RobotFinal]
    records: Records
    tracks_m: Mapping[str, Floats] = field(default_factory=dict[str, Floats])
    """True way (N, 2) of each robot in the world frame, start first; where one is missing, the
    places of its looks stand for it."""
    goal_m: tuple[float, float] | None = None
    """Where the Cliff-bot is to go, world frame."""


def draw(path: Path, overview: Overview) -> None:
    """Write the picture of a run as a PNG, whole or not at all."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with mpl.rc_context(STYLE):
        layout = ConstrainedLayoutEngine(w_pad=0.09, h_pad=0.1, hspace=0.04)
        figure = Figure(figsize=(16, 11.6), dpi=110, layout=layout, facecolor="white")
        FigureCanvasAgg(figure)
        _draw_all(figure, overview)
        part = path.with_name(f".{path.name}.part")
        figure.savefig(part, format="png")
    part.replace(path)


def _draw_all(figure: "Figure", overview: Overview) -> None:
    figure.suptitle(overview.title, x=0.012, ha="left", fontsize=18, fontweight="bold")
    figure.supxlabel(caption(overview.summary), x=0.012, ha="left", fontsize=12.5)
    parts: Any = figure.subfigures(2, 1, height_ratios=[2.4, 1])
    upper, lower = parts
    _draw_maps(upper, overview)
    over_time, by_robot, known = lower.subplots(1, 3, width_ratios=[1.1, 1, 1.1])
    end_s = float(overview.summary["simulated_s"])
    draw_bytes_over_time(over_time, overview.records, end_s)
    draw_bytes_by_robot(by_robot, overview.records)
    draw_information(known, overview.records, end_s)


def caption(summary: Mapping[str, Any]) -> str:
    """Return the run's outcome in a line, and its figures in another."""
    team = summary["team"]
    sent = sum(robot["sent_bytes"] for robot in summary["robots"].values())
    facts = [
        f"{summary['simulated_s'] / 60:.1f} simulated minutes, seed {summary['seed']}",
        f"{100 * team['coverage']:.0f} % of what can be seen is mapped",
        f"{sent / 1000:.1f} kB sent",
    ]
    if team["elevation_rmse_m"] is not None:
        facts.insert(2, f"elevation error {100 * team['elevation_rmse_m']:.1f} cm rms")
    outcome = f"{str(summary['outcome']).capitalize()}: {summary['outcome_reason']}"
    return "\n".join([outcome, ", ".join(facts)])


def _ways(overview: Overview) -> list[Way]:
    """Return what is drawn of each robot on the ground."""
    palette = robot_colours(robot.name for robot in overview.robots)
    return [_way(overview, robot.name, palette[robot.name]) for robot in overview.robots]


def _way(overview: Overview, name: str, colour: str) -> Way:
    looks = sorted((o for o in overview.records.looks if o.robot == name), key=lambda o: o.t_s)
    spots_m = np.array([(look.x_m, look.y_m) for look in looks]).reshape(-1, 2)
    track_m = overview.tracks_m.get(name, spots_m)
    role = overview.summary["robots"][name]["role"]
    return Way(name, role, colour, track_m, spots_m)


def _draw_maps(figure: "SubFigure", overview: Overview) -> None:
    ways = _ways(overview)[:MAX_MAPS]
    columns = (len(ways) + 1) // 2 if len(ways) > 2 else 1
    width = 0.47 * columns if len(ways) > 1 else 1.0
    parts: Any = figure.subfigures(1, 2, width_ratios=[1.15, width])
    left, right = parts
    truth, frame = overview.truth, overview.frame
    if isinstance(truth, VoxelTruth):
        draw_cave(left, truth, _ways(overview))
        scale = None
    elif isinstance(truth, PlanarTruth):
        draw_floor(left, truth.solid, truth.observable, frame, _ways(overview))
        scale = None
    else:
        draw_ground(left, truth.elevation_m, frame, _ways(overview), overview.goal_m)
        scale = scale_of(truth.elevation_m)
    panels: list[Axes] = list(np.ravel(right.subplots(min(2, len(ways)), columns)))
    for axes in panels[len(ways) :]:
        axes.set_axis_off()
    for axes, robot, way in zip(panels, overview.robots, ways, strict=False):
        _draw_robot_map(axes, overview, robot, way, scale)
    if len(overview.robots) > MAX_MAPS:
        right.supxlabel(f"and {len(overview.robots) - MAX_MAPS} more robots", fontsize=11)


def _draw_robot_map(
    axes: "Axes", overview: Overview, robot: RobotFinal, way: Way, scale: Scale | None
) -> None:
    frame = overview.frame
    kept = robot.elevation_m if scale else robot.log_odds
    values = np.full(frame.shape, np.nan, np.float32) if kept is None else kept
    if scale:
        show_map(axes, values, frame, scale)
    elif values.ndim == 3:
        show_space(axes, values, frame)
    else:
        show_floor(axes, values, frame)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    state = "" if robot.state == "alive" else f" ({robot.state})"
    axes.set_title(f"Map of {robot.name}{state}", color=way.colour)
    small = 8.5 if len(overview.robots) > 4 else 10.5
    axes.set_xlabel(map_facts(robot, overview.truth), fontsize=small, loc="left")
    if not np.isfinite(values).any():
        centre: dict[str, Any] = {"ha": "center", "va": "center", "transform": axes.transAxes}
        words = "no map at the end" if kept is None else "knows nothing"
        axes.text(0.5, 0.5, words, color=INK, fontsize=12, **centre)
    show_robot(axes, way, size=9)


def map_facts(robot: RobotFinal, truth: Truth | PlanarTruth) -> str:
    """Return how much a robot knows and how well, in a few words."""
    if isinstance(truth, PlanarTruth):
        return "" if robot.log_odds is None else _floor_facts(robot.log_odds, truth)
    if robot.elevation_m is None or robot.sigma_m is None:
        return ""
    result = score(robot.elevation_m, robot.sigma_m, truth)
    known = f"{100 * result.coverage:.0f} % of what can be seen"
    return known if result.rmse_m is None else f"{known}, {100 * result.rmse_m:.1f} cm rms"


def _floor_facts(log_odds: Singles, truth: PlanarTruth) -> str:
    result = score_floor(log_odds, truth)
    known = f"{100 * result.coverage:.0f} % of what can be seen"
    if result.mapped_cells == 0:
        return known
    return f"{known}, {100 * result.wrong_cells / result.mapped_cells:.1f} % of that wrong"
