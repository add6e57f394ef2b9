"""One trial: a complete scenario in, what came out of it back, as plain values.

It runs where Dask puts it, maybe on another machine: it takes and returns text, shares no files,
and whatever goes wrong in it is part of what it returns.
"""

import csv
import faulthandler
import importlib
import json
import math
import tempfile
import tomllib
import traceback
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, cast

from scenarios.runner import RECORDS_ONLY, run
from scenarios.schema import parse

Number = int | float | bool | str | None
SHARES = (0.5, 0.8)
"""When the robots' maps knew so much of what can be seen is a column of the table."""


@dataclass(frozen=True)
class Told:
    """What came of a trial."""

    state: Literal["done", "failed"]
    error: str = ""
    """Why it failed, in one line."""
    log: str = ""
    """What there is to know of its failure."""
    summary: str = ""
    """The run's `summary.json`, as it is."""
    host: str = ""
    """The run's `host.json`."""
    measures: dict[str, Number] = field(default_factory=dict[str, Number])
    """What the table has beside the summary (`measures_of`)."""


def measure(text: str, death_log: str = "") -> Told:
    """Run the scenario in `text` (TOML) in this process.

    A crash of the process itself (a segmentation fault) leaves its trace in the file `death_log`.
    """
    with tempfile.TemporaryDirectory(prefix="ropeteam-trial-") as folder, ExitStack() as stack:
        if death_log:
            file = stack.enter_context(Path(death_log).open("w"))
            faulthandler.enable(file)
            stack.callback(faulthandler.disable)
        try:
            return _measured(text, Path(folder) / "run")
        except Exception as error:
            name, words = type(error).__name__, str(error).strip()
            line = words.splitlines()[-1] if words else ""
            return Told("failed", f"{name}: {line}", traceback.format_exc())


def _measured(text: str, out: Path) -> Told:
    cv2 = importlib.import_module("cv2")
    cv2.setNumThreads(1)  # the other cores are for the other trials
    scenario = parse(tomllib.loads(text), "trial")
    run(scenario, out, RECORDS_ONLY)
    summary = (out / "summary.json").read_text()
    told = cast("dict[str, Any]", json.loads(summary))
    measures = measures_of(out, told, scenario.limit_s)
    return Told("done", summary=summary, host=(out / "host.json").read_text(), measures=measures)


def measures_of(out: Path, summary: Mapping[str, Any], limit_s: float) -> dict[str, Number]:
    """Return what a run's records tell beyond its summary.

    - `team.mapped_50_s`, `team.mapped_80_s`: from when on the robots' own team maps held 50 or 80 %
      of the observable cells, in the mean over the robots that ran; None: never.
    - `team.coverage_mean`: that share's mean over the time up to the scenario's limit; it counts
      both what was mapped and how soon everybody had it. A run that ends before keeps its last.
    - `mission.reached_at_s`: when the Cliff-bot was down; None: never. (Only where there is one.)
    """
    observable = int(summary["team"]["observable_cells"])
    series = list(_coverage(out, observable))
    found: dict[str, Number] = {
        f"team.mapped_{share:.0%}_s".replace("%", ""): next(
            (t_s for t_s, held in series if held >= share), None
        )
        for share in SHARES
    }
    found["team.coverage_mean"] = _mean_over(series, limit_s)
    if summary["mission"]:
        found["mission.reached_at_s"] = _event_s(out, "reached")
    return found


def _rows(path: Path) -> Iterator[dict[str, str]]:
    with path.open(newline="") as file:
        yield from csv.DictReader(file)


def _coverage(out: Path, observable: int) -> Iterator[tuple[float, float]]:
    """Yield time and the share of the observable cells that a robot's map holds, in the mean."""
    cells: dict[float, list[float]] = {}
    for row in _rows(out / "maps.csv"):
        cells.setdefault(float(row["t_s"]), []).append(float(row["map_cells"]))
    for t_s in sorted(cells):
        mean = math.fsum(cells[t_s]) / len(cells[t_s])
        yield t_s, min(1.0, mean / observable) if observable else 0.0


def _mean_over(series: list[tuple[float, float]], limit_s: float) -> float:
    ends = [*series, (limit_s, 0.0)]
    area = math.fsum(held * max(0.0, after - t) for (t, held), (after, _) in pairwise(ends))
    return area / limit_s


def _event_s(out: Path, what: str) -> float | None:
    return next(
        (float(row["t_s"]) for row in _rows(out / "events.csv") if row["what"] == what), None
    )
