"""Cliffs strewn with rocks as the Viking landers saw them, and what a robot knows of one."""

from dataclasses import dataclass

import cv2
import numpy as np

from agents.geometry import Bools, Floats, GridFrame
from agents.ground import edge, markov
from scenarios.experiments.markov_surfaces import holes
from sim.relief import make_relief
from sim.settings import TerrainSettings

FOOTPRINT_M = 0.5
SIDE_M = 8.0
FAR_M = 2.0
"""The robot stands no farther than this from the map's north side."""
ROCKS = {"Viking 1": 0.07, "Viking 2": 0.18}
"""k of Golombek's law: the share of the ground under rocks."""
HOLE_M = 0.3
"""Diameter of the holes in the map."""
WAYS = {"paper": 0.0, "ours": 25.0}
"""Ground gentler than this, in degrees, counts whatever its height; at 0 the threshold decides."""


@dataclass(frozen=True)
class Trial:
    """One cliff at one cell size."""

    site: str
    cell_m: float
    seed: int
    wheel_m: float
    unknown_share: float


@dataclass(frozen=True)
class Site:
    """A cliff as a robot knows it; arrays (H, W), row 0 south."""

    frame: GridFrame
    ground_m: Floats
    """The truth."""
    lip_m: Floats
    """The true lip, (M, 2)."""
    completed_m: Floats
    known_distance_m: Floats
    cell: tuple[int, int]
    """Where the robot stands."""
    contact_m: float


def site_of(trial: Trial) -> Site:
    """Return the cliff of a trial: the same ground at any cell size."""
    side = round(SIDE_M / trial.cell_m)
    frame = GridFrame(0.0, 0.0, trial.cell_m, side, side)
    settings = TerrainSettings(
        kind="cliff",
        drop_m=2.0,
        slope_deg=70.0,
        lip_m=0.05,
        edge_meander_m=0.6,
        edge_wavelength_m=3.0,
        roughness_m=0.05,
        rock_fraction=ROCKS[trial.site],
        rock_min_m=0.05,
        rock_max_m=1.0,
        jumble_m=0.0,
        texture_poor=0.0,
    )
    terrain = make_relief(settings, frame, np.random.default_rng(trial.seed))
    assert terrain.edge_m is not None, "a made cliff has a lip"
    ground_m = terrain.elevation_m.astype(np.float64)
    cell = _standing(ground_m, trial.cell_m)
    rng = np.random.default_rng((trial.seed, 9))
    unknown = holes(frame.shape, HOLE_M / trial.cell_m, trial.unknown_share, rng)
    reach = round(FOOTPRINT_M / 2 / trial.cell_m)
    unknown[cell[0] - reach : cell[0] + reach, cell[1] - reach : cell[1] + reach] = False
    known_m = np.where(unknown, np.nan, ground_m)
    return Site(
        frame,
        ground_m,
        terrain.edge_m,
        markov.complete(known_m, border="low"),
        markov.distance_to_known_m(~unknown, trial.cell_m),
        cell,
        float(ground_m[cell]),
    )


def _standing(ground_m: Floats, cell_m: float) -> tuple[int, int]:
    """Return the cell of the plateau's north whose surroundings are the flattest."""
    reach = round(FOOTPRINT_M / 2 / cell_m)
    square = np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
    spread = cv2.dilate(ground_m, square) - cv2.erode(ground_m, square)
    low = ground_m.shape[0] - round(FAR_M / cell_m)
    field = spread[low : -reach - 1, reach + 1 : -reach - 1]
    row, col = np.unravel_index(int(np.argmin(field)), field.shape)
    return low + int(row), reach + 1 + int(col)


def found_edge(site: Site, trial: Trial, way: str) -> edge.Edge:
    """Return the edge of a site by one of the ways."""
    return edge.find_edge(
        site.completed_m,
        site.known_distance_m,
        site.cell,
        contact_m=site.contact_m,
        wheel_m=trial.wheel_m,
        cell_m=trial.cell_m,
        band_m=trial.wheel_m,
        max_slope_deg=WAYS[way],
        patch_m=FOOTPRINT_M,
    )


def outer_pixels(plateau: Bools) -> Floats:
    """Return the plateau's boundary pixels (N, 2), row and column."""
    contours, _ = cv2.findContours(
        plateau.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    return max(contours, key=len)[:, 0, ::-1].astype(np.float64)
