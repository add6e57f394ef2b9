"""What became of the paper's claims about choosing looks (section 3.1), and the tables."""

import math
from collections.abc import Sequence

import numpy as np

from scenarios.experiments.frame import Claim, Findings
from scenarios.experiments.planar_runs import GOAL, OURS, PAPER, VARIANTS
from scenarios.experiments.tables import Cell, Row, Table, estimate

NAMES = {
    "random": "(i)",
    "raster": "(ii)",
    "max-new": "(iii)",
    "min-old": "(iv)",
    "information": "(v)",
}
SOURCE = "section 3.1"
DEAR = 1.5
"""Being worse by this factor in one thing excuses being better in the other."""


def conclude(rows: Sequence[Row]) -> Findings:
    """Return a table for each world, and what became of the claims in the first."""
    tables = [_table(rows, world) for world in worlds(rows)]
    claims = [claim for world in worlds(rows) for claim in _claims(rows, world)]
    return Findings(tables, claims)


def worlds(rows: Sequence[Row]) -> list[str]:
    """Return the worlds, in order."""
    return list(dict.fromkeys(str(row["world"]) for row in rows))


def methods(rows: Sequence[Row]) -> list[str]:
    """Return the ways of choosing, in order."""
    return list(dict.fromkeys(str(row["method"]) for row in rows))


def runs(rows: Sequence[Row], world: str, method: str, robots: int = 0) -> list[Row]:
    """Return the runs of one way of choosing; of the largest team, or of one of this size."""
    mine = [
        row
        for row in rows
        if row["row"] == "run" and row["world"] == world and row["method"] == method
    ]
    size = robots or max((int(row["robots"]) for row in mine), default=0)
    return [row for row in mine if row["robots"] == size]


def curve(
    rows: Sequence[Row], world: str, method: str, key: str, looks: int, robots: int = 0
) -> list[float]:
    """Return a value after each look, mean over seeds; a run that is over stays as it ended."""
    size = robots or max(int(row["robots"]) for row in rows)
    by_seed: dict[int, dict[int, float]] = {}
    for row in rows:
        if (row["row"], row["world"], row["method"], row["robots"]) == (
            "look", world, method, size,
        ):  # fmt: skip
            by_seed.setdefault(int(row["seed"]), {})[int(row["look"])] = float(row[key])
    filled = [
        [told.get(n, told[max(told)]) for n in range(1, looks + 1)] for told in by_seed.values()
    ]
    return [float(v) for v in np.mean(filled, axis=0)] if filled else []


def _estimated(found: Sequence[Row], key: str) -> Cell:
    values = [float(row[key]) for row in found]
    reached = [value for value in values if math.isfinite(value)]
    if len(reached) < len(values):
        return f"{len(reached)} of {len(values)} only"
    return estimate(values)


def _table(rows: Sequence[Row], world: str) -> Table:
    lines: list[list[Cell]] = []
    for method in methods(rows):
        for robots in sorted({int(row["robots"]) for row in rows}, reverse=True):
            found = runs(rows, world, method, robots)
            if found:
                lines.append(_line(method, robots, found))
    title = f"World {world}: to {GOAL:.0%} of the observable area, and to the end"
    columns = [
        "method", "robots", "looks", "driven, m", "time, s", "looks in all", "driven in all, m",
        "mapped, %", "m2 per m", "run_cpu_s",
    ]  # fmt: skip
    formats = ["", "d", ".1f", ".0f", ".0f", ".1f", ".0f", ".1f", ".2f", ".1f"]
    return Table(f"methods-{world}", title, columns, lines, formats)


def _line(method: str, robots: int, found: Sequence[Row]) -> list[Cell]:
    return [
        f"{method} {NAMES.get(method, '')}".strip(),
        robots,
        _estimated(found, "looks_to_goal"),
        _estimated(found, "driven_to_goal_m"),
        _estimated(found, "time_to_goal_s"),
        _estimated(found, "looks"),
        _estimated(found, "driven_m"),
        estimate([100.0 * float(row["coverage"]) for row in found]),
        estimate([per_metre(row) for row in found]),
        _estimated(found, "run_cpu_s"),
    ]


def per_metre(row: Row) -> float:
    """Return the area mapped per metre driven, m2/m; 0 for who never left its place."""
    driven_m = float(row["driven_m"])
    return float(row["area_m2"]) / driven_m if driven_m > 0 else 0.0


def mean(found: Sequence[Row], key: str) -> float:
    """Return the mean of a value over runs; inf where one has no end."""
    return float(np.mean([float(row[key]) for row in found])) if found else math.inf


def _claims(rows: Sequence[Row], world: str) -> list[Claim]:
    there = set(methods(rows))
    claims: list[Claim] = []
    if set(PAPER) <= there:
        claims += [_best_per_metre(rows, world), _worst_per_metre(rows, world)]
        claims += [_random_ends_ahead(rows, world), _farther_for_more(rows, world)]
    if {OURS, *PAPER, *VARIANTS} <= there:
        claims += [_less_driven(rows, world), _not_beaten(rows, world)]
    if len({row["robots"] for row in rows}) > 1 and OURS in there:
        claims.append(_sooner_by_two(rows, world))
    return claims


def _rates(rows: Sequence[Row], world: str) -> dict[str, float]:
    return {
        method: float(np.mean([per_metre(row) for row in runs(rows, world, method)]))
        for method in methods(rows)
    }


def _best_per_metre(rows: Sequence[Row], world: str) -> Claim:
    rate = _rates(rows, world)
    informed = [name for name in ("information", *VARIANTS) if name in rate]
    ours = max(informed, key=lambda name: rate[name])
    other = max(PAPER[:-1], key=lambda name: rate[name])
    ratio = rate[ours] / rate[other]
    found = f"{ours} maps {rate[ours]:.2f} m2 per m driven, {other} {rate[other]:.2f}"
    text = f"{world}: (v) maps the most area per distance moved"
    return Claim(text, SOURCE, ratio > 1.0, ratio, found)


def _worst_per_metre(rows: Sequence[Row], world: str) -> Claim:
    rate = _rates(rows, world)
    other = min(PAPER[1:], key=lambda name: rate[name])
    ratio = rate["random"] / rate[other]
    found = f"random maps {rate['random']:.2f} m2 per m driven, {other} {rate[other]:.2f}"
    text = f"{world}: (i) maps the least area per distance moved"
    return Claim(text, SOURCE, ratio < 1.0, ratio, found)


def _random_ends_ahead(rows: Sequence[Row], world: str) -> Claim:
    ends = {
        method: {int(row["seed"]): float(row["coverage"]) for row in runs(rows, world, method)}
        for method in ("random", "max-new", "min-old")
    }
    ahead = [
        seed
        for seed, share in ends["random"].items()
        if share > min(ends["max-new"][seed], ends["min-old"][seed])
    ]
    share = len(ahead) / len(ends["random"])
    text = f"{world}: (i) can end with more mapped than (iii) or (iv)"
    found = f"it did over {len(ahead)} of {len(ends['random'])} seeds"
    return Claim(text, SOURCE, share > 0, share, found)


def _farther_for_more(rows: Sequence[Row], world: str) -> Claim:
    """Compare (v) and (iii) after as many looks as (iii) takes to half of the goal."""
    new = curve(rows, world, "max-new", "coverage", 1000)
    looks = next((n + 1 for n, share in enumerate(new) if share >= 0.5 * GOAL), len(new))
    coverage = [curve(rows, world, m, "coverage", looks)[-1] for m in ("information", "max-new")]
    driven = [curve(rows, world, m, "driven_m", looks)[-1] for m in ("information", "max-new")]
    more, farther = coverage[0] / coverage[1], driven[0] / max(driven[1], 1e-9)
    text = f"{world}: (v) moves slightly farther than (iii) but maps much more"
    found = f"after {looks} looks: {farther:.2f} times as far, {more:.2f} times as much mapped"
    return Claim(text, SOURCE, 1.0 <= farther <= 1.5 and more >= 1.1, more, found)


def _less_driven(rows: Sequence[Row], world: str) -> Claim:
    ours = mean(runs(rows, world, OURS), "driven_to_goal_m")
    theirs = min(
        mean(runs(rows, world, name), "driven_to_goal_m")
        for name in ("information", "information-voxel")
    )
    ratio = ours / theirs if math.isfinite(theirs) else (0.0 if math.isfinite(ours) else math.inf)
    text = f"{world}: `{OURS}` drives at most 0.6 times as far as (v), the better of two readings"
    return Claim(text, "ours", ratio <= 0.6, ratio, f"{ratio:.3f} times as far ({ours:.0f} m)")


def _not_beaten(rows: Sequence[Row], world: str) -> Claim:
    ours = [mean(runs(rows, world, OURS), key) for key in ("looks_to_goal", "driven_to_goal_m")]
    worst = math.inf
    name = ""
    for method in (*PAPER, *VARIANTS):
        theirs = [
            mean(runs(rows, world, method), key) for key in ("looks_to_goal", "driven_to_goal_m")
        ]
        for a, b in ((0, 1), (1, 0)):
            # How much worse it is in b, where it is better in a.
            if theirs[a] < ours[a] and theirs[b] / ours[b] < worst:
                worst, name = theirs[b] / ours[b], method
    text = (
        f"{world}: whoever beats `{OURS}` in looks or distance is {DEAR} times worse in the other"
    )
    if not name:
        return Claim(text, "ours", True, worst, "nobody beats it in either")
    found = f"the nearest is {name}, {worst:.2f} times worse in the other"
    return Claim(text, "ours", worst >= DEAR, worst, found)


def _sooner_by_two(rows: Sequence[Row], world: str) -> Claim:
    two = {int(r["seed"]): float(r["time_to_goal_s"]) for r in runs(rows, world, OURS, 2)}
    one = {int(r["seed"]): float(r["time_to_goal_s"]) for r in runs(rows, world, OURS, 1)}
    ratio = float(np.mean([two[seed] / one[seed] for seed in two if seed in one]))
    text = f"{world}: two robots need at most 0.6 of the time of one with the same sensor"
    found = f"{ratio:.3f} of the time, by `{OURS}`, what one measures being known to both at once"
    return Claim(text, "ours", ratio <= 0.6, ratio, found)
