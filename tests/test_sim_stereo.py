import math
import time
from dataclasses import replace

import numpy as np
import pytest
from sim_helpers import run
from stereo_helpers import AHEAD, HERE, MASTS_M, SENSOR, STEREO, flat, shot, stage

from agents.geometry import Pose, wrap_angle
from agents.stereo.eyes import Look, calibration_of, left_eye_m, level_from_camera, see
from agents.stereo.matching import MatchSettings, match
from agents.stereo.settings import StereoSettings
from agents.stereo.tagmodel import TAG_M, panels
from agents.stereo.tags import corners
from sim.stereo.camera import StereoCamera, make_stage, take
from sim.stereo.mesh import lander_mesh, placed, robot_mesh
from sim.stereo.paint import CONTRAST, LATTICE_SIGMA, pattern, value_noise
from sim.stereo.scene import origin_of
from sim.stereo.settings import LensSettings, LightSettings
from sim.stereo.shoot import tag_cells

FULL = StereoSettings()
TEXTURED = Look(0.0, math.radians(-35), math.radians(-20))
"""Turned to the right (south), away from the ground without texture."""


def mate_at(forward_m: float, left_m: float, turn_rad: float) -> Pose:
    return HERE.moved(forward_m, left_m, 0.0, turn_rad)


def test_the_same_seed_gives_the_same_images() -> None:
    one, same, other = shot(seed=4), shot(seed=4), shot(seed=5)
    assert np.array_equal(one.left, same.left)
    assert np.array_equal(one.right, same.right)
    assert not np.array_equal(one.left, other.left)


def test_depth_is_that_of_the_plane() -> None:
    """Depth of level ground under pixel row v: h / (sin(-tilt) + cos(tilt) (v - cy) / f)."""
    got = shot(look=Look(0.0, 0.0, math.radians(-30)))
    c = calibration_of(SENSOR, STEREO)
    row = 200
    slope = (row - c.cy_px) / c.focal_px
    want_m = 1.6 / (0.5 + math.cos(math.radians(30)) * slope)
    assert np.allclose(got.depth_m[row, 5:-5], want_m, rtol=1e-4)


def test_what_the_left_image_shows_the_right_one_shows_at_the_true_disparity() -> None:
    got = shot(look=TEXTURED)
    c = calibration_of(SENSOR, STEREO)
    rows, cols = np.indices(got.left.shape)
    there = cols - (c.focal_px * c.baseline_m / got.depth_m)
    inside = np.isfinite(got.depth_m) & (there >= 1) & (there <= STEREO.width_px - 2)
    r, u = rows[inside], there[inside]
    low = np.floor(u).astype(int)
    right = got.right.astype(float)
    seen = (1 - (u - low)) * right[r, low] + (u - low) * right[r, low + 1]
    apart = np.abs(seen - got.left[inside])
    assert np.median(apart) < 4
    shuffled = np.abs(seen - np.roll(got.left[inside], 997))
    assert np.median(shuffled) > 3 * np.median(apart)


def test_disparity_of_a_rendered_pair_is_true() -> None:
    got = shot(look=TEXTURED)
    c = calibration_of(SENSOR, STEREO)
    truth = c.focal_px * c.baseline_m / got.depth_m
    found = match(got.left, got.right, MatchSettings(max_disparity_px=80))
    both = np.isfinite(found.disparity_px) & np.isfinite(got.depth_m)
    assert both.sum() / (np.isfinite(got.depth_m) & (truth > 1)).sum() > 0.8
    error = (found.disparity_px - truth)[both]
    assert (np.abs(error) > 2).mean() < 0.01
    assert abs(np.median(error)) < 0.06
    assert np.quantile(np.abs(error / found.sigma_px[both]), 0.68) < 1.2


def test_ground_without_texture_gives_no_points_and_says_why() -> None:
    poor = Look(0.0, math.radians(90), math.radians(-25))
    got = shot(look=poor)
    seen = see(got.left, got.right, poor, sensor=SENSOR, stereo=STEREO, mates={})
    assert seen.matched.density < 0.3
    assert any("little texture" in ill for ill in seen.exposure.ill)


def test_a_night_is_told_as_too_dark() -> None:
    night = stage(sun=0.0, sky=0.001)
    got = shot(on=night, look=TEXTURED)
    seen = see(got.left, got.right, TEXTURED, sensor=SENSOR, stereo=STEREO, mates={})
    assert seen.exposure.points_m.shape[0] < 50
    assert any("too dark" in ill for ill in seen.exposure.ill)


def test_points_lie_on_the_ground_as_surely_as_they_say() -> None:
    got = shot(look=TEXTURED)
    seen = see(got.left, got.right, TEXTURED, sensor=SENSOR, stereo=STEREO, mates={})
    points = seen.exposure.points_m
    assert points.shape[0] > 1000
    eye = left_eye_m(SENSOR, STEREO, TEXTURED.pan_rad)
    ray = points - eye
    along = np.linalg.norm(ray, axis=1)
    assert along.max() <= SENSOR.range_m
    # How far along its ray each point is from the level ground.
    error = along + eye[2] / (ray[:, 2] / along)
    assert np.quantile(np.abs(error) / seen.exposure.sigma_m, 0.68) < 1.3
    assert np.quantile(np.abs(error) / seen.exposure.sigma_m, 0.68) > 0.3


@pytest.mark.parametrize(
    ("forward_m", "left_m", "turn_rad"), [(4.0, 0.4, 0.5), (6.0, -1.0, 2.4), (9.0, 0.5, -2.0)]
)
def test_a_team_mate_is_found_where_it_is(forward_m: float, left_m: float, turn_rad: float) -> None:
    got = shot({"bravo": mate_at(forward_m, left_m, turn_rad)}, stereo=FULL)
    seen = see(got.left, got.right, AHEAD, sensor=SENSOR, stereo=FULL, mates={1: "bravo"})
    (sighting,) = seen.exposure.sightings
    assert sighting.name == "bravo"
    error = np.array(
        [
            *(np.array(sighting.offset_m) - [forward_m, left_m, 0.0]),
            wrap_angle(sighting.bearing_rad - turn_rad),
        ]
    )
    assert np.linalg.norm(error[:3]) < 0.02 * forward_m
    assert abs(error[3]) < math.radians(3)
    assert error @ np.linalg.solve(sighting.covariance, error) < 25
    assert np.linalg.eigvalsh(sighting.covariance).min() > 0
    aside = np.hypot(
        seen.exposure.points_m[:, 0] - forward_m, seen.exposure.points_m[:, 1] - left_m
    )
    assert aside.min() > 0.4, "the team-mate itself is no ground"


@pytest.mark.parametrize(("forward_m", "turn_rad"), [(2.2, 0.3), (3.0, -2.0)])
def test_who_hangs_below_is_found_by_its_lid(forward_m: float, turn_rad: float) -> None:
    """All but its lid is hidden, as by the slope that it hangs in."""
    sunk = replace(mate_at(forward_m, 0.2, turn_rad), z_m=-0.45)
    look = Look(0.0, 0.0, math.radians(-30))
    lidded = make_stage(flat(), {"alfa": 1.6, "bravo": 0.0}, salt=3)
    got = shot({"bravo": sunk}, look=look, stereo=FULL, on=lidded)
    seen = see(got.left, got.right, look, sensor=SENSOR, stereo=FULL, mates={1: "bravo"})
    (sighting,) = seen.exposure.sightings
    error = np.array(sighting.offset_m) - [forward_m, 0.2, -0.45]
    assert np.linalg.norm(error) < 0.02 * forward_m
    assert abs(wrap_angle(sighting.bearing_rad - turn_rad)) < math.radians(3)


def test_corners_of_a_painted_tag_are_where_geometry_says() -> None:
    mate = mate_at(4.0, 0.0, 0.5)
    got = shot({"bravo": mate}, stereo=FULL)
    c = calibration_of(SENSOR, FULL)
    turn = level_from_camera(AHEAD.pan_rad, AHEAD.tilt_rad)
    found = corners(got.left)
    assert found
    for tag, quad in found.items():
        panel = next(panel for panel in panels(1) if panel.tag == tag)
        corners_m = Pose(4.0, 0.0, 0.0, 0.5).team_from_robot(panel.corners_m(TAG_M))
        want = c.pixels((corners_m - left_eye_m(SENSOR, FULL, 0.0)) @ turn)
        assert np.abs(quad - want).max() < 0.35


def test_a_stranger_is_no_team_mate() -> None:
    got = shot({"bravo": mate_at(4.0, 0.0, 0.5)}, stereo=FULL)
    seen = see(got.left, got.right, AHEAD, sensor=SENSOR, stereo=FULL, mates={2: "delta"})
    assert seen.exposure.sightings == ()


def test_a_team_mate_throws_a_shadow_and_hides_ground() -> None:
    alone, together = shot(), shot({"bravo": mate_at(4.0, 0.0, 0.5)})
    nearer = together.depth_m < alone.depth_m - 0.05
    farther = together.depth_m > alone.depth_m + 0.05
    assert nearer.mean() > 0.01
    assert not farther.any()
    same = ~nearer & np.isfinite(alone.depth_m)
    light = together.left[same].astype(float) / together.exposure
    darker = light < 0.5 * alone.left[same] / alone.exposure
    assert darker.mean() > 0.002


def test_the_sun_from_below_lights_nothing_and_level_ground_takes_its_sine() -> None:
    lens = LensSettings(blur_px=0.0, read_noise=0.0, full_well=1e6, longest_exposure=1e6)
    high, low = (
        make_stage(
            flat(),
            MASTS_M,
            salt=3,
            light=LightSettings(sun_elevation_deg=angle, sky=0.0),
            lens=lens,
        )
        for angle in (90.0, 30.0)
    )
    one, other = shot(on=high), shot(on=low)
    assert one.exposure / other.exposure == pytest.approx(0.5, rel=0.02)


def test_noise_of_the_pattern_is_as_stated() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-50, 50, (20_000, 3))
    one = np.array([value_noise(*p, 9) for p in points])
    assert one.std() == pytest.approx(LATTICE_SIGMA, rel=0.1)
    fine, whole = np.full(20_000, 1e-4), np.ones(20_000)
    albedo = pattern(points, fine, whole, 9)
    assert albedo.mean() == pytest.approx(1.0, abs=0.02)
    assert albedo.std() == pytest.approx(CONTRAST, rel=0.15)
    assert np.ptp(pattern(points, fine, 0 * whole, 9)) == 0
    assert np.ptp(pattern(points, fine + 10, whole, 9)) == 0


def test_tags_are_painted_with_a_white_border() -> None:
    cells = tag_cells(7)
    assert cells.shape == (10, 10)
    assert (cells[0] == cells.max()).all()
    assert (cells[1, 1:-1] == cells.min()).all()
    assert not np.array_equal(cells, tag_cells(8))


def test_robots_stand_where_they_are_placed() -> None:
    terrain = flat()
    pose = Pose(3.0, 4.0, 0.5, math.pi / 2)
    mesh = placed(robot_mesh(0, 1.6), pose, origin_of(terrain))
    world = mesh.vertices_m + origin_of(terrain)
    assert world[:, 2].min() == pytest.approx(0.5)
    assert world[:, 2].max() == pytest.approx(2.1)
    assert np.allclose((world[:, :2].min(axis=0) + world[:, :2].max(axis=0)) / 2, [3, 4])
    ahead = next(k for k in range(len(mesh.tag)) if mesh.tag[k] == 0)
    assert np.allclose(mesh.panel[ahead, :3] + origin_of(terrain), [3.0, 4.282, 0.8])


def test_the_lander_is_seen_from_any_side() -> None:
    made = make_stage(flat(), MASTS_M, salt=3, landmark=Pose(11.0, 10.0, 0.0, 0.3))
    bare = shot()
    assert (shot(on=made).depth_m < bare.depth_m - 0.2).mean() > 0.01
    size = np.ptp(lander_mesh().vertices_m, axis=0)
    assert (size > 1).all()
    assert (size < 5).all()


def test_the_camera_stands_in_for_the_range_camera() -> None:
    kept: list[object] = []
    camera = StereoCamera(
        "alfa",
        stage(),
        SENSOR.model_copy(update={"stereo": STEREO}),
        lambda: HERE,
        lambda _t_ns: {"bravo": mate_at(4.0, -0.5, 0.3)},
        np.random.default_rng(2),
        kept=lambda a, b: kept.append((a, b)),
    )
    exposure = run(camera.look(0.0, math.radians(-20)))
    assert exposure.t_s == SENSOR.look_s
    assert exposure.points_m.shape[0] == exposure.sigma_m.shape[0] > 500
    assert np.abs(np.median(exposure.points_m[:, 2])) < 0.03
    assert len(kept) == 1


def test_a_levelling_error_tilts_the_whole_look() -> None:
    wrong = SENSOR.model_copy(update={"attitude_sigma_deg": 2.0})
    rng = np.random.default_rng(3)
    got = take(stage(), wrong, STEREO, HERE, TEXTURED, others={}, rng=rng)
    level = shot(look=TEXTURED)
    row, col = 200, 160
    assert abs(got.depth_m[row, col] - level.depth_m[row, col]) > 0.01


def replace_sensor(**changes: float):
    return SENSOR.model_copy(update=changes)


def test_vergence_shifts_all_disparities() -> None:
    pair = [
        take(
            stage(),
            SENSOR,
            STEREO,
            HERE,
            TEXTURED,
            others={},
            rng=np.random.default_rng(0),
            vergence_px=(shift, 0.0),
        )
        for shift in (0.0, 1.0)
    ]
    found = [match(p.left, p.right, MatchSettings(max_disparity_px=80)).disparity_px for p in pair]
    assert np.nanmedian(found[1] - found[0]) == pytest.approx(-1.0, abs=0.1)


@pytest.mark.slow
def test_two_pairs_are_rendered_in_a_second_of_one_core() -> None:
    shot(stereo=FULL)
    start = time.process_time()
    for seed in range(3):
        shot({"bravo": mate_at(4.0, 0.0, 0.5)}, stereo=FULL, seed=seed)
    assert (time.process_time() - start) / 3 < 0.5
