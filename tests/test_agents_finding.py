"""Landmarks of known geometry: their surfaces, and whether they are found where they stand."""

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from stereo_helpers import SENSOR, flat

from agents.geometry import Pose, wrap_angle
from agents.stereo.eyes import Look, see
from agents.stereo.finding import Finder, Found, NotFound, visible
from agents.stereo.settings import StereoSettings
from agents.stereo.shape import LANDER, Part, ShapeError, box_triangles, shape_of
from sim.stereo.camera import make_stage, take

HERE = Pose(4.0, 5.0, 0.0, 0.0)
LOOK = Look(0.0, 0.0, math.radians(-15))
STEREO = StereoSettings(stride_px=3)
EYE_M = np.array([0.0, 0.15, 2.5])
"""High enough to see the tops of the solar panels, without which it falls into pieces."""


@cache
def finder() -> Finder:
    return Finder(shape_of("lander"))


def box_points(parts: tuple[Part, ...]) -> int:
    """Return how many points stand for boxes, by their area."""
    area_m2 = sum(2 * (x * y + y * z + z * x) for x, y, z in (part.size_m for part in parts))
    return round(area_m2 / 0.05**2)


def test_a_surface_is_covered_evenly_and_its_normals_lead_out() -> None:
    shape = shape_of("lander")
    assert len(shape.points_m) == pytest.approx(box_points(LANDER), rel=0.03)
    assert np.linalg.norm(shape.normals, axis=1) == pytest.approx(1.0)
    vertices, faces = box_triangles((1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    outwards = (np.cross(b - a, c - a) * (a + b + c)).sum(axis=1)
    assert (outwards > 0).all()
    assert (shape.radius_m, shape.height_m) == pytest.approx((math.hypot(0.45, 2.25), 1.9))


def test_an_eye_sees_the_near_side_only() -> None:
    shape = shape_of("solar-panel")
    seen = shape.points_m[visible(shape, np.array([8.0, 0.0, 1.6]))]
    assert (seen[:, 0] > -0.02).all()
    assert 0.2 < len(seen) / len(shape.points_m) < 0.5


def test_a_file_is_a_shape_or_a_sentence(tmp_path: Path) -> None:
    path = tmp_path / "box.stl"
    trimesh.creation.box((1.0, 2.0, 1.0)).export(path)
    assert shape_of(str(path)).points_m.shape[1] == 3
    trimesh.creation.box((100.0, 2.0, 1.0)).export(tmp_path / "large.stl")
    with pytest.raises(ShapeError, match=r"100 m wide; a landmark must be 0.3 to 20 m"):
        shape_of(str(tmp_path / "large.stl"))
    (tmp_path / "bad.ply").write_text("hello")
    with pytest.raises(ShapeError, match=r"bad\.ply"):
        shape_of(str(tmp_path / "bad.ply"))
    with pytest.raises(ShapeError, match="must be lander, solar-panel or a file"):
        shape_of("nonsense")


def cloud(at: Pose, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return what an eye over the origin would measure of a lander on level ground."""
    rng = np.random.default_rng(seed)
    shape = shape_of("lander")
    foot = np.array([at.x_m, at.y_m, at.z_m])
    back = Pose(0.0, 0.0, 0.0, -at.yaw_rad)
    shown = visible(shape, back.team_from_robot((EYE_M - foot)[None])[0])
    ground = np.column_stack((rng.uniform(2, 9, 4000), rng.uniform(-4, 4, 4000), np.zeros(4000)))
    points = np.concatenate((at.team_from_robot(shape.points_m[shown]), ground))
    sigma = np.full(len(points), 0.02)
    return points + rng.normal(0, 0.01, points.shape), sigma


@pytest.mark.parametrize("yaw_rad", [-2.5, -0.6, 0.3, 1.9])
def test_a_lander_is_found_from_every_side(yaw_rad: float) -> None:
    at = Pose(5.5, 0.4, 0.05, yaw_rad)
    found = finder().find(*cloud(at), EYE_M)
    assert isinstance(found, Found)
    assert found.foot_m == pytest.approx([5.5, 0.4, 0.05], abs=0.05)
    assert wrap_angle(found.yaw_rad - yaw_rad) == pytest.approx(0.0, abs=0.02)


def test_what_is_no_lander_is_not_found() -> None:
    assert finder().find(np.zeros((0, 3)), np.zeros(0), EYE_M) == NotFound("")
    rng = np.random.default_rng(2)
    ground = np.column_stack((rng.uniform(2, 9, 4000), rng.uniform(-4, 4, 4000), np.zeros(4000)))
    sigma = np.full(6000, 0.02)
    ball = rng.normal(size=(2000, 3))
    ball = 0.9 * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    rock = ball[(ball[:, 2] > 0) & (ball[:, 0] < 0.3)] + [5.0, 0.0, 0.0]
    points = np.concatenate((ground, rock))
    answer = finder().find(points, sigma[: len(points)], EYE_M)
    assert isinstance(answer, NotFound)
    assert "nothing in sight has its shape" in answer.reason


def test_a_lander_behind_which_one_sees_is_none() -> None:
    """Half of it is not there, and where it should be the ground beyond it was measured."""
    at = Pose(5.0, 0.0, 0.0, 0.4)
    points, sigma = cloud(at)
    local = Pose(0.0, 0.0, 0.0, -at.yaw_rad).team_from_robot(points - [at.x_m, at.y_m, at.z_m])
    gone = (local[:, 1] > -0.2) & (local[:, 2] > 0.1) & (np.abs(local[:, :2]) < 3).all(axis=1)
    answer = finder().find(points[~gone], sigma[~gone], EYE_M)
    assert isinstance(answer, NotFound)
    assert "was seen through" in answer.reason


def test_rough_ground_about_its_feet_says_nothing_against_a_lander() -> None:
    at = Pose(5.0, 0.3, 0.05, -1.1)
    points, sigma = cloud(at)
    rng = np.random.default_rng(4)
    about = rng.uniform(-1.5, 1.5, (3000, 2))
    stones = np.column_stack((about + np.array((at.x_m, at.y_m)), rng.uniform(0.1, 0.4, 3000)))
    points, sigma = np.concatenate((points, stones)), np.append(sigma, np.full(3000, 0.02))
    found = finder().find(points, sigma, EYE_M)
    assert isinstance(found, Found)
    assert found.foot_m == pytest.approx([5.0, 0.3, 0.05], abs=0.06)
    assert wrap_angle(found.yaw_rad + 1.1) == pytest.approx(0.0, abs=0.03)


def test_a_lander_in_a_picture_is_a_sighting_and_no_ground() -> None:
    stands = HERE.moved(5.0, 0.3, 0.0, 0.8)
    stage = make_stage(flat(), {"alfa": 1.6, "post": 0.0}, salt=3, meshes={"post": "lander"})
    rng = np.random.default_rng(0)
    pair = take(stage, SENSOR, STEREO, HERE, LOOK, others={"post": stands}, rng=rng)
    seen = see(
        pair.left, pair.right, LOOK, sensor=SENSOR, stereo=STEREO, mates={},
        shapes={"post": finder()},
    ).exposure  # fmt: skip
    (mark,) = seen.sightings
    assert mark.name == "post"
    error = np.array([*mark.offset_m, mark.bearing_rad]) - [5.0, 0.3, 0.0, 0.8]
    assert error @ np.linalg.solve(mark.covariance, error) < 18.5  # chi2(4): 0.1 %
    assert np.abs(error[:3]).max() < 0.1
    assert seen.points_m[:, 2].max() < 0.4  # nothing of it is left to be mapped
