import asyncio
import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim_helpers import ground, run

from agents.geometry import Pose
from agents.settings import SensorSettings
from sim.camera import (
    RangeCamera,
    Scene,
    expose,
    observable_cells,
    ray_directions,
    reachable_positions,
)
from sim.ground import Terrain
from sim.sighting import sighting_covariance
from sim.terrain import TerrainSettings, WorldSettings, make_terrain

EXACT = SensorSettings(height_m=1.4, range_m=10.0, noise_s=0.0, attitude_sigma_deg=0.0)
HERE = Pose(10.0, 10.0, 0.0, 0.0)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@cache
def rough(seed: int) -> Terrain:
    world = WorldSettings(
        terrain=TerrainSettings(kind="plain", rock_fraction=0.1), window_m=(12.0, 12.0)
    )
    return make_terrain(world, 0.1, rng(seed))


def slow_cast(terrain: Terrain, eye_m: np.ndarray, ray: np.ndarray, limit_m: float) -> float:
    """Return the first point of a ray, of points 2 mm apart, that is under the ground."""
    s = np.arange(0.0, limit_m, 0.002)
    x, y, z = (eye_m[:, None] + ray[:, None] * s)[:3]
    u, v = x / 0.1 - 0.5, y / 0.1 - 0.5
    inside = (u >= 0) & (v >= 0) & (u <= terrain.frame.cols - 1) & (v <= terrain.frame.rows - 1)
    end = len(s) if inside.all() else int(np.argmin(inside))
    c = np.minimum(u[:end].astype(int), terrain.frame.cols - 2)
    r = np.minimum(v[:end].astype(int), terrain.frame.rows - 2)
    a, b = u[:end] - c, v[:end] - r
    g = terrain.elevation_m.astype(float)
    height = (1 - b) * ((1 - a) * g[r, c] + a * g[r, c + 1])
    height += b * ((1 - a) * g[r + 1, c] + a * g[r + 1, c + 1])
    under = z[:end] <= height
    return float(s[np.argmax(under)]) if under.any() else math.nan


@given(
    seed=st.integers(0, 5),
    azimuth=st.floats(-math.pi, math.pi),
    elevation=st.floats(-math.pi / 2, 0.3),
    height_m=st.floats(0.5, 3.0),
)
@settings(max_examples=100, deadline=None)
def test_a_ray_ends_where_slow_marching_says(
    seed: int, azimuth: float, elevation: float, height_m: float
) -> None:
    terrain = rough(seed)
    eye = np.array([6.0, 6.0, terrain.height_m(6.0, 6.0) + height_m])
    flat = math.cos(elevation)
    ray = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])
    got = Scene(terrain).cast(eye, ray[None, :], np.array([8.0]))[0, 0]
    want = slow_cast(terrain, eye, ray, 8.0)
    if abs(got - want) > 0.01 or math.isnan(got) != math.isnan(want):
        # A ray that grazes a crest for less than half a cell may pass it: no deeper than this.
        nearest = min(v for v in (got, want) if not math.isnan(v))
        point = eye + nearest * ray
        assert abs(point[2] - terrain.height_m(*point[:2])) < 0.02
        assert elevation > -0.5


def test_grazed_crests_are_rare_among_many_rays() -> None:
    terrain = rough(1)
    eye = np.array([6.0, 6.0, terrain.height_m(6.0, 6.0) + 1.4])
    rays = ray_directions(SensorSettings(columns=24, rows=18), 0.3, -0.3)
    got = Scene(terrain).cast(eye, rays, np.full(len(rays), 8.0))[:, 0]
    want = np.array([slow_cast(terrain, eye, ray, 8.0) for ray in rays])
    same = (np.isnan(got) & np.isnan(want)) | (np.abs(got - want) < 0.005)
    assert same.mean() > 0.99


def test_a_look_at_flat_ground_gives_points_on_it_and_within_range_and_view() -> None:
    scene = Scene(ground(lambda x, y: 0.0))
    seen = expose(scene, EXACT, HERE, 0.5, -0.4, others={}, rng=rng())
    assert len(seen.points_m) > 15000
    assert np.abs(seen.points_m[:, 2]).max() < 1e-4
    ranges = np.linalg.norm(seen.points_m - (0, 0, EXACT.height_m), axis=1)
    assert EXACT.near_m <= ranges.min()
    assert ranges.max() <= EXACT.range_m
    bearing = np.arctan2(seen.points_m[:, 1], seen.points_m[:, 0])
    assert np.abs(bearing - 0.5).max() <= math.radians(30.0)


@given(yaw=st.floats(-3.1, 3.1), pan=st.floats(-1.5, 1.5))
@settings(max_examples=15, deadline=None)
def test_points_are_in_the_levelled_robot_frame(yaw: float, pan: float) -> None:
    terrain = ground(lambda x, y: 0.3 * x - 0.2 * y)
    small = EXACT.model_copy(update={"columns": 32, "rows": 24})
    pose = Pose(10.0, 9.0, terrain.height_m(10.0, 9.0), yaw)
    seen = expose(Scene(terrain), small, pose, pan, -0.5, others={}, rng=rng())
    world = pose.team_from_robot(seen.points_m)
    assert len(world) > 100
    assert np.allclose(world[:, 2], 0.3 * world[:, 0] - 0.2 * world[:, 1], atol=1e-3)


def test_a_wall_hides_what_is_behind_it_and_no_more() -> None:
    def wall(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 1.0 * ((x > 12) & (x < 12.5) & (y > 8) & (y < 12))

    wide = EXACT.model_copy(update={"fov_deg": 100.0})
    seen = expose(Scene(ground(wall)), wide, HERE, 0.0, -0.4, others={}, rng=rng())
    points = HERE.team_from_robot(seen.points_m)
    # The camera is 1.4 m high and the wall's far top edge 2.5 m off and 1 m high: its shadow ends
    # 2.5 * 1.4 / 0.4 = 8.75 m off.
    behind = (points[:, 0] > 12.8) & (points[:, 0] < 18.4) & (np.abs(points[:, 1] - 10) < 1.5)
    assert not behind.any()
    assert ((points[:, 0] > 12.8) & (points[:, 0] < 18)).any()  # past its ends
    assert (points[:, 2] > 0.95).any()  # its top


def test_unknown_ground_gives_no_points_and_hides_nothing() -> None:
    def hole(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where((x > 12) & (x < 13), np.nan, 0.0 * y)

    seen = expose(Scene(ground(hole)), EXACT, HERE, 0.0, -0.4, others={}, rng=rng())
    x = HERE.team_from_robot(seen.points_m)[:, 0]
    assert not ((x > 12) & (x < 13)).any()
    assert (x > 13.5).sum() > 500
    assert (x < 12).sum() > 500


def test_noise_along_and_across_the_ray_is_eq_4() -> None:
    sensor = SensorSettings(
        attitude_sigma_deg=0.0, fov_deg=2.0, fov_vertical_deg=2.0, columns=200, rows=200
    )
    terrain = ground(lambda x, y: 0.0)
    pan, tilt = 0.4, -0.25
    scene = Scene(terrain)
    seen = expose(scene, sensor, HERE, pan, tilt, others={}, rng=rng(5))
    from_camera = seen.points_m - (0, 0, sensor.height_m)
    # The true range of each ray to flat ground is height / sin(depression); rays that returned
    # nothing are matched by taking the ray nearest in direction: all are within a degree.
    ranges = np.linalg.norm(from_camera, axis=1)
    assert seen.sigma_m == pytest.approx(sensor.noise_s * ranges**2, rel=1e-3)
    z = seen.points_m[:, 2]
    depression = np.arcsin(-from_camera[:, 2] / ranges)
    sigma = sensor.noise_s * (sensor.height_m / math.sin(-tilt)) ** 2
    # z = L_err sin(elevation) + up_err cos(elevation)
    want = sigma * math.hypot(math.sin(tilt), sensor.noise_t_lateral * math.cos(tilt))
    assert z.std() == pytest.approx(want, rel=0.05)
    assert abs(z.mean()) < 0.1 * want
    assert depression.std() < 0.02


@pytest.mark.parametrize("n", [1.0, 2.0])
def test_noise_grows_with_range_to_the_power_n(n: float) -> None:
    def std_at(range_m: float) -> float:
        sensor = SensorSettings(
            attitude_sigma_deg=0.0,
            noise_n=n,
            noise_t_lateral=0.0,
            fov_deg=1.1,
            fov_vertical_deg=1.1,
            columns=80,
            rows=80,
        )
        wall = ground(lambda x, y: 8.0 * (x > 10 + range_m))
        seen = expose(Scene(wall), sensor, HERE, 0.0, 0.0, others={}, rng=rng(1))
        assert len(seen.points_m) > 6000
        return float(seen.points_m[:, 0].std())

    assert std_at(8.0) / std_at(2.0) == pytest.approx(4**n, rel=0.06)


def test_one_levelling_error_turns_the_whole_look() -> None:
    sensor = SensorSettings(noise_s=0.0, attitude_sigma_deg=1.0, columns=24, rows=18)
    scene = Scene(ground(lambda x, y: 0.0))
    tilts = []
    for seed in range(200):
        points = expose(scene, sensor, HERE, 0.0, -0.4, others={}, rng=rng(seed)).points_m
        plane, residual, *_ = np.linalg.lstsq(
            np.column_stack((points[:, :2], np.ones(len(points)))), points[:, 2], rcond=None
        )
        assert residual[0] < 1e-3
        tilts.append(plane[:2])
    assert np.degrees(np.std(tilts, axis=0)) == pytest.approx([1.0, 1.0], rel=0.15)


def test_ground_without_texture_gives_nothing_and_in_between_some() -> None:
    terrain = ground(lambda x, y: 0.0)
    for texture, low, high in ((0.05, 0.0, 0.0), (0.25, 0.4, 0.6), (0.9, 0.95, 1.0)):
        dull = Terrain(terrain.frame, terrain.elevation_m, np.full_like(terrain.texture, texture))
        seen = expose(Scene(dull), EXACT, HERE, 0.0, -0.7, others={}, rng=rng())
        assert low <= len(seen.points_m) / (EXACT.rows * EXACT.columns) <= high


def test_a_team_mate_hides_the_ground_behind_it_gives_no_points_and_is_sighted() -> None:
    scene = Scene(ground(lambda x, y: 0.0))
    mate = Pose(13.0, 10.0, 0.0, 1.0)
    alone = expose(scene, EXACT, HERE, 0.0, -0.4, others={}, rng=rng())
    seen = expose(scene, EXACT, HERE, 0.0, -0.4, others={"mate": mate}, rng=rng())
    points = HERE.team_from_robot(seen.points_m)
    assert np.hypot(points[:, 0] - 13, points[:, 1] - 10).min() > 0.39
    shadow = (np.abs(points[:, 1] - 10) < 0.2) & (points[:, 0] > 13) & (points[:, 0] < 14.8)
    assert not shadow.any()
    assert len(seen.points_m) < len(alone.points_m)
    (sighting,) = seen.sightings
    assert sighting.name == "mate"
    assert sighting.offset_m == pytest.approx((3.0, 0.0, 0.0), abs=0.01)
    assert sighting.bearing_rad == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("mate", "why"),
    [
        (Pose(10.0, 13.0, 0.0, 0.0), "out of the frame"),
        (Pose(17.0, 10.0, 0.0, 0.0), "behind the wall"),
        (Pose(20.5, 10.0, 0.0, 0.0), "out of range"),
        (Pose(14.0, 10.05, 0.0, 0.0), "behind another"),
    ],
)
def test_who_is_not_in_plain_sight_is_not_sighted(mate: Pose, why: str) -> None:
    terrain = ground(lambda x, y: 1.2 * ((x > 15) & (x < 16)), side_m=24.0)
    others = {"mate": mate, "screen": Pose(11.5, 10.0, 1.0, 0.0)}
    seen = expose(Scene(terrain), EXACT, HERE, 0.0, -0.3, others=others, rng=rng())
    assert "mate" not in [s.name for s in seen.sightings], why


def test_sightings_are_as_good_as_their_covariance_says() -> None:
    sensor = SensorSettings(columns=4, rows=4)
    scene = Scene(ground(lambda x, y: 0.0))
    mate = Pose(14.0, 11.0, 0.0, 0.7)
    pose = Pose(10.0, 10.0, 0.0, 0.2)
    c, s = math.cos(0.2), math.sin(0.2)
    truth = np.array([4 * c + s, c - 4 * s, 0.0, 0.5])
    nees = []
    generator = rng(3)
    for _ in range(400):
        (got,) = expose(
            scene, sensor, pose, 0.0, -0.2, others={"mate": mate}, rng=generator
        ).sightings
        error = np.array([*got.offset_m, got.bearing_rad]) - truth
        nees.append(error @ np.linalg.solve(got.covariance, error))
    assert np.mean(nees) == pytest.approx(4.0, abs=0.5)


def test_sighting_covariance_by_hand() -> None:
    sensor = SensorSettings(attitude_sigma_deg=0.0)
    cov = sighting_covariance(sensor, np.array([5.0, 0.0, 0.0]))
    # sigma = 0.0008 * 25 = 0.02 along, a quarter of it across; floor 1 mm
    assert np.sqrt(np.diag(cov)[:3]) == pytest.approx([0.02, 0.005, 0.005], rel=0.03)
    assert np.linalg.eigvalsh(cov).min() > 0


def test_the_same_generator_gives_the_same_exposure() -> None:
    scene = Scene(rough(2))
    pose = Pose(6.0, 6.0, 0.5, 1.0)
    others = {"b": Pose(7.5, 7.5, 0.3, 0.0), "a": Pose(6.5, 8.5, 0.3, 0.0)}
    one = expose(scene, SensorSettings(), pose, 0.0, -0.3, others=others, rng=rng(9))
    two = expose(
        scene, SensorSettings(), pose, 0.0, -0.3, others=dict(reversed(others.items())), rng=rng(9)
    )
    assert np.array_equal(one.points_m, two.points_m)
    assert [s.offset_m for s in one.sightings] == [s.offset_m for s in two.sightings]


def test_a_look_takes_its_time_and_exposes_at_its_end() -> None:
    asked: list[int] = []

    def others(t_ns: int) -> dict[str, Pose]:
        asked.append(t_ns)
        return {}

    async def two_looks() -> tuple[float, float]:
        camera = RangeCamera(ground(lambda x, y: 0.0), EXACT, lambda: HERE, others, rng())
        first = await camera.look(0.0, -0.4)
        second = await camera.look(0.0, -0.4)
        assert asyncio.get_running_loop().time() == 30.0
        return first.t_s, second.t_s

    assert run(two_looks()) == (15.0, 30.0)
    assert asked == [15 * 10**9, 30 * 10**9]


def test_what_looks_measure_is_observable_and_the_other_way_round() -> None:
    terrain = rough(4)
    scene = Scene(terrain)
    pose = Pose(6.0, 6.0, terrain.height_m(6.0, 6.0), 0.0)
    sensor = EXACT.model_copy(update={"range_m": 4.0, "height_m": 1.4})
    dense = sensor.model_copy(update={"columns": 260, "rows": 160, "fov_deg": 95.0})
    seen = np.zeros(terrain.frame.shape, dtype=bool)
    for pan in np.arange(4) * math.pi / 2:
        for tilt in (-1.2, -0.6, 0.0):
            shot = expose(scene, dense, pose, float(pan), tilt, others={}, rng=rng())
            cells = terrain.frame.cells_of(pose.team_from_robot(shot.points_m))
            seen[cells[:, 0], cells[:, 1]] = True
    able = observable_cells(terrain, np.array([[6.0, 6.0]]), 1.4, 4.0, 0.4, footprint_m=0.1)
    assert (seen & able).sum() / seen.sum() > 0.97
    assert (seen & able).sum() / able.sum() > 0.97


def test_reachable_ground_ends_at_the_cliff_and_at_rocks() -> None:
    world = WorldSettings()
    terrain = make_terrain(world, 0.1, rng(1), ("cliffbot",))
    points = reachable_positions(terrain, (16.0, 26.0), 25.0, 0.8)
    assert len(points) > 60
    assert tuple(points[0]) == (16.0, 26.0)
    heights = [terrain.height_m(float(x), float(y)) for x, y in points]
    assert min(heights) > -1.0
    below = reachable_positions(terrain, (16.0, 4.0), 25.0, 0.8)
    assert max(terrain.height_m(float(x), float(y)) for x, y in below) < -4.0
