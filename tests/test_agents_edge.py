"""The edge polygon (Figs. 8, 9): simple, within tolerance, and no one drives over it."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.ground import polygon
from agents.ground.edge import EdgeError, drivable, find_edge, inside
from agents.ground.markov import complete, distance_to_known_m

SHARED = Path(os.environ.get("ROPETEAM_SHARED", str(Path(__file__).parents[2] / "shared")))


def edge_of(z, cell, *, cell_m=0.1, wheel_m=0.2, contact_m=None, **more):
    known = ~np.isnan(z)
    return find_edge(
        complete(z, border="low"),
        distance_to_known_m(known, cell_m),
        cell,
        contact_m=float(z[cell]) if contact_m is None else contact_m,
        wheel_m=wheel_m,
        cell_m=cell_m,
        band_m=wheel_m,
        **more,
    )


def cliff(n=120, meander=12.0, drop=5.0):
    y, x = np.mgrid[:n, :n].astype(float)
    edge = n / 2 + meander * np.sin(x / 9)
    return np.where(y > edge, 0.02 * np.sin(x / 7), -drop + 0.02 * np.cos(y / 5)), edge


def test_the_polygon_follows_a_meandering_edge_within_one_wheel():
    z, edge = cliff()
    found = edge_of(z, (100, 60))
    assert found.max_px <= 2.0
    assert found.mean_px <= found.max_px
    assert polygon.is_simple(found.vertices)
    assert len(found.vertices) > 8
    mask = inside(found, z.shape)
    y, _ = np.mgrid[: z.shape[0], : z.shape[1]]
    assert mask[y > edge + 8].mean() > 0.97
    assert not mask[y < edge - 3].any()


def test_paper_tolerances_ten_cm_wheel_at_two_and_at_one_cm_per_pixel():
    for cell_m, bound in ((0.02, 5.0), (0.01, 10.0)):
        rng = np.random.default_rng(5)
        y, x = np.mgrid[:200, :200] * cell_m
        rough = sum(
            0.12 / k * np.sin(2 * np.pi * k * x / x.max() + rng.uniform(0, 6)) for k in range(1, 12)
        )
        z = np.where(y > 0.5 * y.max() + rough, 0.0, -1.0)
        found = edge_of(z, (190, 100), cell_m=cell_m, wheel_m=0.1, patch_m=0.1)
        assert found.max_px <= bound
        assert found.mean_px <= 0.55 * bound
        assert polygon.is_simple(found.vertices)


def test_open_ground_without_a_cliff_gives_the_known_area():
    y, x = np.mgrid[:100, :100]
    disc = np.hypot(y - 50, x - 50) < 30
    z = np.where(disc, 0.3 * np.sin(x / 15), np.nan)
    found = edge_of(z, (50, 50))
    assert inside(found, z.shape)[disc].mean() > 0.97
    assert (inside(found, z.shape) & (np.hypot(y - 50, x - 50) > 35)).sum() == 0


def test_an_unseen_face_is_never_plateau_beyond_one_wheel():
    z = np.zeros((80, 80))
    z[:40] = np.nan
    found = edge_of(z, (60, 40))
    assert not found.plateau[:38].any()
    assert found.plateau[42:].all()


def test_undulating_ground_is_one_plateau_where_a_height_band_would_break_it():
    y, x = np.mgrid[:120, :120] * 0.1
    z = 0.8 * np.sin(x / 2.5) * np.cos(y / 3)
    found = edge_of(z, (60, 60))
    assert found.plateau.mean() > 0.9
    assert (np.abs(z - z[60, 60]) < 0.2).mean() < 0.5


def test_holes_are_dropped_but_nobody_drives_in_them():
    z = np.zeros((80, 80))
    z[30:36, 30:36] = -2.0
    found = edge_of(z, (60, 60))
    assert found.plateau[33, 33]
    free = free_cells(found, z)
    assert not free[25:41, 25:41].any()
    assert free[60, 60]


def free_cells(found, z, inset_m=0.6):
    known = ~np.isnan(z)
    return drivable(
        found,
        complete(z, border="low"),
        distance_to_known_m(known, 0.1),
        np.zeros(z.shape),
        cell_m=0.1,
        wheel_m=0.2,
        footprint_m=0.8,
        max_slope_deg=25.0,
        inset_m=inset_m,
    )


def test_every_drivable_cell_is_an_inset_away_from_the_true_edge():
    z, _ = cliff()
    free = free_cells(edge_of(z, (100, 60)), z)
    assert free.any()
    over = np.argwhere(z < -2)
    for cell in np.argwhere(free)[::37]:
        assert 0.1 * np.hypot(*(over - cell).T).min() > 0.4
    assert not free[-5:].any()


def test_a_cell_outside_the_map_is_refused():
    with pytest.raises(EdgeError, match="outside the map"):
        edge_of(np.zeros((10, 10)), (10, 3), contact_m=0.0)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.3, 0.5, 0.62, 0.8]), st.integers(0, 2))
@settings(max_examples=60, deadline=None)
def test_the_polygon_of_any_plateau_is_simple_and_within_tolerance(seed, share, smooth):
    rng = np.random.default_rng(seed)
    ground = rng.random((24, 24))
    for _ in range(smooth):
        ground = (ground + np.roll(ground, 1, 0) + np.roll(ground, 1, 1)) / 3
    high = ground < np.quantile(ground, share)
    z = np.where(high, 0.0, -3.0)
    found = edge_of(z, (12, 12), contact_m=0.0, max_slope_deg=1.0)
    assert found.max_px <= 2.0
    assert len(found.vertices) >= 3
    assert polygon.is_simple(found.vertices)
    assert found.plateau[12, 12]


def test_crossing_and_folded_polygons_are_told_from_simple_ones():
    square = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]])
    assert polygon.is_simple(square)
    assert not polygon.is_simple(square[[0, 2, 1, 3]])
    assert not polygon.is_simple(np.array([[0.0, 0.0], [0.0, 2.0], [0.0, 1.0], [1.0, 1.0]]))


@pytest.mark.parametrize("name", ["mars_gale_hirise_1m", "marsyard_erc2021_0p09m"])
def test_real_ground_gives_a_simple_polygon_within_tolerance(name):
    path = SHARED / "data" / "dem" / f"{name}.npz"
    if not path.exists():
        pytest.skip(f"{path} is not there")
    z = np.load(path)["elevation"][::-1][100:300, 100:300].astype(np.float64)
    z *= 0.1 if "gale" in name else 1.0
    found = edge_of(z, (100, 100))
    assert found.plateau.sum() > 1000
    assert found.max_px <= 2.0
    assert polygon.is_simple(found.vertices)
