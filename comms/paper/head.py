"""What the receiver of a map in the paper's form has to know first."""

import math
from dataclasses import dataclass

import numpy as np

from comms.errors import CodecError
from comms.paper.sections import Cursor

COMPRESSORS = ("lzw", "huffman", "rle", "jpeg-ls")
_TREE_OF = {"lzw": "lzw", "huffman": "huffman", "rle": "rle", "jpeg-ls": "huffman"}
"""What packs the trees: a predictive coder packs elevations only, and goes with Huffman's codes."""


@dataclass(frozen=True)
class Head:
    """Eight bytes: the grid, its bins, and how the rest was packed."""

    shape: tuple[int, int]
    step_m: float
    compressor: str
    has_sigma: bool
    critical: int

    @property
    def tree(self) -> str:
        """What packs all but the elevations."""
        return _TREE_OF[self.compressor]

    def to_bytes(self) -> bytes:
        """One byte of choices, twelve bits for each side, the bins as float32."""
        choices = COMPRESSORS.index(self.compressor) | int(self.has_sigma) << 2
        choices |= (self.critical.bit_length() - 1) << 3
        sides = (self.shape[0] - 1) << 12 | (self.shape[1] - 1)
        step = np.array(self.step_m, "<f4").tobytes()
        return bytes([choices]) + sides.to_bytes(3, "big") + step

    @staticmethod
    def read(cursor: Cursor, max_cells: int) -> "Head":
        """Read what `to_bytes` wrote.

        Raises `CodecError` for a grid of more than `max_cells`, or what is no head.
        """
        choices = cursor.take(1)[0]
        sides = int.from_bytes(cursor.take(3), "big")
        step_m = float(np.frombuffer(cursor.take(4), "<f4")[0])
        rows, cols = (sides >> 12) + 1, (sides & 4095) + 1
        if rows * cols > max_cells:
            raise CodecError(f"a grid of {rows} x {cols} cells is above {max_cells} cells")
        if choices > 127 or choices >> 3 > 12 or not (math.isfinite(step_m) and step_m > 0):
            raise CodecError(f"no map begins with a byte {choices} and bins of {step_m:g} m")
        compressor = COMPRESSORS[choices & 3]
        return Head((rows, cols), step_m, compressor, bool(choices & 4), 1 << (choices >> 3))
