"""Maps as OctoMap trees: the binary `.bt` file of octomap's `OcTree`.

A tree has 16 levels below its root, which spans 65536 cells each way. An inner node is 16 bits, two
for each of its eight children: 0 unknown, 1 free, 2 occupied, 3 an inner node of its own; nodes
follow each other depth first. Eight children that are leaves of one kind are one leaf.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Ints, Singles
from scenarios.exports.kept import Kept
from scenarios.formats.rtm import MapFileError, write_file
from scenarios.logs.diary import Chart

Codes = NDArray[np.uint64]

LEVELS = 16
HALF = 1 << (LEVELS - 1)
UNKNOWN, FREE, OCCUPIED, INNER = 0, 1, 2, 3
MAX_VOXELS = 20_000_000


def write_octomap(kept: Kept, folder: Path) -> list[Path]:
    """Write ROBOT.bt in voxels of the map's cell size.

    Ground is occupied from each known cell's height down to that of its lowest known neighbour, so
    that a steep face has no holes. A floor is one layer of voxels from z = 0 up, free and occupied.

    Raises:
        MapFileError: the map is too large or too steep for a tree.

    """
    keys, states = voxels_of(kept.chart)
    path = folder / f"{kept.robot}.bt"
    write_file(path, tree_bytes(keys, states, kept.chart.frame.cell_m))
    return [path]


def voxels_of(chart: Chart) -> tuple[Ints, NDArray[np.uint8]]:
    """Return a chart's voxels: (N, 3) keys x, y, z, counted from the origin, and their states."""
    frame = chart.frame
    odds = chart.layers.get("log_odds")
    shown = np.isfinite(chart.layers["elevation"] if odds is None else odds)
    rows, cols = np.nonzero(shown)
    x_m = frame.x_m + (cols + 0.5) * frame.cell_m
    y_m = frame.y_m + (rows + 0.5) * frame.cell_m
    x, y = (np.floor(v / frame.cell_m).astype(np.int64) for v in (x_m, y_m))
    if odds is not None:
        states = np.where(odds[shown] > 0, OCCUPIED, FREE).astype(np.uint8)
        return np.column_stack((x, y, np.zeros_like(x))), states
    top = np.floor(chart.layers["elevation"][shown] / frame.cell_m).astype(np.int64)
    low = np.floor(_lowest(chart.layers["elevation"])[shown] / frame.cell_m).astype(np.int64)
    height = top - np.minimum(low, top - 1)
    if int(height.sum()) > MAX_VOXELS:
        raise MapFileError(f"the map has {int(height.sum())} voxels, allowed are {MAX_VOXELS}")
    start = np.repeat(np.cumsum(height) - height, height)
    down = np.arange(int(height.sum())) - start
    x, y, top = (np.repeat(axis, height) for axis in (x, y, top))
    keys = np.column_stack((x, y, top - down))
    return keys, np.full(len(keys), OCCUPIED, np.uint8)


def _lowest(elevation_m: Singles) -> Singles:
    """Return the lowest known height among each cell and its four neighbours, NaN where none is."""
    padded = np.pad(elevation_m, 1, constant_values=np.nan)
    south, north = padded[:-2, 1:-1], padded[2:, 1:-1]
    west, east = padded[1:-1, :-2], padded[1:-1, 2:]
    lowest = np.fmin.reduce([elevation_m, south, north, west, east])
    return np.where(np.isfinite(elevation_m), lowest, np.nan).astype(np.float32)


@dataclass(frozen=True)
class _Level:
    """Nodes of one depth that are told of: their codes (path from the root) and their children."""

    depth: int
    codes: Codes
    words: NDArray[np.uint16]


def tree_bytes(keys: Ints, states: NDArray[np.uint8], cell_m: float) -> bytes:
    """Return a tree of voxels (N, 3) of a size as the bytes of a `.bt` file.

    Raises:
        MapFileError: there is none, or one lies further from the origin than a tree reaches.

    """
    if not len(keys):
        raise MapFileError("the map has no known cell: there is no tree of nothing")
    if np.abs(keys).max() >= HALF:
        far_m = float(np.abs(keys).max()) * cell_m
        raise MapFileError(
            f"the map reaches {far_m:g} m from its origin, a tree of {cell_m:g} m voxels"
            f" {HALF * cell_m:g} m"
        )
    levels, nodes = _levels(_codes(keys + HALF), states)
    codes = np.concatenate([n.codes << np.uint64(3 * (LEVELS - n.depth)) for n in levels])
    depths = np.concatenate([np.full(len(n.codes), n.depth) for n in levels])
    words = np.concatenate([n.words for n in levels])
    head = (
        "# Octomap OcTree binary file\n# x east, y north, z up, metres\nid OcTree\n"
        f"size {nodes}\nres {cell_m:.10g}\ndata\n"
    )
    return head.encode() + words[np.lexsort((depths, codes))].astype("<u2").tobytes()


def _codes(keys: Ints) -> Codes:
    """Interleave the bits of x, y and z: three bits a level, the root's child first."""
    code = np.zeros(len(keys), np.uint64)
    for bit in range(LEVELS):
        for axis in range(3):
            one = (keys[:, axis] >> bit & 1).astype(np.uint64)
            code |= one << np.uint64(3 * bit + axis)
    return code


def _levels(codes: Codes, states: NDArray[np.uint8]) -> tuple[list[_Level], int]:
    """Return all inner nodes, and how many nodes there are in all.

    Of two voxels with one key the occupied one counts.
    """
    order = np.lexsort((states, codes))
    codes, states = codes[order], states[order]
    last = np.append(codes[1:] != codes[:-1], True)
    codes, states = codes[last], states[last]
    levels: list[_Level] = []
    nodes = 1
    for depth in range(LEVELS - 1, -1, -1):
        parents, first = np.unique(codes >> np.uint64(3), return_index=True)
        shifts = (2 * (codes & np.uint64(7))).astype(np.uint16)
        words = np.bitwise_or.reduceat(states.astype(np.uint16) << shifts, first)
        free, occupied = words == 0x5555, words == 0xAAAA
        inner = ~(free | occupied) if depth else np.ones(len(parents), dtype=np.bool_)
        levels.append(_Level(depth, parents[inner], words[inner].astype(np.uint16)))
        pairs = np.stack([words[inner] >> (2 * child) & 3 for child in range(8)])
        nodes += int(np.count_nonzero(pairs))
        codes = parents
        states = np.where(inner, INNER, np.where(free, FREE, OCCUPIED)).astype(np.uint8)
    return levels, nodes
