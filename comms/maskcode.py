"""The mask of known cells, coded exactly in the contexts of its decoded neighbours.

Four opinions are mixed: the nearest neighbours with what lies ahead where the reader knows that
already, and causal templates of 6, 10 and 14 cells.

Source of the idea: ITU-T T.82 (JBIG).
"""

import numpy as np
from numpy.typing import NDArray

from comms.kernels import kernel, warmer
from comms.logistic import Opinions, code_mixed
from comms.parts import part, whole
from comms.priors import opinions
from comms.rangecoder import Coder, decoder, encoder, has_run_out

Flags = NDArray[np.uint8]

KINDS = ("whole", "rest", "lattice", "blocks", "news")
"""Masks that start from different priors: a whole grid's, what a tile's first levels left open,
that of a coarse lattice, which blocks a level tells, and what is known since the version before."""
_TEMPLATE = np.array(
    [
        [0, -1],
        [-1, 0],
        [-1, 1],
        [-1, -1],
        [0, -2],
        [-2, 0],
        [-1, 2],
        [-1, -2],
        [-2, 1],
        [-2, -1],
        [0, -3],
        [-2, 2],
        [-2, -2],
        [-3, 0],
    ],
    np.int64,
)
"""Neighbours decoded before, (row, column), nearest first."""
_INPUTS = 4
_NEAR = 4
_AHEAD_SLOTS = 9 << _NEAR
_STARTS = np.array([0, _AHEAD_SLOTS, _AHEAD_SLOTS + 64, _AHEAD_SLOTS + 64 + 1024], np.int64)
LEARNED_SLOTS = int(_STARTS[-1])
_SLOTS = LEARNED_SLOTS + (1 << 14)
_LIMIT = 400


def mask_opinions(kind: str) -> Opinions:
    """Return the models of one of the `KINDS` of masks at the start of a payload."""
    return opinions(kind, _SLOTS, 1 << _NEAR, _INPUTS)


@part
def _template(mask: Flags, i: int, j: int) -> int:
    width = mask.shape[1]
    bits = whole(0)
    for k in range(_TEMPLATE.shape[0]):
        a, b = i + _TEMPLATE[k, 0], j + _TEMPLATE[k, 1]
        if a >= 0 and 0 <= b < width and mask[a, b]:
            bits |= whole(1) << k
    return bits


@part
def _ahead(settled: Flags, mask: Flags, i: int, j: int) -> int:
    """Return what is known of a later cell: 0 nothing, 1 that it is 0, 2 that it is 1."""
    h, w = mask.shape
    if i >= h or j >= w or not settled[i, j]:
        return whole(0)
    return 1 + whole(mask[i, j])


@kernel
def code_mask(coder: Coder, mixed: Opinions, settled: Flags, mask: Flags) -> None:
    """Code `mask` (rows, cols) in place, but for the cells that both sides know (`settled`)."""
    h, w = mask.shape
    slots = mixed.slots
    for i in range(h):
        if has_run_out(coder):
            return
        for j in range(w):
            if settled[i, j]:
                continue
            template = _template(mask, i, j)
            near = template & 15
            ahead = 3 * _ahead(settled, mask, i, j + 1) + _ahead(settled, mask, i + 1, j)
            slots[0] = (ahead << _NEAR) + near
            slots[1] = _STARTS[1] + (template & 63)
            slots[2] = _STARTS[2] + (template & 1023)
            slots[3] = _STARTS[3] + template
            mask[i, j] = code_mixed(coder, mixed, near, _LIMIT, whole(mask[i, j]))


@warmer
def _warm() -> None:
    for coder in (encoder(64), decoder(b"\1\2\3")):
        settled, mask = np.zeros((3, 3), np.uint8), np.ones((3, 3), np.uint8)
        code_mask(coder, mask_opinions("rest"), settled, mask)
