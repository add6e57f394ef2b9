"""What looks from many places would show, worked out once and then asked often.

From each place visibility is predicted once (Eq. 5, times the chance that a ray falls on a cell);
what is kept is each cell's chance and the bin of azimuth and elevation angle in which it is seen.
Whatever cells are worth then, the gain of every heading and tilt from there is a sum of bins, and
a look that is planned takes its share of the cells' worth away from those after it.
"""

import math
from dataclasses import dataclass

import numpy as np

from agents.geometry import Bools, Floats, Ints
from agents.planning.looks import Stage, eye_at, stage_of
from agents.planning.scene import Scene
from agents.sight import gaze, sweep
from agents.sight.gaze import Lens
from agents.sight.sweep import RISE_BINS, TURN_BINS

FAINT = 0.01
"""Chances below this are taken for none."""
HEADINGS = 60
TILT_STEP_DEG = 4.0


@dataclass(frozen=True)
class Site:
    """One place: the cells that it shows; arrays of one length."""

    cells: Ints
    """Flat indices on the stage's grid."""
    bins: Ints
    """Flat indices of (elevation angle, azimuth) bins."""
    chance: Floats
    """That a look which has the cell in view measures it."""


@dataclass(frozen=True)
class Look:
    """One look from a site: its bins' window, and its gain."""

    heading_rad: float
    tilt_rad: float
    gain: float


class Survey:
    """Sites of a scene, on the grid on which looks are rated."""

    def __init__(self, scene: Scene) -> None:
        """Take the scene's ground; places are surveyed when they are asked for."""
        self.scene = scene
        self.lens = Lens.of(scene.view.sensor)
        self._stage: Stage = stage_of(scene)
        turns = np.arange(HEADINGS, dtype=np.float64)
        self.headings_rad = turns * (2.0 * math.pi / HEADINGS)
        self.tilts_rad = np.radians(tilts_deg(scene))

    @property
    def worth(self) -> Floats:
        """(cells,) what the stage's cells are worth: one fresh cell of the map is 1."""
        return self._stage.ground.worth.ravel()

    def joined(self, worth: Floats) -> Floats:
        """Return a worth (H, W) of the map's cells as that of the stage's (cells,)."""
        rows, cols = self._stage.frame.shape
        factor = self.scene.view.frame.rows // rows
        blocks = worth[: rows * factor, : cols * factor].reshape(rows, factor, cols, factor)
        return np.asarray(blocks.sum(axis=(1, 3)), dtype=np.float64).ravel()

    def site(self, cell: tuple[int, int]) -> Site:
        """Return what a place shows."""
        patch = self._stage.patch(eye_at(self.scene, cell), self.scene.view.sensor)
        chance = gaze.measured_chance(patch, self._stage.ground, self.lens)
        rows, cols = np.nonzero(chance > FAINT)
        bins = sweep.bins_of(patch.azimuth_rad[rows, cols], patch.elevation_angle_rad[rows, cols])
        flat = (rows + patch.row0) * self._stage.frame.cols + cols + patch.col0
        return Site(flat, bins, chance[rows, cols].astype(np.float64))

    def gains(self, site: Site, worth: Floats) -> Floats:
        """Return the gain (headings, tilts) of looks from a site, in fresh cells."""
        return self._sums(site, worth, self.headings_rad, self.tilts_rad)

    def _sums(self, site: Site, worth: Floats, headings_rad: Floats, tilts_rad: Floats) -> Floats:
        weights = site.chance * worth[site.cells]
        bins: Floats = np.bincount(site.bins, weights, TURN_BINS * RISE_BINS).astype(np.float64)
        return sweep.in_windows(
            bins.reshape(TURN_BINS, RISE_BINS), headings_rad, tilts_rad, self.lens
        )

    def best(self, site: Site, worth: Floats) -> Look:
        """Return the best look from a site."""
        gains = self.gains(site, worth)
        k, t = np.unravel_index(int(gains.argmax()), gains.shape)
        return Look(float(self.headings_rad[k]), float(self.tilts_rad[t]), float(gains[k, t]))

    def refined(self, site: Site, worth: Floats, look: Look) -> Look:
        """Return the best look near another one, to a degree or so."""
        step = 2.0 * math.pi / HEADINGS
        headings = look.heading_rad + np.linspace(-step, step, 9)
        low, high = float(self.tilts_rad.min()), float(self.tilts_rad.max())
        half = math.radians(TILT_STEP_DEG)
        tilts = np.clip(look.tilt_rad + np.linspace(-half, half, 5), low, high)
        gains = self._sums(site, worth, headings, tilts)
        k, t = np.unravel_index(int(gains.argmax()), gains.shape)
        return Look(float(headings[k]), float(tilts[t]), float(gains[k, t]))

    def shown(self, site: Site, look: Look) -> tuple[Ints, Floats]:
        """Return the cells that a look has in view, and their chances of being measured."""
        turn, angle = np.divmod(site.bins, RISE_BINS)
        rise = ((angle + 0.5) / RISE_BINS - 0.5) * math.pi - look.tilt_rad
        azimuth = (turn + 0.5) * (2.0 * math.pi / TURN_BINS) - look.heading_rad
        azimuth = (azimuth + math.pi) % (2.0 * math.pi) - math.pi
        within: Bools = np.abs(azimuth) <= self.lens.half_turn_rad
        within &= np.abs(rise) <= self.lens.half_rise_rad
        return site.cells[within], site.chance[within]


def tilts_deg(scene: Scene) -> Floats:
    """Return the tilts tried: all between the least and the largest that the settings name."""
    given = scene.view.planner.tilts_deg
    count = max(1, round((max(given) - min(given)) / TILT_STEP_DEG) + 1)
    return np.linspace(min(given), max(given), count)


def after(worth: Floats, shown: tuple[Ints, Floats]) -> Floats:
    """Return what cells are still worth when a look has shown some of them."""
    cells, chance = shown
    left = worth.copy()
    left[cells] *= 1.0 - chance
    return left
