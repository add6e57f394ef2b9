"""Small worlds and a clock for the tests of `sim`."""

import os
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest

from agents.geometry import GridFrame
from sim.clock import VirtualLoop
from sim.ground import Terrain

T = TypeVar("T")
SHARED = Path(os.environ.get("ROPETEAM_SHARED", Path(__file__).parents[2] / "shared"))
DEMS = SHARED / "data" / "dem"


def needs(name: str) -> pytest.MarkDecorator:
    path = DEMS / name
    return pytest.mark.skipif(not path.is_file(), reason=f"real terrain {path} is not here")


def run(coroutine: Coroutine[Any, Any, T]) -> T:
    loop = VirtualLoop(0)
    try:
        task = loop.create_task(coroutine)
        loop.run_window(10**15)
        return task.result()
    finally:
        loop.close()


def ground(
    height: Callable[[np.ndarray, np.ndarray], Any], side_m: float = 20.0, cell_m: float = 0.1
) -> Terrain:
    """Return a terrain from a function of x and y; well textured."""
    n = round(side_m / cell_m)
    centres = (np.arange(n) + 0.5) * cell_m
    x, y = np.meshgrid(centres, centres)
    z = np.broadcast_to(np.asarray(height(x, y), dtype=np.float32), (n, n)).copy()
    return Terrain(GridFrame(0.0, 0.0, cell_m, n, n), z, np.ones((n, n), dtype=np.float32))
