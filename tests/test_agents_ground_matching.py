"""Looks held against the own elevation map: where the robot stands, and how sure that is."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.fusion import pose_numbers
from agents.geometry import Floats, GridFrame, Pose
from agents.ground import matching
from agents.ground.stands import Stands
from agents.layers import Anchor, variances
from agents.maps.elevation import Submap
from agents.maps.elevationlook import bin_look
from agents.ports import Exposure, Odometry
from agents.pose.anchoring import submap_name
from agents.pose.posefilter import PoseFilter, Remembered
from agents.settings import SensorSettings
from sim.camera import expose
from sim.ground import Terrain
from sim.scene import Scene, scene_of

FRAME = GridFrame(0.0, 0.0, 0.1, 120, 120)
SENSOR = SensorSettings(attitude_sigma_deg=0.15)
STAND = Pose(6.0, 3.0, 0.0, math.pi / 2)
SURE = np.diag([1e-8, 1e-8, 1e-8, 1e-10])
UNSURE = np.diag([0.08**2, 0.08**2, 0.04**2, 0.01**2])
EVERYWHERE = np.ones(FRAME.shape, dtype=np.bool_)


def rough(seed: int = 1, height_m: float = 0.12) -> Terrain:
    """Return ground of waves of all directions, as high as that."""
    rng = np.random.default_rng(seed)
    y, x = (np.indices(FRAME.shape) + 0.5) * FRAME.cell_m
    total = np.zeros(FRAME.shape)
    for _ in range(24):
        along, phase = rng.uniform(0, 2 * math.pi, 2)
        length_m = rng.uniform(0.9, 4.0)
        total += np.sin(2 * math.pi / length_m * (x * np.cos(along) + y * np.sin(along)) + phase)
    heights = (height_m / 3.5 * total).astype(np.float32)
    return Terrain(FRAME, heights, np.ones_like(heights))


def flat() -> Terrain:
    level = np.zeros(FRAME.shape, dtype=np.float32)
    return Terrain(FRAME, level, np.ones_like(level))


def grounded(terrain: Terrain, pose: Pose) -> Pose:
    row, col = terrain.frame.cell_of(pose.x_m, pose.y_m)
    return replace(pose, z_m=float(terrain.elevation_m[row, col]))


def seen_from(scene: Scene, pose: Pose, seed: int = 0) -> Exposure:
    rng = np.random.default_rng(seed)
    return expose(scene, SENSOR, pose, 0.0, -0.35, others={}, rng=rng)


def matched(
    terrain: Terrain, elevation_m: Floats, off: tuple[float, float, float, float]
) -> tuple[Pose, matching.Match | None]:
    """Return the true pose, and what a look from there says if one believes to be off by that."""
    truth = grounded(terrain, STAND)
    look = seen_from(scene_of(terrain), truth)
    believed = Pose(*(pose_numbers(truth) + off))
    relief = matching.relief_of(FRAME, elevation_m, EVERYWHERE)
    points = matching.points_of(look, FRAME, believed)
    return truth, matching.match(relief, points, believed, UNSURE, SENSOR)


@settings(max_examples=15, deadline=None)
@given(
    st.tuples(*(st.floats(-0.1, 0.1) for _ in range(2)), st.floats(-0.05, 0.05)),
    st.floats(-0.02, 0.02),
)
def test_a_look_at_known_rough_ground_tells_the_pose(
    off_m: tuple[float, float, float], off_rad: float
) -> None:
    terrain = rough()
    truth, found = matched(terrain, terrain.elevation_m.astype(np.float64), (*off_m, off_rad))
    assert found is not None
    error = pose_numbers(found.pose) - pose_numbers(truth)
    assert np.abs(error[:3]).max() < 0.02
    assert abs(error[3]) < 0.005
    assert float(error @ np.linalg.solve(found.covariance, error)) < 25.0


def test_level_ground_tells_the_height_and_says_that_it_tells_no_more() -> None:
    truth, found = matched(flat(), np.zeros(FRAME.shape), (0.05, -0.05, 0.04, 0.01))
    assert found is not None
    sigma = np.sqrt(np.diag(found.covariance))
    assert abs(found.pose.z_m - truth.z_m) < 3 * sigma[2] < 0.05
    assert sigma[:2].min() > 0.3
    assert sigma[3] > 0.1


def test_other_ground_is_not_taken_for_the_own() -> None:
    """Either nothing fits, or it fits so badly that the pose stays where it was believed."""
    other = rough(seed=9, height_m=0.3).elevation_m.astype(np.float64)
    _, found = matched(rough(seed=2, height_m=0.3), other, (0.0, 0.0, 0.0, 0.0))
    assert found is None


def test_without_enough_ground_in_common_nothing_is_told() -> None:
    elevation_m = rough().elevation_m.astype(np.float64)
    elevation_m[45:] = np.nan
    assert matched(rough(), elevation_m, (0.0, 0.0, 0.0, 0.0))[1] is None


def test_a_match_adds_to_what_was_believed_and_does_not_hold_it_already() -> None:
    """The measurement is the same, to its own sigma, whatever was believed before."""
    terrain = rough()
    truth = grounded(terrain, STAND)
    look = seen_from(scene_of(terrain), truth)
    relief = matching.relief_of(FRAME, terrain.elevation_m.astype(np.float64), EVERYWHERE)
    told: list[Floats] = []
    for off in (0.05, -0.05):
        believed = Pose(truth.x_m + off, truth.y_m, truth.z_m, truth.yaw_rad)
        points = matching.points_of(look, FRAME, believed)
        found = matching.match(relief, points, believed, UNSURE, SENSOR)
        assert found is not None
        told.append(pose_numbers(found.pose) - pose_numbers(truth))
    assert np.abs(told[0] - told[1])[:3].max() < 0.01


def test_what_stands_for_a_pose_is_measured_no_surer_than_it_was_drawn() -> None:
    way = PoseFilter(Pose(0.0, 0.0, 0.0, 0.0), SURE)
    name, blur = Remembered("stand", 0), np.diag([0.01**2, 0.01**2, 0.01**2, 0.002**2])
    way.remember(name, blur)
    way.predict(Odometry(1.0, 0.0, 0.0, 0.0, UNSURE))
    for _ in range(500):
        offset = np.array((1.0, 0.0, 0.0, 0.0))
        way.fix_against(name, offset, np.diag([0.005**2] * 3 + [0.001**2]))
    sigma = np.sqrt(np.diag(way.covariance))
    assert sigma[0] == pytest.approx(0.01, rel=0.02)
    assert sigma[3] == pytest.approx(0.002, rel=0.02)


class Rover:
    """A robot on rough ground that maps, with a filter and its stands."""

    def __init__(self, seed: int) -> None:
        self.terrain = rough(seed)
        self.scene = scene_of(self.terrain)
        self.truth = grounded(self.terrain, Pose(4.0, 4.0, 0.0, 0.5))
        self.way, self.wheels = (PoseFilter(self.truth, SURE) for _ in range(2))
        self.submap = Submap(FRAME, Anchor.at(self.truth, (1e-8, 1e-8, 1e-8, 1e-10)))
        self.way.remember(submap_name(0))
        self.stands = Stands(FRAME, SENSOR)
        self.rng = np.random.default_rng(seed)
        self.looks = 0

    def look(self) -> list[str]:
        self.looks += 1
        seen = seen_from(self.scene, self.truth, self.looks)
        doubts = self.stands.locate(self.submap, 0, seen, self.way)
        offset = self.way.from_remembered(submap_name(0))
        drawn = self.submap.anchor.pose.moved(*(float(v) for v in offset.mean))
        beyond = variances(offset.covariance)
        cells = bin_look(
            seen, drawn, FRAME, attitude_sigma_rad=math.radians(0.15), extra_variance=beyond
        )
        self.submap.observe(cells)
        self.stands.drew(self.submap, 0, drawn, seen, cells, self.way)
        return doubts

    def drive(self, forward_m: float, turn_rad: float) -> None:
        turned = replace(self.truth, yaw_rad=self.truth.yaw_rad + turn_rad)
        there = grounded(self.terrain, turned.moved(forward_m, 0.0, 0.0, 0.0))
        error = self.rng.normal(size=4) * np.sqrt(np.diag(UNSURE))
        offset = np.array((forward_m * math.cos(turn_rad), forward_m * math.sin(turn_rad)))
        offset = np.append(offset, (there.z_m - self.truth.z_m, turn_rad)) + error
        for way in (self.way, self.wheels):
            way.predict(Odometry(*(float(v) for v in offset), UNSURE))
        self.truth = there


def test_robots_that_hold_their_looks_against_the_map_drift_less_and_are_as_wrong_as_they_say() -> (
    None
):
    squared: list[float] = []
    off_m: list[tuple[float, float]] = []
    for seed in range(1, 7):
        rover = Rover(seed)
        rover.look()
        for forward_m, turn_rad in ((0.6, 0.2), (0.6, 0.3), (0.6, 0.3), (0.6, 0.4)):
            rover.drive(forward_m, turn_rad)
            assert rover.look() == []
        error = pose_numbers(rover.way.pose) - pose_numbers(rover.truth)
        squared.append(float(error @ np.linalg.solve(rover.way.covariance, error)))
        by_wheels = pose_numbers(rover.wheels.pose) - pose_numbers(rover.truth)
        off_m.append((math.hypot(*error[:2]), math.hypot(*by_wheels[:2])))
    matched_m, wheels_m = np.sqrt(np.mean(np.square(off_m), axis=0))
    assert matched_m < 0.35 * wheels_m
    assert np.mean(squared) < 7.2, "chi-squared of 24 degrees of freedom, over six: 99 %"


def test_a_robot_that_has_not_moved_learns_nothing_from_the_same_stand() -> None:
    rover = Rover(3)
    rover.look()
    before = rover.way.covariance
    rover.look()
    assert np.array_equal(rover.way.covariance, before)


def test_only_so_many_stands_are_kept_and_the_filter_lets_go_of_the_others() -> None:
    rover = Rover(4)
    for number in range(20):
        rover.look()
        rover.drive(0.1 if number % 2 else -0.1, 0.3)
    held = [n for n in range(25) if rover.way.holds(Remembered("stand", n))]
    assert len(held) == 16
    assert 0 in held, "the first drew the most cells"


def test_a_new_submap_begins_without_stands() -> None:
    rover = Rover(5)
    rover.look()
    rover.drive(0.3, 0.0)
    seen = seen_from(rover.scene, rover.truth)
    before = rover.way.covariance
    assert rover.stands.locate(rover.submap, 1, seen, rover.way) == []
    assert np.array_equal(rover.way.covariance, before)
