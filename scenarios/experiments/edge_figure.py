"""The figure of the `edge` experiment: Fig. 9."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from agents.geometry import Bools, Floats
from scenarios.experiments.edge_claims import groups, values
from scenarios.experiments.edge_ground import Site, Trial, found_edge, outer_pixels, site_of
from scenarios.experiments.figure import COLOURS
from scenarios.experiments.tables import Row
from scenarios.palette import INK, MUTED
from scenarios.pictures.shading import colours, hillshade

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw(figure: "Figure", rows: Sequence[Row]) -> None:
    """Draw the steps on one map, the polygon at both cell sizes, and all deviations."""
    figure.set_size_inches(16, 10)
    first = rows[0]
    figure.suptitle(
        f"The cliff edge on ground with {first['site']} rocks, the paper's way",
        x=0.012,
        ha="left",
        fontsize=16,
        fontweight="bold",
    )
    panels = figure.subplots(2, 3)
    trial = _trial(first)
    site = site_of(trial)
    found = found_edge(site, trial, "paper")
    level = np.abs(site.completed_m - site.contact_m) <= trial.wheel_m
    _show_ground(panels[0, 0], site)
    _show(panels[0, 1], level, "Within a wheel of the wheels' height")
    _show(panels[0, 2], found.plateau, "Region grown, closed, holes dropped")
    for axes, cell_m in zip(panels[1, :2], sorted({_cell(r) for r in rows})[::-1], strict=False):
        _draw_polygon(axes, next(row for row in rows if _cell(row) == cell_m))
    _draw_deviations(panels[1, 2], [row for row in rows if row["way"] == "paper"])


def _cell(row: Row) -> float:
    return float(row["cell_m"])


def _trial(row: Row) -> Trial:
    sizes = (float(row["wheel_m"]), float(row["unknown_share"]))
    return Trial(str(row["site"]), _cell(row), int(row["seed"]), *sizes)


def _bare(axes: "Axes", title: str) -> None:
    axes.set_title(title)
    axes.set_xticks([])
    axes.set_yticks([])


def _show_ground(axes: "Axes", site: Site) -> None:
    z = site.ground_m
    share = (z - z.min()) / max(float(np.ptp(z)), 1e-9)
    lit = hillshade(z.astype(np.float32), site.frame.cell_m)
    picture = np.clip(colours(share) * (0.5 + lit[:, :, None]), 0.0, 1.0)
    picture[site.known_distance_m > 0] = (0.84, 0.86, 0.885)
    axes.imshow(picture, origin="lower")
    axes.plot(site.cell[1], site.cell[0], "^", color=INK, ms=9)
    _bare(axes, "As it is known (8 m wide); the robot")


def _show(axes: "Axes", mask: Bools, title: str) -> None:
    axes.imshow(mask, origin="lower", cmap="Greys", vmin=0, vmax=1.6)
    _bare(axes, title)


def _draw_polygon(axes: "Axes", row: Row) -> None:
    trial = _trial(row)
    found = found_edge(site_of(trial), trial, "paper")
    pixels = outer_pixels(found.plateau)
    axes.plot(pixels[:, 1], pixels[:, 0], ".", color=MUTED, ms=1.5)
    corners: Floats = np.concatenate((found.vertices, found.vertices[:1]))
    axes.plot(corners[:, 1], corners[:, 0], "o-", color=COLOURS[1], ms=3, lw=1.4)
    axes.set_aspect("equal")
    _bare(axes, f"{100 * trial.cell_m:g} cm per pixel: largest {found.max_px:.2f} pixels")


def _draw_deviations(axes: "Axes", rows: Sequence[Row]) -> None:
    axes.set_title("Deviations, as shares of the bound")
    for place, (site, cell_m, _, mine) in enumerate(groups(rows)):
        bound = float(mine[0]["bound_px"])
        for colour, key in zip(COLOURS, ("max_px", "segment_mean_px", "rim_mean_px"), strict=False):
            shares = [value / bound for value in values(mine, key)]
            axes.plot([place] * len(shares), shares, "o", color=colour, ms=4, alpha=0.6)
            axes.annotate(
                f"{site}\n{100 * cell_m:g} cm", (place, -0.13), ha="center", annotation_clip=False
            )
    for colour, label in zip(COLOURS, ("largest", "segments' largest, mean", "mean"), strict=False):
        axes.plot([], [], "o", color=colour, label=label)
    axes.axhline(1.0, color=INK, lw=1)
    axes.set(ylim=(0, 1.3), xlim=(-0.5, 3.5))
    axes.set_xticks([])
    axes.legend(fontsize=9, loc="upper center", ncols=3)
