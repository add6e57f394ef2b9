"""Runs side by side: where their summaries differ, and their curves laid over each other."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenarios.palette import run_colours
from scenarios.view.page import self_contained
from scenarios.view.report import keep
from scenarios.view.rundir import Run, Table, fitting, read_run
from scenarios.view.varied import Value, settings_of, varied

Curve = list[tuple[float, float]]
MAIN = (
    "scenario",
    "seed",
    "outcome",
    "simulated_s",
    "team.coverage",
    "team.elevation_rmse_m",
    "team.wrong_cells",
    "team.maps_equal",
    "looks",
    "sent_bytes",
    "coverage_per_kB",
    "mission.cliffbot_reached",
    "mission.safe_path_at_s",
    "mission.hazards_hit",
)
"""What the terminal's table shows, where a run has it."""
_NOT_SHOWN = ("schema", "team_map_digest")
LEAST_SHARE = 0.0005
"""A smaller difference, as a share of the first run's value, is not spoken of."""
MOST_POINTS = 1500
"""Of a curve: more are thinned."""
MOST_SETTINGS = 20
"""That differ, in the terminal: the page has all."""


@dataclass(frozen=True)
class Compared:
    """One run among others."""

    label: str
    run: Run
    values: dict[str, Value]
    """Of its summary, by key: "team.coverage"; and the sums `sent_bytes` and `looks`."""
    settings: dict[str, Value]
    """Of its scenario, by key."""
    sent: Curve
    coverage: Curve


def read_all(paths: Sequence[Path]) -> list[Compared]:
    """Read runs.

    Raises:
        UsageError: one of them is no run.

    """
    runs = [read_run(path) for path in paths]
    names = [run.name for run in runs]
    labels = [
        run.name if names.count(run.name) == 1 else f"{run.path} ({number})"
        for number, run in enumerate(runs, start=1)
    ]
    compared: list[Compared] = []
    for label, run in zip(labels, runs, strict=True):
        with fitting(run.path):
            tables = (values_of(run), settings_of(run.scenario))
            curves = (sent_curve(run.frames), coverage_curve(run.looks))
            compared.append(Compared(label, run, *tables, *curves))
    return compared


def values_of(run: Run) -> dict[str, Value]:
    """Return a run's summary, flat, with what all its robots did together."""
    robots = run.summary["robots"].values()
    sent_bytes = sum(robot["sent_bytes"] for robot in robots)
    coverage = run.summary["team"]["coverage"]
    return {
        **dict(_flat(run.summary, "")),
        "looks": sum(robot["looks"] for robot in robots),
        "sent_bytes": sent_bytes,
        "coverage_per_kB": 1000 * coverage / sent_bytes if sent_bytes else None,
    }


def _flat(table: dict[str, Any], above: str) -> Iterable[tuple[str, Value]]:
    for key, value in table.items():
        if key in _NOT_SHOWN:
            continue
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def keys_of(runs: Sequence[Compared]) -> list[str]:
    """Return all keys that any run has: the main ones first, the rest in the order of the files."""
    found = {key: None for run in runs for key in run.values}
    return [*(key for key in MAIN if key in found), *(key for key in found if key not in MAIN)]


def differs(runs: Sequence[Compared], key: str) -> bool:
    """Say whether runs have different values of a key."""
    return len({repr(run.values.get(key)) for run in runs}) > 1


def as_text(runs: Sequence[Compared]) -> str:
    """Return the tables for the terminal: what was set differently, and what came out.

    Of figures the main ones, each with its difference from the first run's.
    """
    keys, settings = keys_of(runs), varied([run.settings for run in runs])
    head = ["", *(run.label for run in runs)]
    figures = [[key, *_cells(runs, key)] for key in keys if key in MAIN]
    set_so = [[key, *map(_text, values)] for key, values in settings[:MOST_SETTINGS]]
    table = _aligned([["set differently", *head[1:]], *set_so, head, *figures])
    lines = [*table[: 1 + len(set_so)], ""] if set_so else []
    if len(settings) > MOST_SETTINGS:
        lines.insert(-1, f"and {len(settings) - MOST_SETTINGS} more settings")
    lines += table[1 + len(set_so) :]
    others = [key for key in keys if key not in MAIN and differs(runs, key)]
    if others:
        lines.append(f"and {len(others)} more keys differ")
    return "\n".join(lines)


def _aligned(table: Sequence[Sequence[str]]) -> list[str]:
    """Return a table as lines: the first column to the left, the others to the right."""
    widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
    return [
        "  ".join(cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in pairs).rstrip()
        for pairs in (list(enumerate(zip(row, widths, strict=True))) for row in table)
    ]


def _cells(runs: Sequence[Compared], key: str) -> list[str]:
    first = runs[0].values.get(key)
    cells = [_text(first)]
    for run in runs[1:]:
        value = run.values.get(key)
        change = difference(first, value)
        cells.append(f"{_text(value)} ({change})" if change else _text(value))
    return cells


def difference(first: Value, value: Value) -> str:
    """Return how a number differs from another, in words; nothing where both are no numbers."""
    if not (_is_number(first) and _is_number(value)) or first == value:
        return ""
    assert isinstance(first, int | float)
    assert isinstance(value, int | float)
    change = value - first
    if first != 0 and abs(change / first) < LEAST_SHARE:
        return ""
    if first == 0 or abs(change / first) > 10:
        return f"{change:+.4g}"
    return f"{100 * change / first:+.1f} %"


def _is_number(value: Value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _text(value: Value) -> str:
    match value:
        case None:
            return "-"
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.4g}" if abs(value) < 10_000 else f"{value:,.0f}"
        case int():
            return f"{value:,}"
        case str():
            return value


def write_comparison(runs: Sequence[Compared], out: Path) -> Path:
    """Write the page of runs side by side; return where it is.

    Raises:
        UsageError: it can't be written there.

    """
    colours = run_colours(len(runs))
    keys = keys_of(runs)
    data = {
        "keys": [[key, key in MAIN] for key in keys],
        "settings": varied([run.settings for run in runs]),
        "runs": [
            {
                "label": run.label,
                "colour": colour,
                "reason": run.run.summary["outcome_reason"],
                "end_s": run.run.summary["simulated_s"],
                "values": [run.values.get(key) for key in keys],
                "sent": _thin(run.sent),
                "coverage": _thin(run.coverage),
            }
            for run, colour in zip(runs, colours, strict=True)
        ],
    }
    title = "Runs side by side: " + ", ".join(run.label for run in runs)
    return keep(out, self_contained(title, "compare", data))


def sent_curve(frames: Table) -> Curve:
    """Return (seconds, kB that the team had begun to send), from the first frame on."""
    sent = {
        (row["from"], row["start_s"], row["end_s"], row["kind"]): int(row["bytes"])
        for row in frames
    }
    total = 0
    curve: Curve = []
    for (_, start, _, _), size in sorted(sent.items(), key=lambda item: float(item[0][1])):
        total += size
        curve.append((round(float(start), 2), total / 1000))
    return curve


def coverage_curve(looks: Table) -> Curve:
    """Return (seconds, % of the cells that can be seen which the best map has so far)."""
    best = 0.0
    curve: Curve = []
    for row in sorted(looks, key=lambda row: float(row["t_s"])):
        best = max(best, 100 * float(row["coverage"]))
        curve.append((round(float(row["t_s"]), 2), round(best, 3)))
    return curve


def _thin(curve: Curve) -> Curve:
    """Return at most so many points of a curve, its last one among them."""
    stride = -(-len(curve) // MOST_POINTS) if curve else 1
    return curve[::-1][::stride][::-1]
