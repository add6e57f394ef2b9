"""The sums of a sweep against direct sums (whole looks: `test_agents_strategies`)."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.geometry import GridFrame
from agents.planning.information import binary_entropy
from agents.sight import gaze, sweep, visibility
from agents.sight.gaze import Ground, Lens

LENS = Lens(math.radians(30.0), math.radians(22.0), 3e-5)


def test_half_entropy_and_angle_bins_are_those_of_the_formulas():
    p = np.linspace(0, 1, 1777)
    got = np.array([sweep.half_entropy(x) for x in p])
    assert np.abs(got - binary_entropy(p / 2)).max() < 6e-4
    for slope in (-1e9, -20.0, -7.99, -1.0, -0.1, 0.0, 0.3, 1.7, 7.99, 30.0, 1e9):
        angle_deg = math.degrees(math.atan(slope))
        middle_deg = (sweep.rise_bin(slope) + 0.5) * 180 / sweep.RISE_BINS - 90
        assert abs(angle_deg - middle_deg) <= 90 / sweep.RISE_BINS + 0.12


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_windows_of_whole_bins_are_plain_sums_that_wrap_round(seed):
    rng = np.random.default_rng(seed)
    bins = rng.uniform(size=(sweep.TURN_BINS, sweep.RISE_BINS))
    heading, half_turn = int(rng.integers(sweep.TURN_BINS)), int(rng.integers(1, 60))
    tilt, half_rise = int(rng.integers(sweep.RISE_BINS)), int(rng.integers(1, 40))
    out = np.zeros((1, 1))
    sweep.window_sums(
        bins,
        np.array([float(heading)]),
        np.array([float(tilt)]),
        (float(half_turn), float(half_rise)),
        out,
    )
    turns = np.arange(heading - half_turn, heading + half_turn) % sweep.TURN_BINS
    low, high = max(0, tilt - half_rise), min(sweep.RISE_BINS, tilt + half_rise)
    assert out[0, 0] == pytest.approx(bins[turns, low:high].sum())


@pytest.mark.parametrize(("cell_m", "range_m"), [(0.1, 6.0), (0.25, 15.0)])
def test_a_sweep_promises_what_cell_by_cell_prediction_does(cell_m, range_m):
    rng = np.random.default_rng(5)
    n = round(2.4 * range_m / cell_m)
    frame = GridFrame(0.0, 0.0, cell_m, n, n)
    y, x = np.mgrid[:n, :n] * cell_m
    z = 0.3 * np.sin(x) * np.cos(0.7 * y) + rng.normal(scale=0.02, size=frame.shape)
    sigma = np.where(x > 0.5 * n * cell_m, 0.3, 0.02)
    worth = (rng.random(frame.shape) < 0.7).astype(np.float64)
    flat = np.zeros(frame.shape)
    ground = Ground(z, flat, flat, worth, cell_m, cell_m)
    row, col = n // 2, n // 2 - 3
    x_m, y_m = frame.centre_of(row, col)
    eye_z = float(z[row, col]) + 1.5
    headings, tilts = np.linspace(0, 2 * math.pi, 12, endpoint=False), np.radians([-12.0, -35.0])
    eyes = np.array([[row, col, eye_z]], dtype=np.float64)
    got = sweep.look_gains(ground, sigma, eyes, headings, tilts, LENS, (0.4, range_m))[0]
    patch = visibility.predict(z, sigma, frame, (x_m, y_m, eye_z), range_m=range_m, near_m=0.4)
    bits = binary_entropy(gaze.measured_chance(patch, ground, LENS) / 2)
    h, w = bits.shape
    bits *= worth[patch.row0 : patch.row0 + h, patch.col0 : patch.col0 + w]
    want = [
        [bits[gaze.in_view(patch, heading, tilt, LENS)].sum() for tilt in tilts]
        for heading in headings
    ]
    assert np.min(want) > 50
    assert got == pytest.approx(np.array(want), rel=0.1, abs=0.03 * np.max(want))
