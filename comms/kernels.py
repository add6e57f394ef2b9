"""Compiled kernels: one decorator, one cache, one place that warms them all.

A kernel is compiled once per machine and kept on disk. Modules register a small function that
calls their kernels with the argument types of real use; `warm_all` runs these before any robot
starts, so that no robot ever compiles (or waits) in the middle of a mission.
"""

import hashlib
import os
import shutil
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import ParamSpec, TypeVar, cast

P = ParamSpec("P")
R = TypeVar("R")


ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("comms", "agents", "sim", "scenarios")
KEPT_CACHES = 3
"""Compiled kernels of so many versions of the source are kept."""


def cache_dir() -> Path:
    """Return the folder that holds compiled kernels (`ROPETEAM_CACHE`, else the user's cache)."""
    base = os.environ.get("ROPETEAM_CACHE")
    if base:
        return Path(base)
    return Path(os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))) / "ropeteam"


def sources_with_kernels() -> list[Path]:
    """Return the source files of the four rooms that hold kernels or parts of kernels."""
    files = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]
    return [path for path in files if any(m in path.read_bytes() for m in (b"@kernel", b"@part"))]


def _source_digest() -> str:
    digest = hashlib.sha256(version("numba").encode())
    for path in sources_with_kernels():
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


# Numba looks at a kernel's own file only, and would go on using one that calls into another file
# after that has changed. So each version of the whole has a folder of its own.
FOLDER = cache_dir() / f"kernels-{_source_digest()}"
"""Where this very source's compiled kernels are kept."""
os.environ["NUMBA_CACHE_DIR"] = str(FOLDER)

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


def warm(which: slice) -> None:
    """Call some of the registered warmers, in the order in which their modules were loaded."""
    for one in _warmers[which]:
        one()


def warm_all() -> float:
    """Call every registered warmer; return the wall seconds that it took."""
    start = time.perf_counter()
    warm(slice(None))
    return time.perf_counter() - start


def make_folder() -> None:
    """Make the folder of compiled kernels.

    Raises:
        OSError: it can't be written to.

    """
    FOLDER.mkdir(parents=True, exist_ok=True)
    (FOLDER / "writable").touch()


def is_warm() -> bool:
    """Say whether the kernels of this very source were compiled on this machine before."""
    return (FOLDER / "warm").exists()


def mark_warm() -> None:
    """Note that the kernels of this very source are compiled; drop those of long ago."""
    make_folder()
    (FOLDER / "warm").touch()
    others = sorted(cache_dir().glob("kernels-*"), key=lambda path: path.stat().st_mtime)
    for old in others[:-KEPT_CACHES]:
        shutil.rmtree(old, ignore_errors=True)
