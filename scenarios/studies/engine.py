"""Who runs the trials: Dask, on this machine or on a cluster.

Nothing here queues, schedules or restarts: that is Dask's. A trial that raises tells so itself
(`scenarios.studies.trial`); one whose process dies is told by Dask, after its third death.
"""

import contextlib
import logging
import os
import signal
import tempfile
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from comms import kernels
from scenarios.compiling import compile_kernels
from scenarios.errors import UsageError
from scenarios.studies.study import Trial
from scenarios.studies.trial import Told, measure

if TYPE_CHECKING:
    from distributed import Client

Engine = Callable[[Sequence[Trial], Path], Iterator[tuple[Trial, Told]]]
"""Runs trials, and yields each with what came of it as it ends; given the sweep's folder."""

DEATHS = 3
"""A trial whose process dies so often is given up."""
CONNECT_S = 10
LOCAL = "127.0.0.1"
"""A cluster of our own listens to nobody else."""


def dask_setup(worker: object) -> None:
    """Leave Ctrl-C to the sweep (called by Dask in each process of a cluster of our own)."""
    del worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _settings() -> dict[str, Any]:
    return {
        "distributed.scheduler.allowed-failures": DEATHS - 1,
        # Trials wait in the scheduler, not on a worker whose death would count as theirs.
        "distributed.scheduler.worker-saturation": 1.0,
        "distributed.worker.preload": [__name__],
    }


def in_turn(trials: Sequence[Trial], out: Path) -> Iterator[tuple[Trial, Told]]:
    """Run trials one after another, in this process: for tests and debuggers."""
    del out
    for trial in trials:
        yield trial, measure(trial.text)


def on_dask(jobs: int | None = None, scheduler: str = "") -> Engine:
    """Return an engine of Dask's: a cluster of `jobs` processes here, or the one at an address."""

    def run(trials: Sequence[Trial], out: Path) -> Iterator[tuple[Trial, Told]]:
        workers = min(jobs or len(os.sched_getaffinity(0)), len(trials))
        if not scheduler:
            _compile()
        with _client(workers, scheduler) as client:
            yield from _run(client, trials, None if scheduler else out)

    return run


def _compile() -> None:
    """Compile the kernels once, where that was never done, before all workers do it at a time."""
    if not kernels.is_warm():
        compile_kernels()


def _run(
    client: "Client", trials: Sequence[Trial], out: Path | None
) -> Iterator[tuple[Trial, Told]]:
    from distributed import as_completed  # noqa: PLC0415  (slow to import; `on_dask` only)

    submitted: dict[Any, Trial] = {}
    for trial in trials:
        death_log = "" if out is None else str(out / f".{trial.id}.crash.log")
        submitted[client.submit(measure, trial.text, death_log, pure=False)] = trial
    ended = as_completed(list(submitted), with_results=True, raise_errors=False)
    for future, result in cast("Iterator[tuple[Any, Any]]", ended):
        trial = submitted.pop(future)
        trace = _taken(None if out is None else out / f".{trial.id}.crash.log")
        yield trial, result if isinstance(result, Told) else _death(result, trace)
        future.release()


def _death(raised: Any, trace: str) -> Told:
    """Return what is told of a trial that could not tell anything itself."""
    error = raised[1] if isinstance(raised, tuple) else raised
    return Told("failed", f"its process died ({DEATHS} times)", f"{error!r}\n\n{trace}")


def _taken(path: Path | None) -> str:
    """Return what a crash left, and remove it."""
    if path is None or not path.is_file():
        return ""
    text = path.read_text(errors="replace")
    path.unlink()
    return text


@contextlib.contextmanager
def _client(workers: int, scheduler: str) -> Generator["Client"]:
    """Connect to a cluster, or make one of our own that ends with the sweep.

    Raises:
        UsageError: nobody answers at the address.

    """
    from dask import config  # noqa: PLC0415
    from distributed import Client, LocalCluster  # noqa: PLC0415

    if scheduler:
        try:
            client = Client(scheduler, timeout=CONNECT_S)
        except (OSError, ValueError) as error:
            raise UsageError(
                f"--scheduler {scheduler}: no Dask scheduler answers there ({error})"
            ) from error
        with client:
            yield client
        return
    with (
        tempfile.TemporaryDirectory(prefix="ropeteam-dask-") as scratch,
        config.set(_settings()),
        contextlib.ExitStack() as stack,
    ):
        with _ctrl_c_waits():
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    host=LOCAL,
                    dashboard_address=f"{LOCAL}:0",
                    worker_dashboard_address=f"{LOCAL}:0",
                    local_directory=scratch,
                    silence_logs=logging.CRITICAL,
                )
            )
        yield stack.enter_context(Client(cluster))


@contextlib.contextmanager
def _ctrl_c_waits() -> Generator[None]:
    """Have a Ctrl-C wait for the end of the block.

    A cluster of Dask's that is interrupted while it starts can't be closed in order.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
