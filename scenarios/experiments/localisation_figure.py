"""The figure of the `localisation` experiment: Fig. 19, and the error by number of fiducials."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from scenarios.experiments.figure import COLOURS
from scenarios.experiments.localisation_claims import MM, OURS, chosen, curve, distinct, typical
from scenarios.experiments.localisation_walk import WAYS
from scenarios.experiments.tables import Row
from scenarios.palette import MUTED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STYLES = ("o-", "s--", "^:")


def draw(figure: "Figure", rows: Sequence[Row]) -> None:
    """Draw the accumulated error at each distance, and the error by number of fiducials."""
    figure.set_size_inches(16, 5.6)
    figure.suptitle(
        "Accumulated r.m.s. translation error of a camera that goes by fiducials, median of seeds",
        x=0.012,
        ha="left",
        fontsize=16,
        fontweight="bold",
    )
    distances = distinct(rows, "distance_m")
    panels = figure.subplots(1, len(distances) + 1)
    for axes, distance_m in zip(panels, reversed(distances), strict=False):
        _draw_way(axes, rows, distance_m)
    _draw_counts(panels[-1], rows)


def _draw_way(axes: "Axes", rows: Sequence[Row], distance_m: float) -> None:
    axes.set_title(f"Fiducials at {MM * distance_m:.0f} mm on average")
    way_m = distinct(rows, "travelled_m")
    for colour, count in zip(COLOURS, distinct(rows, "fiducials"), strict=False):
        made = [MM * v for v in curve(rows, OURS, distance_m, count)]
        said = [MM * v for v in curve(rows, "said_m", distance_m, count)]
        axes.plot(way_m, made, color=colour, label=f"{count:.0f}")
        axes.plot(way_m, said, "--", color=colour, lw=1, alpha=0.7)
    axes.set(xlabel="distance travelled, m", ylabel="error, mm", yscale="log")
    axes.grid(color=MUTED, alpha=0.2)
    axes.legend(title="fiducials (dashed: as\nthe covariance says)", fontsize=9, ncols=2)


def _draw_counts(axes: "Axes", rows: Sequence[Row]) -> None:
    axes.set_title("At the end of the way, by fiducials")
    counts = distinct(rows, "fiducials")
    end_m = distinct(rows, "travelled_m")[-1]
    for colour, distance_m in zip(COLOURS, distinct(rows, "distance_m"), strict=False):
        for style, way in zip(_STYLES, WAYS, strict=True):
            errors = [
                MM * typical(mine, f"{way} error_m")
                for n in counts
                for mine in [
                    chosen(rows, "path", distance_m=distance_m, fiducials=n, travelled_m=end_m)
                ]
            ]
            label = f"{MM * distance_m:.0f} mm, {way}"
            axes.plot(counts, errors, style, color=colour, label=label, ms=5)
    axes.set(xlabel="fiducials tracked", ylabel="error, mm", xscale="log", yscale="log")
    axes.set_xticks(counts, [f"{n:.0f}" for n in counts])
    axes.minorticks_off()
    axes.legend(fontsize=9)
