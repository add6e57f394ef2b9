"""Compiling all kernels, once on a machine: `python -m scenarios.compiling`.

Each processor compiles a share of them, in a process and a cache of its own, since numba's cache
bears one writer only; then the caches are put together. What two shares compiled, a part that
both call, is kept once.
"""

import importlib
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from comms import kernels
from scenarios.errors import FolderError

MOST_SHARES = 8


def compile_kernels() -> float:
    """Compile all kernels and keep them on disk; return the wall seconds that it took.

    Raises:
        FolderError: they can't be kept.

    """
    start_s = time.perf_counter()
    try:
        kernels.make_folder()
    except OSError as error:
        raise FolderError(
            f"{kernels.cache_dir()}: compiled kernels can't be kept there ({error.strerror}); name"
            " a folder that can be written to: ROPETEAM_CACHE=DIR"
        ) from error
    shares = min(MOST_SHARES, len(os.sched_getaffinity(0)))
    if shares > 1:
        with tempfile.TemporaryDirectory(prefix="ropeteam-kernels-") as folder:
            caches = [Path(folder) / str(k) for k in range(shares)]
            _compile_shares(caches)
            for cache in caches:
                put_together(cache / kernels.FOLDER.name, kernels.FOLDER)
    importlib.import_module("scenarios.preload")  # loads each kernel; compiles what still lacks
    kernels.mark_warm()
    return time.perf_counter() - start_s


def _compile_shares(caches: Sequence[Path]) -> None:
    running: list[subprocess.Popen[bytes]] = []
    try:
        for k, cache in enumerate(caches):
            command = [sys.executable, "-m", "scenarios.compiling", str(k), str(len(caches))]
            env = {**os.environ, "ROPETEAM_CACHE": str(cache)}
            # A share that fails says nothing: its kernels are compiled once more, here.
            quiet = subprocess.DEVNULL
            running.append(
                subprocess.Popen(
                    command, env=env, stdin=subprocess.PIPE, stdout=quiet, stderr=quiet
                )
            )
        for share in running:
            share.wait()
    finally:
        for share in running:
            share.kill()
            share.wait()


def put_together(source: Path, cache: Path) -> None:
    """Move the kernels that a cache lacks into it, from another that nobody writes to any more."""
    for index in sorted(source.rglob("*.nbi")):
        there = cache / index.relative_to(source)
        if there.exists():
            continue
        there.parent.mkdir(parents=True, exist_ok=True)
        for data in index.parent.glob(f"{index.stem}.*.nbc"):
            shutil.move(data, there.parent / data.name)
        shutil.move(index, there)


def _compile_share(k: int, shares: int) -> None:
    """Compile every so many-th kernel, from the k-th on, into this process's own cache."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    importlib.import_module("scenarios.crews.processes")
    kernels.make_folder()
    kernels.warm(slice(k, None, shares))


def _end_with_parent() -> None:
    sys.stdin.read()  # its end is the parent's, however that came
    os._exit(1)


if __name__ == "__main__":
    if len(sys.argv) == 3:
        _compile_share(int(sys.argv[1]), int(sys.argv[2]))
    elif not kernels.is_warm():
        compile_kernels()
