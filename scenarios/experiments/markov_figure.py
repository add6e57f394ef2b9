"""The figure of the `markov` experiment: Fig. 7, errors by size of holes, and sigmas."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from agents.geometry import Floats
from agents.ground import markov
from scenarios.experiments.figure import COLOURS
from scenarios.experiments.markov_claims import MM, chosen, distinct, values
from scenarios.experiments.markov_surfaces import sample
from scenarios.experiments.tables import Row
from scenarios.palette import INK, MUTED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw(figure: "Figure", rows: Sequence[Row]) -> None:
    """Draw both samples as they are known and as they are completed, then errors and sigmas."""
    figure.set_size_inches(16, 8.6)
    figure.suptitle(
        "Unknown cells estimated from known ones",
        x=0.012,
        ha="left",
        fontsize=16,
        fontweight="bold",
    )
    panels = figure.subplots(2, 3, width_ratios=(1, 1, 1.35))
    seed = min(int(row["seed"]) for row in rows)
    for number, (name, title) in enumerate(
        (("sinusoid", "sinusoid, unknown cells"), ("step", "step, one half unknown"))
    ):
        _, known_m = sample(name, np.random.default_rng((seed, 7)))
        panels[number, 0].set_title(f"Sample {number + 1}: {title}")
        panels[number, 1].set_title("completed")
        _show(panels[number, 0], known_m, known_m)
        _show(panels[number, 1], markov.complete(known_m), known_m)
    _draw_sizes(panels[0, 2], chosen(rows, part="size"))
    _draw_sigmas(panels[1, 2], chosen(rows, part="ground", unknown="holes"))


def _show(axes: "Axes", values_m: Floats, known_m: Floats) -> None:
    low, high = float(np.nanmin(known_m)), float(np.nanmax(known_m))
    axes.set_facecolor("#d8dbe2")
    axes.imshow(values_m, origin="lower", cmap="cividis", vmin=low, vmax=high)
    axes.set_xticks([])
    axes.set_yticks([])


def _draw_sizes(axes: "Axes", sizes: Sequence[Row]) -> None:
    axes.set_title("Error in holes of the sinusoid")
    diameters = [float(d) for d in distinct(sizes, "diameter_cells")]
    lines = (("harmonic", "rmse_m"), ("nearest known height", "nearest_rmse_m"))
    for colour, (label, key) in zip(COLOURS, lines, strict=False):
        means = [MM * np.mean(values(chosen(sizes, diameter_cells=d), key)) for d in diameters]
        axes.plot(diameters, means, "o-", color=colour, label=label)
    axes.set(xscale="log", yscale="log", xlabel="diameter, cells", ylabel="rms error, mm")
    axes.set_xticks(diameters, [f"{d:g}" for d in diameters])
    axes.minorticks_off()
    axes.legend()


def _draw_sigmas(axes: "Axes", ground: Sequence[Row]) -> None:
    """Draw the share of cells within two sigmas; 95 % would be right for Gaussian errors."""
    axes.set_title("Share of cells in holes within two sigmas")
    for colour, surface in zip(COLOURS, distinct(ground, "surface"), strict=False):
        for style, law in zip(("o-", "s--"), distinct(ground, "law"), strict=False):
            mine = chosen(ground, surface=surface, law=law)
            bins = [float(b) for b in distinct(mine, "to_cells")]
            shares = [np.mean(values(chosen(mine, to_cells=b), "within_2")) for b in bins]
            axes.plot(bins, shares, style, color=colour, label=f"{surface}, {law}", ms=4)
    axes.axhline(0.95, color=INK, lw=1)
    bins = [float(b) for b in distinct(ground, "to_cells")]
    axes.set(xscale="log", xlabel="at most so many cells from known ground")
    axes.set_xticks(bins, [f"{b:g}" for b in bins])
    axes.minorticks_off()
    axes.grid(color=MUTED, alpha=0.2)
    axes.legend(fontsize=9)
