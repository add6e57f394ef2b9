"""Made-up ground: a cliff or a plain, from a seed.

Every ingredient is drawn over metres, not cells (a fixed spectrum, rocks as a list, the edge as a
curve), so that one seed gives one piece of ground, at whatever cell size it is then sampled.
"""

import math

import cv2
import numpy as np
from scipy.spatial import KDTree

from agents.geometry import Bools, Floats, GridFrame, Singles
from sim.errors import WorldError
from sim.ground import Terrain
from sim.resample import resample
from sim.rocks import draw_rocks, rock_heights, within
from sim.settings import TerrainSettings

LATTICE = 512
"""Points per side of the lattice on which noise is made."""
PLATEAU_SHARE = 0.45
"""Share of the window, at its north, that is plateau; the cliff falls to the south."""
POOR, RICH = 0.03, 0.9
"""Texture of ground that can't be matched, and of ordinary ground."""


def fractal(exponent: float, rng: np.random.Generator, longest: float = 1.0) -> Floats:
    """Return (LATTICE, LATTICE) noise of unit deviation whose 2-D spectrum falls as f^-exponent.

    `longest` is the longest wavelength in it, as a share of the lattice.
    """
    f = np.hypot(np.fft.fftfreq(LATTICE)[:, None], np.fft.rfftfreq(LATTICE)[None, :]) * LATTICE
    gain = np.where(f >= 1 / longest - 1e-9, np.maximum(f, 1.0) ** (-exponent / 2), 0.0)
    shape = (LATTICE, LATTICE // 2 + 1)
    spectrum = gain * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    noise = np.fft.irfft2(spectrum, s=(LATTICE, LATTICE))
    noise -= noise.mean()
    return np.asarray(noise / noise.std(), dtype=np.float64)


class _Sheet:
    """A lattice of noise laid over the window, a little larger, so that its ends don't meet."""

    def __init__(self, frame: GridFrame) -> None:
        self.frame = frame
        self.side_m = 1.2 * max(frame.rows, frame.cols) * frame.cell_m

    def sampled(self, lattice: Floats) -> Singles:
        """Return the lattice's values at the window's cell centres."""
        step = self.frame.cell_m / self.side_m * lattice.shape[0]
        return resample(lattice, (step / 2, step / 2), step, self.frame.shape)


def make_relief(settings: TerrainSettings, frame: GridFrame, rng: np.random.Generator) -> Terrain:
    """Return a cliff or a plain over a frame.

    Raises WorldError where the window can't hold the cliff.
    """
    sheet = _Sheet(frame)
    height_m = settings.roughness_m * sheet.sampled(fractal(settings.roughness_exponent, rng))
    edge_m = None
    if settings.kind != "plain":
        edge_m = _edge(settings, frame, rng)
        fall_m = _fall(settings, edge_m, frame)
        height_m -= fall_m
    else:
        height_m += _swell(settings, sheet, rng)
    height_m += _rocks(settings, frame, edge_m, rng)
    if settings.kind == "sandpit" and edge_m is not None:
        poor = _poor_west(settings.texture_poor, frame, edge_m, rng)
        return Terrain(frame, height_m, _painted(poor, frame, rng), edge_m)
    return Terrain(frame, height_m, texture(settings.texture_poor, frame, rng), edge_m)


def _swell(settings: TerrainSettings, sheet: _Sheet, rng: np.random.Generator) -> Singles:
    longest = min(1.0, settings.swell_wavelength_m / sheet.side_m)
    swell = sheet.sampled(fractal(6.0, rng, longest))
    return np.asarray(settings.swell_m * np.clip(swell / 2, -1, 1), dtype=np.float32)


def _edge(settings: TerrainSettings, frame: GridFrame, rng: np.random.Generator) -> Floats:
    """Return the lip of the cliff, (M, 2), west to east, beyond the window on both sides."""
    west, east, south, north = frame.extent_m
    face_m = settings.drop_m / math.tan(math.radians(settings.slope_deg))
    needed_m = 2 * settings.edge_meander_m + face_m + 6.0
    if needed_m > north - south:
        raise WorldError(
            f"world.window_m is {north - south:g} m high, a cliff of drop_m {settings.drop_m:g},"
            f" slope_deg {settings.slope_deg:g} and edge_meander_m {settings.edge_meander_m:g}"
            f" needs at least {needed_m:.1f} m"
        )
    margin_m = settings.edge_meander_m + 2.0
    middle_m = max(
        min(north - PLATEAU_SHARE * (north - south), north - margin_m), south + face_m + margin_m
    )
    x = np.arange(west - face_m - 5, east + face_m + 5, 0.1)
    wave = np.zeros(x.size)
    for octave in range(3):
        phase = rng.uniform(0, 2 * np.pi)
        length_m = settings.edge_wavelength_m / 2**octave * rng.uniform(0.9, 1.1)
        wave += 0.4**octave * np.sin(2 * np.pi * x / length_m + phase)
    wave /= np.abs(wave).max()
    return np.column_stack((x, middle_m + settings.edge_meander_m * wave))


def _downhill(edge_m: Floats, frame: GridFrame) -> Singles:
    """Return the horizontal distance past the lip, (rows, cols) in m; negative on the plateau."""
    coarse_m = max(frame.cell_m, 0.2)
    west, east, south, north = frame.extent_m
    x = np.arange(west - coarse_m, east + 2 * coarse_m, coarse_m)
    y = np.arange(south - coarse_m, north + 2 * coarse_m, coarse_m)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    distance, _ = KDTree(edge_m).query(points)
    beyond = points[:, 1] < np.interp(points[:, 0], edge_m[:, 0], edge_m[:, 1])
    signed = np.where(beyond, distance, -distance).reshape(y.size, x.size)
    start = 1 + frame.cell_m / 2 / coarse_m
    return resample(signed, (start, start), frame.cell_m / coarse_m, frame.shape)


def _fall(settings: TerrainSettings, edge_m: Floats, frame: GridFrame) -> Singles:
    """Return how far the ground lies below the plateau, (rows, cols) in m.

    A straight face between two bends (softplus), so that its steepness is the one asked for.
    """
    face_m = settings.drop_m / math.tan(math.radians(settings.slope_deg))
    bend_m = min(settings.lip_m, face_m / 4)
    s = _downhill(edge_m, frame).astype(np.float64)
    fall = np.logaddexp(0, s / bend_m) - np.logaddexp(0, (s - face_m) / bend_m)
    return np.asarray(settings.drop_m * fall * bend_m / face_m, dtype=np.float32)


def _rocks(
    settings: TerrainSettings,
    frame: GridFrame,
    edge_m: Floats | None,
    rng: np.random.Generator,
) -> Singles:
    """Return the height of rocks above the ground, a jumble on the cliff's face included."""
    heights = np.zeros(frame.shape, dtype=np.float32)
    sizes = (settings.rock_min_m, settings.rock_max_m)
    if settings.rock_fraction > 0:
        heights = rock_heights(
            draw_rocks(settings.rock_fraction, *sizes, frame.extent_m, rng), frame
        )
    if edge_m is not None and settings.jumble_m > 0 and settings.jumble_fraction > 0:
        r = settings.jumble_m / 2
        for n in range(settings.jumbles):
            on_the_face = n == 0 and settings.kind != "sandpit"
            place = _jumble_centre if on_the_face else _pile_centre
            x, y = place(settings, frame, edge_m, rng)
            drawn = draw_rocks(settings.jumble_fraction, *sizes, (x - r, x + r, y - r, y + r), rng)
            heights = np.maximum(heights, rock_heights(within(drawn, x, y, r), frame))
    return heights


def _pile_centre(
    settings: TerrainSettings, frame: GridFrame, edge_m: Floats, rng: np.random.Generator
) -> tuple[float, float]:
    """Return a place at the foot of the cliff, anywhere along it."""
    west, east, south, _ = frame.extent_m
    r = settings.jumble_m / 2
    x = float(rng.uniform(west + r, east - r))
    lip_y = float(np.interp(x, edge_m[:, 0], edge_m[:, 1]))
    foot_y = lip_y - settings.drop_m / math.tan(math.radians(settings.slope_deg)) - r
    return x, float(rng.uniform(max(south, foot_y - 5.0), foot_y))


def _jumble_centre(
    settings: TerrainSettings, frame: GridFrame, edge_m: Floats, rng: np.random.Generator
) -> tuple[float, float]:
    west, east, _, _ = frame.extent_m
    x = (west + east) / 2 + rng.uniform(-1.0, 1.0)
    lip_y = float(np.interp(x, edge_m[:, 0], edge_m[:, 1]))
    face_m = settings.drop_m / math.tan(math.radians(settings.slope_deg))
    return float(x), lip_y - 0.55 * face_m


def texture(poor_share: float, frame: GridFrame, rng: np.random.Generator) -> Singles:
    """Return how well ground can be matched, (rows, cols) in [0, 1], one region of it poorly."""
    fine = _Sheet(frame).sampled(fractal(2.5, rng))
    lobed = _lobed_distance(frame, rng)
    if poor_share <= 0:
        return _blended(fine, np.zeros(frame.shape, dtype=np.bool_), frame)
    return _blended(fine, lobed <= np.quantile(lobed, poor_share), frame)


def _poor_west(share: float, frame: GridFrame, edge_m: Floats, rng: np.random.Generator) -> Bools:
    """Return the west (rows, cols) of the pit, so much of it as is `share` of the whole ground."""
    wave = np.cumsum(rng.normal(0.0, 0.25, frame.rows)) * math.sqrt(frame.cell_m)
    beyond = _downhill(edge_m, frame) > 0
    x = np.arange(frame.cols) * frame.cell_m + wave[:, None]
    x = np.where(beyond, x, np.inf)
    count = round(share * x.size)
    return (x <= np.partition(x.ravel(), count)[count]) & beyond if count > 0 else x < -np.inf


def _painted(poor: Bools, frame: GridFrame, rng: np.random.Generator) -> Singles:
    return _blended(_Sheet(frame).sampled(fractal(2.5, rng)), poor, frame)


def _blended(fine: Singles, where: Bools, frame: GridFrame) -> Singles:
    """Return a texture that is poor where it is said to be."""
    rich = np.clip(RICH + 0.06 * fine, 0.6, 1.0)
    poor = where.astype(np.float32)
    width = max(3, 2 * round(0.3 / frame.cell_m) + 1)
    blend = np.asarray(cv2.blur(poor, (width, width), borderType=cv2.BORDER_REPLICATE))
    return np.asarray(rich + blend * (POOR - rich), dtype=np.float32)


def _lobed_distance(frame: GridFrame, rng: np.random.Generator) -> Floats:
    """Return each cell's distance from a random place, shortened by lobes that depend on bearing.

    The place lies in the west, as the poor region of the paper's sandpit lies on the left.
    What lies within any bound of it is seen whole from that place, hence one region.
    """
    row, col = rng.uniform((0.15, 0.05), (0.85, 0.25)) * (frame.rows, frame.cols)
    rows, cols = np.indices(frame.shape)
    bearing = np.arctan2(rows - row, cols - col)
    lobes = np.ones(frame.shape)
    for k, phase in enumerate(rng.uniform(0, 2 * np.pi, 7), start=1):
        lobes += 0.5 / (k + 1) * np.cos(k * bearing + phase)
    return np.hypot(rows - row, cols - col) / np.maximum(lobes, 0.25)
