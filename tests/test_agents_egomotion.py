"""Eqs. 10-13: motions from tracked points, and covariances that tell the truth about them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from agents.pose import rotations
from agents.pose.egomotion import Tracks, distances, find_motion, point_covariance, refined
from agents.pose.rigidmotion import EgomotionError, Motion, closed_form, least_squares
from agents.pose.runningmotion import RunningMotion, running_motion

seeds = st.integers(0, 2**32 - 1)
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
LATERAL = 0.25


def some_motion(rng, angle_rad=1.0):
    return rotations.from_vector(rng.normal(scale=angle_rad, size=3)), rng.normal(size=3)


def in_view(rng, n):
    """Return points ahead of a camera that looks along x, 0.7 to 1.5 m away."""
    return np.column_stack((rng.uniform(0.7, 1.5, n), rng.uniform(-0.6, 0.6, (n, 2))))


def sigma(points, s=0.002):
    return s * np.linalg.norm(points, axis=1) ** 2


def measured(rng, points, s=0.002):
    """Return points as measured by Eq. 4, and their covariances."""
    noise = point_covariance(points, sigma(points, s), LATERAL)
    drawn = np.linalg.cholesky(noise) @ rng.standard_normal((*points.shape, 1))
    return points + drawn[..., 0], noise


def tracked(rng, n, rotation, translation, s=0.002):
    before = in_view(rng, n)
    after = before @ rotation.T + translation
    (b, b_noise), (a, a_noise) = measured(rng, before, s), measured(rng, after, s)
    return Tracks(b, a, b_noise, a_noise)


SMALL = (rotations.from_vector(np.array([0.02, -0.03, 0.05])), np.array([0.1, -0.05, 0.02]))


def error_of(motion, rotation, translation):
    """Return the error (6,) that the covariance is about."""
    turn = rotations.to_vector(rotation @ motion.rotation.T)
    return np.concatenate((translation - motion.translation_m, turn))


# --- rotations ------------------------------------------------------------------------------------


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_vectors_and_rotations_turn_into_each_other(seed):
    rng = np.random.default_rng(seed)
    vectors = rng.uniform(-1.7, 1.7, size=(4, 2, 3))  # none is longer than pi
    turned = rotations.from_vector(vectors)
    assert turned.shape == (4, 2, 3, 3)
    assert rotations.to_vector(turned) == pytest.approx(vectors, abs=1e-9)
    v, w = vectors[0]
    assert rotations.cross_matrix(v) @ w == pytest.approx(np.cross(v, w))


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_the_nearest_rotation_is_proper_and_no_other_is_nearer(seed):
    rng = np.random.default_rng(seed)
    matrices = rng.normal(size=(5, 3, 3))
    found = rotations.nearest(matrices)
    assert np.linalg.det(found) == pytest.approx(np.ones(5))
    assert found @ np.swapaxes(found, 1, 2) == pytest.approx(np.broadcast_to(np.eye(3), (5, 3, 3)))
    others = rotations.from_vector(rng.normal(size=(200, 3)))
    least = np.linalg.norm(others[:, None] - matrices[None], axis=(2, 3)).min(axis=0)
    assert (np.linalg.norm(found - matrices, axis=(1, 2)) <= least + 1e-9).all()


# --- Eqs. 10 to 12 --------------------------------------------------------------------------------


def test_a_quarter_turn_by_hand():
    before = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]])
    after = np.array([[5.0, 7.0, 7.0], [4.0, 6.0, 7.0], [5.0, 6.0, 8.0], [4.0, 7.0, 8.0]])
    for fit in (closed_form, least_squares):
        rotation, translation = fit(before, after)
        assert rotation == pytest.approx(QUARTER, abs=1e-12)
        assert translation == pytest.approx([5.0, 6.0, 7.0])


@given(seeds, st.integers(3, 12))
@settings(max_examples=50, deadline=None)
def test_points_without_noise_give_the_motion_exactly(seed, n):
    rng = np.random.default_rng(seed)
    rotation, translation = some_motion(rng)
    before = rng.normal(size=(n, 3))
    after = before @ rotation.T + translation
    fits = [closed_form(before, after, rng.uniform(0.1, 9.0, n))]
    if n > 5:
        fits.append(least_squares(before, after))
    for found in fits:
        assert found[0] == pytest.approx(rotation, abs=1e-6)
        assert found[1] == pytest.approx(translation, abs=1e-6)


@given(seeds, st.integers(4, 9))
@settings(max_examples=30, deadline=None)
def test_the_closed_form_is_what_a_peer_finds_and_no_near_motion_fits_better(seed, n):
    rng = np.random.default_rng(seed)
    before, after, w = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), rng.uniform(0.2, 5.0, n)
    rotation, translation = closed_form(before, after, w)
    middle = [np.average(points, axis=0, weights=w) for points in (before, after)]
    peer, _ = Rotation.align_vectors(after - middle[1], before - middle[0], weights=w)
    assert rotation == pytest.approx(peer.as_matrix(), abs=1e-6)

    def cost(r, x):
        return (w * ((after - before @ r.T - x) ** 2).sum(axis=1)).sum()

    best = cost(rotation, translation)
    for _ in range(10):
        near = rotations.from_vector(rng.normal(scale=0.05, size=3)) @ rotation
        assert cost(near, translation + rng.normal(scale=0.05, size=3)) >= best - 1e-9


def test_the_papers_form_errs_more_than_the_closed_form():
    rng = np.random.default_rng(2)
    errors = []
    for _ in range(300):
        tracks = tracked(rng, 8, *SMALL)
        pair = (tracks.before_m, tracks.after_m)
        fits = (least_squares(*pair), closed_form(*pair))
        errors.append([np.linalg.norm(x - SMALL[1]) for _, x in fits])
    paper, ours = np.sqrt(np.mean(np.square(errors), axis=0))
    assert paper > 1.3 * ours


@pytest.mark.parametrize(
    ("before", "after", "fit", "words"),
    [
        (np.zeros((2, 3)), np.zeros((2, 3)), closed_form, "at least 3 points"),
        (np.zeros((4, 3)), np.zeros((5, 3)), closed_form, r"\(4, 3\) and \(5, 3\)"),
        (np.eye(3), np.full((3, 3), np.nan), closed_form, "finite"),
        (np.outer(np.arange(5.0), [1, 2, 3]), np.zeros((5, 3)), closed_form, "on no line"),
        (np.eye(3), np.eye(3), least_squares, "at least 4 points"),
        (np.eye(4)[:, :3] * [1, 1, 0], np.zeros((4, 3)), least_squares, "in no plane"),
    ],
)
def test_points_that_tell_no_motion_are_refused(before, after, fit, words):
    with pytest.raises(EgomotionError, match=words):
        fit(before, after)


def test_noise_of_another_shape_is_refused():
    with pytest.raises(EgomotionError, match=r"\(3, 3, 3\)"):
        Tracks(np.eye(3), np.eye(3), np.zeros((3, 3, 3)), np.zeros((2, 3, 3)))


# --- covariances ----------------------------------------------------------------------------------


def test_a_points_covariance_is_eq_4_along_its_ray_and_across():
    got = point_covariance(np.array([[0.0, 2.0, 0.0]]), np.array([0.04]), 0.25)[0]
    assert got == pytest.approx(np.diag([0.01**2, 0.04**2, 0.01**2]))


@pytest.mark.parametrize("n", [4, 12])
def test_the_predicted_covariance_is_that_of_the_errors_made(n):
    rng = np.random.default_rng(n)
    runs = 600
    errors, predicted, nees = [], [], []
    before = in_view(rng, n)
    for _ in range(runs):
        b, b_noise = measured(rng, before)
        a, a_noise = measured(rng, before @ SMALL[0].T + SMALL[1])
        motion = refined(Tracks(b, a, b_noise, a_noise), *closed_form(b, a))
        e = error_of(motion, *SMALL)
        errors.append(e)
        predicted.append(motion.covariance)
        nees.append(e @ np.linalg.solve(motion.covariance, e))
    low, high = chi2.ppf((0.005, 0.995), 6 * runs) / runs
    assert low < np.mean(nees) < high
    made, said = np.cov(np.transpose(errors)), np.mean(predicted, axis=0)
    assert np.diag(made) == pytest.approx(np.diag(said), rel=0.25)
    scale = np.sqrt(np.outer(np.diag(said), np.diag(said)))
    assert made / scale == pytest.approx(said / scale, abs=0.2)


def test_covariances_of_points_are_worth_more_than_their_mean_size():
    rng = np.random.default_rng(7)
    errors = []
    for _ in range(200):
        tracks = tracked(rng, 10, *SMALL)
        start = closed_form(tracks.before_m, tracks.after_m)
        best = refined(tracks, *start)
        errors.append([np.linalg.norm(x - SMALL[1]) for x in (start[1], best.translation_m)])
    plain, weighed = np.sqrt(np.mean(np.square(errors), axis=0))
    assert weighed < 0.75 * plain


def spd(rng):
    a = rng.normal(size=(6, 6))
    return a @ a.T


def numeric_covariance(change, motion, covariance):
    """Carry a covariance through `change(R, X) -> (R, X)` by differences."""
    step = 1e-6
    at = change(motion.rotation, motion.translation_m)
    columns = []
    for axis in np.eye(6) * step:
        turned = rotations.from_vector(axis[3:]) @ motion.rotation
        r, x = change(turned, motion.translation_m + axis[:3])
        turn = rotations.to_vector(r @ at[0].T)
        columns.append(np.concatenate((x - at[1], turn)) / step)
    jacobian = np.transpose(columns)
    return jacobian @ covariance @ jacobian.T


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_motions_compose_and_invert_with_their_covariances(seed):
    rng = np.random.default_rng(seed)
    one, two = (Motion(*some_motion(rng), spd(rng)) for _ in range(2))
    points = rng.normal(size=(5, 3))
    assert one.then(two).moved(points) == pytest.approx(two.moved(one.moved(points)))
    assert one.inverse().moved(one.moved(points)) == pytest.approx(points)
    back = numeric_covariance(lambda r, x: (r.T, -r.T @ x), one, one.covariance)
    assert one.inverse().covariance == pytest.approx(back, rel=1e-3, abs=1e-3)
    first = numeric_covariance(
        lambda r, x: (two.rotation @ r, two.rotation @ x + two.translation_m), one, one.covariance
    )
    second = numeric_covariance(
        lambda r, x: (r @ one.rotation, r @ one.translation_m + x), two, two.covariance
    )
    assert one.then(two).covariance == pytest.approx(first + second, rel=1e-3, abs=1e-3)
    assert Motion.none().then(one).covariance == pytest.approx(one.covariance)


# --- RANSAC ---------------------------------------------------------------------------------------


@given(seeds, st.integers(12, 30))
@settings(max_examples=25, deadline=None)
def test_false_points_are_thrown_out_and_true_ones_kept(seed, n):
    rng = np.random.default_rng(seed)
    tracks = tracked(rng, n, *SMALL)
    false = np.zeros(n, dtype=bool)
    false[rng.permutation(n)[: round(0.4 * n)]] = True
    tracks.after_m[false] += rng.choice([-1, 1], (int(false.sum()), 3)) * rng.uniform(0.1, 0.5)
    found = find_motion(tracks, rng)
    assert not found.inliers[false].any()
    assert found.inliers[~false].mean() > 0.7
    e = error_of(found.motion, *SMALL)
    assert e @ np.linalg.solve(found.motion.covariance, e) < 60


def test_without_false_points_one_in_a_thousand_is_thrown_out():
    rng = np.random.default_rng(3)
    kept = [find_motion(tracked(rng, 20, *SMALL), rng).inliers.mean() for _ in range(100)]
    assert np.mean(kept) > 0.997


def test_three_points_are_enough_and_as_many_draws_give_the_same():
    tracks = tracked(np.random.default_rng(1), 3, *SMALL, s=1e-6)
    found = find_motion(tracks, np.random.default_rng(0))
    assert found.motion.translation_m == pytest.approx(SMALL[1], abs=1e-4)
    many = tracked(np.random.default_rng(1), 25, *SMALL)
    a, b = (find_motion(many, np.random.default_rng(5)).motion for _ in range(2))
    assert np.array_equal(a.rotation, b.rotation)
    assert np.array_equal(a.covariance, b.covariance)


def test_points_that_do_not_agree_are_refused():
    rng = np.random.default_rng(4)
    tracks = tracked(rng, 8, *SMALL, s=1e-4)
    tracks.after_m[:] += rng.uniform(-0.4, 0.4, (8, 3))
    with pytest.raises(EgomotionError, match="of 8 tracked points only"):
        find_motion(tracks, rng)


def test_distances_are_chi_squared():
    rng = np.random.default_rng(6)
    d = distances(tracked(rng, 4000, *SMALL), SMALL[0][None], SMALL[1][None])[0]
    assert d.mean() == pytest.approx(3.0, abs=0.15)
    assert (d < chi2.ppf(0.95, 3)).mean() == pytest.approx(0.95, abs=0.012)


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_distances_are_those_of_plain_algebra(seed):
    rng = np.random.default_rng(seed)
    tracks = tracked(rng, 5, *SMALL, s=0.05)
    motions = [some_motion(rng) for _ in range(3)]
    got = distances(tracks, *(np.array(part) for part in zip(*motions, strict=True)))
    for k, (r, x) in enumerate(motions):
        for i in range(5):
            e = tracks.after_m[i] - r @ tracks.before_m[i] - x
            s = tracks.after_noise[i] + r @ tracks.before_noise[i] @ r.T
            assert got[k, i] == pytest.approx(e @ np.linalg.solve(s, e), rel=1e-9)


# --- Eq. 13 ---------------------------------------------------------------------------------------


def test_two_estimates_by_hand():
    running = RunningMotion()
    for side in (-1.0, 1.0):
        running.add(rotations.from_vector(np.array([0.0, 0.0, side])), np.array([side, 0.0, 2.0]))
    assert running.translation_m == pytest.approx([0.0, 0.0, 2.0])
    assert running.rotation == pytest.approx(np.eye(3), abs=1e-12)
    want = np.zeros((6, 6))
    want[np.ix_([0, 5], [0, 5])] = 1.0  # as printed: half of it
    assert running.covariance == pytest.approx(want, abs=1e-12)


@given(seeds, st.integers(1, 12))
@settings(max_examples=40, deadline=None)
def test_the_running_mean_and_covariance_are_those_of_all_estimates_at_once(seed, n):
    rng = np.random.default_rng(seed)
    base = rotations.from_vector(rng.normal(size=3))
    turns, shifts = rng.normal(scale=1e-3, size=(n, 3)), rng.normal(size=(n, 3))
    running = RunningMotion()
    for turn, shift in zip(turns, shifts, strict=True):
        running.add(rotations.from_vector(turn) @ base, shift)
    assert running.count == n
    assert running.translation_m == pytest.approx(shifts.mean(axis=0))
    said = rotations.to_vector(running.rotation @ base.T)
    assert said == pytest.approx(turns.mean(axis=0), abs=1e-5)
    want = np.cov(np.column_stack((shifts, turns)).T, bias=True)
    assert running.covariance == pytest.approx(want, abs=1e-4 * max(1.0, np.abs(want).max()))


def test_far_rotations_are_averaged_on_the_sphere_not_entry_by_entry():
    turns = [math.radians(a) for a in (170.0, -170.0)]
    running = RunningMotion()
    for turn in turns:
        running.add(rotations.from_vector(np.array([0.0, 0.0, turn])), np.zeros(3))
    assert abs(rotations.to_vector(running.rotation)[2]) == pytest.approx(math.pi)
    assert running.covariance[5, 5] == pytest.approx(math.radians(10.0) ** 2)


def test_the_wandering_of_independent_estimates_is_their_error():
    rng = np.random.default_rng(8)
    running, predicted = RunningMotion(), []
    before = in_view(rng, 8)
    for _ in range(400):
        b, b_noise = measured(rng, before)
        a, a_noise = measured(rng, before @ SMALL[0].T + SMALL[1])
        motion = refined(Tracks(b, a, b_noise, a_noise), *closed_form(b, a))
        running.add(motion.rotation, motion.translation_m)
        predicted.append(motion.covariance)
    assert np.diag(running.covariance) == pytest.approx(np.diag(np.mean(predicted, 0)), rel=0.3)
    e = error_of(Motion(running.rotation, running.translation_m, running.covariance), *SMALL)
    assert e @ np.linalg.solve(running.covariance / 400, e) < chi2.ppf(0.999, 6)


def test_over_more_points_the_mean_comes_nearer_and_wanders_less():
    far, wide = {6: [], 40: []}, {6: [], 40: []}
    for seed in range(60):
        tracks = tracked(np.random.default_rng(seed), 40, *SMALL)
        for n, errors in far.items():
            running = running_motion(tracks.before_m[:n], tracks.after_m[:n])
            assert running.count == n - 2
            errors.append(np.linalg.norm(running.translation_m - SMALL[1]))
            wide[n].append(np.trace(running.covariance[:3, :3]))
    assert np.mean(far[40]) < 0.7 * np.mean(far[6])
    assert np.median(wide[40]) < np.median(wide[6])
