"""`descents`: whole cliff missions on stereo eyes: how right maps are, and who got down.

Nothing is given from the truth: poses are the robots' own estimates, points come out of rendered
pairs, and the Cliff-bot, which sees nothing, goes down by the map that it is sent. A mission ends
well when it got down, or stayed up and said so, and touched no rock and no step.
"""

import csv
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agents.ground.paths import travel_field
from agents.planning.waydown import GOAL_M, within
from scenarios.errors import StudyError, UsageError
from scenarios.experiments.descents_claims import conclude
from scenarios.experiments.descents_figure import draw
from scenarios.experiments.frame import Experiment, Options
from scenarios.experiments.ground.accuracy import accuracy, by_class
from scenarios.experiments.ground.runs import SENSORS
from scenarios.experiments.tables import Row
from scenarios.runner import RECORDS_ONLY, RunResult, run
from scenarios.schema import Scenario, load
from scenarios.stage import Stage, set_stage
from sim.errors import WorldError
from sim.ground import Terrain, footing_on

CELL_M = 0.05
LEAST_GAIN_M2 = 2.5
"""A look that is expected to show less is not worth its way, however fine the cells are."""
SAMPLE_S = 20
"""Robots weigh their maps for the record so often: here nobody reads that."""
RECON = "recon"
CLIFFBOT = "cliffbot"


@dataclass(frozen=True)
class Trial:
    """One mission."""

    seed: int
    sets: tuple[str, ...]


def trials(options: Options) -> Sequence[Trial]:
    """Return a mission for each seed.

    Raises StudyError for bad settings, before anything runs.
    """
    sensor = options.one("sensor", "stereo")
    if sensor not in SENSORS:
        raise UsageError(f"--sensor {sensor}: must be one of {', '.join(SENSORS)}")
    cell_m = options.number("cell_m", CELL_M)
    sets = [f"sensor.kind={sensor}", f"air={options.one('air', 'memory')}", f"map.cell_m={cell_m}"]
    sets += [f"sample_s={SAMPLE_S}", "ends=descent"]
    sets += [f"planner.min_gain_cells={LEAST_GAIN_M2 / max(cell_m, 0.01) ** 2:g}"]
    file = options.one("world.terrain.file", "")
    sets += [f"world.terrain.file={file}"] if file else []
    sets += options.sets.get("scenario", ())
    text = options.one("first_seed", "1")
    if not text.isdecimal():
        raise UsageError(f"--set first_seed={text}: must be a whole number")
    first = int(text)
    made = [Trial(seed, tuple(sets)) for seed in range(first, first + options.seeds)]
    try:
        set_stage(_scenario(made[0]))
    except WorldError as error:
        raise StudyError(str(error)) from error
    return made


def _scenario(trial: Trial) -> Scenario:
    return load("cliff", trial.sets, seed=trial.seed)


def measure(trial: Trial) -> Sequence[Row]:
    """Run a mission; return its one row."""
    with tempfile.TemporaryDirectory(prefix="ropeteam-descent-") as folder:
        out = Path(folder) / "run"
        result = run(_scenario(trial), out, RECORDS_ONLY)
        looks, events = _table(out, "looks"), _table(out, "events")
    eyes_m = [(float(row["x_m"]), float(row["y_m"])) for row in looks]
    row: Row = {"seed": trial.seed, **_ending(result, events), "looks": len(looks)}
    row |= legs(events)
    row["way_exists"] = way_exists(result.stage)
    row["recon_pose_rms_m"] = result.summary["robots"][RECON]["pose_error_rms_m"]
    return [{**row, **accuracy(result, eyes_m), **by_class(result, eyes_m)}]


def way_exists(stage: Stage) -> bool:
    """Say whether the ground as it is has a way down on which the Cliff-bot touches nothing."""
    terrain, drive = stage.terrain, stage.scenario.drive
    assert isinstance(terrain, Terrain)
    assert stage.goal_m is not None
    footing = footing_on(terrain, drive.footprint_m, drive.wheel_m, drive.climb_m)
    cost = np.where(footing.open & ~footing.contact, 1.0, np.inf)
    stand = stage.starts[CLIFFBOT]
    start = np.array([terrain.frame.cell_of(stand.x_m, stand.y_m)])
    away_m, _ = travel_field(cost, start, terrain.frame.cell_m)
    return bool(np.isfinite(away_m[within(terrain.frame, stage.goal_m, GOAL_M)]).any())


def _table(out: Path, name: str) -> list[dict[str, str]]:
    with (out / f"{name}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def _ending(result: RunResult, events: Sequence[dict[str, str]]) -> Row:
    """Return what became of the Cliff-bot, and when."""
    mission = result.summary["mission"]
    said = {row["what"] for row in events if row["robot"] == CLIFFBOT}
    hazards, reached = int(mission["hazards_hit"]), bool(mission["cliffbot_reached"])
    stayed = "stayed" if "stuck" in said else "neither"
    return {
        "became": "hurt" if hazards else "down" if reached else stayed,
        "hazards": hazards,
        "reached": reached,
        "knew_a_way": mission["safe_path_at_s"] is not None,
        "simulated_s": float(result.summary["simulated_s"]),
        "reason": _why(events) or str(result.summary["outcome_reason"]),
    }


def _why(events: Sequence[dict[str, str]]) -> str:
    """Return what the Cliff-bot said when it gave up; empty if it did not."""
    said = [e["detail"] for e in events if e["robot"] == CLIFFBOT and e["what"] == "stuck"]
    return said[-1] if said else ""


def legs(events: Sequence[dict[str, str]]) -> Row:
    """Return how many legs there were, of how many images told the motion, and ill looks."""
    mine = [row for row in events if row["robot"] == RECON]
    told = [row["detail"].split(" ") for row in mine if row["what"] == "motion from images"]
    return {
        "legs": sum(int(words[2]) for words in told),  # "6 of 13 legs" since the last time
        "legs_told": sum(int(words[0]) for words in told),
        "ill_looks": sum(row["what"] == "ill look" for row in mine),
    }


EXPERIMENT = Experiment(
    trials=trials,
    measure=measure,
    conclude=conclude,
    draw=draw,
    settings={
        "sensor": f"what the RECON-bot sees with: {' or '.join(SENSORS)} (stereo); also --sensor",
        "cell_m": f"the map's cells in metres ({CELL_M:g})",
        "first_seed": "the seed to begin with (1)",
        "world.terrain.file": "a measured ground (.npz or GeoTIFF) instead of the made one",
        "air": "memory, all robots in one process (the default), or zenoh, a process for each",
        "scenario": "KEY=VALUE for every run's scenario, e.g. scenario=links.profile=sojourner",
    },
)
