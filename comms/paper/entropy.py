"""How much information data holds: Sujan & Meggiolaro, Eqs. 1 and 2, before and after compression.

A histogram can't see order: a slope and its cells in any other order have the same. The paper's
mend (section 2.3) is to compress the data without loss first and to measure what is left. Here are
the four ways that it names, each measured by the entropy of what it leaves, in bits per item of the
original data. (That mends it where the compression looks at order. Huffman's codes don't.)
"""

import heapq

import numpy as np
from numpy.typing import NDArray

from comms.errors import CodecError
from comms.paper.lzw import lzw_codes
from comms.paper.predictive import cells_in_order, residuals
from comms.paper.runlength import runs

Words = NDArray[np.int64]

PASSES = ("none", "rle", "huffman", "lzw", "jpeg-ls")


def histogram_bits(values: NDArray[np.integer]) -> float:
    """Return the entropy of the histogram of integers of any shape, in bits per item.

    `H = -sum q_k log2 q_k`, `q_k = n_k / N` (Eqs. 1, 2). A constant has 0 bits, n equally likely
    values have log2 n. Raises `CodecError` where there are none.
    """
    counts = _counts(values)
    share = counts / counts.sum()
    return abs(float((share * np.log2(share)).sum()))


def bits_after(values: NDArray[np.integer], compression: str) -> float:
    """Return the entropy of a grid (H, W) of integers after a lossless pass, in bits per cell.

    Args:
        values: (H, W), taken row by row where the pass knows no second dimension.
        compression: one of `PASSES`: `none`; `rle`, where values and lengths of runs have a
            histogram each; `huffman`, whose codes' mean length it is; `lzw`, whose codes have the
            histogram; `jpeg-ls`, where what the median edge detector misses has it (of the grid
            less its first value).

    Raises `CodecError` for an empty grid or another pass.

    """
    if values.ndim != 2 or values.size == 0:
        raise CodecError(f"a grid of shape {values.shape} has no information to be told")
    flat = values.astype(np.int64).ravel()
    if compression == "none":
        return histogram_bits(flat)
    if compression == "rle":
        pairs = runs(flat)
        each = histogram_bits(pairs[:, 0]) + histogram_bits(pairs[:, 1])
        return each * len(pairs) / flat.size
    if compression == "huffman":
        return huffman_bits(flat)
    if compression == "lzw":
        codes = lzw_codes(*_as_symbols(flat))
        return histogram_bits(codes) * codes.size / flat.size
    if compression == "jpeg-ls":
        rows, cols = values.shape
        return histogram_bits(residuals(flat - flat[0], cells_in_order(rows, cols), (rows, cols)))
    raise CodecError(f"a pass {compression!r} is none of {', '.join(PASSES)}")


def huffman_bits(values: NDArray[np.integer]) -> float:
    """Return the mean length of the Huffman codes of integers, in bits per item.

    Never below their entropy, and less than one bit above it; 0 for a constant.
    """
    heap = [int(count) for count in _counts(values)]
    total, paid = sum(heap), 0
    heapq.heapify(heap)
    while len(heap) > 1:
        joined = heapq.heappop(heap) + heapq.heappop(heap)
        paid += joined
        heapq.heappush(heap, joined)
    return paid / total


def _counts(values: NDArray[np.integer]) -> Words:
    if values.size == 0:
        raise CodecError("no data, no information: at least one value is needed")
    return np.unique(values, return_counts=True)[1].astype(np.int64)


def _as_symbols(values: Words) -> tuple[NDArray[np.uint8], int]:
    """Return values by rank as symbols below 256, several to a value where there are more ranks."""
    found, ranks = np.unique(values, return_inverse=True)
    if found.size <= 256:
        return ranks.astype(np.uint8), found.size
    width = (found.size.bit_length() + 7) // 8
    shifts = 8 * np.arange(width - 1, -1, -1)
    return ((ranks[:, None] >> shifts) & 255).astype(np.uint8).ravel(), 256
