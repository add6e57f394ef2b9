"""What the radios carried and what it brought, over time: the lower half of the overview."""

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from agents.geometry import Floats
from scenarios.palette import INK, MANY, MUTED, in_kind_order, kind_colour, robot_colours
from scenarios.records.tables import EventRow, Records
from scenarios.schema.events import KINDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STEPS = 400
"""Moments at which sums are drawn: a pixel or two each."""
INCIDENTS = (*KINDS, "died")
"""Events that change what the robots can do, and are marked."""


def sent_kb(records: Records, kind: str, times_s: Floats) -> Floats:
    """Return the kilobytes (T,) of one kind whose transmission had ended by each moment."""
    frames = sorted((tx.end_s, tx.bytes) for tx in records.frames if tx.kind == kind)
    ends_s = np.array([end_s for end_s, _ in frames])
    sums = np.concatenate(([0.0], np.cumsum([size for _, size in frames])))
    return sums[np.searchsorted(ends_s, times_s, side="right")] / 1000


def draw_bytes_over_time(axes: "Axes", records: Records, end_s: float) -> None:
    """Draw what the team has sent by each moment, stacked by kind."""
    axes.set_title("Sent by the team")
    axes.set_ylabel("kB, modem overhead included")
    _time_axis(axes, end_s)
    kinds = in_kind_order(tx.kind for tx in records.frames)
    if not kinds:
        return _nothing(axes, "nothing was sent")
    times_s = np.linspace(0.0, end_s, _STEPS)
    layers = [sent_kb(records, kind, times_s) for kind in kinds]
    colours = [kind_colour(kind) for kind in kinds]
    axes.stackplot(times_s / 60, layers, labels=kinds, colors=colours, alpha=0.92, linewidth=0)
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], loc="upper left", fontsize=9.5)
    _mark_incidents(axes, records)
    return None


def draw_bytes_by_robot(axes: "Axes", records: Records) -> None:
    """Draw what every byte was spent on: one bar per robot, cut by kind."""
    axes.set_title("What every byte was spent on")
    axes.set_xlabel("kB sent")
    sizes = Counter[tuple[str, str]]()
    for tx in records.frames:
        sizes[(tx.sender, tx.kind)] += tx.bytes
    totals = {
        name: sum(n for (who, _), n in sizes.items() if who == name) for name in records.robots
    }
    bars = _bars(sorted(records.robots, key=lambda name: (-totals[name], name)))
    left = np.zeros(len(bars))
    for kind in in_kind_order(kind for _, kind in sizes):
        widths = np.array([np.mean([sizes[(name, kind)] for name in who]) for who in bars.values()])
        axes.barh(list(bars), widths / 1000, left=left / 1000, color=kind_colour(kind), height=0.62)
        left += widths
    if not left.any():
        return _nothing(axes, "nothing was sent")
    for row, total in enumerate(left):
        axes.text(total / 1000, row, f" {total / 1000:.1f}", va="center", fontsize=9.5)
    axes.set_xlim(0, left.max() / 1000 * 1.14)
    axes.invert_yaxis()
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)
    return None


def _bars(names: list[str]) -> dict[str, list[str]]:
    """Return whose mean each bar shows, by its label: of many robots the last share one."""
    if len(names) <= MANY:
        return {name: [name] for name in names}
    most, rest = names[: MANY - 1], names[MANY - 1 :]
    return {**{name: [name] for name in most}, f"mean of {len(rest)} more": rest}


def draw_information(axes: "Axes", records: Records, end_s: float) -> None:
    """Draw how much each robot knows by each moment: the gap between two is what the link owes."""
    axes.set_title("What each robot knows")
    axes.set_ylabel("information, kbit")
    _time_axis(axes, end_s)
    if not records.maps:
        return _nothing(axes, "no map was recorded")
    curves = {name: _known(records, name) for name in records.robots}
    curves = {name: curve for name, curve in curves.items() if len(curve)}
    if len(curves) > MANY:
        _draw_spread(axes, list(curves.values()), end_s)
    else:
        _draw_each(axes, curves, robot_colours(records.robots))
    axes.set_ylim(bottom=0)
    axes.legend(loc="lower right", fontsize=9.5)
    _mark_incidents(axes, records)
    return None


def _known(records: Records, name: str) -> Floats:
    """Return what a robot knew (N, 2): times in s, bits."""
    rows = sorted((row.t_s, row.information_bits) for row in records.maps if row.robot == name)
    return np.array(rows).reshape(-1, 2)


def _draw_each(axes: "Axes", curves: dict[str, Floats], colours: dict[str, str]) -> None:
    dashes = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), "-.", (0, (7, 2, 1.2, 2)), (0, (3, 1)))
    for index, (name, colour) in enumerate(colours.items()):
        if name in curves:
            curve, style = curves[name], dashes[index % len(dashes)]
            axes.plot(curve[:, 0] / 60, curve[:, 1] / 1000, ls=style, color=colour, label=name)


def _draw_spread(axes: "Axes", curves: list[Floats], end_s: float) -> None:
    """Draw the curves of many, the middle one and the bounds of all of them."""
    times_s = np.linspace(0.0, end_s, _STEPS)
    kbit = np.array([np.interp(times_s, curve[:, 0], curve[:, 1]) for curve in curves]) / 1000
    for curve in curves:
        axes.plot(curve[:, 0] / 60, curve[:, 1] / 1000, color=MUTED, linewidth=0.6, alpha=0.6)
    least, middle, most = np.quantile(kbit, (0.0, 0.5, 1.0), axis=0)
    axes.fill_between(
        times_s / 60, least, most, color=MUTED, alpha=0.18, label=f"all {len(curves)} robots"
    )
    axes.plot(times_s / 60, middle, color=INK, linewidth=2, label="the middle one")


def _time_axis(axes: "Axes", end_s: float) -> None:
    axes.set_xlim(0, max(end_s, 1.0) / 60)
    axes.set_xlabel("simulated time, min")
    axes.grid(axis="y", color=MUTED, alpha=0.25, linewidth=0.7)
    axes.set_axisbelow(True)


def _mark_incidents(axes: "Axes", records: Records) -> None:
    for event in _incidents(records):
        axes.axvline(event.t_s / 60, color=INK, linewidth=1, linestyle=":")
        axes.annotate(
            f"{event.what} {event.robot}",
            (event.t_s / 60, 0.98),
            xycoords=("data", "axes fraction"),
            rotation=90,
            ha="right",
            va="top",
            fontsize=9,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1},
        )


def _incidents(records: Records) -> list[EventRow]:
    return [event for event in records.events if event.what in INCIDENTS][:12]


def _nothing(axes: "Axes", words: str) -> None:
    axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", color=MUTED, fontsize=12)
