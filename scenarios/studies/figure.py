"""What came out of a study against what was varied: means with 95 % intervals, in one picture."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.errors import UsageError
from scenarios.experiments.figure import COLOURS, save_figure
from scenarios.experiments.tables import Estimate, Table, estimate
from scenarios.palette import INK, MUTED
from scenarios.schema.overrides import parse_value
from scenarios.studies.table import Number, Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOG_RATIO = 30.0
"""Values that spread wider than this are drawn on a logarithmic axis."""
_MARKERS = "osD^vPX*"
_PANEL_INCHES = (6.4, 5.0)


@dataclass(frozen=True)
class Point:
    """All trials of one value of x, of one line."""

    x: Number
    y: Estimate | None
    """None: no trial has a value."""
    trials: int
    """Ended in order, with or without a value of y."""

    @property
    def share(self) -> float:
        """Share of the trials that have a value."""
        return 0.0 if self.y is None else self.y.count / self.trials


@dataclass(frozen=True)
class Line:
    """One line of the picture."""

    name: str
    points: Sequence[Point]


def chosen(rows: Sequence[Row], conditions: Sequence[str]) -> list[Row]:
    """Return the rows for which all COLUMN=VALUE hold.

    Raises:
        UsageError: one is no such thing, there is no such column, or no row is left.

    """
    left = list(rows)
    for condition in conditions:
        column, equals, text = condition.partition("=")
        if not equals:
            raise UsageError(f"--where {condition}: must be COLUMN=VALUE")
        _check(rows, column)
        value = parse_value(text)
        there = list(dict.fromkeys(str(row.get(column)) for row in rows))
        left = [row for row in left if row.get(column) in (value, text)]
        if not left:
            raise UsageError(f"--where {condition}: no trial is left; there are {', '.join(there)}")
    return left


def lines_of(rows: Sequence[Row], x: str, y: str, by: str | None) -> list[Line]:
    """Return what is to be drawn of one quantity; trials that failed don't count.

    Raises:
        UsageError: there is no such column, or no trial has a value in it.

    """
    for column in (x, y, *([by] if by else [])):
        _check(rows, column)
    ended = [row for row in rows if row.get("state") == "done"]
    if not any(_number(row.get(y)) is not None for row in ended):
        raise UsageError(f"{y}: no trial has a number there ({len(ended)} trials ended)")
    names = _in_order({row.get(by) for row in ended}) if by else [None]
    found: list[Line] = []
    for name in names:
        mine = [row for row in ended if by is None or row.get(by) == name]
        points = [
            _point(x_value, [row for row in mine if row.get(x) == x_value], y)
            for x_value in _in_order({row.get(x) for row in mine})
        ]
        found.append(Line(y if by is None else str(name), points))
    return found


def _check(rows: Sequence[Row], column: str) -> None:
    there = list(dict.fromkeys(name for row in rows for name in row))
    if column not in there:
        raise UsageError(f"{column}: there is no such column; there are: {', '.join(there)}")


def _point(x: Number, rows: Sequence[Row], y: str) -> Point:
    values = [value for value in (_number(row.get(y)) for row in rows) if value is not None]
    return Point(x, estimate(values) if values else None, len(rows))


def _number(value: Number) -> float | None:
    if isinstance(value, bool | int | float) and math.isfinite(value):
        return float(value)
    return None


def _in_order(values: set[Number]) -> list[str | float]:
    """Return values by size, words after numbers, what is missing left out."""
    words = sorted(value for value in values if isinstance(value, str))
    numbers = sorted(v for v in values if v is not None and not isinstance(v, str))
    return [*numbers, *words]


def table_of(lines: Sequence[Line], x: str, y: str, by: str | None) -> Table:
    """Return the picture's numbers as a table, how many of the trials have one beside them."""
    cells = [
        [
            line.name,
            str(p.x),
            "none" if p.y is None else p.y,
            f"{p.y.count if p.y else 0}/{p.trials}",
        ]
        for line in lines
        for p in line.points
    ]
    return Table(y, y, [by or "line", x, "mean", "trials"], cells, ["", "", ".4g", ""])


def draw_study(
    path: Path, rows: Sequence[Row], *, x: str, y: Sequence[str], by: str | None, title: str = ""
) -> list[Table]:
    """Draw a panel for each quantity, write the PNG, and return the numbers in it.

    Raises:
        UsageError: as `lines_of`.

    """
    panels = [(name, lines_of(rows, x, name, by)) for name in y]

    def draw(figure: "Figure") -> None:
        figure.set_size_inches(_PANEL_INCHES[0] * len(panels), _PANEL_INCHES[1])
        if title:
            figure.suptitle(title, x=0.012, ha="left", fontsize=14, fontweight="bold", wrap=True)
        for axes, (name, lines) in zip(
            figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
        ):
            _draw_panel(axes, lines, x, name, by)

    save_figure(path, draw)
    return [table_of(lines, x, name, by) for name, lines in panels]


def _draw_panel(axes: "Axes", lines: Sequence[Line], x: str, y: str, by: str | None) -> None:
    places = _places(lines)
    some_missing = False
    for number, line in enumerate(lines):
        shown = [(places[p.x], p) for p in line.points if p.y is not None]
        some_missing |= any(p.share < 1 for p in line.points)
        style = {"color": COLOURS[number % len(COLOURS)], "label": line.name}
        _draw_line(axes, shown, _MARKERS[number % len(_MARKERS)], style)
    axes.set_title(y)
    axes.set_xlabel(x)
    axes.grid(color=MUTED, alpha=0.2)
    _scale(axes, lines, places)
    if by is not None:
        axes.legend(title=by, fontsize=9)
    if some_missing:
        note = "hollow: not every trial has a value (mean of those that have)"
        axes.annotate(note, (0, -0.17), xycoords="axes fraction", fontsize=8.5, color=MUTED)


def _draw_line(
    axes: "Axes", shown: Sequence[tuple[float, Point]], marker: str, style: dict[str, Any]
) -> None:
    at = [place for place, _ in shown]
    estimates = [point.y for _, point in shown if point.y is not None]
    means = [one.mean for one in estimates]
    reach = [one.half_width or 0.0 for one in estimates]
    axes.errorbar(at, means, yerr=reach, fmt="-", capsize=3, elinewidth=1.2, zorder=3, **style)
    for (place, point), mean in zip(shown, means, strict=True):
        fill = style["color"] if point.share == 1 else "white"
        axes.plot(place, mean, marker, color=style["color"], markerfacecolor=fill, ms=6.5, zorder=4)


def _places(lines: Sequence[Line]) -> dict[Number, float]:
    """Return where each x stands: numbers where they are, words side by side."""
    values = _in_order({point.x for line in lines for point in line.points})
    if any(isinstance(value, str | bool) for value in values):
        return {value: float(place) for place, value in enumerate(values)}
    return {value: float(value) for value in values}


def _scale(axes: "Axes", lines: Sequence[Line], places: dict[Number, float]) -> None:
    if any(isinstance(value, str | bool) for value in places):
        axes.set_xticks(list(places.values()), [str(value) for value in places])
    else:
        at = list(places.values())
        if min(at) > 0 and max(at) / min(at) > LOG_RATIO:
            axes.set_xscale("log")
        axes.set_xticks(at, [f"{value:g}" for value in at], color=INK)
        axes.minorticks_off()
    shown = [p.y for line in lines for p in line.points if p.y is not None]
    low, high = min(one.mean for one in shown), max(one.mean for one in shown)
    if low > 0 and high / low > LOG_RATIO:
        axes.set_yscale("log")
    elif low >= 0 and high > 0:
        axes.set_ylim(0, 1.06 * max(one.mean + (one.half_width or 0.0) for one in shown))
