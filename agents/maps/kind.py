"""What a kind of map has to answer, so that it is kept, shared and merged like every other.

A kind says how cells are measured, written for the air and laid over one another; who keeps
versions, tells what is worth its bytes, or writes to disk knows nothing of what is in a cell.
"""

from typing import Protocol, TypeVar

from agents.geometry import GridFrame
from agents.layers import Anchor, Mask, Submap
from agents.tiles import Shape, TileGrid, Window
from comms.codec import EncodedTile

__all__ = [
    "ALONE",
    "EVERYWHERE",
    "Beside",
    "E",
    "Estimate",
    "MapKind",
    "Mask",
    "S",
    "Shape",
    "Window",
]

EVERYWHERE: Window = (slice(None), slice(None))
"""The whole of a map, however many axes it has."""


class Estimate(Protocol):
    """What is known of each cell of a grid (rows, cols), or of voxels."""

    @property
    def known(self) -> Mask:
        """Mask of the cells of which something is known."""
        ...


S = TypeVar("S", bound=Submap)
E = TypeVar("E", bound=Estimate)
T = TypeVar("T")
Beside = tuple[T | None, T | None, T | None, T | None]
"""What is drawn on the tiles in the south, north, west and east; None: nothing."""
ALONE = (None, None, None, None)


class MapKind(Protocol[S, E]):
    """One kind of map: its submaps S, and the estimates E that are made of them."""

    @property
    def least_bits_per_byte(self) -> float:
        """Less information than this is not worth a byte of radio."""
        ...

    @property
    def looks_beside(self) -> bool:
        """Whether what is drawn next to a cell says how unsure the anchor makes it."""
        ...

    def tiles(self, frame: GridFrame, tile_cells: int, whole: GridFrame | None = None) -> TileGrid:
        """Return how a grid is cut into tiles of so many cells a side; see `TileGrid`."""
        ...

    def submap(self, frame: GridFrame, anchor: Anchor) -> S:
        """Return an empty submap."""
        ...

    def blank(self, shape: Shape) -> E:
        """Return an estimate of a place of which nothing is known."""
        ...

    def drawn(self, submap: S, window: Window) -> E:
        """Return what a robot measured itself, in a window of its own submap."""
        ...

    def as_sent(self, submap: S, window: Window) -> E:
        """Return a tile of a submap as its payload's finest level would give it to a listener."""
        ...

    def offer(self, submap: S, window: Window) -> tuple[float, int]:
        """Return what information a window would be worth once sent, and about how many bytes."""
        ...

    def encode(self, submap: S, window: Window) -> EncodedTile:
        """Return the payload of a window; information is rounded down, never up."""
        ...

    def decode(self, prefix: bytes, shape: Shape) -> E | None:
        """Return what a prefix of a payload tells of a tile; None where that is nothing."""
        ...

    def level(self, prefix: bytes, shape: Shape) -> int:
        """Return the last level of a payload that a prefix holds whole; -1 where that is none."""
        ...

    def paste(self, drawing: E, window: Window, tile: E) -> None:
        """Replace a window of a drawing by a tile."""
        ...

    def cut(self, estimate: E, window: Window) -> E:
        """Return a window of an estimate."""
        ...

    def surest(self, first: E, second: E) -> E:
        """Take each cell from the surer of two estimates of one origin, whose errors are shared."""
        ...

    def fuse(self, layers: list[E], shape: Shape) -> E:
        """Add up what independent origins measured, cell by cell."""
        ...

    def moved(self, drawing: E, anchor: Anchor, frame: GridFrame) -> E:
        """Return a drawing where its anchor's correction puts it."""
        ...

    def blurred(
        self,
        drawing: E,
        anchor: Anchor,
        frame: GridFrame,
        window: Window = EVERYWHERE,
        beside: Beside[E] = ALONE,
    ) -> E:
        """Return a window of a drawing no surer than its anchor's covariance lets it be.

        `beside` counts only where the kind `looks_beside`.
        """
        ...

    def bits(self, estimate: E) -> float:
        """Return the information of an estimate, against knowing nothing."""
        ...

    def restored(self, frame: GridFrame, anchor: Anchor, cells: list[bytes]) -> S:
        """Return the submap that `Submap.cells` wrote.

        Raises:
            ValueError: the bytes are none that were written for this frame.

        """
        ...
