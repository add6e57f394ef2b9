"""Colours of robots and frame kinds: Okabe and Ito's set, told apart by colour-blind readers too."""

from collections.abc import Iterable, Sequence

INK = "#1d2430"
MUTED = "#8a92a0"

_ROBOTS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
_KINDS = {
    "MAP": "#0072b2",
    "ANCHOR": "#56b4e9",
    "DIGEST": "#e69f00",
    "STATUS": "#009e73",
    "TETHER": "#d55e00",
    "FIX": "#cc79a7",
    "STOP": "#1d2430",
}
_OTHER_KIND = "#999999"
_MARKERS = {"recon": "o", "explorer": "o", "cliffbot": "v", "anchor": "s"}


def robot_colours(names: Sequence[str]) -> dict[str, str]:
    """Return a colour per robot, in the order given; they come round again after six."""
    return {name: _ROBOTS[index % len(_ROBOTS)] for index, name in enumerate(names)}


def kind_colour(kind: str) -> str:
    """Return the colour of a kind of frame."""
    return _KINDS.get(kind.upper(), _OTHER_KIND)


def in_kind_order(kinds: Iterable[str]) -> list[str]:
    """Return the kinds that there are, maps first; unknown ones last, by name."""
    order = list(_KINDS)
    known = lambda kind: order.index(kind) if kind in order else len(order)
    return sorted(set(kinds), key=lambda kind: (known(kind.upper()), kind))


def marker_of(role: str) -> str:
    """Return the marker of a role: round maps, pointing down goes down, square stands fast."""
    return _MARKERS.get(role, "D")
