"""The paper's own map codec, to be measured against: an entropy quadtree of mean elevations.

Sujan & Meggiolaro, section 2.4 and Fig. 16: adaptive decimation; a quadtree that divides what has
much information (Eqs. 1 and 2) down to a critical size; the mean elevation of each leaf; lossless
compression. What the paper leaves open is done here as well as it can be without leaving the
paper's design: bins twice as wide as the error that is wanted, the mean told by its bin, leaves
told by their difference from the one before (or, with `jpeg-ls`, predicted from the neighbours that
are there), the mask as a quadtree of its own, three streams that are compressed apart.

**The entropy bounds no error.** A quadrant of a thousand cells with a single boulder has next to
no entropy; its mean says nothing of the boulder. The encoder therefore measures what it did.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comms.errors import CodecError
from comms.gridcode import LARGEST_SIDE, check_grid
from comms.paper import quadtree
from comms.paper.bits import Bytes, Words
from comms.paper.decimation import decimated
from comms.paper.head import COMPRESSORS, Head
from comms.paper.predictive import LARGEST, predictive_pack, predictive_unpack
from comms.paper.quadtree import Flags, Floats, Squares
from comms.paper.sections import (
    Cursor,
    folded,
    number_bytes,
    numbers_section,
    read_numbers,
    read_section,
    section,
    unfolded,
)
from comms.sigmacode import HIGHEST, LOWEST, code_of, sigma_of

__all__ = [
    "COMPRESSORS",
    "CUTOFF_BITS",
    "PaperMap",
    "PaperPayload",
    "decode_paper_map",
    "encode_paper_map",
]

Bools = NDArray[np.bool_]
Singles = NDArray[np.float32]

CUTOFF_BITS = 0.5
_LARGEST_SIGMA_M = 4096.0


@dataclass(frozen=True)
class PaperPayload:
    """A map as the paper would send it, and what that did to it."""

    data: bytes
    max_error_m: float
    """The largest error of a known cell; 0 where none is known."""
    rmse_m: float
    leaves: int
    sigma_bytes: int
    """Of the data: what the standard deviations take."""


@dataclass(frozen=True)
class PaperMap:
    """A map as its receiver has it; NaN where unknown."""

    elevation_m: Singles
    known: Bools
    sigma_m: Singles | None


def encode_paper_map(
    elevation_m: NDArray[np.floating],
    known: Bools,
    max_error_m: float,
    *,
    sigma_m: NDArray[np.floating] | None = None,
    cutoff_bits: float = CUTOFF_BITS,
    compressor: str = "lzw",
    critical_cells: float = 1.0,
    pebble_m: float | None = None,
) -> PaperPayload:
    """Return a map as the paper would send it, with the error that it was measured to have.

    Args:
        elevation_m: (H, W), read only where `known`; 1x1 to 4096x4096 cells.
        known: (H, W).
        max_error_m: half the width of the bins. It is no bound: see the module.
        sigma_m: (H, W) standard deviations to go with it, one for each leaf: of its cells' own, of
            their spread about the mean and of the bins, the root of the sum of squares, rounded up
            to half an octave. (The paper does not say what is sent of them.)
        cutoff_bits: quadrants with more entropy than this, bits per cell, are divided.
        compressor: one of `COMPRESSORS`.
        critical_cells: quadrants of this side are not divided; the paper's wheel diameter.
        pebble_m: adaptive decimation takes single cells that stand out by so much; the default is
            `max_error_m`, 0 leaves the map as it is.

    Raises `CodecError` for arguments that make no sense, or elevations of more than 2^52 bins.

    """
    values = check_grid(elevation_m, known, max_error_m)
    _check_choices(cutoff_bits, compressor, critical_cells, pebble_m)
    mask = np.ascontiguousarray(known).astype(np.uint8)
    step_m = float(np.float32(2 * max_error_m))
    if float(np.abs(values).max()) / step_m > LARGEST / 4:
        raise CodecError(f"bins of {step_m:g} m are too fine for {np.abs(values).max():g} m")
    kept = decimated(values, mask, max_error_m if pebble_m is None else pebble_m)
    critical = quadtree.critical_side(min(critical_cells, LARGEST_SIDE))
    symbols, leaves = _divide(kept, mask, step_m, cutoff_bits, critical)
    means, spreads = quadtree.leaf_means(kept, mask, leaves)
    bins = np.floor(means / step_m + 0.5).astype(np.int64)
    head = Head(known.shape, step_m, compressor, sigma_m is not None, critical)
    data = head.to_bytes() + _mask_sections(mask, head.tree)
    if leaves.size:
        data += section(symbols, head.tree) + _values_section(bins, leaves, head)
    sigma = b""
    if sigma_m is not None and leaves.size:
        codes = _sigma_codes(sigma_m, known, mask, leaves, spreads + step_m**2 / 12)
        sigma = numbers_section(folded(np.diff(codes, prepend=0)), head.tree)
    error_m = np.abs(_laid(_metres(bins, step_m), mask, leaves) - values)[known]
    return PaperPayload(
        data + sigma,
        float(error_m.max(initial=0.0)),
        math.sqrt(float(np.mean(error_m**2))) if error_m.size else 0.0,
        len(leaves),
        len(sigma),
    )


def decode_paper_map(data: bytes, max_cells: int = LARGEST_SIDE**2) -> PaperMap:
    """Return the map that these bytes tell.

    Raises `CodecError` for bytes that are no payload of `encode_paper_map`, or a grid of more than
    `max_cells` cells.
    """
    cursor = Cursor(data)
    head = Head.read(cursor, max_cells)
    mask = _read_mask(cursor, head)
    elevation_m = np.full(head.shape, np.nan, np.float32)
    sigma_m = elevation_m.copy() if head.has_sigma else None
    if mask.any():
        leaves = _read_leaves(cursor, head, mask)
        bins = _read_values(cursor, head, leaves)
        quadtree.paint(_metres(bins, head.step_m), mask, leaves, elevation_m)
        if sigma_m is not None:
            sigmas = _read_sigmas(cursor, head, len(leaves))
            quadtree.paint(sigmas, mask, leaves, sigma_m)
    cursor.end()
    return PaperMap(elevation_m, mask.astype(np.bool_), sigma_m)


def _check_choices(
    cutoff_bits: float, compressor: str, critical_cells: float, pebble_m: float | None
) -> None:
    if compressor not in COMPRESSORS:
        raise CodecError(f"compressor {compressor!r} is none of {', '.join(COMPRESSORS)}")
    if not 0 <= cutoff_bits < math.inf:
        raise CodecError(f"a cut-off of {cutoff_bits} bits is no number from 0 up")
    if not critical_cells >= 1:
        raise CodecError(f"a critical size of {critical_cells} cells is less than 1")
    if pebble_m is not None and not pebble_m >= 0:
        raise CodecError(f"pebbles of {pebble_m} m are no size from 0 up")


def _mask_sections(mask: Flags, compressor: str) -> bytes:
    symbols = np.empty(quadtree.most_nodes(mask.shape), np.uint8)
    blocks = np.empty_like(symbols)
    side = quadtree.root_side(mask.shape)
    n, mixed = quadtree.mask_symbols(mask, side, symbols, blocks)
    return section(symbols[:n], compressor) + section(blocks[:mixed], compressor)


def _read_mask(cursor: Cursor, head: Head) -> Flags:
    most = quadtree.most_nodes(head.shape)
    symbols = read_section(cursor, head.tree, most)
    blocks = read_section(cursor, head.tree, most)
    mask = np.zeros(head.shape, np.uint8)
    if not quadtree.paint_mask(symbols, blocks, quadtree.root_side(head.shape), mask):
        raise CodecError("the mask in the bytes is none")
    return mask


def _divide(
    values: Floats, mask: Flags, step_m: float, cutoff_bits: float, critical: int
) -> tuple[Bytes, Squares]:
    """Return the symbols of the elevations' tree, and its leaves (N, 3)."""
    ranks, count = _ranks(np.floor(values / step_m + 0.5).astype(np.int64), mask)
    cells = int(mask.sum())
    symbols = np.empty(quadtree.most_nodes(mask.shape), np.uint8)
    leaves = np.empty((cells, 3), np.int32)
    n, found = quadtree.elevation_tree(
        ranks,
        mask,
        quadtree.root_side(mask.shape),
        cutoff_bits,
        critical,
        np.zeros(count, np.int64),
        quadtree.plogp_table(cells),
        symbols,
        leaves,
    )
    return symbols[:n], leaves[:found]


def _ranks(bins: Words, mask: Flags) -> tuple[Words, int]:
    """Return the bins (H, W) as numbers from 0 up, and how many numbers that takes."""
    inside = bins[mask > 0]
    if inside.size == 0:
        return np.zeros_like(bins), 1
    low, high = int(inside.min()), int(inside.max())
    if high - low <= 4 * bins.size:
        return np.where(mask > 0, bins - low, 0), high - low + 1
    found, ranks = np.unique(bins, return_inverse=True)
    return ranks.reshape(bins.shape).astype(np.int64), found.size


def _values_section(bins: Words, leaves: Squares, head: Head) -> bytes:
    """Return the leaves' bins: the first by itself, the others as the compressor likes them."""
    first = number_bytes(int(folded(bins[:1])[0]))
    if head.compressor != "jpeg-ls":
        return first + numbers_section(folded(np.diff(bins, prepend=bins[0])), head.tree)
    packed = predictive_pack(bins - bins[0], leaves, head.shape)
    return first + number_bytes(len(packed)) + packed


def _read_values(cursor: Cursor, head: Head, leaves: Squares) -> Words:
    first = unfolded(np.array([cursor.number()]))
    if head.compressor != "jpeg-ls":
        return first + np.cumsum(unfolded(read_numbers(cursor, head.tree, len(leaves))))
    return first + predictive_unpack(cursor.take(cursor.number()), leaves, head.shape)


def _read_leaves(cursor: Cursor, head: Head, mask: Flags) -> Squares:
    symbols = read_section(cursor, head.tree, quadtree.most_nodes(head.shape))
    # A symbol divides a quadrant into quarters, and may divide all of them, to the critical size.
    leaves = np.empty((min(int(mask.sum()), 16 * symbols.size), 3), np.int32)
    side = quadtree.root_side(head.shape)
    found = quadtree.leaves_of(symbols, mask, side, head.critical, leaves)
    if found < 0:
        raise CodecError("the quadtree in the bytes is none")
    return leaves[:found]


def _sigma_codes(
    sigma_m: NDArray[np.floating], known: Bools, mask: Flags, leaves: Squares, other: Floats
) -> Words:
    """Return the code (N,) of each leaf's standard deviation; `other`: variances to be added."""
    if sigma_m.shape != known.shape:
        raise CodecError(f"sigma {sigma_m.shape} and mask {known.shape} must be one grid")
    each_m = np.where(known, sigma_m, 0.0)
    code_of(each_m, known)
    variance, _ = quadtree.leaf_means(each_m**2, mask, leaves)
    together = np.minimum(np.sqrt(variance + other), _LARGEST_SIGMA_M)
    return code_of(together, np.ones(len(leaves), np.bool_))


def _read_sigmas(cursor: Cursor, head: Head, count: int) -> Floats:
    codes = np.cumsum(unfolded(read_numbers(cursor, head.tree, count)))
    if codes.size and (codes.min() < LOWEST or codes.max() > HIGHEST):
        raise CodecError("a standard deviation in the bytes is none")
    return sigma_of(codes).astype(np.float64)


def _metres(bins: Words, step_m: float) -> Floats:
    """Return the elevations that bins stand for, as float32 has them."""
    with np.errstate(over="ignore"):
        metres = (bins * step_m).astype(np.float32)
    if not np.isfinite(metres).all():
        raise CodecError(f"float32 cannot hold {bins.size} elevations in bins of {step_m:g} m")
    return metres.astype(np.float64)


def _laid(metres: Floats, mask: Flags, leaves: Squares) -> Singles:
    laid = np.zeros(mask.shape, np.float32)
    quadtree.paint(metres, mask, leaves, laid)
    return laid
