"""Trials of `sandpit` and `field`: whole runs, in which a RECON-bot takes so many looks.

Every robot begins with the same looks all round, which are not counted; after them it takes as
many as it may, and whatever it looks at for (a bearing on a team-mate too), counts as a look.
"""

import csv
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from agents.planning import strategies
from scenarios.errors import StudyError, UsageError
from scenarios.experiments.frame import Options
from scenarios.experiments.ground import grids, oracle
from scenarios.experiments.ground.accuracy import accuracy
from scenarios.experiments.tables import Row
from scenarios.runner import RECORDS_ONLY, RunResult, run
from scenarios.schema import Scenario, load
from scenarios.stage import set_stage
from sim.errors import WorldError

PAPER = (
    "raster",
    "raster-yaw",
    "information-line",
    "information-edge",
    "information-interest",
)
"""Methods 1 to 5."""
OURS = "team-information"
ORACLE = "oracle"
LOOKS = 10
TWICE = "information-line"
"""Method 3 is given twice the looks: the paper says that it needs them."""
SHOWN = ("information-line", "information-interest", OURS)
"""Whose maps the figure shows."""
SENSORS = ("range", "stereo")
RECON = "recon"

SETTINGS = {
    "sensor": f"what the RECON-bot sees with: {' or '.join(SENSORS)} (range); also --sensor",
    "method": "only this way to choose a look, or `oracle`; may be repeated",
    "looks": f"looks after those all round ({LOOKS})",
    "world.terrain.file": "a measured ground (.npz or GeoTIFF) instead of the made one",
    "links.profile": "the robots' radio (uhf-9600)",
    "air": "zenoh, a process for each robot (field), or memory, all in one (sandpit)",
    "scenario": "KEY=VALUE for every run's scenario, e.g. scenario=map.cell_m=0.05",
}


@dataclass(frozen=True)
class Trial:
    """One run."""

    site: str
    method: str
    seed: int
    looks: int
    sets: tuple[str, ...] = ()
    pictured: bool = False
    """Its maps are kept for the figure."""


def trials_of(site: str, options: Options, methods: Sequence[str], air: str) -> list[Trial]:
    """Return the runs that are asked for, seed by seed.

    Raises StudyError for bad settings, before anything runs.
    """
    chosen = options.sets.get("method", (*methods, OURS, ORACLE))
    allowed = (*strategies.STRATEGIES.names(), ORACLE)
    for name in chosen:
        if name not in allowed:
            raise UsageError(f"--set method={name}: must be one of {', '.join(allowed)}")
    text = options.one("looks", str(LOOKS))
    if not text.isdecimal() or not 1 <= int(text) <= 100:
        raise UsageError(f"--set looks={text}: must be a whole number from 1 to 100")
    sets = _sets(options, air)
    made = [
        Trial(site, name, seed, int(text) * (2 if name == TWICE else 1), sets, name in SHOWN)
        for seed in range(1, options.seeds + 1)
        for name in chosen
    ]
    made = [trial if trial.seed == 1 else replace(trial, pictured=False) for trial in made]
    try:
        set_stage(scenario_of(made[0]))
    except WorldError as error:
        raise StudyError(str(error)) from error
    return made


def _sets(options: Options, air: str) -> tuple[str, ...]:
    sensor = options.one("sensor", SENSORS[0])
    if sensor not in SENSORS:
        raise UsageError(f"--sensor {sensor}: must be one of {', '.join(SENSORS)}")
    sets = [f"sensor.kind={sensor}", f"air={options.one('air', air)}"]
    for key in ("world.terrain.file", "links.profile"):
        value = options.one(key, "")
        if value:
            sets.append(f"{key}={value}")
    return (*sets, *options.sets.get("scenario", ()))


def scenario_of(trial: Trial) -> Scenario:
    """Return what is run."""
    method = strategies.STRATEGIES.names()[0] if trial.method == ORACLE else trial.method
    scenario = load(trial.site, [f"method={method}", *trial.sets], seed=trial.seed)
    most = scenario.planner.first_looks + trial.looks
    return load(
        trial.site,
        [f"method={method}", *trial.sets, f"planner.max_looks={most}"],
        seed=trial.seed,
    )


def measure(trial: Trial) -> Sequence[Row]:
    """Run it; return one row in all, one for each look, and the grids that the figure shows."""
    scenario = scenario_of(trial)
    base: Row = {"site": trial.site, "method": trial.method, "seed": trial.seed}
    if trial.method == ORACLE:
        told = oracle.explore(scenario, trial.looks)
        looks = [
            {"look": n, "new_cells": new, "cells": sum(told.new_cells[:n])}
            for n, new in enumerate(told.new_cells, 1)
        ]
        whole: Row = {"first_cells": told.first_cells, "looks": len(looks)}
        return [{**base, "row": "run", **whole}, *({**base, "row": "look", **r} for r in looks)]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        result = run(scenario, out, RECORDS_ONLY)
        looks, first = _looks(out, scenario.planner.first_looks, trial.looks)
        whole = {"first_cells": first, "looks": len(looks), **_ending(result)}
        whole |= accuracy(result, _eyes(out, scenario.planner.first_looks + trial.looks))
        rows: list[Row] = [{**base, "row": "run", **whole}]
        rows += [{**base, "row": "look", **look} for look in looks]
        if trial.pictured:
            until = scenario.planner.first_looks + trial.looks
            kept = grids.watched(out, Path(folder) / "again", RECON, until, result.stage)
            rows += [{**base, "row": "grid", **grid} for grid in kept]
    return rows


def _table(out: Path) -> list[dict[str, str]]:
    with (out / "looks.csv").open(newline="") as file:
        return [row for row in csv.DictReader(file) if row["robot"] == RECON]


def _looks(out: Path, first_looks: int, most: int) -> tuple[list[Row], int]:
    """Return a row for each look that counts, and the cells that the looks all round mapped."""
    told = _table(out)
    first = sum(int(row["new_cells"]) for row in told[:first_looks])
    rows: list[Row] = []
    cells = 0
    for number, row in enumerate(told[first_looks : first_looks + most], start=1):
        cells += int(row["new_cells"])
        rows.append(
            {
                "look": number,
                "expected_cells": float(row["expected_cells"]),
                "obtained_cells": int(row["obtained_cells"]),
                "new_cells": int(row["new_cells"]),
                "cells": cells,
                "driven_m": float(row["distance_m"]),
                "x_m": float(row["x_m"]),
                "y_m": float(row["y_m"]),
            }
        )
    return rows, first


def _eyes(out: Path, most: int) -> list[tuple[float, float]]:
    return [(float(row["x_m"]), float(row["y_m"])) for row in _table(out)[:most]]


def _ending(result: RunResult) -> Row:
    mission = result.summary["mission"]
    if not mission:
        return {}
    told: Row = {"reached": bool(mission["cliffbot_reached"])}
    told["hazards"] = int(mission["hazards_hit"])
    told["safe_path"] = mission["safe_path_at_s"] is not None
    return told
