"""Colours of robots (Okabe and Ito) and frame kinds (Tol): the colour-blind tell them apart too."""

from collections.abc import Iterable
from typing import Any

INK = "#1d2430"
MUTED = "#8a92a0"
STYLE: dict[Any, Any] = {
    "font.size": 11,
    "axes.titlesize": 12.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
}
"""Of every figure, as matplotlib has it."""

MANY = 12
"""Of more robots than these not each one is named beside a picture."""
_ROBOTS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
_KINDS = {
    "MAP": "#332288",
    "ANCHOR": "#88ccee",
    "DIGEST": "#ddcc77",
    "STATUS": "#44aa99",
    "TETHER": "#cc6677",
    "FIX": "#999933",
    "STOP": "#882255",
}
_OTHER_KIND = "#999999"
_MARKERS = {"recon": "o", "explorer": "o", "cliffbot": "v", "anchor": "s"}


def robot_colours(names: Iterable[str]) -> dict[str, str]:
    """Return a colour per robot, by name; they come round again after six."""
    return {name: _ROBOTS[index % len(_ROBOTS)] for index, name in enumerate(sorted(names))}


def run_colours(count: int) -> list[str]:
    """Return a colour per run; with more than six they are spread over all hues."""
    if count <= len(_ROBOTS):
        return list(_ROBOTS[:count])
    return [f"hsl({round(360 * index / count)} 60% 45%)" for index in range(count)]


def kind_colour(kind: str) -> str:
    """Return the colour of a kind of frame."""
    return _KINDS.get(kind.upper(), _OTHER_KIND)


def in_kind_order(kinds: Iterable[str]) -> list[str]:
    """Return the kinds that there are, maps first; unknown ones last, by name."""
    ranks = {kind: rank for rank, kind in enumerate(_KINDS)}
    return sorted(set(kinds), key=lambda kind: (ranks.get(kind.upper(), len(ranks)), kind))


def marker_of(role: str) -> str:
    """Return the marker of a role: round maps, pointing down goes down, square stands fast."""
    return _MARKERS.get(role, "D")


def short(name: str) -> str:
    """Return what tells a robot from those of its kind: the end of its name."""
    return name.rpartition("-")[2]
