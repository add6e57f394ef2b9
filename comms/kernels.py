"""Compiled kernels: one decorator, one cache, one place that warms them all.

A kernel is compiled once per machine and kept on disk. Modules register a small function that
calls their kernels with the argument types of real use; `warm_all` runs these before any robot
starts, so that no robot ever compiles (or waits) in the middle of a mission.
"""

import hashlib
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

P = ParamSpec("P")
R = TypeVar("R")


def cache_dir() -> Path:
    """Return the folder that holds compiled kernels (`ROPETEAM_CACHE`, else the user's cache)."""
    base = os.environ.get("ROPETEAM_CACHE")
    if base:
        return Path(base)
    return Path(os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))) / "ropeteam"


os.environ.setdefault("NUMBA_CACHE_DIR", str(cache_dir() / "numba"))

import numba  # noqa: E402  (the cache folder has to be set before numba reads its configuration)

_warmers: list[Callable[[], None]] = []


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` with numba: cached on disk, without the GIL, IEEE arithmetic."""
    compiled = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    return cast("Callable[P, R]", compiled)


def warmer(function: Callable[[], None]) -> Callable[[], None]:
    """Register a function that calls this module's kernels with the types of real use."""
    _warmers.append(function)
    return function


def warm_all() -> float:
    """Call every registered warmer; return the wall seconds that it took."""
    start = time.perf_counter()
    for warm in _warmers:
        warm()
    return time.perf_counter() - start


def _stamp(sources: list[Path]) -> Path:
    digest = hashlib.sha256(str(cast("Any", numba).__version__).encode())
    for path in sorted(sources):
        digest.update(str(path).encode())
        digest.update(path.read_bytes())
    return cache_dir() / f"kernels-{digest.hexdigest()[:16]}.stamp"


def sources_with_kernels(root: Path) -> list[Path]:
    """Return the source files under the four rooms of `root` that define kernels."""
    rooms = [root / room for room in ("comms", "agents", "sim", "scenarios")]
    return [p for room in rooms for p in room.glob("*.py") if b"@kernel" in p.read_bytes()]


def is_warm(root: Path) -> bool:
    """Say whether the kernels of this very source were compiled on this machine before."""
    return _stamp(sources_with_kernels(root)).exists()


def mark_warm(root: Path) -> None:
    """Note that the kernels of this very source are compiled."""
    stamp = _stamp(sources_with_kernels(root))
    stamp.parent.mkdir(parents=True, exist_ok=True)
    stamp.touch()
