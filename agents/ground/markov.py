"""Unknown cells estimated from known ones: Sujan & Meggiolaro, section 2.2, Fig. 7 (Eq. M).

"For all unknown points a worst case initial guess is assumed: the lowest elevation in the known
model. A nearest measured neighbour average is performed and iterated till convergence." The fixed
point is the discrete Laplace equation with the known cells as its boundary; it is solved
directly here, not swept towards.
"""

from typing import Literal

import cv2
import numpy as np

from agents.errors import AgentError
from agents.geometry import Bools, Floats
from agents.ground import multigrid

Border = Literal["mirror", "low"]
"""How the map's outer ring is completed; see `complete`."""
MAX_STEPS = 80
"""Conjugate-gradient steps at most; about ten do for any map we met."""
ENOUGH_PAIRS = 200
LEAST_ROUGHNESS_M = 0.03
LEAST_SIGMA_M = 1e-3
UNKNOWN_SIGMA_M = 0.25
"""Of an estimated cell where too little is known to tell how rough the ground is."""


class MarkovError(AgentError):
    """A map that can't be completed."""


def complete(
    elevation_m: Floats,
    *,
    border: Border = "mirror",
    tolerance_m: float = 1e-3,
) -> Floats:
    """Fill the unknown cells so that each is the mean of its 4 neighbours inside the grid.

    Args:
        elevation_m: (H, W) metres, NaN where unknown.
        border: "mirror": a cell of the outer ring averages the neighbours that it has (Fig. 7).
            "low": unknown cells of the outer ring are fixed at the lowest known elevation, so
            that an unseen cliff face doesn't fill up to plateau height (edges and planning).
        tolerance_m: how far a cell may be from the exact fixed point.

    Returns:
        (H, W) float64; known cells are untouched.

    Raises:
        MarkovError: no cell is known, or a cell is infinite.
    """
    values = np.asarray(elevation_m, dtype=np.float64)
    known = ~np.isnan(values)
    if values.ndim != 2 or not known.any():
        raise MarkovError(
            f"an elevation map of shape {values.shape} with {int(known.sum())} known cells can't "
            "be completed: it takes two dimensions and at least one known cell"
        )
    lowest = float(values[known].min())
    if not np.isfinite(lowest) or not np.isfinite(values[known].max()):
        raise MarkovError("elevations must be finite, or NaN where unknown; got an infinite one")
    fixed = np.where(known, values - lowest, 0.0)
    if border == "low":
        known = known | _ring(known.shape)
    return np.where(np.isnan(values), _laplace(fixed, known, tolerance_m) + lowest, values)


def _ring(shape: tuple[int, ...]) -> Bools:
    ring = np.ones(shape, dtype=np.bool_)
    ring[1:-1, 1:-1] = False
    return ring


def _laplace(fixed: Floats, known: Bools, tolerance: float) -> Floats:
    """Return the harmonic filling of `fixed` (0 where unknown)."""
    if known.all():
        return fixed
    levels = multigrid.pyramid(known)
    filled = fixed.copy()
    pulled = _neighbour_sum(np.where(known, fixed, 0.0))
    load = np.where(known, 0.0, pulled)
    unknown = np.where(known, 0.0, _first_guess(fixed, known))
    multigrid.solve(levels, unknown, load, tolerance, MAX_STEPS)
    filled[~known] = unknown[~known]
    return filled


def _neighbour_sum(values: Floats) -> Floats:
    total = np.zeros_like(values)
    total[:-1] += values[1:]
    total[1:] += values[:-1]
    total[:, :-1] += values[:, 1:]
    total[:, 1:] += values[:, :-1]
    return total


def _first_guess(fixed: Floats, known: Bools) -> Floats:
    """Return a coarse pyramid's means, near enough to save the solver some steps."""
    value, weight = fixed * known, known.astype(np.float64)
    means = [np.divide(value, weight, out=np.zeros_like(value), where=weight > 0)]
    weights = [weight]
    while min(value.shape) > 1 and (weight == 0).any():
        size = ((value.shape[1] + 1) // 2, (value.shape[0] + 1) // 2)
        value = np.asarray(cv2.resize(value, size, interpolation=cv2.INTER_AREA), dtype=np.float64)
        weight = np.asarray(cv2.resize(weight, size, interpolation=cv2.INTER_AREA), np.float64)
        means.append(np.divide(value, weight, out=np.zeros_like(value), where=weight > 0))
        weights.append(weight)
    guess = np.where(weights[-1] > 0, means[-1], float(means[-1].mean()))
    for mean, known_share in zip(reversed(means[:-1]), reversed(weights[:-1]), strict=True):
        size = (mean.shape[1], mean.shape[0])
        finer = cv2.resize(guess, size, interpolation=cv2.INTER_LINEAR)
        guess = np.where(known_share > 0, mean, finer)
    return guess


def distance_to_known_m(known: Bools, cell_m: float) -> Floats:
    """Return each cell's distance (H, W) to the nearest known cell's centre; inf if there is none.

    Exact Euclidean distance between cell centres, in metres; 0 on known cells.
    """
    if not known.any():
        return np.full(known.shape, np.inf)
    cells = cv2.distanceTransform((~known).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # OpenCV's roots differ in their last bits with where the arrays happen to lie in memory: two
    # equal robots would choose differently. The squares are whole numbers.
    return cell_m * np.sqrt(np.rint(np.square(cells, dtype=np.float64)))


def roughness_m(elevation_m: Floats, cell_m: float, *, unknown_m: float = 0.25) -> float:
    """Return by how much known heights 1 m apart differ: the robust (median) standard deviation.

    `unknown_m` is the answer where fewer than `ENOUGH_PAIRS` pairs of cells are known.
    """
    lag = max(1, round(1.0 / cell_m))
    pairs = (
        elevation_m[lag:] - elevation_m[:-lag],
        elevation_m[:, lag:] - elevation_m[:, :-lag],
    )
    apart = np.abs(np.concatenate([pair.ravel() for pair in pairs]))
    apart = apart[~np.isnan(apart)]
    if len(apart) < ENOUGH_PAIRS:
        return unknown_m
    return max(LEAST_ROUGHNESS_M, 1.4826 * float(np.median(apart)))


def variogram_sigma(known_m: Floats, distance_cells: Floats) -> Floats:
    """Return the deviation of estimated cells (H, W): how much known heights so far apart differ.

    The root mean square of differences at lags of 1, 2, 4 ... cells, along rows and columns, taken
    where there are `ENOUGH_PAIRS`; between lags by power laws, beyond the longest as at the
    longest. Rocks and steps count, which a median would not see. 0 on measured cells: theirs comes
    from the sensor.
    """
    lags: list[int] = []
    sizes: list[float] = []
    for lag in (2**k for k in range(12) if 2 ** (k + 1) < min(known_m.shape)):
        down, across = known_m[lag:] - known_m[:-lag], known_m[:, lag:] - known_m[:, :-lag]
        apart = np.concatenate((down.ravel(), across.ravel()))
        apart = apart[~np.isnan(apart)]
        if len(apart) >= ENOUGH_PAIRS:
            lags.append(lag)
            sizes.append(max(LEAST_SIGMA_M, float(np.sqrt(np.mean(apart**2)))))
    if not lags:
        return np.where(distance_cells > 0, UNKNOWN_SIGMA_M, 0.0)
    steps = np.interp(np.log(np.maximum(distance_cells, 1e-9)), np.log(lags), np.log(sizes))
    return np.where(distance_cells > 0, np.exp(steps), 0.0)


def estimated_sigma(
    distance_m: Floats,
    *,
    sigma_at_1m: float = 0.25,
    exponent: float = 0.8,
    ceiling_m: float = 1.0,
) -> Floats:
    """Return the standard deviation (metres) of estimated cells, by distance to measured ground.

    Law: `sigma = min(ceiling, sigma_at_1m * (distance / 1 m) ** exponent)`, the structure
    function of fractal ground with Hurst exponent 0.8; `sigma_at_1m` is best taken from the known
    part of the map (`roughness_m`). 0 on measured cells: theirs comes from the sensor.
    """
    return np.minimum(ceiling_m, sigma_at_1m * distance_m**exponent)
