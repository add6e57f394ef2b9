"""Eq. 5: the kernels against slow references of the same definitions, and against frequencies."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from agents.geometry import GridFrame
from agents.sight import crests
from agents.sight import visibility as vis


def steps_out(z, frame, eye, range_m, near_m):
    """Yield every target in range with the points before it on its bearing: (slope, height) lists.

    Each point is (run in metres, row, col); points off the map end the list.
    """
    cell = frame.cell_m
    row, col = (eye[1] - frame.y_m) / cell - 0.5, (eye[0] - frame.x_m) / cell - 0.5
    bearings, _ = vis.fan_size(range_m, cell)
    for i, j in np.ndindex(z.shape):
        dy, dx = i - row, j - col
        flat = math.hypot(dy, dx)
        distance = math.hypot(flat * cell, z[i, j] - eye[2])
        if distance > range_m or distance < near_m:
            continue
        turn = math.floor(math.atan2(dy, dx) * bearings / (2 * math.pi) + 0.5)
        angle = 2 * math.pi * (turn % bearings) / bearings
        points = []
        for k in range(math.floor(flat + 0.5) - 1 if flat >= 1 else 0):
            a = math.floor(row + 0.5 + (k + 1) * math.sin(angle))
            b = math.floor(col + 0.5 + (k + 1) * math.cos(angle))
            if not (0 <= a < z.shape[0] and 0 <= b < z.shape[1]):
                break
            points.append(((k + 1) * cell, a, b))
        yield i, j, flat, points


def slow_product(z, sigma, frame, eye, range_m, near_m):
    """Sujan & Meggiolaro, Eq. 5, every factor."""
    out = np.zeros(z.shape)
    for i, j, flat, points in steps_out(z, frame, eye, range_m, near_m):
        out[i, j] = 1.0
        for run, a, b in points:
            ray_m = eye[2] + (z[i, j] - eye[2]) * run / (flat * frame.cell_m)
            out[i, j] *= ndtr((ray_m - z[a, b]) / max(sigma[a, b], crests.LEAST_SIGMA_M))
    return out


def slow_crest(z, sigma, frame, eye, range_m, near_m):
    """The definition of `agents.sight.crests`, target by target."""
    out, cell = np.zeros(z.shape), frame.cell_m
    shared = crests.shared_points(cell)
    for i, j, flat, points in steps_out(z, frame, eye, range_m, near_m):
        if flat < 1:
            out[i, j] = 1.0
            continue
        target = (z[i, j] - eye[2] + crests.LIFT_CELLS * cell) / (flat * cell)
        seen = [
            ((z[a, b] - eye[2]) / run, max(sigma[a, b], crests.LEAST_SIGMA_M) / run)
            for run, a, b in points
        ]
        first_near = max(0, math.floor(flat + 0.5) - 1 - shared)
        if any(s - crests.RISE_SIGMAS * w > target for s, w in seen[first_near:]):
            continue
        far = seen[:first_near]
        out[i, j] = 1.0
        if far:
            doubtful = max(far, key=lambda crest: crest[0] + crests.DOUBT * crest[1])
            for s, w in (max(far), doubtful):
                chance = ndtr((target - s) / math.hypot(w, sigma[i, j] / (flat * cell)))
                out[i, j] = min(out[i, j], chance)
    return out


def whole(patch, shape):
    out = np.zeros(shape)
    h, w = patch.p.shape
    out[patch.row0 : patch.row0 + h, patch.col0 : patch.col0 + w] = patch.p
    return out


@st.composite
def views(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = (draw(st.integers(3, 26)), draw(st.integers(3, 26)))
    frame = GridFrame(-2.0, 5.0, draw(st.sampled_from([0.1, 0.2, 0.5])), *shape)
    z = rng.normal(scale=draw(st.sampled_from([0.05, 0.5])), size=shape)
    sigma = rng.uniform(0.0, draw(st.sampled_from([0.02, 0.5])), shape)
    west, east, south, north = frame.extent_m
    x, y = rng.uniform(west, east), rng.uniform(south, north)
    row, col = frame.cell_of(x, y)
    eye = (x, y, z[row, col] + rng.uniform(0.3, 2))
    return z, sigma, frame, eye, rng.uniform(0.5, 4.0)


@pytest.mark.parametrize(("law", "slow"), [("crest", slow_crest), ("product", slow_product)])
@given(case=views())
@settings(max_examples=30, deadline=None)
def test_the_kernel_agrees_with_every_factor_of_every_ray(law, slow, case):
    z, sigma, frame, eye, range_m = case
    patch = vis.predict(z, sigma, frame, eye, range_m=range_m, near_m=0.4, law=law)
    want = slow(z, sigma, frame, eye, range_m, 0.4)
    assert np.abs(whole(patch, z.shape) - want).max() < 1e-3


@pytest.mark.parametrize("law", ["crest", "product"])
def test_rays_of_full_length_over_grazing_ground_are_within_a_thousandth_too(law):
    rng = np.random.default_rng(3)
    frame = GridFrame(0.0, 0.0, 0.1, 9, 170)
    z = rng.normal(scale=0.03, size=frame.shape)
    sigma = np.full(frame.shape, 0.05)
    case = (frame, (1.0, 0.5, 1.2), 15.0, 0.4)
    patch = vis.predict(z, sigma, *case[:2], range_m=15.0, near_m=0.4, law=law)
    want = {"crest": slow_crest, "product": slow_product}[law](z, sigma, *case)
    assert 0.05 < want.mean() < 0.95
    assert np.abs(whole(patch, z.shape) - want).max() < 1e-3


def test_the_table_of_phi_is_exact_to_seven_digits():
    z = np.linspace(-5, 5, 20011)
    assert np.abs([crests.table_phi(x) for x in z] - ndtr(z)).max() < 1.3e-7


def least_chances(z, sigma, frame, eye, range_m, near_m):
    """As `slow_crest`, with every cell for a crest."""
    out, cell = slow_crest(z, sigma, frame, eye, range_m, near_m), frame.cell_m
    shared = crests.shared_points(cell)
    for i, j, flat, points in steps_out(z, frame, eye, range_m, near_m):
        target = (z[i, j] - eye[2] + crests.LIFT_CELLS * cell) / max(flat * cell, 1e-9)
        for run, a, b in points[: max(0, math.floor(flat + 0.5) - 1 - shared)]:
            slope, spread = (z[a, b] - eye[2]) / run, max(sigma[a, b], crests.LEAST_SIGMA_M) / run
            chance = ndtr((target - slope) / math.hypot(spread, sigma[i, j] / (flat * cell)))
            out[i, j] = min(out[i, j], chance)
    return out


@given(case=views())
@settings(max_examples=20, deadline=None)
def test_two_crests_stand_for_all_obstructions(case):
    patch = vis.predict(*case[:4], range_m=case[4], near_m=0.4)
    got, least = whole(patch, case[0].shape), least_chances(*case, 0.4)
    assert (got >= least - 1e-3).all()
    assert (got - least).mean() < 0.03


def flat_world(n=61, cell=0.2):
    return GridFrame(0.0, 0.0, cell, n, n), np.zeros((n, n))


def test_flat_certain_ground_is_all_visible_within_range():
    frame, z = flat_world()
    patch = vis.predict(z, z + 0.001, frame, (6.1, 6.1, 1.4), range_m=5.0, near_m=1.5)
    far = patch.range_m > 5.0
    assert (patch.p[far] == 0).all()
    assert (patch.p[patch.range_m < 1.5] == 0).all()
    between = (patch.range_m <= 5.0) & (patch.range_m >= 1.5)
    assert (patch.p[between] > 0.999).all()


def test_a_wall_hides_what_is_behind_it_and_not_itself():
    frame, z = flat_world()
    z[:, 40] = 3.0
    patch = vis.predict(z, z * 0 + 0.001, frame, (6.1, 6.1, 1.4), range_m=6.0, near_m=0.0)
    seen = whole(patch, z.shape)
    assert seen[30, 40] > 0.99
    assert (seen[:, 42:] == 0).all()
    assert seen[30, 39] > 0.99


@pytest.mark.parametrize(("law", "lift_m"), [("crest", 0.25 * 2 / 6), ("product", 0.0)])
def test_the_chance_behind_an_unsure_crest_is_phi_of_the_clearance(law, lift_m):
    """Eye 1 m up, crest of 0.5 +- 0.2 m at 2 m, target on the ground at 6 m: ray at 2/3 m."""
    frame = GridFrame(0.0, 0.0, 0.5, 1, 20)
    z, sigma = np.zeros((1, 20)), np.full((1, 20), 1e-4)
    z[0, 4], sigma[0, 4] = 0.5, 0.2
    eye = (0.25, 0.25, 1.0)
    patch = vis.predict(z, sigma, frame, eye, range_m=9.0, near_m=0.0, law=law)
    assert patch.p[0, 12] == pytest.approx(ndtr((2 / 3 + lift_m - 0.5) / 0.2), abs=1e-3)


def test_grazing_ground_hides_by_the_product_and_not_by_the_crest():
    """Level ground of 3 cm noise seen 15 m off: each cell before the target counts about 0.5."""
    frame = GridFrame(0.0, 0.0, 0.1, 41, 200)
    z, sigma = np.zeros(frame.shape), np.full(frame.shape, 0.1)
    eye = (1.0, 2.0, 1.2)
    far = {
        law: float(whole(patch, z.shape)[20, 140:150].mean())
        for law in ("crest", "product")
        for patch in [vis.predict(z, sigma, frame, eye, range_m=15.0, near_m=0.4, law=law)]
    }
    assert far["product"] < 0.1
    assert far["crest"] > 0.4


def test_angles_and_ranges_are_the_geometry():
    frame, z = flat_world()
    patch = vis.predict(z, z + 0.01, frame, (6.1, 6.1, 1.0), range_m=4.0, near_m=0.0)
    row, col = 30 - patch.row0, 35 - patch.col0
    assert patch.azimuth_rad[row, col] == pytest.approx(0, abs=1e-9)
    assert patch.elevation_angle_rad[row, col] == pytest.approx(-math.pi / 4)
    assert patch.range_m[row, col] == pytest.approx(math.sqrt(2))


def test_an_impossible_eye_or_range_is_refused():
    frame, z = flat_world()
    with pytest.raises(vis.VisibilityError, match="outside the map"):
        vis.predict(z, z, frame, (-1.0, 3.0, 1.0), range_m=3.0, near_m=0.0)
    with pytest.raises(vis.VisibilityError, match="more than 0"):
        vis.predict(z, z, frame, (3.0, 3.0, 1.0), range_m=0.0, near_m=0.0)


def fractal(rng, n, rms):
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(n), np.fft.fftfreq(n)))
    f[0, 0] = 1.0
    spectrum = np.fft.fft2(rng.normal(size=(n, n))) * f**-1.8
    spectrum[0, 0] = 0
    z = np.fft.ifft2(spectrum).real
    return z * rms / z.std()


def test_predicted_chances_are_the_frequencies_on_measured_rough_ground():
    """Truth: sharp geometry on the true ground; map: the truth with 2 cm of noise per cell."""
    rng = np.random.default_rng(7)
    frame = GridFrame(0.0, 0.0, 0.2, 100, 100)
    predicted, seen = [], []
    for _ in range(6):
        truth = fractal(rng, 100, 0.6)
        guess = truth + rng.normal(scale=0.02, size=truth.shape)
        eye = (10.1, 10.1, float(truth[50, 50]) + 1.4)
        args = (frame, eye)
        want = vis.predict(truth, np.full(truth.shape, 1e-4), *args, range_m=8.0, near_m=1.0)
        got = vis.predict(guess, np.full(truth.shape, 0.02), *args, range_m=8.0, near_m=1.0)
        inside = (want.range_m < 7.8) & (want.range_m > 1.2)
        predicted.append(got.p[inside])
        seen.append(want.p[inside])
    p, truth = np.concatenate(predicted), np.concatenate(seen)
    assert 0.3 < truth.mean() < 0.97
    assert p.mean() == pytest.approx(truth.mean(), abs=0.05)
    assert truth[p > 0.95].mean() > 0.93
    assert truth[p < 0.05].mean() < 0.15
    assert ((p - truth) ** 2).mean() < 0.07
