"""The figure of `sandpit` and `field`: Figs. 24 to 27 and 29 of the paper, ours beside."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from scenarios.experiments.figure import COLOURS
from scenarios.experiments.ground.claims import AGREE, at_look, methods
from scenarios.experiments.ground.grids import SHOWN_LOOK, grid_of
from scenarios.experiments.ground.runs import LOOKS, ORACLE, OURS, SHOWN
from scenarios.experiments.tables import Row
from scenarios.palette import INK, MUTED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Grids = dict[str, Row]


def drawing(title: str) -> Callable[["Figure", Sequence[Row]], None]:
    """Return a function that draws the figure of one experiment."""

    def draw(figure: "Figure", rows: Sequence[Row]) -> None:
        shown = [name for name in SHOWN if _grids(rows, name)]
        height = 5.2 + (9.6 if shown else 0.0)
        figure.set_size_inches(15, height)
        figure.suptitle(title, x=0.012, ha="left", fontsize=16, fontweight="bold")
        heights = [5.2, 9.6] if shown else [5.2]
        parts: Any = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)
        above = parts[0, 0]
        mapped, agreed = above.subplots(1, 2, width_ratios=[1.2, 1])
        _draw_mapped(mapped, rows)
        _draw_agreed(agreed, rows)
        if shown:
            panels = parts[1, 0].subplots(3, len(shown), squeeze=False)
            for column, name in enumerate(shown):
                grids = _grids(rows, name)
                _draw_top(panels[0][column], name, grids, rows)
                _draw_interest(panels[1][column], grids)
                _draw_regions(panels[2][column], grids)

    return draw


def _grids(rows: Sequence[Row], method: str) -> Grids:
    return {str(r["grid"]): r for r in rows if r["row"] == "grid" and r["method"] == method}


def _colour(method: str, place: int) -> str:
    return INK if method == OURS else MUTED if method == ORACLE else COLOURS[place % len(COLOURS)]


def _last(rows: Sequence[Row], method: str) -> int:
    return max(
        (int(r["look"]) for r in rows if r["row"] == "look" and r["method"] == method),
        default=LOOKS,
    )


def _draw_mapped(axes: "Axes", rows: Sequence[Row]) -> None:
    axes.set_title("Cells mapped, by look (mean over seeds)")
    for place, method in enumerate(methods(rows)):
        looks = range(1, _last(rows, method) + 1)
        means = [float(np.mean(list(at_look(rows, method, n).values()))) for n in looks]
        style: dict[str, Any] = {"lw": 2.6 if method == OURS else 1.5, "label": method}
        style["ls"] = "--" if method == ORACLE else "-"
        axes.plot([0, *looks], [0.0, *means], color=_colour(method, place), **style)
    axes.set_xlabel("looks after those all round")
    axes.grid(color=MUTED, alpha=0.2)
    axes.legend(fontsize=9)


def _draw_agreed(axes: "Axes", rows: Sequence[Row]) -> None:
    axes.set_title("Obtained over expected cells, by look (median over seeds)")
    axes.axhspan(*AGREE, color=MUTED, alpha=0.15, lw=0)
    for place, method in enumerate(methods(rows)):
        if method not in SHOWN:
            continue
        ratios: dict[int, list[float]] = {}
        for row in rows:
            if row["row"] == "look" and row["method"] == method and "expected_cells" in row:
                ratio = float(row["obtained_cells"]) / max(float(row["expected_cells"]), 1.0)
                ratios.setdefault(int(row["look"]), []).append(ratio)
        looks = sorted(ratios)
        medians = [float(np.median(ratios[n])) for n in looks]
        axes.plot(looks, medians, "o-", color=_colour(method, place), ms=4, label=method)
    axes.set_ylim(0, 2)
    axes.set_xlabel("looks after those all round")
    axes.legend(fontsize=9)


def _extent(row: Row) -> tuple[float, float, float, float]:
    west, east = float(row["west_m"]), float(row["east_m"])
    return west, east, float(row["south_m"]), float(row["north_m"])


def _image(axes: "Axes", row: Row, colours: str, **more: Any) -> None:
    style: dict[str, Any] = {"origin": "lower", "interpolation": "nearest", "cmap": colours, **more}
    axes.imshow(grid_of(row), extent=_extent(row), **style)


def _mask(axes: "Axes", row: Row, colour: str, alpha: float) -> None:
    grid = grid_of(row) > 0.5
    layer = np.zeros((*grid.shape, 4))
    layer[..., :3] = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    layer[..., 3] = np.where(grid, alpha, 0.0)
    axes.imshow(layer, extent=_extent(row), origin="lower", interpolation="nearest")


def _outline(axes: "Axes", row: Row, colour: str) -> None:
    grid = grid_of(row)
    if grid.max() > 0.5:
        west, east, south, north = _extent(row)
        x = np.linspace(west, east, grid.shape[1])
        y = np.linspace(south, north, grid.shape[0])
        axes.contour(x, y, grid, levels=[0.5], colors=[colour], linewidths=1.0)


def _draw_top(axes: "Axes", method: str, grids: Grids, rows: Sequence[Row]) -> None:
    looks = [r for r in rows if r["row"] == "look" and r["method"] == method and r["seed"] == 1]
    axes.set_title(f"{method}, {len(looks)} looks")
    _image(axes, grids["ground"], "Greys_r", alpha=0.55)
    _mask(axes, grids["known"], "#0072b2", 0.45)
    _outline(axes, grids["poor"], "#d55e00")
    style: dict[str, Any] = {"color": INK, "ms": 5, "mfc": "white", "lw": 1.0}
    axes.plot([float(r["x_m"]) for r in looks], [float(r["y_m"]) for r in looks], "o-", **style)
    axes.set_ylabel("north, m")


def _draw_interest(axes: "Axes", grids: Grids) -> None:
    axes.set_title("Interest; orange: poor texture")
    _image(axes, grids["interest"], "magma", vmin=0.0, vmax=1.0)
    _outline(axes, grids["poor"], "#d55e00")
    axes.set_ylabel("north, m")


def _draw_regions(axes: "Axes", grids: Grids) -> None:
    axes.set_title(f"Look {SHOWN_LOOK}: expected (red), got")
    if "expected" not in grids:
        return
    _mask(axes, grids["before"], MUTED, 0.5)
    _mask(axes, grids["acquired"], "#000000", 1.0)
    _outline(axes, grids["expected"], "#cc3311")
    axes.set_aspect("equal")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
