"""The figure of the `descents` experiment: endings, and each mission's errors."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from scenarios.experiments.descents_claims import BECAME, LIMITS_M, count, pooled
from scenarios.experiments.figure import COLOURS
from scenarios.experiments.ground.accuracy import CLASSES
from scenarios.experiments.tables import Row
from scenarios.palette import INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw(figure: "Figure", rows: Sequence[Row]) -> None:
    """Draw what became of the missions, their errors one by one, and errors by kind of ground."""
    figure.set_size_inches(16, 5)
    ends, errors, classes = figure.subplots(1, 3)
    _draw_ends(ends, rows)
    _draw_errors(errors, rows)
    _draw_classes(classes, rows)


def _draw_ends(axes: "Axes", rows: Sequence[Row]) -> None:
    axes.set_title(f"What became of {len(rows)} missions")
    names = list(BECAME)
    counts = [count(rows, name) for name in names]
    axes.barh(names, counts, color=[COLOURS[k] for k in (7, 4, 3, 1)])
    for place, number in enumerate(counts):
        axes.annotate(f" {number}", (number, place), va="center")
    axes.invert_yaxis()
    axes.set(xlabel="missions")


def _draw_errors(axes: "Axes", rows: Sequence[Row]) -> None:
    axes.set_title("The team map's error in each mission")
    labels = ("of height, gentle and near", "to the surface, elsewhere within 10 m")
    for colour, label, (key, limit_m) in zip(COLOURS, labels, LIMITS_M.items(), strict=False):
        values = sorted(float(row[key]) for row in rows if key in row)
        axes.plot(range(1, len(values) + 1), values, "o", color=colour, label=label, ms=4)
        axes.axhline(limit_m, color=colour, lw=1, ls="--")
    axes.set(xlabel="missions, by error", ylabel="r.m.s. error, m (dashed: the most allowed)")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=9)


def _draw_classes(axes: "Axes", rows: Sequence[Row]) -> None:
    axes.set_title("Error by kind of ground, all missions")
    for shift, kind, colour in ((-0.2, "height", COLOURS[0]), (0.2, "surface", COLOURS[2])):
        places = [place + shift for place in range(len(CLASSES))]
        values = [pooled(rows, one.name, kind) for one in CLASSES]
        label = "of height" if kind == "height" else "to the surface"
        axes.bar(places, values, 0.38, color=colour, label=label)
    axes.set_xticks(range(len(CLASSES)), [one.words.replace(", ", "\n") for one in CLASSES])
    axes.set(ylabel="r.m.s. error, m")
    axes.axhline(0, color=INK, lw=0.8)
    axes.legend(fontsize=9)
