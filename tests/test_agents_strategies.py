"""Choosing looks: box sums against direct sums, plans that can be driven, a small mission."""

import math
from dataclasses import replace

import numpy as np
import pytest

from agents.geometry import GridFrame, Pose, wrap_angle
from agents.ground import surface
from agents.planning import looks, strategies
from agents.planning.information import Interest, new_information
from agents.planning.scene import CLAIMED, Scene, View, ViewError
from agents.settings import DriveSettings, PlannerSettings, SensorSettings
from agents.sight import gaze
from agents.sight.gaze import Lens
from comms.plugins import PluginError

SENSOR = SensorSettings(range_m=5.0, height_m=1.4, fov_deg=60.0, fov_vertical_deg=45.0)
PLANNER = PlannerSettings(max_candidates=30, n_max=3, tilts_deg=(-15.0, -38.0))
FRAME = GridFrame(0.0, 0.0, 0.1, 120, 120)


def cliff():
    y, x = np.mgrid[:120, :120] * 0.1
    edge = 5.0 + 0.8 * np.sin(x)
    return np.clip((y - edge) * 2.5, -4.0, 0.0) + 0.03 * np.sin(3 * x) * np.cos(2 * y)


def view_of(elevation, looked=None, *, pose=None, **more):
    looked = (~np.isnan(elevation)).astype(np.int64) if looked is None else looked
    fields = {
        "frame": FRAME,
        "elevation_m": elevation,
        "sigma_m": np.where(np.isnan(elevation), np.nan, 0.01),
        "looks": looked,
        "interest": np.ones(FRAME.shape),
        "pose": pose or Pose(6.0, 8.0, 0.0, -1.5),
        "pose_sigma_m": 0.02,
        "others": [],
        "sensor": SENSOR,
        "drive": DriveSettings(),
        "planner": PLANNER,
        "claims": [],
    }
    return View(**(fields | more))


def partly_known():
    z = cliff()
    y, x = np.mgrid[:120, :120] * 0.1
    return np.where((np.hypot(x - 6, y - 8) < 3) & (z > -2), z, np.nan)


def choose(view, name="information-interest", seed=0):
    return strategies.strategy(name).choose(view, np.random.default_rng(seed))


def test_box_sums_agree_with_summing_each_look_by_itself():
    scene = Scene(view_of(partly_known()))
    got = looks.look_gains(scene)
    view, lens = scene.view, Lens.of(SENSOR)
    north, east = surface.gradient(surface.smoothed(scene.ground_m), 0.1)
    ground = gaze.Ground(scene.obstacles_m, north, east, scene.worth, 0.1, 0.1)
    for n in (0, len(got.cells) // 2):
        cell = tuple(int(i) for i in got.cells[n])
        eye = looks.eye_at(scene, cell)
        patch = looks.visibility.predict(
            scene.obstacles_m, scene.sigma_m, FRAME, eye, range_m=5.0, near_m=SENSOR.near_m
        )
        chance = gaze.measured_chance(patch, ground, lens)
        h, w = chance.shape
        cut = (slice(patch.row0, patch.row0 + h), slice(patch.col0, patch.col0 + w))
        bits = new_information(view.looks[cut], PLANNER.n_max, chance)
        for k, heading in enumerate(got.headings_rad):
            for t, tilt in enumerate(got.tilts_rad):
                direct = bits[gaze.in_view(patch, heading, tilt, lens)].sum()
                assert got.bits[n, k, t] == pytest.approx(direct, rel=0.08, abs=15)


def test_rating_on_the_coarser_grid_finds_about_the_same_gains(monkeypatch):
    scene = Scene(view_of(partly_known()))
    fine = looks.look_gains(scene)
    monkeypatch.setattr(looks, "FINE_RANGE_CELLS", 10)
    coarse = looks.look_gains(scene)
    assert np.corrcoef(fine.bits.ravel(), coarse.bits.ravel())[0, 1] > 0.97
    assert coarse.bits.sum() == pytest.approx(fine.bits.sum(), rel=0.15)


def test_the_chance_of_a_ray_by_hand():
    side, distance, flat, ray = 0.1, 5.0, 4.0, 1e-4
    n = side**2 * 0.6 / (flat * distance * ray)
    assert gaze.hit_chance(0.6, distance, flat, side, ray) == pytest.approx(1 - math.exp(-n))
    assert gaze.hit_chance(0.02, distance, flat, side, ray) == 0


def test_the_first_look_works_with_nothing_known():
    plan = choose(view_of(np.full(FRAME.shape, np.nan)))
    assert plan is not None
    assert plan.path_m.shape == (1, 2)
    assert plan.target_m == (6.0, 8.0)
    assert plan.tilt_rad == pytest.approx(math.radians(-38))
    assert plan.expected_cells > 300


def test_a_finished_map_is_worth_no_look():
    assert choose(view_of(cliff(), np.full(FRAME.shape, 3))) is None


@pytest.mark.parametrize("name", strategies.STRATEGIES.own)
def test_a_plan_is_drivable_and_points_where_it_says(name):
    view = view_of(partly_known(), others=[Pose(7.5, 9.0, 0.0, 0.0)])
    plan = choose(view, name)
    assert plan is not None
    scene = Scene(view)
    assert plan.path_m[0] == pytest.approx((6.0, 8.0))
    assert tuple(plan.path_m[-1]) == pytest.approx(plan.target_m)
    for a, b in zip(plan.path_m[:-1], plan.path_m[1:], strict=True):
        for t in np.linspace(0.05, 1, 20):
            x, y = a + t * (b - a)
            assert np.isfinite(scene.cost[FRAME.cell_of(x, y)])
            assert math.hypot(x - 7.5, y - 9.0) > 0.8
    if len(plan.path_m) > 1:
        leg = plan.path_m[-1] - plan.path_m[-2]
        yaw = math.atan2(leg[1], leg[0])
    else:
        yaw = view.pose.yaw_rad
    assert wrap_angle(plan.pan_rad + yaw - plan.heading_rad) == pytest.approx(0, abs=1e-9)


def test_candidates_stand_inside_the_polygon_and_not_on_the_face():
    scene = Scene(view_of(partly_known()))
    z = cliff()
    assert len(scene.candidates) > 5
    assert len(scene.candidates) <= PLANNER.max_candidates
    assert (z[tuple(scene.candidates.T)] > -0.2).all()
    assert tuple(scene.candidates[0]) == scene.cell


@pytest.mark.parametrize("name", ["information-interest", "team-information"])
def test_choosing_is_deterministic_wherever_its_arrays_lie_in_memory(name):
    between, seen = [], []
    for size in (1, 3, 9, 501, 1203, 2717, 3333, 4801):
        between.append(np.zeros(size))
        plan = choose(view_of(partly_known()), name)
        assert plan is not None
        between.append(plan)
        seen.append((plan.path_m.tobytes(), replace(plan, path_m=np.zeros(0)).__repr__()))
    assert len(set(seen)) == 1


def test_lost_interest_and_claims_discount_what_would_be_seen():
    view = view_of(partly_known())
    free = looks.look_gains(Scene(view)).bits
    dull = looks.look_gains(Scene(replace(view, interest=np.full(FRAME.shape, 0.5)))).bits
    assert dull == pytest.approx(0.5 * free)
    claimed = looks.look_gains(Scene(replace(view, claims=[(6.0, 8.0, 50.0)]))).bits
    assert claimed == pytest.approx(CLAIMED * free)
    dull_view = replace(view, interest=np.full(FRAME.shape, 1e-3))
    assert choose(dull_view) is None
    assert choose(dull_view, "information-edge") is not None


def test_a_team_mate_hides_ground_and_is_no_ground():
    mate = Pose(6.0, 6.8, 0.0, 0.0)
    known = np.where(np.isnan(partly_known()), np.nan, 0.0)
    alone = strategies.expected_visibility(
        view_of(known), Pose(6.0, 8.0, 0.0, -math.pi / 2), 0, -0.5
    )
    view = view_of(known, others=[mate])
    both = strategies.expected_visibility(view, Pose(6.0, 8.0, 0.0, -math.pi / 2), 0, -0.5)
    assert alone[68, 60] > 0.9
    assert both[68, 60] == 0
    assert both[62, 60] < 0.1 < alone[62, 60]


def test_expected_visibility_stays_in_the_field_of_view_and_range():
    view = view_of(np.zeros(FRAME.shape))
    seen = strategies.expected_visibility(view, Pose(6.05, 6.05, 0.0, 0.0), math.pi / 2, -0.3)
    rows, cols = np.nonzero(seen)
    dy, dx = (rows - 60) * 0.1, (cols - 60) * 0.1
    assert seen.dtype == np.float32
    assert np.abs(np.degrees(np.arctan2(dx, dy))).max() <= 30.01
    assert np.sqrt(dx**2 + dy**2 + 1.4**2).max() <= 5.0
    assert seen.max() <= 1


def test_an_unknown_strategy_and_a_bad_view_are_named():
    with pytest.raises(PluginError, match=r'"best".*information-interest'):
        strategies.strategy("best")
    with pytest.raises(ViewError, match="outside the map"):
        Scene(view_of(partly_known(), pose=Pose(-3.0, 0.0, 0.0, 0.0)))
    with pytest.raises(ViewError, match="looks has shape"):
        Scene(view_of(partly_known(), np.zeros((3, 3), dtype=np.int64)))


def reveal(truth, view, pose, heading, tilt, rng):
    """Crudely: a cell is measured as often as sharp geometry on the true ground says."""
    exact = replace(view, elevation_m=truth, sigma_m=np.full(truth.shape, 1e-3))
    p = strategies.expected_visibility(exact, pose, heading - pose.yaw_rad, tilt)
    return rng.random(truth.shape) < p


def mission(name, count):
    truth, rng = cliff(), np.random.default_rng(0)
    seen = np.zeros(FRAME.shape, dtype=np.int64)
    interest = Interest(FRAME.shape, PLANNER.beta)
    method, pose, totals = strategies.strategy(name), Pose(6.0, 8.0, 0.0, 0.0), []
    for _ in range(count):
        known = np.where(seen > 0, truth + rng.normal(scale=0.01, size=truth.shape), np.nan)
        view = view_of(known, seen, pose=pose, interest=interest.share)
        plan = method.choose(view, rng)
        if plan is None:
            break
        row, col = FRAME.cell_of(*plan.target_m)
        pose = Pose(*plan.target_m, float(truth[row, col]), plan.heading_rad)
        assert truth[row, col] > -0.4, "the robot went over the cliff"
        expected = strategies.expected_visibility(view, pose, 0.0, plan.tilt_rad)
        got = reveal(truth, view, pose, plan.heading_rad, plan.tilt_rad, rng)
        interest.update(expected, got)
        seen += got
        totals.append(int((seen > 0).sum()))
    return totals


def test_a_small_mission_maps_the_plateau_without_falling_and_beats_the_raster():
    paper, raster = mission("information-interest", 16), mission("raster", 16)
    assert paper[-1] > 5000
    assert paper[-1] > 1.1 * raster[-1]


def test_the_blind_ring_is_trusted_only_where_the_robot_was_put_down():
    y, x = np.mgrid[:120, :120] * 0.1
    apart = np.hypot(x - 6, y - 8)
    put_down = Scene(view_of(np.where((apart > 0.7) & (apart < 3), 0.0, np.nan)))
    assert put_down.edge.plateau[80, 60:69].all()
    beside_the_lip = np.where(y > 7.4, 0.0, np.nan)
    scene = Scene(view_of(beside_the_lip))
    assert not scene.edge.plateau[y < 7.1].any()
    assert np.isinf(scene.cost[y < 7.7]).all()


def test_a_robot_outside_the_inset_polygon_may_only_go_inward():
    y, _ = np.mgrid[:120, :120] * 0.1
    scene = Scene(view_of(np.where(y > 7.7, 0.0, np.nan)))
    assert 1 < scene.cost[scene.cell] < np.inf
    assert np.isinf(scene.cost[y < 7.85]).all()
    assert len(scene.candidates) > 5


def test_ground_on_which_the_wheels_came_to_a_halt_is_gone_round_but_the_way_back_is_free():
    view = view_of(np.zeros(FRAME.shape))
    barred = ((6.0, 7.5, 0.4),)
    scene = Scene(replace(view, barred=barred))
    assert np.isinf(scene.cost[75, 60])
    assert np.isfinite(scene.travel[0][60, 60])
    assert scene.travel[0][60, 60] > Scene(view).travel[0][60, 60]
    trail = np.array([(6.0, 7.0), (6.0, 8.0)])
    back = Scene(replace(view, barred=((6.0, 7.7, 0.4),), trail_m=trail))
    assert np.isfinite(back.cost[72:80, 60]).all()
    assert np.isinf(back.cost[75:79, 63]).all()
    unseen = np.where(np.hypot(*(np.mgrid[:120, :120] - 80)) < 8, np.nan, 0.0)
    came_m = np.array([(8.0, 7.0), (8.0, 8.0)])
    came = Scene(replace(view_of(unseen, pose=Pose(8.0, 6.5, 0.0, 0.0)), trail_m=came_m))
    assert np.isfinite(came.cost[72:80, 78:83]).all(), "its circle has covered that"


def test_two_robots_that_stand_beside_each_other_can_part():
    ground = np.zeros(FRAME.shape)
    mate = Pose(6.7, 8.0, 0.0, 0.0)
    scene = Scene(view_of(ground, others=[mate]))
    reached = np.isfinite(scene.travel[0])
    assert reached.mean() > 0.7
    rows, cols = np.nonzero(reached)
    x_m, y_m = (cols + 0.5) * FRAME.cell_m + FRAME.x_m, (rows + 0.5) * FRAME.cell_m + FRAME.y_m
    assert np.hypot(x_m - mate.x_m, y_m - mate.y_m).min() > 0.7 - FRAME.cell_m
