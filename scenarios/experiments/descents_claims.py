"""What became of the missions of `descents`, and how right their maps were."""

import math
from collections.abc import Sequence

from scenarios.experiments.frame import Claim, Findings
from scenarios.experiments.ground.accuracy import CLASSES
from scenarios.experiments.tables import Cell, Row, Table, estimate

WELL = ("down", "stayed")
"""Ways for a mission to end well."""
BECAME = {
    "down": "got down, touched nothing",
    "stayed": "stayed, and said so",
    "neither": "neither: still on its way when the time was over",
    "hurt": "touched a rock or a step",
}
"""What may become of the Cliff-bot, in the order in which it is told."""
LEAST_WELL = 0.95
LIMITS_M = {"near_rmse_m": 0.10, "far_rmse_m": 0.20}
WHERE = {
    "near_rmse_m": "of height, on slopes below 30 degrees within 5 m of a look",
    "far_rmse_m": "from point to surface, elsewhere within 10 m",
}


def conclude(rows: Sequence[Row]) -> Findings:
    """Return what became of each mission, errors by kind of ground, and the verdicts."""
    errors = [claim for key in LIMITS_M if (claim := _right(rows, key))]
    tables = [_became(rows), *_failures(rows), _errors(rows), _sums(rows)]
    return Findings(tables, [_well(rows), _down(rows), *errors])


def count(rows: Sequence[Row], became: str) -> int:
    """Return how many missions ended that way."""
    return sum(row["became"] == became for row in rows)


def pooled(rows: Sequence[Row], name: str, kind: str) -> float:
    """Return the r.m.s. error of a class over all missions (`kind`: height or surface)."""
    cells = [float(row[f"{name}_cells"]) for row in rows]
    squares = [float(row[f"{name}_{kind}_m"]) ** 2 for row in rows]
    total = sum(n * s for n, s in zip(cells, squares, strict=True))
    return math.sqrt(total / max(sum(cells), 1.0))


def _became(rows: Sequence[Row]) -> Table:
    lines: list[list[Cell]] = [
        [words, count(rows, name), _seeds(rows, name)] for name, words in BECAME.items()
    ]
    columns = ["the Cliff-bot", "missions", "seeds"]
    return Table("missions", f"What became of {len(rows)} missions", columns, lines)


def _seeds(rows: Sequence[Row], became: str) -> str:
    """Return which seeds ended that way, where that is worth a look."""
    if became == "down":
        return ""
    return " ".join(str(row["seed"]) for row in rows if row["became"] == became)


def _failures(rows: Sequence[Row]) -> list[Table]:
    """Return the missions that ended otherwise than down, one by one; none if all did."""
    lines: list[list[Cell]] = [
        [
            str(row["seed"]),
            BECAME[str(row["became"])],
            "yes" if row["way_exists"] else "no",
            str(row["reason"]),
        ]
        for row in rows
        if row["became"] != "down"
    ]
    columns = ["seed", "the Cliff-bot", "a safe way exists", "what was said"]
    title = "Missions that ended otherwise than down"
    return [Table("failures", title, columns, lines)] if lines else []


def _errors(rows: Sequence[Row]) -> Table:
    lines: list[list[Cell]] = []
    for one in CLASSES:
        worst = [max(float(row[f"{one.name}_{kind}_m"]) for row in rows) for kind in _KINDS]
        means = [pooled(rows, one.name, kind) for kind in _KINDS]
        cells = sum(int(row[f"{one.name}_cells"]) for row in rows) / len(rows)
        lines.append([one.words, cells, means[0], worst[0], means[1], worst[1]])
    columns = ["slope, distance from the nearest look", "cells per mission"]
    columns += ["of height, m", "worst mission", "to the surface, m", "worst mission's"]
    title = "The team map's r.m.s. error, over the cells of all missions"
    return Table("errors", title, columns, lines, ("", ",.0f", ".3f", ".3f", ".3f", ".3f"))


_KINDS = ("height", "surface")


def _sums(rows: Sequence[Row]) -> Table:
    names = {
        "near_rmse_m": (f"error {WHERE['near_rmse_m']}, m", ".3f"),
        "far_rmse_m": (f"error {WHERE['far_rmse_m']}, m", ".3f"),
        "recon_pose_rms_m": ("the RECON-bot's pose, r.m.s. error over its way, m", ".3f"),
        "legs": ("its legs", ".1f"),
        "legs_told": ("those of which images told the motion", ".1f"),
        "looks": ("looks", ".1f"),
        "ill_looks": ("of them with a reason why they gave less", ".1f"),
        "simulated_s": ("simulated time, s", ",.0f"),
    }
    lines: list[list[Cell]] = []
    for key, (words, spec) in names.items():
        values = [float(row[key]) for row in rows if key in row]
        if values:
            largest = format(max(values), spec)
            lines.append([words, format(estimate(values), spec), largest])
    return Table("whole", "Means over missions", ["", "mean", "largest"], lines)


def _well(rows: Sequence[Row]) -> Claim:
    well = sum(count(rows, name) for name in WELL)
    text = "the Cliff-bot gets down without touching a hazard, or stays and says so, in 95 of 100"
    found = f"{well} of {len(rows)} missions; in {count(rows, 'hurt')} it touched something"
    return Claim(text, "ours", well >= LEAST_WELL * len(rows), well / len(rows), found)


def _down(rows: Sequence[Row]) -> Claim:
    down = count(rows, "down")
    text = "it gets down without touching a hazard in 95 of 100"
    ways = sum(bool(row["way_exists"]) for row in rows)
    found = (
        f"{down} of {len(rows)} missions, in {ways} of which the ground as it is has a safe way;"
        f" in {count(rows, 'stayed')} it stayed and said so"
    )
    return Claim(text, "ours", down >= LEAST_WELL * len(rows), down / len(rows), found)


def _right(rows: Sequence[Row], key: str) -> Claim | None:
    values = [float(row[key]) for row in rows if key in row]
    if not values:
        return None
    limit_m, worst_m = LIMITS_M[key], max(values)
    within = sum(value <= limit_m for value in values)
    text = f"the team map's r.m.s. error {WHERE[key]}, is at most {limit_m:.2f} m in every mission"
    mean = estimate(values).mean
    found = f"{mean:.3f} m, the worst {worst_m:.3f} m; {within} of {len(values)} were within"
    return Claim(text, "ours", worst_m <= limit_m, worst_m, found)
