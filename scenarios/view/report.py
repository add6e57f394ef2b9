"""`report.html` of a run: a playback of it, its figures and its tables, in one file."""

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from scenarios.errors import UsageError
from scenarios.records.tables import write_atomic
from scenarios.view.page import self_contained
from scenarios.view.playback import Rows, read_playback
from scenarios.view.rundir import Run, Table, fitting, read_run

FILE = "report.html"
_VERSIONS = ("ropeteam", "eclipse-zenoh", "numpy", "scipy", "numba")


def write_report(path: Path, out: Path | None = None) -> Path:
    """Make the report of the run in a folder, from its files; return where it is.

    Raises:
        UsageError: it is no run, or one that kept no playback; `out` can't be written to.

    """
    run = read_run(path)
    head, rows = read_playback(path)
    with fitting(path):
        rows.update(_rows(run, {robot["name"]: n for n, robot in enumerate(head["robots"])}))
    data = {
        "head": head,
        "rows": rows,
        "end": end_of(run),
    }
    text = self_contained(f"{head['title']} (seed {head['seed']})", "report", data)
    return keep(path / FILE if out is None else out, text)


def keep(out: Path, text: str) -> Path:
    """Write a page that a user asked for.

    Raises:
        UsageError: it can't be written there.

    """
    try:
        write_atomic(out, text)
    except OSError as error:
        raise UsageError(f"{out}: can't be written: {error.strerror}") from error
    return out


def end_of(run: Run) -> dict[str, Any]:
    """Return what a page is told of a run that has ended."""
    return {"summary": run.summary, "scenario": run.scenario, "versions": versions()}


def versions() -> dict[str, str]:
    """Return the versions of what a run's figures depend on."""
    found: dict[str, str] = {}
    for name in _VERSIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # run from a folder that was never installed
            continue
    return found


def _rows(run: Run, index: dict[str, int]) -> Rows:
    """Return a run's tables as a page is told them (see `scenarios.view.reel`)."""
    return {
        "looks": [_look(row, index) for row in run.looks],
        **_frames(run.frames, index),
        "maps": [
            [
                index[row["robot"]], _float(row["t_s"]), int(row["map_cells"]),
                int(row["own_cells"]), int(row["team_cells"]), _float(row["elevation_rmse_m"], 4),
            ]
            for row in run.maps
        ],
        "events": [
            [index.get(row["robot"], row["robot"]), _float(row["t_s"]), row["what"], row["detail"]]
            for row in run.events
        ],
    }  # fmt: skip


def _look(row: dict[str, str], index: dict[str, int]) -> list[Any]:
    keys = ("t_s", "x_m", "y_m", "pan_rad", "expected_cells")
    counts = (int(row["obtained_cells"]), int(row["new_cells"]))
    place = [_float(row[key]) for key in keys]
    return [index[row["robot"]], *place, *counts, _float(row["coverage"], 5)]


def _frames(table: Table, index: dict[str, int]) -> Rows:
    """Return frames and their arrivals; a frame has a row for each team-mate in the table."""
    tx: list[Any] = []
    rx: list[Any] = []
    numbers: dict[tuple[str, ...], int] = {}
    for row in table:
        key = (row["from"], row["start_s"], row["end_s"], row["kind"], row["chosen_s"])
        number = numbers.setdefault(key, len(numbers))
        sender = index[row["from"]]
        if number == len(tx):
            when = [_float(row[key]) for key in ("start_s", "end_s", "chosen_s")]
            tx.append([sender, number, row["kind"], int(row["bytes"]), *when])
        arrive_s = _float(row["arrive_s"] or row["end_s"])
        rx.append([index[row["to"]], sender, number, arrive_s, row["verdict"]])
    return {"tx": tx, "rx": rx}


def _float(text: str, digits: int = 3) -> float | None:
    return round(float(text), digits) if text else None
