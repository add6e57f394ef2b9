"""What thin links do to a team: catching up, lagging behind, and the mission.

The paper (section 2.4) sends maps over links of 2400 bps and leaves open when and what to share.
Three questions, each over seeds of whole runs:

- `catch-up`: a team-mate joins when the map is finished; until when does it hold 90 % of it?
- `lag`: how much of what was measured do listeners lack, over a mission at 2400 bps?
- `mission`: against a link without limit, how much later is the safe path found (`cliff`), and how
  much less is mapped at any time (`pair`)?
"""

import csv
import json
import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from agents.sharing import WAYS
from scenarios.errors import UsageError
from scenarios.experiments.frame import Experiment, Options
from scenarios.experiments.sharing_claims import conclude
from scenarios.experiments.sharing_figure import draw
from scenarios.experiments.tables import Row
from scenarios.runner import RECORDS_ONLY, run
from scenarios.schema import Scenario, load

THIN_BPS = 2400.0
RATES_BPS = {
    "cliff": (math.inf, 9600.0, THIN_BPS, 600.0),
    "pair": (math.inf, THIN_BPS, 600.0, 0.0),
}
"""Links of the mission: unlimited, 9600 baud, Sojourner's, one that binds, and none."""
JOIN_S = 1500.0
"""A latecomer joins when the map has been finished for some time."""
MISSION_S = {"cliff": 1200.0, "pair": 3000.0}
SERIES_S = 30.0
SAMPLE_S = {"catch-up": 1.0, "lag": 1.7, "mission": 1.7}
"""How often maps are weighed. Looks end at multiples of 5 s: who weighs just then finds each before
a word of it could be sent, and counts it as lacking until the next time."""
CAUGHT_UP = 0.9
PARTS = ("catch-up", "lag", "mission")


@dataclass(frozen=True)
class Trial:
    """One run."""

    part: str
    scenario: str
    seed: int
    policy: str
    rate_bps: float
    sets: tuple[str, ...] = ()


def trials(options: Options) -> Sequence[Trial]:
    """Return all runs of the parts that are asked for."""
    parts = options.sets.get("part", PARTS)
    unknown = [part for part in parts if part not in PARTS]
    if unknown:
        raise UsageError(f"--set part={unknown[0]}: must be one of {', '.join(PARTS)}")
    sets = tuple(options.sets.get("scenario", ()))
    made = [trial for seed in range(1, options.seeds + 1) for trial in _of_seed(seed, parts, sets)]
    for trial in made[: len(made) // max(options.seeds, 1)]:
        scenario_of(trial)  # bad settings are refused before anything runs
    return made


def _of_seed(seed: int, parts: Sequence[str], sets: tuple[str, ...]) -> Iterator[Trial]:
    for part in parts:
        match part:
            case "catch-up":
                for policy in WAYS.own:
                    yield Trial(part, "cliff", seed, policy, THIN_BPS, sets)
            case "lag":
                # What `value` does at this rate is a run of the mission too, if that is run.
                others = [p for p in WAYS.own if p != "value" or "mission" not in parts]
                for scenario in MISSION_S:
                    for policy in others:
                        yield Trial(part, scenario, seed, policy, THIN_BPS, sets)
            case _:
                for scenario in MISSION_S:
                    for rate_bps in RATES_BPS[scenario]:
                        yield Trial(part, scenario, seed, "value", rate_bps, sets)


def scenario_of(trial: Trial) -> Scenario:
    """Return what is run; Sojourner's radio at the rate that is asked for."""
    sample = f"sample_s={SAMPLE_S[trial.part]:g}"
    sets = ["air=memory", sample, f"sharing.policy={trial.policy}", *trial.sets]
    if trial.part == "catch-up":
        # The map is made over an unlimited link, which becomes thin as the latecomer joins.
        thin = f'{{at_s = {JOIN_S:g}, link = "all", profile = "sojourner"}}'
        sets += ["links.profile=unlimited", f"events=[{thin}]", "planner.max_looks=45"]
        sets += [f"robots.cliffbot.join_s={JOIN_S:g}", f"limit_s={2 * JOIN_S:g}"]
    elif math.isinf(trial.rate_bps):
        sets += ["links.profile=unlimited", f"limit_s={MISSION_S[trial.scenario]:g}"]
    else:
        sets += ["links.profile=sojourner", f"links.rate_bps={trial.rate_bps:g}"]
        sets += [f"limit_s={MISSION_S[trial.scenario]:g}"]
    return load(trial.scenario, sets, seed=trial.seed)


def measure(trial: Trial) -> Sequence[Row]:
    """Run it, and return what its records say: one row in all, and one for each half minute."""
    base: Row = {
        "part": trial.part,
        "scenario": trial.scenario,
        "seed": trial.seed,
        "policy": trial.policy,
        "rate_bps": trial.rate_bps,
    }
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        run(scenario_of(trial), out, RECORDS_ONLY)
        samples = _samples(out)
        summary = json.loads((out / "summary.json").read_text())
        robots = len(summary["robots"])
        found: Row = {**base, "row": "run", "simulated_s": summary["simulated_s"]}
        found |= _lag(samples, robots)
        found |= _bytes(out, robots, float(summary["simulated_s"]))
        if trial.part == "catch-up":
            found |= _catch_up(samples, summary)
        elif trial.scenario == "cliff":
            found["safe_path_s"] = _safe_path_s(out)
    observable = float(summary["team"]["observable_cells"])
    series = [
        {**base, "row": "series", "t_s": t_s, "coverage": cells / observable, "lacking_share": lack}
        for t_s, cells, lack in _series(samples, robots)
    ]
    return [found, *(series if trial.part != "catch-up" else [])]


Samples = dict[float, dict[str, dict[str, float]]]
"""By time and robot: what `maps.csv` says."""


def _samples(out: Path) -> Samples:
    samples: Samples = {}
    with (out / "maps.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            told = {key: float(row[key]) for key in ("map_cells", "own_bits", "heard_bits")}
            samples.setdefault(float(row["t_s"]), {})[row["robot"]] = told
    return samples


def _lacking(robots: dict[str, dict[str, float]]) -> tuple[float, float]:
    """Return the bits that listeners lack of what others measured, and how many there are."""
    measured = sum(told["own_bits"] for told in robots.values())
    lacking = [measured - told["own_bits"] - told["heard_bits"] for told in robots.values()]
    there = [measured - told["own_bits"] for told in robots.values()]
    return sum(max(0.0, bits) for bits in lacking), sum(there)


def _lag(samples: Samples, robots: int) -> Row:
    """Return what was lacked over the mission: bits times seconds, and as a share of what was."""
    times = sorted(t for t in samples if len(samples[t]) == robots)
    lacking = there = 0.0
    for start, end in pairwise(times):
        bits, all_bits = _lacking(samples[start])
        lacking += bits * (end - start)
        there += all_bits * (end - start)
    return {"lacking_bit_s": lacking, "lacking_share": lacking / there if there else 0.0}


def _series(samples: Samples, robots: int) -> Iterator[tuple[float, float, float]]:
    """Yield time, cells that a robot's map knows (mean over robots), and the share lacking."""
    due_s = 0.0
    for t_s in sorted(samples):
        if t_s >= due_s and len(samples[t_s]) == robots:
            due_s += SERIES_S
            cells = sum(told["map_cells"] for told in samples[t_s].values()) / robots
            bits, all_bits = _lacking(samples[t_s])
            yield t_s, cells, bits / all_bits if all_bits else 0.0


def _bytes(out: Path, robots: int, simulated_s: float) -> Row:
    """Return what went over the air, charged, in kilobytes per robot and minute."""
    sent: dict[str, int] = {}
    with (out / "frames.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            sent[row["kind"]] = sent.get(row["kind"], 0) + int(row["bytes"])
    per = 1000 * robots * (robots - 1) * simulated_s / 60  # each frame has a row per team-mate
    told: Row = {f"{kind}_kb_per_robot_min": sent.get(kind, 0) / per for kind in ("map", "digest")}
    return {**told, "kb_per_robot_min": sum(sent.values()) / per}


def _catch_up(samples: Samples, summary: dict[str, dict[str, dict[str, float]]]) -> Row:
    """Return how long the latecomer took, and how long the encoded bytes alone would take.

    The map that is to be caught up with is the one that the others hold, who heard it over a link
    without limit: a policy that leaves something out is not asked for it.
    """
    after = [t for t in sorted(samples) if t >= JOIN_S and "cliffbot" in samples[t]]
    others = [bits["heard_bits"] for name, bits in samples[after[0]].items() if "anchor" in name]
    wanted = CAUGHT_UP * max(others)
    held = next((t for t in after if samples[t]["cliffbot"]["heard_bits"] >= wanted), math.inf)
    store_bytes = summary["robots"]["anchor-left"]["map_payload_bytes"]
    return {
        "catch_up_s": held - JOIN_S,
        "payload_bytes": store_bytes,
        "ideal_s": CAUGHT_UP * 8 * store_bytes / THIN_BPS,
        "map_bits": max(others),
    }


def _safe_path_s(out: Path) -> float:
    with (out / "events.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            if row["what"] == "safe path":
                return float(row["t_s"])
    return math.inf


EXPERIMENT = Experiment(
    trials=trials,
    measure=measure,
    conclude=conclude,
    draw=draw,
    settings={
        "part": f"only this part ({', '.join(PARTS)}); may be repeated",
        "scenario": "KEY=VALUE for every run's scenario, e.g. scenario=map.cell_m=0.2",
    },
)
