"""Worlds of cubes: caves as they are made, files as they are read, and robots in them."""

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from sim_helpers import run
from voxel_helpers import BUILD, CELL_M, EXACT, PLANNER, SENSOR, hall, standing

from agents.geometry import Pose
from agents.voxel.frame import VoxelFrame
from agents.voxel.ground import Build
from sim.errors import WorldError
from sim.motion import Motions, Segment
from sim.occupancy import BUMP, SPACING_M, OccupancyBody, RangeCamera
from sim.propagation import Propagation
from sim.voxel.cave import make_cave
from sim.voxel.files import MOST_CELLS, read_world
from sim.voxel.robot import DROP, VoxelTread, place_explorers
from sim.voxel.settings import CaveSettings
from sim.voxel.world import VoxelWorld, best_start, look, observable

HALL = hall()
WINDOW_M = (20.0, 18.0)


def cave(seed: int, settings: CaveSettings | None = None) -> VoxelWorld:
    chosen = settings or CaveSettings(chambers=3)
    rng = np.random.default_rng(seed)
    return make_cave(rng, chosen, window_m=WINDOW_M, cell_m=CELL_M, build=BUILD)


# --- caves ----------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2])
def test_a_cave_can_be_gone_through_has_overhangs_and_lies_open_at_its_entrance(seed: int) -> None:
    world = cave(seed)
    solid, (layer, row, col) = world.solid, world.start
    assert world.frame.voxels == solid.shape == (28, 72, 80)
    ground = world.ground(BUILD)
    reached = ground.reachable(ground.place_at(layer, row, col, 0))
    assert reached.mean() > 0.8, "nearly all of its floor"
    assert len({int(n) for n in ground.cells[reached][:, 0]}) >= 1
    assert not solid[layer:, row, col].any(), "one sees the sky from the start"
    free = ~solid
    under = free[:-2] & solid[1:-1]
    overhang = under & (np.cumsum(free[::-1], axis=0)[::-1][2:] > 0)
    assert overhang.sum() > 15, "free below, then rock, then free again"
    assert solid[:, 0].all()
    assert solid[0].all()


def test_the_same_seed_gives_the_same_cave_and_another_another() -> None:
    assert np.array_equal(cave(3).solid, cave(3).solid)
    assert not np.array_equal(cave(3).solid, cave(4).solid)


def test_what_can_be_seen_is_what_some_look_sees() -> None:
    seen = observable(HALL, SENSOR, EXACT, PLANNER.tilts_deg)
    assert seen[HALL.start]
    assert not seen[:, 0].any(), "not the rock behind the walls"
    free = ~HALL.solid
    assert (seen & free).sum() > 0.97 * free.sum()
    under = seen[4:8, 9:12, 12:16] & free[4:8, 9:12, 12:16]
    assert under.sum() > 0.9 * free[4:8, 9:12, 12:16].sum(), "and what lies under the table"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (CaveSettings(height_m=3.0), "world.cave.height_m = 3: must be at least 4.6"),
    ],
)
def test_a_cave_that_cannot_be_is_refused(settings: CaveSettings, words: str) -> None:
    with pytest.raises(WorldError, match=words):
        cave(1, settings)


def test_a_window_without_room_for_a_cave_is_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(WorldError, match=r"a cave needs at least \[10, 9\]"):
        make_cave(rng, CaveSettings(), window_m=(6.0, 6.0), cell_m=CELL_M, build=BUILD)


def test_a_robot_that_fits_in_no_tunnel_has_no_cave() -> None:
    giant = Build(tall=26, climb=0, reach=9.0)
    settings = CaveSettings(chambers=1)
    with pytest.raises(WorldError, match="must be fewer"):
        make_cave(
            np.random.default_rng(0), settings, window_m=(10.0, 9.0), cell_m=CELL_M, build=giant
        )


# --- files ----------------------------------------------------------------------------------


def box(path: Path, **kwargs: float) -> Path:
    """Write a room of 6 x 4 x 2.5 m as a mesh."""
    room = trimesh.creation.box(extents=(6.0, 4.0, 2.5))
    room.apply_translation((10.0, -3.0, 1.25))
    room.export(path, **kwargs)
    return path


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_a_mesh_is_solid_where_its_surface_is(tmp_path: Path, suffix: str) -> None:
    world = read_world(box(tmp_path / f"room{suffix}"), cell_m=CELL_M, build=BUILD)
    pose = world.standing(np.array(world.start), 0.0)
    assert abs(pose.x_m - 10.0) < 0.5
    assert abs(pose.y_m + 3.0) < 0.5
    assert abs(pose.z_m) <= CELL_M
    ranges_m = look(world, pose, 0.0, SENSOR, None)
    assert np.isfinite(ranges_m).all(), "no ray slips out"
    level = ranges_m.reshape(SENSOR.rows, SENSOR.columns)[SENSOR.rows // 2, SENSOR.columns // 2]
    assert level == pytest.approx(13.0 - pose.x_m, abs=CELL_M + 0.01)


def test_a_point_cloud_is_solid_where_its_points_are(tmp_path: Path) -> None:
    mesh = trimesh.creation.box(extents=(6.0, 4.0, 2.5))
    points, _ = trimesh.sample.sample_surface(mesh, 60_000, seed=1)
    path = tmp_path / "cloud.ply"
    trimesh.PointCloud(points).export(path)
    world = read_world(path, cell_m=CELL_M, build=BUILD)
    ranges_m = look(world, world.standing(np.array(world.start), 0.3), 0.0, SENSOR, None)
    assert np.isfinite(ranges_m).mean() > 0.99


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("room.stl", b"solid", "is no mesh or point cloud; allowed are .ply, .obj"),
        ("room.ply", b"nonsense", "can't be read as a mesh or point cloud"),
        ("room.ply", b"", "can't be read as a mesh or point cloud"),
        ("room.obj", b"# nothing\n", "holds no points|can't be read"),
        ("room.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "not finite|can't be read"),
        ("room.obj", b"v 0 0 0\nv 1e5 1e5 1e5\nv 0 1 0\n", f"allowed are {MOST_CELLS:,}"),
        ("room.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "has no room for the robot"),
    ],
)
def test_files_that_hold_no_world_are_refused_in_a_sentence(
    tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(WorldError, match=words):
        read_world(path, cell_m=CELL_M, build=BUILD)


def test_the_largest_floor_is_where_the_team_starts() -> None:
    solid = HALL.solid.copy()
    solid[5:10, 6:10, 22:24] = True  # the door is shut
    world = best_start(VoxelWorld(HALL.frame, solid, (0, 0, 0)), BUILD)
    layer, _, col = world.start
    assert (layer, col > 24) in ((4, False), (5, True))
    with pytest.raises(WorldError, match="no room"):
        best_start(VoxelWorld(HALL.frame, np.ones_like(solid), (0, 0, 0)), BUILD)


# --- robots ---------------------------------------------------------------------------------


def test_a_camera_ranges_to_the_nearest_rock_and_errs_as_it_says() -> None:
    pose = standing(HALL, (4, 7, 6))

    rng = np.random.default_rng(0)

    async def shots() -> np.ndarray:
        camera = RangeCamera(
            lambda at, tilt_rad: look(HALL, at, tilt_rad, SENSOR, rng), SENSOR, lambda: pose
        )
        return np.array([(await camera.look(0.0, 0.0)).ranges_m for _ in range(30)])

    seen, true = run(shots()), look(HALL, pose, 0.0, SENSOR, None)
    hit = np.isfinite(true) & (true < 4.5)
    errors = seen[:, hit] - true[hit]
    assert np.std(errors / (SENSOR.noise_s * true[hit] ** 2)) == pytest.approx(1.0, abs=0.05)
    assert not np.isfinite(seen[:, ~np.isfinite(true)]).any()


def body(cell: tuple[int, int, int], yaw_rad: float, world: VoxelWorld = HALL) -> OccupancyBody:
    tread = VoxelTread(world, world.ground(BUILD))
    pose = standing(world, cell, yaw_rad)
    return OccupancyBody("a", tread, EXACT, pose, lambda _: None, np.random.default_rng(0))


def test_a_robot_climbs_a_step_and_is_stopped_by_a_wall() -> None:
    robot = body((4, 7, 18), 0.0)

    async def east() -> list[str]:
        return [(await robot.drive(0.0, 1.0)).halted for _ in range(6)]

    halts = run(east())
    assert halts[:4] == ["", "", "", ""]
    assert halts[-1] == BUMP
    assert robot.hazards_hit >= 1


def test_the_floor_lifts_a_robot() -> None:
    robot = body((4, 7, 18), 0.0)

    async def over() -> tuple[float, float, float]:
        before = robot.pose_now().z_m
        odometry = await robot.drive(0.0, 2.5)
        return before, robot.pose_now().z_m, odometry.up_m

    before, after, felt = run(over())
    assert after - before == pytest.approx(CELL_M)
    assert felt == pytest.approx(CELL_M, abs=0.1)


def test_a_robot_does_not_go_down_a_drop() -> None:
    solid = HALL.solid.copy()
    solid[4:7, 2:14, 2:10] = True
    robot = body((7, 7, 5), 0.0, VoxelWorld(HALL.frame, solid, (7, 7, 5)))

    async def east() -> str:
        return (await robot.drive(0.0, 3.0)).halted

    assert run(east()) in (DROP, BUMP)
    assert robot.hazards_hit <= 1


def test_a_team_stands_apart_on_one_floor() -> None:
    poses = place_explorers(HALL, BUILD, 4, np.random.default_rng(1))
    assert poses[0].distance_m(standing(HALL, HALL.start)) < 1e-9
    for n, pose in enumerate(poses):
        assert all(pose.distance_m(other) >= SPACING_M - 1e-9 for other in poses[:n])
    with pytest.raises(WorldError, match="60 robots"):
        place_explorers(HALL, BUILD, 60, np.random.default_rng(1))


def test_rock_hides_robots_from_each_others_radios() -> None:
    motions = Motions()
    for name, cell in (("a", (4, 12, 6)), ("b", (5, 12, 38)), ("c", (4, 4, 18))):
        pose = standing(HALL, cell)
        motions.add(Segment(name, 0, 0, pose, pose))
    air = Propagation("a", motions, HALL, 0)
    assert air.hides("b", 0, 0.5, 0.5)
    assert not air.hides("c", 0, 0.5, 0.5)


def test_points_and_cells_are_of_one_mind() -> None:
    frame = VoxelFrame(-2.0, 1.0, 0.25, 16, 44, -1.0, 20)
    cells = np.array([(0, 0, 0), (4, 7, 6), (19, 15, 43)])
    assert np.array_equal(frame.voxels_of(frame.centres_m(cells)), cells)
    x_m, y_m, z_m = (float(v) for v in frame.centres_m(cells)[1])
    assert frame.voxel_of(x_m, y_m, z_m) == (4, 7, 6)
    assert frame.holds_voxel(19, 15, 43)
    assert not frame.holds_voxel(20, 15, 43)
    pose = standing(HALL, (4, 7, 6), 0.5)
    assert isinstance(pose, Pose)
    assert math.isclose(pose.z_m, -1.0 + 4 * 0.25)
