"""What places may show, cell by cell, so that looks from several of them can be chosen together.

`casting.gains` says how much a look shows; two looks that show the same cells are worth less than
their sum. So here each place keeps, for each sector of bearings, the list of cells that it may show
and how likely; whatever a chosen look shows is taken off what is left of those cells for all
others, and every place's gains are summed anew from its lists.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agents.geometry import Floats, Ints
from agents.planar.casting import BEARINGS, HALF, LEAST, Star, onward, star_of
from agents.planar.looksets import COARSE, look_sets
from agents.planar.scene import Scene
from agents.settings import SensorSettings
from comms import kernels
from comms.kernels import kernel

SECTORS = BEARINGS // COARSE
"""Sectors of bearings, each `COARSE` rays wide."""
ROOM = 200_000
"""Cells that the lists hold in all, to begin with."""


@kernel
def _list(
    through: np.ndarray,
    lacking: np.ndarray,
    worth: np.ndarray,
    steps: np.ndarray,
    counts: np.ndarray,
    sure: np.ndarray,
    eyes: np.ndarray,
    part: np.ndarray,
    trust: np.ndarray,
    first: np.ndarray,
    cells: np.ndarray,
    chance: np.ndarray,
) -> int:
    """Fill the lists of all places; return how long they are, or -1 if there was no room.

    `part` is (half, coarse): what a look counts that leaves a cell half sure, and rays in a sector.
    """
    rows, cols = through.shape
    half, coarse = part[0], int(part[1])
    sectors = len(counts) // coarse
    stamp = np.full((rows, cols), -1, dtype=np.int32)
    best = np.zeros((rows, cols), dtype=np.float32)
    at, fine = 0, len(trust) - 1
    for e in range(len(eyes)):
        row, col = eyes[e, 0], eyes[e, 1]
        for b in range(len(counts)):
            if b % coarse == 0:
                first[e * sectors + b // coarse] = at
            if at + steps.shape[1] > len(cells):
                return -1
            p = 1.0
            for n in range(counts[b]):
                i, j = row + steps[b, n, 0], col + steps[b, n, 1]
                if i < 0 or j < 0 or i >= rows or j >= cols:
                    break
                if worth[i, j] > 0.0:
                    if stamp[i, j] != e:
                        stamp[i, j] = e
                        best[i, j] = 0.0
                    held = trust[int(p * fine + 0.5)]
                    more = held - best[i, j]
                    if more > 0.0:
                        cells[at] = i * cols + j
                        chance[at] = more if sure[b, n] >= lacking[i, j] else half * more
                        best[i, j] = held
                        at += 1
                if n > 0:
                    p = onward(p, float(through[i, j]), True)
                    if p < LEAST:
                        break
    first[len(eyes) * sectors] = at
    return at


@kernel
def _sum(
    first: np.ndarray, cells: np.ndarray, chance: np.ndarray, left: np.ndarray, out: np.ndarray
) -> None:
    """Fill what each place and sector (E, K) shows of what is left."""
    sectors = out.shape[1]
    for e in range(len(out)):
        for k in range(sectors):
            total = 0.0
            for m in range(first[e * sectors + k], first[e * sectors + k + 1]):
                total += chance[m] * left[cells[m]]
            out[e, k] = total


@kernel
def _take(
    first: np.ndarray,
    cells: np.ndarray,
    chance: np.ndarray,
    sectors: np.ndarray,
    left: np.ndarray,
    seen: np.ndarray,
) -> float:
    """Take what a look over some lists (flat indices) shows off what is left; return how much.

    `seen` is all zeros, before and after.
    """
    for k in sectors:
        for m in range(first[k], first[k + 1]):
            seen[cells[m]] += chance[m]
    total = 0.0
    for k in sectors:
        for m in range(first[k], first[k + 1]):
            at = cells[m]
            p = min(float(seen[at]), 1.0)
            total += p * float(left[at])
            left[at] *= 1.0 - p
            seen[at] = 0.0
    return total


Lists = tuple[Ints, NDArray[np.int32], NDArray[np.float32]]
"""Where the list of each place and sector begins, and, one after another, cells and chances."""


def _lists_of(
    through: Floats, lacking: Floats, worth: Floats, rays: Star, places: Ints, trust: Floats
) -> Lists:
    passing, short, value = (np.asarray(v, dtype=np.float32) for v in (through, lacking, worth))
    part = np.array([HALF, float(COARSE)])
    first: Ints = np.zeros(len(places) * SECTORS + 1, dtype=np.int64)
    room = ROOM
    while True:
        cells, chance = np.zeros(room, dtype=np.int32), np.zeros(room, dtype=np.float32)
        if _list(
            passing, short, value, rays.narrow_steps, rays.counts, rays.narrow_sure, places, part,
            trust, first, cells, chance,
        ) >= 0:  # fmt: skip
            return first, cells, chance
        room *= 3


class Prospects:
    """What may be seen from places (E, 2)."""

    def __init__(self, scene: Scene, places: Ints, trust: Floats) -> None:
        """Cast the rays of all places; `trust` says what chances are to be taken for."""
        rays = scene.rays
        self.places = places
        self.width = max(1, rays.width // COARSE)
        """Sectors that a look shows."""
        self.worth: Floats = scene.worth.ravel()
        """(rows cols) what cells are worth before any look, flat."""
        self._seen: Floats = np.zeros(self.worth.size)
        self._lists = _lists_of(scene.through, scene.lacking, scene.worth, rays, places, trust)

    def rings(self, left: Floats) -> Floats:
        """Return what each place shows (E, SECTORS) of what is left of each cell (flat)."""
        out = np.zeros((len(self.places), SECTORS))
        _sum(*self._lists, left, out)
        return out

    def best(self) -> float:
        """Return what the best single look shows, before any other."""
        return float(self.sets(self.worth, 1)[0].max())

    def sets(self, left: Floats, most: int) -> tuple[Floats, Ints]:
        """Return the best sets of looks at each place, as `looksets.look_sets`, in sectors."""
        return look_sets(self.rings(left), self.width, most)

    def take(self, left: Floats, place: int, looks: Sequence[int]) -> float:
        """Take what looks at a place (by first sector) show off what is left; return how much."""
        total = 0.0
        for look in looks:
            sectors = place * SECTORS + (look + np.arange(self.width)) % SECTORS
            total += _take(*self._lists, sectors, left, self._seen)
        return total


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    rays = star_of(SensorSettings(range_m=2.0), 1.0)
    ones = np.ones((6, 6))
    lists = _lists_of(ones, ones, ones, rays, np.array([[3, 3]]), np.array([0.0, 1.0]))
    left = np.ones(36)
    _sum(*lists, left, np.zeros((1, SECTORS)))
    _take(*lists, np.array([0, 1]), left, np.zeros(36))
