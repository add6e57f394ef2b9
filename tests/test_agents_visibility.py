"""Eq. 5: the kernel against a slow reference of the same definition, and against frequencies."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from agents import visibility as vis
from agents.geometry import GridFrame


def slow_patch(z, sigma, frame, eye, range_m, near_m):
    """The definition, target by target, without pruning."""
    cell = frame.cell_m
    row, col = (eye[1] - frame.y_m) / cell - 0.5, (eye[0] - frame.x_m) / cell - 0.5
    bearings, _ = vis.fan_size(range_m, cell)
    out = np.zeros(z.shape)
    for i, j in np.ndindex(z.shape):
        dy, dx = i - row, j - col
        flat = math.hypot(dy, dx)
        rise = z[i, j] - eye[2]
        distance = math.hypot(flat * cell, rise)
        if distance > range_m or distance < near_m:
            continue
        if flat < 1:
            out[i, j] = 1.0
            continue
        angle = (
            2 * math.pi * math.floor(math.atan2(dy, dx) * bearings / (2 * math.pi) + 0.5) / bearings
        )
        count = math.floor(flat + 0.5) - 1
        own = max(sigma[i, j], 0) / (flat * cell)
        p, target = 1.0, rise / (flat * cell)
        for k in range(count):
            a = math.floor(row + (k + 1) * math.sin(angle) + 0.5)
            b = math.floor(col + (k + 1) * math.cos(angle) + 0.5)
            if not (0 <= a < z.shape[0] and 0 <= b < z.shape[1]):
                break
            slope = (z[a, b] - eye[2]) / ((k + 1) * cell)
            spread = max(sigma[a, b], vis.LEAST_SIGMA_M) / ((k + 1) * cell)
            if k >= count - vis.shared_points(cell):
                if slope - target > vis.RISE_SIGMAS * spread:
                    p = 0.0
                continue
            rho = math.exp(-(count - k) * cell / vis.CORRELATED_M)
            joint = math.sqrt(spread**2 + own**2 - 2 * rho * spread * own)
            p = min(p, float(ndtr((target - slope) / joint)))
        out[i, j] = p
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


@given(views())
@settings(max_examples=40, deadline=None)
def test_the_kernel_agrees_with_the_slow_reference(case):
    z, sigma, frame, eye, range_m = case
    patch = vis.predict(z, sigma, frame, eye, range_m=range_m, near_m=0.4)
    want = slow_patch(z, sigma, frame, eye, range_m, 0.4)
    assert np.abs(whole(patch, z.shape) - want).max() < 1e-3


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


def test_the_chance_behind_an_unsure_crest_is_phi_of_the_clearance():
    """Eye 1 m up, crest of 0.5 +- 0.2 m at 2 m, target on the ground at 6 m: ray at 2/3 m."""
    frame = GridFrame(0.0, 0.0, 0.5, 1, 20)
    z, sigma = np.zeros((1, 20)), np.full((1, 20), 1e-4)
    z[0, 4], sigma[0, 4] = 0.5, 0.2
    patch = vis.predict(z, sigma, frame, (0.25, 0.25, 1.0), range_m=9.0, near_m=0.0)
    assert patch.p[0, 12] == pytest.approx(ndtr((2 / 3 - 0.5) / 0.2), abs=2e-3)


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
