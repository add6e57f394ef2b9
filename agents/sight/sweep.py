"""What every look from many eyes promises, by following bearings outwards from each.

One pass along a bearing carries the crests that hide what comes next (`sight.crests`), so each
point costs the same however far out it lies, and all headings and tilts of an eye share it. Bits
(Sujan & Meggiolaro, Eq. 3 with Eq. 5) are binned by elevation angle and azimuth; a look is a sum
over a window of these bins. A point stands for the ground between its neighbours: its cell's bits
times the points' area in cells.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.geometry import Floats, Ints
from agents.sight.crests import (
    LIFT_CELLS,
    chance_past,
    follow,
    raise_crests,
    rise_before,
    shared_points,
)
from agents.sight.gaze import Ground, Lens, hit_chance, soft_facing
from comms import kernels
from comms.kernels import kernel

TURN_BINS = 180
"""Bins of azimuth, one bearing along the middle of each."""
RISE_BINS = 90
"""Bins of elevation angle over [-90, +90] degrees, 2 degrees each."""
ONE_IN_FAR, ONE_IN_NEAR = 2, 4
"""Bits are reckoned for every second point, crosswise (in the first quarter of the range, where
bearings are close, every fourth); crests for all of them."""
STEEPEST = 8.0
STEEPNESS_STEPS = 256
ENTROPY_STEPS = 2048

_HALVES = np.arange(1, ENTROPY_STEPS + 1) / (2.0 * ENTROPY_STEPS)
HALF_ENTROPY = np.zeros(ENTROPY_STEPS + 2)
"""h(P / 2) in bits at P = n / `ENTROPY_STEPS`; linear between, off by at most 5e-4."""
HALF_ENTROPY[1:-1] = -_HALVES * np.log2(_HALVES) - (1.0 - _HALVES) * np.log2(1.0 - _HALVES)
HALF_ENTROPY[-1] = HALF_ENTROPY[-2]

_STEEPNESS = np.arange(-STEEPEST, STEEPEST, 1.0 / STEEPNESS_STEPS) + 0.5 / STEEPNESS_STEPS
RISE_BIN = ((np.arctan(_STEEPNESS) / math.pi + 0.5) * RISE_BINS).astype(np.int64)
"""Bin of elevation angle by slope, from -`STEEPEST` on; off by at most 0.1 degrees."""


class Camera(NamedTuple):
    """A sensor as the kernels take it."""

    near_m: float
    far_m: float
    half_turn: float
    """Half the field of view, in bins of azimuth."""
    half_rise: float
    """The same, in bins of elevation angle."""
    ray_rad2: float


@kernel
def rise_bin(slope: float) -> int:
    """Return the bin of elevation angle that a slope (rise over run) falls in."""
    if abs(slope) < STEEPEST:
        return RISE_BIN[int((slope + STEEPEST) * STEEPNESS_STEPS)]
    return min(int((math.atan(slope) / math.pi + 0.5) * RISE_BINS), RISE_BINS - 1)


@kernel
def half_entropy(p: float) -> float:
    """Return `h(p / 2)` in bits, for p in [0, 1], by the table."""
    at = p * ENTROPY_STEPS
    n = int(at)
    return HALF_ENTROPY[n] + (at - n) * (HALF_ENTROPY[n + 1] - HALF_ENTROPY[n])


class Memory(NamedTuple):
    """Room for what is met along one bearing; arrays (points,), the crests (points, 4)."""

    cells: np.ndarray
    slopes: np.ndarray
    spreads: np.ndarray
    crests: np.ndarray


@kernel
def _add_bearing(
    ground: Ground,
    memory: Memory,
    count: int,
    turn: int,
    apart: float,
    shared: int,
    camera: Camera,
    bins: np.ndarray,
) -> None:
    """Add the bits of some of the `count` points of a bearing to `bins` (angles,).

    `turn`: which bearing it is, all being `apart` radians apart.
    """
    angle = (turn + 0.5) * apart
    dy, dx = math.sin(angle), math.cos(angle)
    near2, far2 = camera.near_m * camera.near_m, camera.far_m * camera.far_m
    worths, norths, easts = ground.worth.ravel(), ground.north.ravel(), ground.east.ravel()
    slopes, spreads, crests = memory.slopes, memory.spreads, memory.crests
    first_far = min(count, len(spreads) // 4)
    for begin, end, one_in in ((0, first_far, ONE_IN_NEAR), (first_far, count, ONE_IN_FAR)):
        for k in range(begin + (turn - begin) % one_in, end, one_in):
            n = np.uint64(memory.cells[k])
            slope, run = slopes[k], (k + 1.0) * ground.cell_m
            distance2 = run * run * (1.0 + slope * slope)
            if worths[n] <= 0.0 or distance2 < near2 or distance2 > far2:
                continue
            lifted = slope + LIFT_CELLS / (k + 1.0)
            p = chance_past(
                lifted, spreads[k], crests[k, 0], crests[k, 1], crests[k, 2], crests[k, 3]
            )
            if p <= 0.0 or rise_before(slopes, spreads, k, shared) > lifted:
                continue
            distance = math.sqrt(distance2)
            facing = (norths[n] * dy + easts[n] * dx - slope) * run / distance
            p *= hit_chance(soft_facing(facing), distance, run, ground.target_m, camera.ray_rad2)
            bits = worths[n] * half_entropy(p)
            bins[rise_bin(slope)] += bits * (k + 1.0) * apart * one_in


@kernel
def _running(sums: np.ndarray, at: float) -> float:
    """Return running sums (first 0) interpolated at a fractional bin, clipped to the ends."""
    n = len(sums) - 1
    at = min(max(at, 0.0), float(n))
    k = min(int(at), n - 1)
    return sums[k] + (at - k) * (sums[k + 1] - sums[k])


@kernel
def window_sums(
    bins: np.ndarray,
    headings: np.ndarray,
    tilts: np.ndarray,
    half: tuple[float, float],
    out: np.ndarray,
) -> None:
    """Sum `bins` (azimuths, angles) over windows into `out` (headings, tilts); lengths in bins."""
    turns, angles = bins.shape
    ring = np.zeros((2 * turns + 1, angles))
    for t in range(2 * turns):
        ring[t + 1] = ring[t] + bins[t % turns]
    wide = min(2.0 * half[0], float(turns))
    rise = np.zeros(angles + 1)
    for c in range(len(headings)):
        left = (headings[c] - half[0]) % turns
        for k in range(angles):
            strip = _running(ring[:, k], left + wide) - _running(ring[:, k], left)
            rise[k + 1] = rise[k] + strip
        for t in range(len(tilts)):
            out[c, t] = _running(rise, tilts[t] + half[1]) - _running(rise, tilts[t] - half[1])


@kernel
def _sweep(
    ground: Ground,
    sigma: np.ndarray,
    eyes: np.ndarray,
    headings: np.ndarray,
    tilts: np.ndarray,
    camera: Camera,
    shared: int,
) -> np.ndarray:
    """Return the bits (eyes, headings, tilts) of every look; headings and tilts in bins."""
    out = np.zeros((len(eyes), len(headings), len(tilts)))
    points = math.ceil(camera.far_m / ground.cell_m) + 1
    met = Memory(
        np.empty(points, dtype=np.int64),
        np.empty(points),
        np.empty(points),
        np.empty((points, 4)),
    )
    apart = 2.0 * math.pi / TURN_BINS
    for n in range(len(eyes)):
        eye = (eyes[n, 0], eyes[n, 1], eyes[n, 2])
        bins = np.zeros((TURN_BINS, RISE_BINS))
        for b in range(TURN_BINS):
            angle = (b + 0.5) * apart
            count = follow(
                ground.height_m,
                sigma,
                eye,
                angle,
                ground.cell_m,
                met.cells,
                met.slopes,
                met.spreads,
            )
            raise_crests(met.slopes, met.spreads, count, shared, met.crests)
            _add_bearing(ground, met, count, b, apart, shared, camera, bins[b])
        window_sums(bins, headings, tilts, (camera.half_turn, camera.half_rise), out[n])
    return out


def look_gains(
    ground: Ground,
    sigma_m: Floats,
    eyes: Floats,
    headings_rad: Floats,
    tilts_rad: Floats,
    lens: Lens,
    limits_m: tuple[float, float],
) -> Floats:
    """Return the bits (N, headings, tilts) of looks from eyes (N, 3) of row, column and height.

    Args:
        ground: the map that looks are rated on.
        sigma_m: (H, W) standard deviation of its heights.
        eyes: in cells of the map, centres at whole numbers, and metres.
        headings_rad: counter-clockwise from +x.
        tilts_rad: positive up.
        lens: the sensor's field of view.
        limits_m: nearest and farthest distance at which it measures.
    """
    per_turn, per_rise = TURN_BINS / (2.0 * math.pi), RISE_BINS / math.pi
    camera = Camera(
        *limits_m, lens.half_turn_rad * per_turn, lens.half_rise_rad * per_rise, lens.ray_rad2
    )
    return _sweep(
        ground,
        sigma_m,
        eyes,
        headings_rad * per_turn,
        (tilts_rad + 0.5 * math.pi) * per_rise,
        camera,
        shared_points(ground.cell_m),
    )


def bins_of(azimuth_rad: Floats, rise_rad: Floats) -> Ints:
    """Return the flat indices (N,) into (azimuths, angles) of what lies in these directions."""
    turn = np.floor(azimuth_rad / (2.0 * math.pi) * TURN_BINS).astype(np.int64) % TURN_BINS
    angle = np.floor((rise_rad / math.pi + 0.5) * RISE_BINS).astype(np.int64)
    return turn * RISE_BINS + np.clip(angle, 0, RISE_BINS - 1)


def in_windows(bins: Floats, headings_rad: Floats, tilts_rad: Floats, lens: Lens) -> Floats:
    """Return the sums (headings, tilts) of bins (azimuths, angles) that each look has in view."""
    per_turn, per_rise = TURN_BINS / (2.0 * math.pi), RISE_BINS / math.pi
    out = np.empty((len(headings_rad), len(tilts_rad)))
    half = (lens.half_turn_rad * per_turn, lens.half_rise_rad * per_rise)
    window_sums(bins, headings_rad * per_turn, (tilts_rad + 0.5 * math.pi) * per_rise, half, out)
    return out


@kernels.warmer
def warm() -> None:
    """Compile the kernels of this module."""
    flat = np.zeros((8, 8))
    ground = Ground(flat, flat, flat, flat + 1.0, 0.5, 0.5)
    eyes, lens = np.array(((4.0, 4.0, 1.0),)), Lens(0.5, 0.4, 1e-4)
    look_gains(ground, flat + 0.1, eyes, np.zeros(1), np.zeros(1), lens, (0.1, 2.0))
