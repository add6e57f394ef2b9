"""Floors: read as they are defined, seen as they are, and hard to drive through."""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from sim_helpers import run

from agents.floorways import gap_m
from agents.geometry import GridFrame, Pose
from agents.planar.rays import fan_rad
from agents.settings import DriveSettings, SensorSettings
from sim.errors import WorldError
from sim.motion import Motions, Segment
from sim.occupancy import BUMP, SPACING_M, OccupancyBody, RangeCamera
from sim.planar import PlanarScene, PlanarTread, place_explorers, stands_free
from sim.planar_world import PlanarWorld, load_map, look, made_up, observable
from sim.propagation import Propagation

EXACT = DriveSettings(
    footprint_m=0.3, slip_sigma=0, slip_bias_sigma=0, odometry_sigma=0,
    yaw_sigma_deg_per_m=0, yaw_sigma_deg_per_turn=0, speed_mps=1.0, turn_rate_radps=1.0,
)  # fmt: skip
SENSOR = SensorSettings(fov_deg=90.0, range_m=5.0, columns=90, look_s=2.0, near_m=0.0)
PLAN = """
    ##########
    #....#...#
    #....#...#
    #........#
    #....#...#
    ######.###
    #...##.###
    ##########
"""


def floor(plan: str, cell_m: float = 0.4, start: tuple[int, int] = (4, 2)) -> PlanarWorld:
    """Return a floor as it is drawn, north up."""
    lines = [line.strip() for line in plan.split()]
    solid = np.array([[sign == "#" for sign in line] for line in lines[::-1]])
    return PlanarWorld(GridFrame(0.0, 0.0, cell_m, *solid.shape), solid, start)


HOUSE = floor(PLAN)


# --- maps of buildings ----------------------------------------------------------------------


def write_map(folder: Path, pixels: np.ndarray, text: str = "", **changes: str) -> Path:
    assert cv2.imwrite(str(folder / "floor.png"), pixels)
    told = {
        "image": "floor.png", "resolution": "0.1", "origin": "[-3.0, 2.0, 0.0]",
        "negate": "0", "occupied_thresh": "0.65", "free_thresh": "0.196", **changes,
    }  # fmt: skip
    path = folder / "floor.yaml"
    path.write_text(text or "".join(f"{key}: {value}\n" for key, value in told.items()))
    return path


def test_a_cell_is_free_where_its_block_is_three_quarters_free(tmp_path: Path) -> None:
    pixels = np.full((40, 48), 254, dtype=np.uint8)
    pixels[0:4, 0:4].flat[:4] = 0  # north-west corner: 12 of 16 free, mean 190.5
    pixels[0:4, 4:8].flat[:3] = 0  # beside it: 13 of 16, mean 206.4
    pixels[0:4, 8:12].flat[:4] = 205  # unknown counts as solid
    pixels[0:4, 12:16].flat[:16] = 240  # light grey is free by the threshold, and counts whole
    world = load_map(write_map(tmp_path, pixels), cell_m=0.4)
    assert world.frame == GridFrame(-3.0, 2.0, 0.4, 10, 12)
    expected = np.zeros((10, 12), dtype=bool)
    expected[9, [0, 2]] = True
    assert np.array_equal(world.solid, expected)


def test_a_negated_map_is_the_other_way_round(tmp_path: Path) -> None:
    pixels = np.zeros((40, 40), dtype=np.uint8)
    pixels[:4, :4] = 255
    world = load_map(write_map(tmp_path, pixels, negate="1"), cell_m=0.4)
    assert np.argwhere(world.solid).tolist() == [[9, 0]]


@pytest.mark.parametrize(
    ("changes", "cell_m", "words"),
    [
        ({"image": "other.png"}, 0.4, "other.png"),
        ({"resolution": "0.15"}, 0.4, "0.4"),
        ({"resolution": "fine"}, 0.4, "fine"),
    ],
)
def test_a_map_that_cannot_be_read_is_refused_in_a_sentence(
    tmp_path: Path, changes: dict[str, str], cell_m: float, words: str
) -> None:
    path = write_map(tmp_path, np.full((40, 40), 254, dtype=np.uint8), **changes)
    with pytest.raises(WorldError, match=words):
        load_map(path, cell_m=cell_m)


def test_a_map_without_room_or_without_a_key_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match="room"):
        load_map(write_map(tmp_path, np.zeros((40, 40), dtype=np.uint8)))
    with pytest.raises(WorldError, match="resolution"):
        load_map(write_map(tmp_path, np.zeros((40, 40), dtype=np.uint8), "image: floor.png\n"))


def test_a_made_up_floor_is_as_solid_as_asked_and_the_same_again() -> None:
    one, again = (made_up(np.random.default_rng(5), side_m=40.0) for _ in range(2))
    assert np.array_equal(one.solid, again.solid)
    assert 0.15 <= one.solid.mean() < 0.25
    assert not np.array_equal(one.solid, made_up(np.random.default_rng(6), side_m=40.0).solid)


def test_observable_is_what_can_be_seen_from_where_one_can_get_to() -> None:
    seen = observable(HOUSE, SENSOR, 0.3)
    assert seen[4:7, 1:5].all(), "the room, and through the door"
    assert seen[5, 0], "the first obstacle along a ray"
    assert not seen[1, 1:4].any(), "the closed cell can't be seen into"
    assert not seen[0, 0], "nor through its wall"


# --- what is near ---------------------------------------------------------------------------


@given(st.floats(-0.5, 4.5), st.floats(-0.5, 3.7), st.floats(0.05, 1.0))
@settings(max_examples=100, deadline=None)
def test_the_gap_to_what_is_solid_is_that_to_the_nearest_square(
    x_m: float, y_m: float, reach_m: float
) -> None:
    frame, best = HOUSE.frame, reach_m
    for row, col in itertools.product(range(-4, frame.rows + 4), range(-4, frame.cols + 4)):
        if frame.holds(row, col) and not HOUSE.solid[row, col]:
            continue
        west, south = frame.x_m + col * 0.4, frame.y_m + row * 0.4
        dx = max(west - x_m, 0.0, x_m - west - 0.4)
        dy = max(south - y_m, 0.0, y_m - south - 0.4)
        best = min(best, math.hypot(dx, dy))
    assert gap_m(HOUSE.solid, HOUSE.frame, x_m, y_m, reach_m) == pytest.approx(best, abs=1e-9)


@given(st.floats(0.1, 3.9), st.floats(0.1, 3.1), st.floats(0.1, 3.9), st.floats(0.1, 3.1))
@settings(max_examples=100, deadline=None)
def test_sight_is_clear_where_no_point_of_the_line_is_solid(
    x1: float, y1: float, x2: float, y2: float
) -> None:
    assume(math.hypot(x2 - x1, y2 - y1) > 0.01)
    scene = PlanarScene(HOUSE)
    a, b = np.array([x1, y1, 1.0]), np.array([x2, y2, 1.0])
    points = a + np.linspace(0, 1, 400)[:, None] * (b - a)
    inside = np.ones(len(points), dtype=bool)
    for nudge in itertools.product((-1e-6, 1e-6), repeat=2):  # on an edge it may be either
        cells = HOUSE.frame.cells_of(points[:, :2] + nudge)
        inside &= HOUSE.solid[cells[:, 0], cells[:, 1]]
    if inside.any():
        assert not scene.clear(a, b)
    elif scene.clear(a, b) is False:  # a corner may be cut between two of the points
        fine = a + np.linspace(0, 1, 40_001)[:, None] * (b - a)
        near = [gap_m(HOUSE.solid, HOUSE.frame, float(x), float(y), 0.01) for x, y, _ in fine[::10]]
        assert min(near) < 2e-3


def test_walls_stand_in_the_way_of_radio_waves() -> None:
    motions = Motions()
    for name, x_m in (("a", 0.6), ("b", 1.8), ("c", 2.6)):
        pose = Pose(x_m, 2.2, 0.0, 0.0)
        motions.add(Segment(name, 0, 0, pose, pose))
    waves = Propagation("a", motions, HOUSE, 0)
    assert waves.hides("c", 0, 1.0, 1.0)
    assert not waves.hides("b", 0, 1.0, 1.0)


# --- a look ---------------------------------------------------------------------------------


def exposed(pan_rad: float = 0.0, seed: int = 0, **changes: float):
    sensor = SENSOR.model_copy(update=changes)
    pose = Pose(1.0, 1.8, 0.0, math.pi)
    rng = np.random.default_rng(seed)
    camera = RangeCamera(lambda at, _: look(HOUSE, at, sensor, rng)[0], sensor, lambda: pose)
    return run(camera.look(pan_rad, 0.0))


def test_a_camera_gives_the_range_to_the_first_wall_along_each_ray() -> None:
    exposure = exposed(noise_s=0.0)
    assert exposure.t_s == 2.0
    assert exposure.points_m.shape == (0, 3)
    west_m = 0.6 / np.cos(fan_rad(SENSOR))
    middle = np.abs(fan_rad(SENSOR)) < math.radians(30)
    assert np.allclose(exposure.ranges_m[middle], west_m[middle])
    panned = exposed(-math.pi / 2, noise_s=0.0)  # to the north: 1 m to the wall
    assert panned.ranges_m[45] == pytest.approx(1.0, abs=0.01)
    assert np.isinf(exposed(range_m=0.5, noise_s=0.0).ranges_m[45])


def test_ranges_err_as_equation_4_says_and_the_same_again() -> None:
    ranges = np.array([exposed(seed=seed, noise_s=0.1).ranges_m[45] for seed in range(300)])
    assert np.std(ranges) == pytest.approx(0.1 * 0.6**2, rel=0.15)
    assert np.array_equal(exposed(seed=7).ranges_m, exposed(seed=7).ranges_m)


# --- driving --------------------------------------------------------------------------------


def body(x_m: float, y_m: float, yaw_rad: float, drive: DriveSettings = EXACT) -> OccupancyBody:
    start = Pose(x_m, y_m, 0.0, yaw_rad)
    tread = PlanarTread(HOUSE, drive)
    return OccupancyBody("a", tread, drive, start, lambda _: None, np.random.default_rng(0))


def test_walls_stop_a_robot_and_count_as_hazards() -> None:
    robot = body(1.0, 2.2, math.pi)

    async def there_and_back() -> tuple[str, float, str, str]:
        into = await robot.drive(0.0, 3.0)
        x_m = robot.pose_now().x_m
        again = await robot.drive(0.0, 1.0)
        back = await robot.drive(0.0, -0.5)
        return into.halted, x_m, again.halted, back.halted

    halted, x_m, again, back = run(there_and_back())
    assert (halted, again, back) == (BUMP, BUMP, "")
    assert 0.4 + 0.15 <= x_m < 0.4 + 0.15 + 0.1
    assert robot.hazards_hit == 2


def test_a_robot_passes_a_door_that_is_wide_enough_for_it() -> None:
    robot = body(1.0, 1.8, 0.0)

    async def through() -> str:
        return (await robot.drive(0.0, 2.0)).halted

    assert run(through()) == ""
    assert robot.hazards_hit == 0
    wide = body(1.0, 1.8, 0.0, EXACT.model_copy(update={"footprint_m": 0.45}))
    assert run(wide.drive(0.0, 2.0)).halted == BUMP


# --- starting -------------------------------------------------------------------------------


@given(st.integers(0, 1000), st.integers(1, 6))
@settings(max_examples=15, deadline=None)
def test_a_team_starts_on_free_places_apart(seed: int, count: int) -> None:
    world = made_up(np.random.default_rng(seed), side_m=20.0, footprint_m=0.3)
    poses = place_explorers(world, count, 0.3, np.random.default_rng(seed))
    assert world.frame.cell_of(poses[0].x_m, poses[0].y_m) == world.start
    assert all(stands_free(world, p.x_m, p.y_m, 0.3) for p in poses)
    assert all(a.distance_m(b) >= SPACING_M for a, b in itertools.combinations(poses, 2))


def test_a_team_that_is_too_large_for_its_floor_is_refused() -> None:
    with pytest.raises(WorldError, match="room for"):
        place_explorers(replace(HOUSE, start=(5, 2)), 30, 0.3, np.random.default_rng(0))
