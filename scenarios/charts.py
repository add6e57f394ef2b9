"""What the radios carried and what it brought, over time: the lower half of the overview."""

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from agents.geometry import Floats
from scenarios.events import KINDS
from scenarios.palette import INK, MUTED, in_kind_order, kind_colour, robot_colours
from scenarios.record import EventRow, Records

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
    names = sorted(records.robots, key=lambda name: (-totals[name], name))
    left = np.zeros(len(names))
    for kind in in_kind_order(kind for _, kind in sizes):
        widths = np.array([sizes[(name, kind)] for name in names])
        axes.barh(names, widths / 1000, left=left / 1000, color=kind_colour(kind), height=0.62)
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


def draw_information(axes: "Axes", records: Records, end_s: float) -> None:
    """Draw how much each robot knows by each moment: the gap between two is what the link owes."""
    axes.set_title("What each robot knows")
    axes.set_ylabel("information, kbit")
    _time_axis(axes, end_s)
    if not records.maps:
        return _nothing(axes, "no map was recorded")
    dashes = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), "-.", (0, (7, 2, 1.2, 2)), (0, (3, 1)))
    names = list(records.robots)
    for index, (name, colour) in enumerate(robot_colours(names).items()):
        rows = sorted((row.t_s, row.information_bits) for row in records.maps if row.robot == name)
        if rows:
            curve = np.array(rows)
            style = dashes[index % len(dashes)]
            axes.plot(curve[:, 0] / 60, curve[:, 1] / 1000, ls=style, color=colour, label=name)
    axes.set_ylim(bottom=0)
    axes.legend(loc="lower right", fontsize=9.5)
    _mark_incidents(axes, records)
    return None


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
