import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from sim_helpers import DEMS, ground, needs

from agents.geometry import GridFrame, Pose
from sim.errors import WorldError
from sim.ground import Footing, Terrain, hazard_mask
from sim.relief import fractal
from sim.rocks import covered_share, draw_rocks, rock_heights
from sim.terrain import TerrainSettings, WorldSettings, descent_goal, make_terrain, place_team

TEAM = ("recon", "cliffbot", "anchor", "anchor")
BARE = {"rock_fraction": 0.0, "jumble_m": 0.0, "roughness_m": 0.0, "texture_poor": 0.0}


def made(seed: int = 1, map_cell_m: float = 0.1, window_m: float = 32.0, **keys: object) -> Terrain:
    world = WorldSettings(
        terrain=TerrainSettings.model_validate(keys), window_m=(window_m, window_m)
    )
    return make_terrain(world, map_cell_m, np.random.default_rng(seed), TEAM)


@pytest.mark.parametrize(("drop_m", "slope_deg"), [(6.0, 50.0), (3.0, 35.0), (8.0, 70.0)])
def test_a_cliff_has_the_drop_and_the_slope_that_were_asked_for(
    drop_m: float, slope_deg: float
) -> None:
    terrain = made(drop_m=drop_m, slope_deg=slope_deg, **BARE)
    z = terrain.elevation_m.astype(float)
    assert np.median(z[-20:]) - np.median(z[:20]) == pytest.approx(drop_m, abs=0.05)
    north, east = np.gradient(z, 0.1)
    face = (z < -0.35 * drop_m) & (z > -0.65 * drop_m)
    slope = np.degrees(np.arctan(np.hypot(north, east)[face]))
    assert np.median(slope) == pytest.approx(slope_deg, abs=1.5)


def test_the_edge_is_where_the_plateau_ends_and_strays_as_far_as_asked() -> None:
    terrain = made(edge_meander_m=2.5, **BARE)
    edge = terrain.edge_m
    assert edge is not None
    assert np.ptp(edge[:, 1]) <= 5.0
    assert np.ptp(edge[:, 1]) > 3.5
    inside = edge[(edge[:, 0] > 1) & (edge[:, 0] < 31)]
    heights = [terrain.height_m(float(x), float(y)) for x, y in inside]
    assert max(heights) < 0.0  # it has begun to bend down
    assert min(heights) > -0.6
    below = [terrain.height_m(float(x), float(y) - 8.0) for x, y in inside]
    assert np.median(below) == pytest.approx(-6.0, abs=0.05)


def test_one_seed_makes_one_ground_and_another_seed_another() -> None:
    first, again, other = made(3), made(3), made(4)
    assert np.array_equal(first.elevation_m, again.elevation_m)
    assert np.array_equal(first.texture, again.texture)
    assert not np.array_equal(first.elevation_m, other.elevation_m)


def test_the_ground_of_a_seed_does_not_depend_on_the_cell_size() -> None:
    fine, coarse = made(5, 0.1, rock_fraction=0.0), made(5, 0.2, rock_fraction=0.0)
    apart = [
        fine.height_m(x, y) - coarse.height_m(x, y)
        for x, y in np.random.default_rng(0).uniform(2, 30, (300, 2))
    ]
    assert np.median(np.abs(apart)) < 0.01


@given(seed=st.integers(0, 10**6), exponent=st.floats(2.5, 5))
@settings(max_examples=10, deadline=None)
def test_fractal_ground_has_unit_deviation_and_the_spectrum_asked_for(
    seed: int, exponent: float
) -> None:
    noise = fractal(exponent, np.random.default_rng(seed))
    assert noise.std() == pytest.approx(1.0)
    power = np.abs(np.fft.rfft2(noise)) ** 2
    f = np.hypot(np.fft.fftfreq(512)[:, None], np.fft.rfftfreq(512)[None, :]) * 512
    low = np.log(power[(f > 8) & (f < 12)].mean())
    high = np.log(power[(f > 80) & (f < 120)].mean())
    assert (low - high) / math.log(10) == pytest.approx(exponent, abs=0.35)


@pytest.mark.parametrize("fraction", [0.03, 0.07, 0.18])
def test_rocks_follow_golombeks_size_frequency_law(fraction: float) -> None:
    side = 150.0
    rocks = draw_rocks(fraction, 0.1, 3.0, (0, side, 0, side), np.random.default_rng(7))
    for diameter in (0.1, 0.2, 0.4, 0.7):
        counted = rocks.diameter_m >= diameter
        share = (np.pi / 4 * rocks.diameter_m[counted] ** 2).sum() / side**2
        law = covered_share(fraction, diameter) - covered_share(fraction, 3.0)
        noise = 3 / math.sqrt(max(1, counted.sum())) + 0.02
        assert share == pytest.approx(law, rel=noise)


def test_golombeks_law_by_hand() -> None:
    # Viking 1: k = 0.069, q = 1.79 + 0.152 / 0.069 = 3.993; F(0.5 m) = 0.069 exp(-1.996)
    assert covered_share(0.069, 0.5) == pytest.approx(0.00937, rel=1e-3)


def test_a_rendered_rock_covers_its_area_and_reaches_its_height() -> None:
    rocks = draw_rocks(0.1, 0.5, 1.2, (2, 38, 2, 38), np.random.default_rng(2))
    heights = rock_heights(rocks, GridFrame(0.0, 0.0, 0.05, 800, 800))
    area = (np.pi / 4 * rocks.diameter_m**2).sum()
    assert (heights > 0).sum() * 0.05**2 == pytest.approx(area, rel=0.1)  # some overlap
    assert heights.max() == pytest.approx(rocks.height_m.max(), rel=0.05)


@given(seed=st.integers(0, 10**6), share=st.floats(0.01, 0.4))
@settings(max_examples=10, deadline=None)
def test_poor_texture_is_one_region_of_the_share_asked_for(seed: int, share: float) -> None:
    texture = made(seed, 0.2, kind="plain", texture_poor=share).texture
    poor = texture < 0.45
    assert poor.mean() == pytest.approx(share, rel=0.1, abs=0.005)
    _, _, stats, _ = cv2.connectedComponentsWithStats(poor.astype(np.uint8), connectivity=8)
    assert stats[1:, cv2.CC_STAT_AREA].max() > 0.8 * poor.sum()


@given(east=st.floats(-2, 2), north=st.floats(-2, 2), base=st.floats(-5000, 5000))
@settings(max_examples=25, deadline=None)
def test_a_plane_has_its_own_slope_and_no_hazard_however_steep(
    east: float, north: float, base: float
) -> None:
    terrain = ground(lambda x, y: base + east * x + north * y, side_m=5.0)
    footing = Footing(terrain, 0.8, 0.2)
    middle = (slice(5, -5), slice(5, -5))
    want = math.degrees(math.atan(math.hypot(east, north)))
    assert np.allclose(footing.slope_deg[middle], want, atol=0.3)
    assert not footing.hazard[middle].any()


@pytest.mark.parametrize("slope", [0.0, 1.19])
def test_rocks_and_steps_are_hazards_on_flat_and_on_steep_ground(slope: float) -> None:
    def rock(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        dome = np.maximum(0.0, 1 - ((x - 5) ** 2 + (y - 5) ** 2) / 0.2**2)
        return slope * y + 0.25 * np.sqrt(dome)

    mask = hazard_mask(ground(rock, side_m=10.0), 0.2, 0.8)
    assert mask[49:51, 49:51].all()
    assert not mask[:44].any()
    assert not mask[:, :44].any()
    step = hazard_mask(ground(lambda x, y: slope * y + 0.3 * (x > 5), side_m=10.0), 0.2, 0.8)
    assert step[10:-10, 49:51].all()
    assert not step[:, :44].any()


def test_what_is_lower_than_half_a_wheel_is_no_hazard() -> None:
    def pebble(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 0.09 * (np.hypot(x - 5, y - 5) < 0.15)

    assert not hazard_mask(ground(pebble, side_m=10.0), 0.2, 0.8).any()


def test_the_lip_and_the_face_of_a_smooth_cliff_are_no_hazards() -> None:
    terrain = made(edge_meander_m=0.0, **BARE)
    assert not hazard_mask(terrain, 0.2, 0.8).any()


@pytest.mark.parametrize(("seed", "slope_deg"), [(0, 50.0), (1, 50.0), (2, 50.0), (3, 75.0)])
def test_a_cliff_team_stands_round_the_lip_and_has_somewhere_to_go(
    seed: int, slope_deg: float
) -> None:
    terrain = made(seed, slope_deg=slope_deg)
    poses = place_team(terrain, TEAM, 0.4, np.random.default_rng(seed))
    _check_standing(terrain, list(poses.values()))
    recon, cliffbot, left, right = (poses[i] for i in range(4))
    assert terrain.edge_m is not None
    to_edge = np.hypot(*(terrain.edge_m - (cliffbot.x_m, cliffbot.y_m)).T).min()
    assert to_edge < 2.5
    # facing south (down), left is east
    assert left.x_m > cliffbot.x_m + 0.9 > right.x_m + 1.8
    assert recon.distance_m(cliffbot) > 1.1
    assert recon.y_m > cliffbot.y_m
    assert all(p.z_m > -0.7 for p in poses.values())
    x, y = descent_goal(terrain, cliffbot)
    assert cliffbot.z_m - terrain.height_m(x, y) > 5.0
    _check_standing(terrain, [Pose(x, y, 0.0, 0.0)])


def test_a_pair_on_a_plain_stands_apart_on_the_same_ground() -> None:
    terrain = made(2, kind="plain")
    poses = place_team(terrain, ("explorer", "explorer"), 0.4, np.random.default_rng(1))
    _check_standing(terrain, list(poses.values()))
    assert 2.0 < poses[0].distance_m(poses[1]) < 6.0


def _check_standing(terrain: Terrain, poses: list[Pose]) -> None:
    standable = Footing(terrain, 0.8, 0.2).standable(25.0)
    for k, pose in enumerate(poses):
        assert standable[terrain.frame.cell_of(pose.x_m, pose.y_m)]
        assert all(pose.distance_m(other) > 0.8 for other in poses[:k])


@pytest.mark.parametrize(
    ("name", "cell_m", "least_fall_m"),
    [
        pytest.param(name, cell_m, fall, marks=needs(name))
        for name, cell_m, fall in (
            ("mars_gale_hirise_1m.npz", 0.1, 1.0),
            ("mars_gale_hirise_1m.npz", None, 1.5),
            ("marsyard_erc2021_0p09m.npz", None, 0.8),
            ("alps_davos_10m.npz", 0.5, 2.0),
            ("ames_yard_0p5m.npz", None, 0.3),
        )
    ],
)
def test_a_team_finds_its_place_on_real_ground(
    name: str, cell_m: float | None, least_fall_m: float
) -> None:
    terrain = made(1, file=str(DEMS / name), cell_m=cell_m)
    assert min(terrain.frame.shape) >= 300
    poses = place_team(terrain, TEAM, 0.4, np.random.default_rng(1))
    _check_standing(terrain, list(poses.values()))
    x, y = descent_goal(terrain, poses[1])
    assert poses[1].z_m - terrain.height_m(x, y) > least_fall_m
    pair = place_team(terrain, ("explorer",) * 3, 0.4, np.random.default_rng(1))
    _check_standing(terrain, list(pair.values()))


def test_what_is_impossible_is_refused_with_a_sentence() -> None:
    with pytest.raises(WorldError, match=r"drop_m 40.*needs at least"):
        made(drop_m=40.0)
    with pytest.raises(WorldError, match=r"cells, allowed are at most"):
        made(window_m=400.0)
    with pytest.raises(WorldError, match=r"no ground flatter than"):
        place_team(ground(lambda x, y: 2 * x), TEAM, 0.4, np.random.default_rng(0))
    with pytest.raises(WorldError, match=r"no room for so many robots"):
        place_team(
            ground(lambda x, y: 0 * x, side_m=4.0),
            ("explorer",) * 40,
            0.4,
            np.random.default_rng(0),
        )
    with pytest.raises(ValidationError, match="needs `file`"):
        TerrainSettings(kind="file")
    with pytest.raises(ValidationError, match="at most rock_max_m"):
        TerrainSettings(rock_min_m=2.0)


def test_a_sandpit_has_an_upright_edge_and_a_west_that_cannot_be_matched() -> None:
    terrain = made(kind="sandpit", window_m=20.0)
    edge = terrain.edge_m
    assert edge is not None
    z = terrain.elevation_m.astype(float)
    for x, y in edge[(edge[:, 0] > 3) & (edge[:, 0] < 17)][::10]:
        assert terrain.height_m(float(x), float(y) + 0.3) > -0.4
        assert terrain.height_m(float(x), float(y) - 0.3) < -0.7
    rows, cols = np.nonzero(terrain.texture < 0.3)
    share = rows.size / z.size
    assert share == pytest.approx(0.15, abs=0.02)
    assert z[rows, cols].max() < 0.0
    assert cols.max() < 0.55 * z.shape[1]


def test_a_kind_brings_its_own_keys_and_what_is_given_counts() -> None:
    field = TerrainSettings.model_validate({"kind": "field", "drop_m": 4.0})
    assert (field.slope_deg, field.drop_m) == (75.0, 4.0)
    again = TerrainSettings.model_validate(field.model_dump())
    assert again == field
    assert TerrainSettings().slope_deg == 45.0


def test_a_lone_recon_bot_stands_behind_the_lip() -> None:
    terrain = made(kind="sandpit", window_m=20.0)
    pose = place_team(terrain, ["recon"], 0.4, np.random.default_rng(1))[0]
    assert terrain.edge_m is not None
    lip_y = float(np.interp(pose.x_m, terrain.edge_m[:, 0], terrain.edge_m[:, 1]))
    assert 1.0 < pose.y_m - lip_y < 4.0
    assert math.sin(pose.yaw_rad) < -0.9
