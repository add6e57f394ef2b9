"""What became of the paper's claims of section 3.2, and the tables."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from scenarios.experiments.frame import Claim, Findings
from scenarios.experiments.ground.runs import LOOKS, ORACLE, OURS, PAPER, TWICE
from scenarios.experiments.tables import Cell, Row, Table, estimate

NUMBERS = {name: number for number, name in enumerate(PAPER, start=1)}
BEST = "information-interest"
TENFOLD = (20.0 / 3.0, 15.0)
"""What "about ten times" may be: ten, give or take a half."""
AGREE = (0.8, 1.25)
SETTLED = 3
"""Expected and obtained cells are compared after this look."""
MARGIN = 1.15
"""What ours is to map more than method 5."""
NEAR_RMSE_M, FAR_RMSE_M = 0.10, 0.20


def methods(rows: Sequence[Row]) -> list[str]:
    """Return the ways of choosing, in order."""
    return list(dict.fromkeys(str(row["method"]) for row in rows))


def _of(rows: Sequence[Row], method: str, kind: str) -> list[Row]:
    return [row for row in rows if row["row"] == kind and row["method"] == method]


def at_look(rows: Sequence[Row], method: str, look: int, key: str = "cells") -> dict[int, float]:
    """Return a value after so many looks, by seed; of runs that were over earlier, at their end."""
    last: dict[int, tuple[int, float]] = {
        int(r["seed"]): (0, 0.0) for r in _of(rows, method, "run")
    }
    for row in _of(rows, method, "look"):
        seed, number = int(row["seed"]), int(row["look"])
        if number <= look and number > last[seed][0] and key in row:
            last[seed] = (number, float(row[key]))
    return {seed: value for seed, (_, value) in last.items()}


def agreement(rows: Sequence[Row], method: str) -> dict[int, float]:
    """Return obtained over expected cells, of all looks after the third to the last, by seed."""
    sums: dict[int, list[float]] = {}
    for row in _of(rows, method, "look"):
        if int(row["look"]) > SETTLED and "expected_cells" in row:
            both = sums.setdefault(int(row["seed"]), [0.0, 0.0])
            both[0] += float(row["obtained_cells"])
            both[1] += float(row["expected_cells"])
    return {seed: got / expected for seed, (got, expected) in sums.items() if expected > 0}


def within(rows: Sequence[Row], method: str) -> float:
    """Return the share of single looks after the third that obtained about what was expected."""
    ratios = [
        float(row["obtained_cells"]) / max(float(row["expected_cells"]), 1.0)
        for row in _of(rows, method, "look")
        if int(row["look"]) > SETTLED and "expected_cells" in row
    ]
    return float(np.mean([AGREE[0] <= r <= AGREE[1] for r in ratios])) if ratios else 0.0


def conclude_sandpit(rows: Sequence[Row]) -> Findings:
    """Return the tables of the sandpit and what became of each claim."""
    claims = [_tenfold, _half_the_looks, _order, _agrees, _falls_apart, _ours, _beside_the_oracle]
    return _concluded(rows, claims)


def conclude_field(rows: Sequence[Row]) -> Findings:
    """Return the tables of the field and what became of each claim."""
    claims = [_more_than_line, _agrees, _falls_apart, _ours, _beside_the_oracle, _unhurt, _down]
    return _concluded(rows, [*claims, _near, _far])


def _concluded(
    rows: Sequence[Row], claims: Sequence[Callable[[Sequence[Row]], Claim | None]]
) -> Findings:
    made = [claim(rows) for claim in claims]
    return Findings([_table(rows), *_missions(rows)], [claim for claim in made if claim])


def _table(rows: Sequence[Row]) -> Table:
    most = _most(rows)
    columns = ["way to choose a look", f"cells, {most} looks", f"{2 * most} looks"]
    columns += ["driven, m", "obtained / expected", "looks within 0.8 to 1.25", "of the oracle"]
    ideal = at_look(rows, ORACLE, most) if ORACLE in methods(rows) else {}
    lines: list[list[Cell]] = []
    for method in methods(rows):
        cells = at_look(rows, method, most)
        line: list[Cell] = [_named(method), estimate(list(cells.values()))]
        longer = max((int(r["look"]) for r in _of(rows, method, "look")), default=0) > most
        line.append(estimate(list(at_look(rows, method, 2 * most).values())) if longer else "")
        if method == ORACLE:
            lines.append([*line, "", "", "", 1.0])
            continue
        agreed = list(agreement(rows, method).values())
        line.append(estimate(list(at_look(rows, method, most, "driven_m").values())))
        line += [estimate(agreed) if agreed else "", within(rows, method)]
        shares = _ratios(cells, ideal)
        lines.append([*line, estimate(shares) if shares else ""])
    title = f"Cells mapped by the first {most} looks after those all round"
    formats = ("", ",.0f", ",.0f", ".1f", ".2f", ".2f", ".2f")
    return Table("looks", title, columns, lines, formats)


def _most(rows: Sequence[Row]) -> int:
    """Return how many looks every method may take."""
    counts = [int(row["look"]) for row in rows if row["row"] == "look" and row["method"] != TWICE]
    return max(counts, default=LOOKS)


def _named(method: str) -> str:
    return f"{NUMBERS[method]} {method}" if method in NUMBERS else method


def _missions(rows: Sequence[Row]) -> list[Table]:
    """Return a table of how right the maps were, and what became of the Cliff-bot."""
    told = [row for row in rows if row["row"] == "run" and "near_rmse_m" in row]
    if not told:
        return []
    columns = ["way to choose a look", "error near, m", "error far, m", "safe way", "down", "hurt"]
    lines: list[list[Cell]] = []
    for method in methods(told):
        mine = [row for row in told if row["method"] == method]
        line: list[Cell] = [_named(method)]
        for key in ("near_rmse_m", "far_rmse_m"):
            values = [float(row[key]) for row in mine if key in row]
            line.append(estimate(values) if values else "")
        for key in ("safe_path", "reached", "hazards"):
            line.append(
                f"{sum(bool(row[key]) for row in mine)} of {len(mine)}" if key in mine[0] else ""
            )
        lines.append(line)
    title = (
        "The team map's error (r.m.s.): height on slopes below 30 degrees within 5 m of a look,"
        " else to the surface within 10 m; and the Cliff-bot"
    )
    return [Table("maps", title, columns, lines, ("", ".3f", ".3f", "", "", ""))]


def _ratios(one: dict[int, float], other: dict[int, float]) -> list[float]:
    return [one[seed] / other[seed] for seed in one if other.get(seed, 0.0) > 0]


def _has(rows: Sequence[Row], *names: str) -> bool:
    return set(names) <= set(methods(rows))


def _compared(rows: Sequence[Row], one: str, other: str, looks: tuple[int, int]) -> float:
    """Return the ratio of the mean cells of two ways, each after so many looks."""
    cells = [at_look(rows, m, n).values() for m, n in zip((one, other), looks, strict=True)]
    return float(np.mean(list(cells[0]))) / max(float(np.mean(list(cells[1]))), 1.0)


def _tenfold(rows: Sequence[Row]) -> Claim | None:
    if not _has(rows, "raster", BEST):
        return None
    most = _most(rows)
    ratio = _compared(rows, BEST, "raster", (most, most))
    text = "method 5 maps about ten times the cells of method 1 in the same number of looks"
    found = f"{ratio:.1f} times the cells in {most} looks (6.7 to 15 would be about ten)"
    return Claim(text, "Fig. 24", TENFOLD[0] <= ratio <= TENFOLD[1], ratio, found)


def _half_the_looks(rows: Sequence[Row]) -> Claim | None:
    if not _has(rows, TWICE, BEST):
        return None
    most = _most(rows)
    ratio = _compared(rows, BEST, TWICE, (most, 2 * most))
    text = "method 5 reaches in 10 looks what method 3 needs 20 for"
    found = f"in {most} looks {ratio:.2f} of the cells that method 3 has after {2 * most}"
    return Claim(text, "Fig. 25", ratio >= 1.0, ratio, found)


def _order(rows: Sequence[Row]) -> Claim | None:
    three = ("information-line", "information-edge", BEST)
    if not _has(rows, *three):
        return None
    by_seed = [at_look(rows, method, _most(rows)) for method in three]
    cells = [float(np.mean(list(of.values()))) for of in by_seed]
    ratio = cells[2] / max(cells[0], 1.0)
    steps = [
        estimate([after[seed] - before[seed] for seed in before])
        for before, after in pairwise(by_seed)
    ]
    text = "there is a significant improvement from method 3 over 4 to 5"
    found = (
        f"{cells[0]:,.0f}, {cells[1]:,.0f} and {cells[2]:,.0f} cells; over the same ground"
        f" 4 had {steps[0]:,.0f} more than 3, and 5 had {steps[1]:,.0f} more than 4"
    )
    held = all(step.mean - (step.half_width or 0.0) > 0 for step in steps)
    return Claim(text, "section 3.2", held, ratio, found)


def _more_than_line(rows: Sequence[Row]) -> Claim | None:
    if not _has(rows, TWICE, BEST):
        return None
    most = _most(rows)
    ratio = _compared(rows, BEST, TWICE, (most, most))
    text = "method 5 maps more than method 3 in the same number of looks"
    found = f"{ratio:.2f} of method 3's cells after {most} looks"
    return Claim(text, "Fig. 29", ratio > 1.0, ratio, found)


def _agrees(rows: Sequence[Row]) -> Claim | None:
    if not _has(rows, BEST):
        return None
    ratio = float(np.mean(list(agreement(rows, BEST).values())))
    text = "what method 5 expects and what it obtains agree (0.8 to 1.25, after look 3)"
    found = (
        f"obtained over expected {ratio:.2f}; of single looks {within(rows, BEST):.0%} were within"
    )
    return Claim(text, "Fig. 26", AGREE[0] <= ratio <= AGREE[1], ratio, found)


def _falls_apart(rows: Sequence[Row]) -> Claim | None:
    if not _has(rows, TWICE):
        return None
    ratio = float(np.mean(list(agreement(rows, TWICE).values())))
    text = "what method 3 expects and what it obtains fall apart"
    found = (
        f"obtained over expected {ratio:.2f}; of single looks {within(rows, TWICE):.0%} were within"
    )
    return Claim(text, "Fig. 26", not AGREE[0] <= ratio <= AGREE[1], ratio, found)


def _ours(rows: Sequence[Row]) -> Claim | None:
    if not _has(rows, OURS, BEST):
        return None
    most = _most(rows)
    ratio = _compared(rows, OURS, BEST, (most, most))
    ahead = _ratios(at_look(rows, OURS, most), at_look(rows, BEST, most))
    text = f"`{OURS}` maps at least 1.15 times the cells of method 5"
    led = sum(r > 1 for r in ahead)
    found = f"{ratio:.2f} times in {most} looks; it led over {led} of {len(ahead)} seeds"
    return Claim(text, "ours", ratio >= MARGIN, ratio, found)


def _beside_the_oracle(rows: Sequence[Row]) -> Claim | None:
    if not _has(rows, OURS, ORACLE):
        return None
    most = _most(rows)
    ratio = _compared(rows, OURS, ORACLE, (most, most))
    other = (
        f", method 5 {_compared(rows, BEST, ORACLE, (most, most)):.2f}" if _has(rows, BEST) else ""
    )
    text = f"`{OURS}` maps at least 0.7 of what a greedy oracle does that knows the ground"
    return Claim(text, "ours", ratio >= 0.7, ratio, f"{ratio:.2f} of the oracle's cells{other}")


def _missioned(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["row"] == "run" and "reached" in row]


def _unhurt(rows: Sequence[Row]) -> Claim | None:
    runs = _missioned(rows)
    if not runs:
        return None
    hurt = sum(int(row["hazards"]) > 0 for row in runs)
    text = "the Cliff-bot, which maps nothing, keeps out of the rocks by the map that it is sent"
    found = f"in {hurt} of {len(runs)} runs it touched a rock or a step"
    return Claim(text, "Fig. 30", hurt == 0, hurt / len(runs), found)


def _down(rows: Sequence[Row]) -> Claim | None:
    runs = _missioned(rows)
    if not runs:
        return None
    down = sum(bool(row["reached"]) for row in runs)
    safe = sum(bool(row["safe_path"]) for row in runs)
    text = "the map of so few looks is enough for the Cliff-bot to get down"
    found = (
        f"it got down in {down} of {len(runs)} runs; in {safe} it knew a safe way, else it stayed"
    )
    return Claim(text, "ours", down >= 0.95 * len(runs), down / len(runs), found)


def _error(rows: Sequence[Row], key: str, limit_m: float, where: str) -> Claim | None:
    values = [float(row[key]) for row in rows if row["row"] == "run" and key in row]
    if not values:
        return None
    mean = float(np.mean(values))
    text = f"the team map errs by at most {limit_m:.2f} m (r.m.s.) {where}"
    found = f"{mean:.3f} m, at most {max(values):.3f} m in one of {len(values)} runs"
    return Claim(text, "ours", mean <= limit_m, mean, found)


def _near(rows: Sequence[Row]) -> Claim | None:
    where = "on slopes below 30 degrees within 5 m of a look"
    return _error(rows, "near_rmse_m", NEAR_RMSE_M, where)


def _far(rows: Sequence[Row]) -> Claim | None:
    return _error(rows, "far_rmse_m", FAR_RMSE_M, "elsewhere within 10 m, point to surface")
