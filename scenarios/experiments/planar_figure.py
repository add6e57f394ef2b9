"""The figure of the planar experiments: area mapped against looks, and against distance."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from scenarios.experiments.figure import COLOURS
from scenarios.experiments.planar_claims import curve, methods, worlds
from scenarios.experiments.planar_runs import OURS
from scenarios.experiments.tables import Row
from scenarios.palette import INK, MUTED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def drawing(title: str) -> Callable[["Figure", Sequence[Row]], None]:
    """Return a function that draws the figure of one experiment."""

    def draw(figure: "Figure", rows: Sequence[Row]) -> None:
        figure.set_size_inches(15, 5.6)
        world = worlds(rows)[0]
        figure.suptitle(f"{title} ({world})", x=0.012, ha="left", fontsize=16, fontweight="bold")
        by_look, driven, by_metre = figure.subplots(1, 3)
        looks = max(int(row["look"]) for row in rows if row["row"] == "look")
        for place, method in enumerate(methods(rows)):
            colour = INK if method == OURS else COLOURS[place % len(COLOURS)]
            mapped = [100.0 * v for v in curve(rows, world, method, "coverage", looks)]
            metres = curve(rows, world, method, "driven_m", looks)
            style = {"color": colour, "lw": 2.4 if method == OURS else 1.3, "label": method}
            by_look.plot(range(1, looks + 1), mapped, **style)
            driven.plot(range(1, looks + 1), metres, **style)
            by_metre.plot(metres, mapped, **style)
        _label(by_look, "Mapped, %, by look", "looks")
        _label(driven, "Metres driven, by look", "looks")
        _label(by_metre, "Mapped, %, by distance", "metres driven")
        best = [curve(rows, world, m, "driven_m", looks)[-1] for m in methods(rows)]
        by_metre.set_xlim(0, min(max(best), 3.0 * sorted(best)[len(best) // 2]))
        by_look.legend(fontsize=9)

    return draw


def _label(axes: "Axes", title: str, below: str) -> None:
    axes.set_title(title)
    axes.set_xlabel(below)
    axes.grid(color=MUTED, alpha=0.2)
