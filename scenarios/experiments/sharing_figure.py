"""The figure of the `sharing` experiment."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from scenarios.experiments.figure import COLOURS
from scenarios.experiments.sharing_claims import (
    chosen,
    distinct,
    lag_rows,
    mean_coverage,
    rate_name,
    rates,
    values,
)
from scenarios.experiments.tables import Row
from scenarios.palette import INK, MUTED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


LEAST_SHARE = 1e-3
"""Below this nobody lacks anything."""


def draw(figure: "Figure", rows: Sequence[Row]) -> None:
    """Draw catching up, lagging behind, and coverage by link."""
    figure.set_size_inches(16, 5.6)
    figure.suptitle(
        "What thin links do to a team", x=0.012, ha="left", fontsize=16, fontweight="bold"
    )
    caught, lagged, mapped = figure.subplots(1, 3)
    _draw_catch_up(caught, chosen(rows, part="catch-up", row="run"))
    _draw_lag(lagged, lag_rows(chosen(rows, row="series")))
    _draw_coverage(mapped, chosen(rows, part="mission", row="series"))


def _draw_catch_up(axes: "Axes", runs: Sequence[Row]) -> None:
    axes.set_title("Until a latecomer holds 90 %, s")
    policies = distinct(runs, "policy")
    for place, policy in enumerate(policies):
        found = [t for t in values(chosen(runs, policy=policy), "catch_up_s") if np.isfinite(t)]
        if found:
            axes.barh(place, float(np.mean(found)), color=COLOURS[place], height=0.6)
            axes.plot(found, [place] * len(found), "o", color=INK, ms=3, alpha=0.5)
            axes.annotate(f" {np.mean(found):.0f} s", (max(found), place), va="center", color=INK)
    axes.set_yticks(range(len(policies)), policies)
    axes.invert_yaxis()
    if runs:
        axes.set_xscale("log")


def _draw_lag(axes: "Axes", series: Sequence[Row]) -> None:
    axes.set_title("What listeners lack of what was measured")
    for style, scenario in zip(("-", "--"), distinct(series, "scenario"), strict=False):
        mine = chosen(series, scenario=scenario)
        for colour, policy in zip(COLOURS, distinct(mine, "policy"), strict=False):
            told = chosen(mine, policy=policy)
            times = sorted({float(row["t_s"]) for row in told})
            means = [float(np.mean(values(chosen(told, t_s=t), "lacking_share"))) for t in times]
            minutes = [t / 60 for t in times]
            axes.plot(minutes, means, style, color=colour, label=f"{policy}, {scenario}")
    axes.set_xlabel("simulated minutes, at 2400 bps")
    if series:
        axes.set_yscale("log")
        axes.set_ylim(LEAST_SHARE, 1)
        axes.legend(fontsize=9, ncols=2)


def _draw_coverage(axes: "Axes", series: Sequence[Row]) -> None:
    axes.set_title("Ground mapped by a robot of `pair`, by link")
    for colour, rate_bps in zip(COLOURS, rates(series), strict=False):
        times, means = mean_coverage(series, "pair", rate_bps)
        if times:
            axes.plot([t / 60 for t in times], means, color=colour, label=rate_name(rate_bps))
    axes.set_xlabel("simulated minutes")
    axes.grid(color=MUTED, alpha=0.2)
    if series:
        axes.legend(title="link", fontsize=9)
