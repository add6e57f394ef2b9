"""The mask of known cells, coded exactly in the contexts of its decoded neighbours.

Source of the idea: ITU-T T.82 (JBIG); here a cell is skipped where the reader knows it already.
"""

import numpy as np
from numpy.typing import NDArray

from comms.kernels import kernel, warmer
from comms.rangecoder import Bytes, Words, decoder, encoder, has_run_out
from comms.symbols import Models, code_adaptive, fresh_models

Flags = NDArray[np.uint8]

_TEMPLATE_BITS = 10
_DY = np.array([0, -1, -1, -1, 0, -2, -1, -1, -2, -2], np.int64)
_DX = np.array([-1, 0, 1, -1, -2, 0, 2, -2, 1, -1], np.int64)


def fresh_mask_models() -> Models:
    """Return the models of the mask, before anything was learned."""
    return fresh_models((1 << (_TEMPLATE_BITS + 2),))


@kernel
def code_mask(state: Words, buffer: Bytes, models: Models, settled: Flags, mask: Flags) -> None:
    """Code `mask` (rows, cols) in place, but for the cells that both sides know (`settled`)."""
    h, w = mask.shape
    for i in range(h):
        if has_run_out(state):
            return
        for j in range(w):
            if settled[i, j]:
                continue
            context = 0
            for k in range(_TEMPLATE_BITS):
                a, b = i + _DY[k], j + _DX[k]
                if a >= 0 and 0 <= b < w and mask[a, b]:
                    context |= 1 << k
            if j + 1 < w and settled[i, j + 1] and mask[i, j + 1]:
                context |= 1 << _TEMPLATE_BITS
            if i + 1 < h and settled[i + 1, j] and mask[i + 1, j]:
                context |= 2 << _TEMPLATE_BITS
            mask[i, j] = code_adaptive(state, buffer, models, context, np.int64(mask[i, j]))


@warmer
def _warm() -> None:
    for coder, buffer in (encoder(64), decoder(b"\1\2\3")):
        code_mask(
            coder,
            buffer,
            fresh_mask_models(),
            np.zeros((3, 3), np.uint8),
            np.ones((3, 3), np.uint8),
        )
