"""Parts of kernels: compiled into the kernels that call them, so that a call costs nothing.

A coder's inner loop is a handful of tiny functions per bit; called as functions, they spend most of
their time passing arrays to one another.
"""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numpy as np

from comms import kernels

P = ParamSpec("P")
R = TypeVar("R")

whole = cast("Callable[[object], int]", np.int64)
"""A signed whole number of 64 bits, to kernels; to readers and type checkers, an int."""


def part(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` like a kernel, but as a part of every kernel that calls it."""
    compiled = kernels.numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)(
        function
    )
    return cast("Callable[P, R]", compiled)
