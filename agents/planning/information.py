"""How much a look is worth, in bits: Sujan & Meggiolaro, Eqs. 1-3 and 6-9."""

import math

import numpy as np
from numpy.typing import ArrayLike

from agents.errors import AgentError
from agents.geometry import Bools, Floats

Array = np.ndarray


class InformationError(AgentError):
    """Data whose information can't be told."""


def plogp(share: ArrayLike) -> Floats:
    """Return `-q log2 q` of shares q in [0, 1], elementwise; 0 at q = 0."""
    q = np.asarray(share, dtype=np.float64)
    return -q * np.log2(np.where(q > 0, q, 1.0))


def binary_entropy(p: ArrayLike) -> Floats:
    """Return `h(p) = -p log2 p - (1-p) log2(1-p)` in bits, elementwise; h(0) = h(1) = 0."""
    p = np.asarray(p, dtype=np.float64)
    return plogp(p) + plogp(1.0 - p)


def histogram_entropy(counts: ArrayLike) -> float:
    """Return the entropy in bits per item of a histogram of counts (Eqs. 1, 2).

    A constant has 0 bits, n equally likely values have log2 n. A histogram can't see order.
    """
    n = np.asarray(counts, dtype=np.float64)
    total = float(n.sum())
    if total <= 0 or float(n.min()) < 0:
        raise InformationError(f"a histogram needs counts >= 0 with a sum > 0; the sum is {total}")
    return float(plogp(n / total).sum())


def data_entropy(values: ArrayLike) -> float:
    """Return the entropy in bits per item of discrete values of any shape (Eqs. 1, 2)."""
    _, counts = np.unique(np.asarray(values), return_counts=True)
    return histogram_entropy(counts)


def new_information(n_looks: ArrayLike, n_max: int, p_visible: ArrayLike) -> Floats:
    """Return the new information in bits, per cell, that a look promises (Eq. 3).

    `(1 - n_i / n_max) h(P_i / 2)`: 1 bit for a fresh cell seen for certain, 0 for one that is
    full or hidden. Arrays of one shape (or scalars); `n_looks` is clipped to `n_max`.
    """
    if n_max < 1:
        raise InformationError(f"n_max is {n_max}: it must be at least 1")
    filled = np.minimum(np.asarray(n_looks, dtype=np.float64) / n_max, 1.0)
    return (1.0 - filled) * binary_entropy(np.asarray(p_visible, dtype=np.float64) / 2.0)


def _histogram(p: Array, bins: int) -> tuple[Floats, Floats]:
    """Return counts (bins,) and centres of probabilities; 0 and 1 have bins of their own."""
    index = np.rint(np.asarray(p, dtype=np.float64).ravel() * (bins - 1)).astype(np.int64)
    counts = np.bincount(index, minlength=bins).astype(np.float64)
    return counts, np.arange(bins) / (bins - 1)


def _checked(p: Array, known: Bools, n_voxels: int, bins: int) -> None:
    if p.shape != known.shape or n_voxels < p.size or bins < 3:
        raise InformationError(
            f"{p.size} probabilities, {known.size} known flags, N = {n_voxels}, {bins} bins: the "
            "first two must be equal, N at least as large, and there must be 3 bins or more"
        )


def voxel_entropy(p: Array, known: Bools, n_voxels: int, bins: int = 33) -> float:
    """Return the information of a view's cells or voxels in bits (Eq. 6).

    Args:
        p: probability of occupancy of every visible cell, any shape.
        known: the same shape: mapped before or not; the two are histogrammed apart.
        n_voxels: N, how many the sensor could see at most.
        bins: bins over [0, 1]; the first and last are centred on 0 and 1.
    """
    _checked(p, known, n_voxels, bins)
    parts = (_histogram(p[known], bins)[0], _histogram(p[~known], bins)[0])
    return float(sum(plogp(counts / n_voxels).sum() for counts in parts))


def stretched(p: ArrayLike, distance_m: ArrayLike, reference_m: float) -> Floats:
    """Return p'' of Eq. 7: certain and far voxels count less, those near 0.5 are drawn apart.

    `s = 1/(1-p)` below 0.5 and `1/p` from there; `d = max(1, distance/reference)`;
    `p'' = (s-1)/(2d)` below, `1 - (s-1)/(2d)` from there. As printed, the 1/d makes
    p'' leave [0, 1]; this keeps what the text means: 0 -> 0, 0.5 -> 0.5 at the reference, 1 -> 1.
    """
    if not reference_m > 0:
        raise InformationError(f"the reference distance is {reference_m} m: it must be > 0")
    p = np.asarray(p, dtype=np.float64)
    far = np.maximum(1.0, np.asarray(distance_m, dtype=np.float64) / reference_m)
    low = p < 0.5
    excess = (1.0 / np.where(low, 1.0 - p, p) - 1.0) / (2.0 * far)
    return np.where(low, excess, 1.0 - excess)


def voxel_information(p: Array, known: Bools, n_voxels: int, bins: int = 33) -> float:
    """Return the paper's metric (v) in bits (Eq. 8): bins weighted by their own entropy.

    Arguments as in `voxel_entropy`. As printed it has a flaw: `-q log2 q` falls again above
    q = 0.37 and is 0 at q = 1, so a view that is wholly unknown is worth nothing.
    """
    _checked(p, known, n_voxels, bins)
    total = 0.0
    for part in (p[known], p[~known]):
        counts, centre = _histogram(part, bins)
        total += float((binary_entropy(centre) * plogp(counts / n_voxels)).sum())
    return total


def mean_voxel_entropy(p: Array, n_voxels: int) -> float:
    """Return `sum h(p_i) / N` in bits: Eq. 8 without its flaw, monotone in what is unknown."""
    if n_voxels < p.size:
        raise InformationError(f"N is {n_voxels}, less than the {p.size} voxels in view")
    return float(binary_entropy(p).sum()) / n_voxels


class Interest:
    """The interest function of every cell (Eq. 9).

    Each look at which a cell was expected with probability P and not measured multiplies its
    interest by `exp(-beta P)`. A cell that is measured after all gets its interest back: that is
    ours, the paper is silent.
    """

    def __init__(self, shape: tuple[int, int], beta: float) -> None:
        """Begin with full interest everywhere; `beta` >= 0 says how fast it is lost."""
        if not (beta >= 0 and math.isfinite(beta)):
            raise InformationError(f"beta is {beta}: it must be a finite number >= 0")
        self._beta = beta
        self._share = np.ones(shape)

    @property
    def share(self) -> Floats:
        """(H, W) interest in (0, 1]; a copy."""
        return self._share.copy()

    def update(self, expected_p: Array, measured: Bools) -> None:
        """Take in one look: P (H, W) of being seen in it, and which cells (H, W) it measured."""
        lost = np.exp(-self._beta * np.asarray(expected_p, dtype=np.float64))
        self._share = np.where(measured, 1.0, self._share * lost)
