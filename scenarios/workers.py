"""Processes that run trials side by side, and are never what is left over."""

import contextlib
import importlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Generator
from concurrent.futures import ProcessPoolExecutor


@contextlib.contextmanager
def workers(jobs: int) -> Generator[ProcessPoolExecutor]:
    """Start so many processes; they end with the block.

    They end at once, whatever they are at, when the block is left by an error or a Ctrl-C, and when
    this process is killed.
    """
    spawning = multiprocessing.get_context("spawn")
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(jobs, mp_context=spawning, initializer=_begin)
    try:
        yield pool
    except BaseException:
        for one in set(multiprocessing.active_children()) - before:
            one.kill()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """Leave Ctrl-C to the parent and the other cores to the others; end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2 = importlib.import_module("cv2")
    cv2.setNumThreads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
