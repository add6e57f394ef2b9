"""Figures of experiments: drawn without a screen, written whole or not at all."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.palette import STYLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#332288", "#cc6677", "#44aa99", "#ddcc77", "#88ccee", "#882255", "#999933", "#117733")
"""Tol's: lines and bars that the colour-blind tell apart too."""


def save_figure(path: Path, draw: Callable[["Figure"], None]) -> None:
    """Write a PNG of what `draw` puts on an empty figure (it may change the figure's size)."""
    import matplotlib as mpl  # noqa: PLC0415  (slow to import, and not all who import this draw)
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415
    from matplotlib.layout_engine import ConstrainedLayoutEngine  # noqa: PLC0415

    with mpl.rc_context(STYLE):
        layout = ConstrainedLayoutEngine(w_pad=0.09, h_pad=0.1)
        figure = Figure(figsize=(12, 6), dpi=110, layout=layout, facecolor="white")
        FigureCanvasAgg(figure)
        draw(figure)
        part = path.with_name(f".{path.name}.part")
        figure.savefig(part, format="png")
    part.replace(path)
