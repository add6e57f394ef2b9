"""The figure of the `compress` experiment."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from comms.papercode import COMPRESSORS
from scenarios.experiments.compress_claims import (
    CUTOFFS_BITS,
    Choice,
    bounds_m,
    grounds,
    is_paper,
    is_way,
    values_of,
)
from scenarios.experiments.figure import COLOURS
from scenarios.experiments.tables import Row
from scenarios.palette import INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw(figure: "Figure", rows: Sequence[Row]) -> None:
    """Draw bytes against error, the four compressors, and how far errors leave their bins."""
    figure.set_size_inches(16, 5.6)
    figure.suptitle(
        f"Maps of {grounds(rows)[0]} ground: the paper's codec, its compressors, and ours",
        x=0.012,
        ha="left",
        fontsize=16,
        fontweight="bold",
    )
    first = [row for row in rows if row["ground"] == grounds(rows)[0]]
    trade, packed, bounded = figure.subplots(1, 3)
    _draw_trade(trade, first)
    _draw_compressors(packed, first)
    _draw_bounds(bounded, first)


def _means(rows: Sequence[Row], value: str, choice: Choice) -> list[float]:
    """Return the mean of a value at each bound."""
    ground = grounds(rows)[0]
    return [float(np.mean(values_of(rows, value, ground, m, choice))) for m in bounds_m(rows)]


def _cutoff_lines(compressor: str) -> list[tuple[str, str, Choice]]:
    """Return label, colour and choice of the paper's cut-offs, then ours."""
    papers = [
        (f"paper, {cutoff:g} bit", colour, is_paper(cutoff, compressor))
        for cutoff, colour in zip(CUTOFFS_BITS, COLOURS, strict=False)
    ]
    return [*papers, ("ours", INK, is_way("ours"))]


def _draw_trade(axes: "Axes", rows: Sequence[Row]) -> None:
    axes.set_title("Largest error for the bytes (LZW)")
    for label, colour, choice in _cutoff_lines("lzw"):
        errors_m = _means(rows, "error_m", choice)
        bits = _means(rows, "bits_per_cell", choice)
        axes.plot(bits, errors_m, "o-", color=colour, label=label)
    axes.set(xscale="log", yscale="log", xlabel="bits per cell", ylabel="largest error, m")
    axes.legend(fontsize=9.5)


def _draw_compressors(axes: "Axes", rows: Sequence[Row]) -> None:
    axes.set_title("The same leaves, four ways (0.5 bit)")
    lines = [
        *((name, COLOURS[4 + k], is_paper(0.5, name)) for k, name in enumerate(COMPRESSORS)),
        ("ours", INK, is_way("ours")),
    ]
    for index, (label, colour, choice) in enumerate(lines):
        kilobytes = [size / 1000 for size in _means(rows, "bytes", choice)]
        at = np.arange(len(kilobytes)) + 0.16 * (index - (len(lines) - 1) / 2)
        axes.bar(at, kilobytes, 0.15, label=label, color=colour)
    _bins_axis(axes, rows)
    axes.set_ylabel("kB")
    axes.legend(fontsize=9.5)


def _draw_bounds(axes: "Axes", rows: Sequence[Row]) -> None:
    axes.set_title("The cut-off bounds no error")
    for label, colour, choice in _cutoff_lines("lzw"):
        halves = np.array(_means(rows, "error_m", choice)) / bounds_m(rows)
        style = "o:" if label == "ours" else "o-"  # it lies on the line of 0 bit
        axes.plot(range(len(halves)), halves, style, color=colour, label=label)
    _bins_axis(axes, rows)
    axes.set(yscale="log", ylabel="largest error, in half bins")
    axes.legend(fontsize=9.5, loc="upper left", bbox_to_anchor=(0.02, 0.36), ncols=2)


def _bins_axis(axes: "Axes", rows: Sequence[Row]) -> None:
    halves_m = bounds_m(rows)
    axes.set_xticks(range(len(halves_m)), [f"{m:g} m" for m in halves_m])
    axes.set_xlabel("half the width of bins")
