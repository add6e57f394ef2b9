"""What a run says at its end: what came out, per robot, and what every byte was spent on."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scenarios.live import clock_text
from scenarios.palette import in_kind_order
from scenarios.records.tables import Records

_ROBOT_HEAD = ("robot", "role", "state", "looks", "driven", "sent", "received", "link", "cells")


def report(summary: Mapping[str, Any], records: Records, out: Path) -> str:
    """Return the text that is printed when a run is over.

    Args:
        summary: as `summary.json` has it.
        records: the run's rows.
        out: the folder that holds its files.

    """
    parts = [
        _outcome(summary),
        *_mission(summary["mission"]),
        _team(summary["team"]),
        "",
        *_columns([_ROBOT_HEAD, *_robot_rows(summary["robots"])], left=3),
        "",
        *_bytes(records),
        "",
        f"Files: {out} (report.html, overview.png, summary.json ...)",
    ]
    return "\n".join(parts)


def _outcome(summary: Mapping[str, Any]) -> str:
    outcome, reason = str(summary["outcome"]).capitalize(), summary["outcome_reason"]
    return f"{outcome} after {clock_text(summary['simulated_s'])} simulated: {reason}"


def _mission(mission: Mapping[str, Any]) -> list[str]:
    if "cliffbot_reached" not in mission:
        return []
    reached = "got down" if mission["cliffbot_reached"] else "did not get down"
    at_s = mission.get("safe_path_at_s")
    path = "no safe way was found" if at_s is None else f"safe way found at {clock_text(at_s)}"
    hits = mission.get("hazards_hit", 0)
    return [f"The Cliff-bot {reached}; {path}; it ran into {hits or 'no'} hazards"]


def _team(team: Mapping[str, Any]) -> str:
    known = f"{100 * team['coverage']:.1f} % of {team['observable_cells']:,} cells that can be seen"
    equal = "all maps are equal" if team["maps_equal"] else "the maps differ"
    if team["elevation_rmse_m"] is None:
        return f"Mapped: {known}; {equal}"
    rms, p95 = team["elevation_rmse_m"], team["elevation_error_p95_m"]
    error = f"error {rms:.3f} m rms, 95 % below {p95:.3f} m"
    return f"Mapped: {known}; {error}; {equal}"


def _robot_rows(robots: Mapping[str, Mapping[str, Any]]) -> list[Sequence[str]]:
    return [
        (
            name,
            robot["role"],
            robot["state"],
            str(robot["looks"] or ""),
            f"{robot['distance_m']:.1f} m",
            f"{robot['sent_bytes'] / 1000:.1f} kB",
            f"{robot['received_bytes'] / 1000:.1f} kB",
            f"{100 * robot['link_busy_fraction']:.0f} %",
            f"{robot['team_cells']:,}",
        )
        for name, robot in sorted(robots.items(), key=lambda item: _natural(item[0]))
    ]


def _natural(name: str) -> list[tuple[int, str]]:
    """Return by what names are sorted so that explorer-2 stands before explorer-10."""
    parts = re.findall(r"\d+|\D+", name)
    return [(int(part), "") if part.isdigit() else (0, part) for part in parts]


def _bytes(records: Records) -> list[str]:
    """Return the table of bytes by robot and kind."""
    sizes = Counter[tuple[str, str]]()
    for tx in records.frames:
        sizes[(tx.sender, tx.kind)] += tx.bytes
    if not sizes:
        return ["Nothing was sent."]
    kinds = in_kind_order(kind for _, kind in sizes)
    totals = [sum(sizes[(name, kind)] for name in records.robots) for kind in kinds]
    rows = [
        (name, *(f"{sizes[(name, kind)]:,}" for kind in kinds))
        for name in sorted(records.robots, key=_natural)
        if any(sizes[(name, kind)] for kind in kinds)
    ]
    shares = ("share", *(f"{100 * total / sum(totals):.1f} %" for total in totals))
    return _columns([("bytes spent on", *kinds), *rows, shares], left=1)


def _columns(rows: Sequence[Sequence[str]], left: int) -> list[str]:
    """Return rows as lines with aligned columns: the first `left` to the left, others right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  ".join(
            text.ljust(width) if i < left else text.rjust(width)
            for i, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
