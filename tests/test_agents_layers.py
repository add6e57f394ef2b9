"""A robot's own layer: anchors as they travel, looks binned, information added up."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.fusion import Gaussian, merge
from agents.geometry import Floats, GridFrame, Pose
from agents.layers import (
    LEAST_VARIANCE,
    Anchor,
    OwnLayer,
    drawn_at,
    rounded_pose,
    rounded_variance,
    variance_of_step,
    variance_step,
)
from agents.maps.elevation import Submap, cell_variance, slope_of
from agents.maps.elevationlook import LookCells, bin_look
from agents.ports import Exposure

quick = settings(max_examples=60, deadline=None)
FRAME = GridFrame(-2.0, 1.0, 0.5, 12, 16)
NOWHERE = (0.0, 0.0, 0.0, 0.0)
angles = st.floats(-math.pi, math.pi)
lengths = st.floats(-1000, 1000)
poses = st.builds(Pose, lengths, lengths, lengths, angles)
near = st.floats(-5, 5)


# --- what travels of an anchor --------------------------------------------------------------


@given(poses)
@quick
def test_rounding_a_pose_twice_is_rounding_it_once(pose: Pose) -> None:
    once = rounded_pose(pose)
    assert repr(rounded_pose(once)) == repr(once)
    assert abs(once.x_m - pose.x_m) <= 0.0005 + 1e-9
    assert abs(once.z_m - pose.z_m) <= 0.0005 + 1e-9
    assert abs(once.yaw_rad - pose.yaw_rad) <= 0.00005 + 1e-12


@given(st.floats(0, 1e9))
@settings(max_examples=200, deadline=None)
def test_a_variance_is_never_rounded_down_and_at_most_a_quarter_octave_up(variance: float) -> None:
    travels = variance_of_step(variance_step(variance))
    assert travels >= variance
    assert travels <= max(variance, LEAST_VARIANCE) * 2**0.25 * (1 + 1e-12)


def test_a_variance_that_travels_stays_as_it_is_and_a_bit_more_goes_up() -> None:
    for step in range(255):
        assert variance_step(variance_of_step(step)) == step
        assert variance_step(math.nextafter(variance_of_step(step), math.inf)) == step + 1
    assert variance_step(1e30) == 255


@given(poses, st.tuples(*[st.floats(0, 100)] * 4))
@quick
def test_an_origin_knows_its_anchor_no_better_than_it_tells(
    pose: Pose, variance: tuple[float, float, float, float]
) -> None:
    anchor = Anchor.at(pose, variance)
    assert (anchor.version, anchor.is_moved) == (0, False)
    assert Anchor.at(anchor.pose, anchor.variance) == anchor
    assert all(told >= known for told, known in zip(anchor.variance, variance, strict=True))
    moved = anchor.moved_to(replace(pose, x_m=pose.x_m + 1), variance)
    assert (moved.version, moved.is_moved, moved.pose) == (1, True, anchor.pose)
    assert moved.moved_to(anchor.pose, variance).version == 2
    assert not moved.moved_to(anchor.pose, variance).is_moved


def test_the_anchors_covariance_grows_with_slope_and_with_distance() -> None:
    variance = rounded_variance((0.04, 0.02, 0.01, 0.001))
    anchor = Anchor.at(Pose(0.25, 2.25, 0.0, 0.0), variance)  # the centre of cell (2, 4)
    slope = np.full(FRAME.shape, 0.5)
    added = cell_variance(anchor, FRAME, slope)
    var_x, var_y, var_z, var_yaw = anchor.variance
    assert added[2, 4] == pytest.approx(var_z + 0.25 * (var_x + var_y) / 2)
    # Three cells east and four north: 2.5 m off, and yaw turns it by that lever.
    assert added[6, 7] == pytest.approx(var_z + 0.25 * ((var_x + var_y) / 2 + 2.5**2 * var_yaw))
    flat = cell_variance(anchor, FRAME, np.zeros(FRAME.shape))
    assert np.allclose(flat, var_z), "level ground is as high wherever the map lies"


@given(poses, poses, st.lists(st.tuples(near, near), min_size=1, max_size=5))
@quick
def test_drawn_at_takes_the_correction_back(
    drawn: Pose, corrected: Pose, offsets: list[tuple[float, float]]
) -> None:
    anchor = Anchor.at(drawn, NOWHERE).moved_to(corrected, NOWHERE)
    local = np.array([(x, y, 0.0) for x, y in offsets])
    truly = anchor.corrected.team_from_robot(local)[:, :2]
    assert np.allclose(drawn_at(anchor, truly), anchor.pose.team_from_robot(local)[:, :2])


# --- a look ---------------------------------------------------------------------------------


def binned_slowly(
    exposure: Exposure, pose: Pose, attitude_rad: float, extra: tuple[float, float, float, float]
) -> dict[tuple[int, int], tuple[float, float]]:
    """Bin a look cell by cell, point by point."""
    found: dict[tuple[int, int], list[tuple[Floats, Floats, float]]] = {}
    in_team = pose.team_from_robot(exposure.points_m)
    for local, point, sigma in zip(exposure.points_m, in_team, exposure.sigma_m, strict=True):
        cell = FRAME.cell_of(point[0], point[1])
        if FRAME.holds(*cell):
            found.setdefault(cell, []).append((local, point, sigma))
    result: dict[tuple[int, int], tuple[float, float]] = {}
    for cell, points in found.items():
        weights, heights, reaches = [], [], []
        for local, point, sigma in points:
            sine = min(1.0, abs(local[2]) / (math.dist((0, 0, 0), local) + 1e-9) + 0.1)
            weights.append(1 / max(sigma * sine, 1e-3) ** 2)
            heights.append(point[2])
            reaches.append(math.hypot(local[0], local[1]))
        mean = sum(w * z for w, z in zip(weights, heights, strict=True)) / sum(weights)
        n = len(points)
        spread = max(sum((z - mean) ** 2 for z in heights) / n, (0.3 * FRAME.cell_m) ** 2)
        reach = sum(reaches) / n
        slope2 = min(12 * spread / FRAME.cell_m**2, 9.0)
        shift = (extra[0] + extra[1]) / 2 + reach**2 * extra[3]
        common = (attitude_rad * reach) ** 2 + extra[2] + slope2 * shift
        result[cell] = (mean, 1 / sum(weights) + spread / min(n, 4) + common)
    return result


@given(st.integers(0, 2**32), st.integers(0, 60), poses)
@quick
def test_binning_agrees_with_the_slow_reference(seed: int, count: int, at: Pose) -> None:
    rng = np.random.default_rng(seed)
    pose = Pose(at.x_m / 500, 3 + at.y_m / 500, at.z_m, at.yaw_rad)
    points = rng.normal(size=(count, 3)) * (3.0, 3.0, 0.7)
    exposure = Exposure(0.0, 0.0, 0.0, points, rng.uniform(1e-4, 0.1, count))
    extra = (0.01, 0.02, 0.003, 0.0004)
    cells = bin_look(exposure, pose, FRAME, attitude_sigma_rad=0.01, extra_variance=extra)
    slow = binned_slowly(exposure, pose, 0.01, extra)
    assert list(zip(cells.rows, cells.cols, strict=True)) == sorted(slow)
    expected = np.array([slow[cell] for cell in sorted(slow)]).reshape(-1, 2)
    assert np.allclose(cells.mean_m, expected[:, 0])
    assert np.allclose(cells.variance_m2, expected[:, 1])


def test_a_thousand_points_of_one_look_are_no_surer_than_its_attitude_and_pose() -> None:
    pose = Pose(0.25, 2.25, 0.0, 0.0)
    points = np.tile((2.0, 0.0, -1.0), (100_000, 1))
    exposure = Exposure(0.0, 0.0, 0.0, points, np.full(100_000, 1e-3))
    extra = (0.0, 0.0, 0.02, 0.0)
    one = bin_look(exposure, pose, FRAME, attitude_sigma_rad=0.01, extra_variance=extra)
    assert len(one.rows) == 1
    common = (0.01 * 2.0) ** 2 + 0.02
    # What a camera sees of a cell faces it: the cell's relief counts for at least 0.3 cells, and
    # its points for no more than four independent ones.
    relief = (0.3 * FRAME.cell_m) ** 2 / 4
    assert one.variance_m2[0] == pytest.approx(common + relief, rel=1e-3)


def test_a_look_that_falls_outside_the_grid_gives_nothing() -> None:
    exposure = Exposure(0.0, 0.0, 0.0, np.array([[100.0, 0.0, 0.0]]), np.array([0.01]))
    cells = bin_look(
        exposure, Pose(0, 0, 0, 0), FRAME, attitude_sigma_rad=0.0, extra_variance=NOWHERE
    )
    assert [len(a) for a in (cells.rows, cells.cols, cells.mean_m, cells.variance_m2)] == [0] * 4


# --- adding up ------------------------------------------------------------------------------


def look_at(cells: list[tuple[int, int]], mean_m: float, variance_m2: float) -> LookCells:
    rows, cols = np.array(cells).T
    n = len(cells)
    return LookCells(rows, cols, np.full(n, mean_m), np.full(n, variance_m2))


def empty_submap() -> Submap:
    return Submap(FRAME, Anchor.at(Pose(0, 0, 0, 0), NOWHERE))


measurements = st.lists(st.tuples(st.floats(-10, 10), st.floats(1e-4, 10)), min_size=1, max_size=6)


@given(measurements)
@quick
def test_looks_add_up_as_the_papers_gaussians_multiply(measured: list[tuple[float, float]]) -> None:
    """Eqs. 20 and 21, for one number."""
    submap = empty_submap()
    for mean, variance in measured:
        submap.observe(look_at([(3, 4)], mean, variance))
    product = Gaussian(np.array([measured[0][0]]), np.array([[measured[0][1]]]))
    for mean, variance in measured[1:]:
        product = merge(product, Gaussian(np.array([mean]), np.array([[variance]])))
    elevation, variance = submap.estimate((slice(3, 4), slice(4, 5)))
    assert elevation[0, 0] == pytest.approx(product.mean[0], abs=1e-9)
    assert variance[0, 0] == pytest.approx(product.covariance[0, 0])
    assert submap.looks[3, 4] == len(measured)


def test_what_was_not_measured_is_nan_and_infinitely_unsure() -> None:
    submap = empty_submap()
    submap.observe(look_at([(0, 0), (5, 7)], 2.0, 0.25))
    elevation, variance = submap.estimate((slice(None), slice(None)))
    assert np.array_equal(np.isfinite(elevation), submap.known)
    assert np.array_equal(np.isfinite(variance), submap.known)
    assert np.argwhere(submap.known).tolist() == [[0, 0], [5, 7]]
    assert (elevation[5, 7], variance[5, 7]) == (2.0, 0.25)


def test_taking_cells_over_takes_those_and_no_others() -> None:
    source, target = empty_submap(), empty_submap()
    source.observe(look_at([(0, 0), (1, 1)], 2.0, 0.25))
    cells = np.zeros(FRAME.shape, dtype=bool)
    cells[1, 1] = True
    target.take(source, cells)
    assert np.argwhere(target.known).tolist() == [[1, 1]]
    assert (target.weighted_z[1, 1], target.looks[1, 1]) == (8.0, 1)


def test_a_cell_counts_once_in_each_submap() -> None:
    layer = OwnLayer(FRAME, Submap)
    for _ in range(2):
        submap = layer.begin_submap(Pose(0, 0, 0, 0), np.zeros((4, 4)))
        submap.observe(look_at([(0, 0), (1, 1)], 0.0, 1.0))
        submap.observe(look_at([(0, 0)], 0.0, 1.0))
    assert layer.known_cells() == 4


def test_the_slope_of_a_plane_is_its_gradient_where_it_can_be_told() -> None:
    rows, cols = np.indices((6, 7))
    plane = 0.3 * cols * 0.5 + 0.4 * rows * 0.5
    plane[2, 3] = np.nan
    slope = slope_of(plane, 0.5)
    inner = np.zeros_like(slope, dtype=bool)
    inner[1:-1, 1:-1] = True
    beside = np.zeros_like(inner)
    beside[[1, 3, 2, 2], [3, 3, 2, 4]] = True
    assert np.allclose(slope[inner & ~beside], 0.5)
    assert np.all(slope[beside] == 0.0)
    assert np.all(slope_of(100 * plane, 0.5) <= 3.0)
