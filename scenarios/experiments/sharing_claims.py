"""What became of the aims of `sharing`, and the tables that say so."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from scenarios.experiments.frame import Claim, Findings
from scenarios.experiments.tables import Cell, Row, Table, estimate

Choice = Callable[[Row], bool]


def conclude(rows: Sequence[Row]) -> Findings:
    """Return the tables of the parts that were run, and what became of their aims."""
    runs = [row for row in rows if row["row"] == "run"]
    tables: list[Table] = []
    claims: list[Claim] = []
    if caught := chosen(runs, part="catch-up"):
        tables.append(_catch_up_table(caught))
        claims += _catch_up_claims(caught)
    if lagged := lag_rows(runs):
        tables.append(_lag_table(lagged))
        claims += _lag_claims(lagged)
    if flown := chosen(runs, part="mission"):
        series = [row for row in rows if row["row"] == "series" and row["part"] == "mission"]
        tables.append(_mission_table(flown, series))
        claims += _mission_claims(flown, series)
    return Findings(tables, claims)


def lag_rows(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of the lag at 2400 bps: those of the mission are part of it."""
    lagged = chosen(rows, part="lag")
    mission = chosen(rows, part="mission", rate_bps=2400.0) if lagged else []
    return [*mission, *lagged]


def chosen(rows: Sequence[Row], **wanted: str | float) -> list[Row]:
    """Return the rows that hold these values."""
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def distinct(rows: Sequence[Row], key: str) -> list[str]:
    """Return the values of a key, in the order in which they come."""
    return list(dict.fromkeys(str(row[key]) for row in rows))


def values(rows: Sequence[Row], key: str) -> list[float]:
    """Return the values of a key in all rows."""
    return [float(row[key]) for row in rows]


def rates(rows: Sequence[Row]) -> list[float]:
    """Return the rates that were run, the highest first."""
    return sorted({float(row["rate_bps"]) for row in rows}, reverse=True)


def rate_name(rate_bps: float) -> str:
    """Return a rate in words."""
    if math.isinf(rate_bps):
        return "unlimited"
    return f"{rate_bps:g} bps" if rate_bps else "none"


def _estimated(rows: Sequence[Row], key: str) -> Cell:
    """Return the mean where every run came to an end, else how many did."""
    found = [value for value in values(rows, key) if math.isfinite(value)]
    if len(found) < len(rows):
        return f"{len(found)} of {len(rows)} only"
    return estimate(found)


def _catch_up_table(runs: Sequence[Row]) -> Table:
    lines = [
        [
            policy,
            _estimated(mine, "catch_up_s"),
            _estimated(mine, "ideal_s"),
            _estimated(mine, "payload_bytes"),
        ]
        for policy in distinct(runs, "policy")
        for mine in [chosen(runs, policy=policy)]
    ]
    title = "Catching up at 2400 bps: seconds until a latecomer holds 90 % of the finished map"
    columns = ["policy", "catch-up, s", "its bytes alone, s", "payload, bytes"]
    return Table("catch-up", title, columns, lines, ["", ".1f", ".1f", ",.0f"])


def _ratios(runs: Sequence[Row], key: str, policy: str, scenario: str) -> list[float]:
    """Return, seed by seed, the value of `value` over that of another policy."""
    ours = {row["seed"]: float(row[key]) for row in chosen(runs, policy="value", scenario=scenario)}
    theirs = chosen(runs, policy=policy, scenario=scenario)
    return [ours[row["seed"]] / float(row[key]) for row in theirs if float(row[key]) > 0]


def _catch_up_claims(runs: Sequence[Row]) -> list[Claim]:
    claims: list[Claim] = []
    for policy, limit, words in (("paper", 1 / 3, "a third"), ("raw", 1 / 20, "a twentieth")):
        ratios = _ratios(runs, "catch_up_s", policy, "cliff")
        if ratios:
            mean = float(np.mean(ratios))
            text = f"a latecomer catches up in at most {words} of the time that `{policy}` takes"
            found = f"mean over seeds {mean:.3f} of its time (largest {max(ratios):.3f})"
            claims.append(Claim(text, "ours", mean <= limit, mean, found))
    return claims


def _lag_table(runs: Sequence[Row]) -> Table:
    lines = [
        [
            scenario,
            policy,
            estimate([100 * share for share in values(mine, "lacking_share")]),
            _estimated(mine, "map_kb_per_robot_min"),
            _estimated(mine, "kb_per_robot_min"),
        ]
        for scenario in distinct(runs, "scenario")
        for policy in distinct(runs, "policy")
        for mine in [chosen(runs, scenario=scenario, policy=policy)]
        if mine
    ]
    title = "Lag at 2400 bps: what listeners lack of what was measured, mean over the mission"
    columns = ["scenario", "policy", "lacking, %", "maps, kB/robot/min", "all, kB/robot/min"]
    return Table("lag", title, columns, lines, ["", "", ".2f", ".2f", ".2f"])


def _lag_claims(runs: Sequence[Row]) -> list[Claim]:
    claims: list[Claim] = []
    for scenario in distinct(runs, "scenario"):
        ratios = _ratios(runs, "lacking_share", "paper", scenario)
        if ratios:
            mean = float(np.mean(ratios))
            text = f"`{scenario}`: listeners lack at most a fifth of what they lack by `paper`"
            found = f"mean over seeds {mean:.3f} (largest {max(ratios):.3f})"
            claims.append(Claim(text, "ours", mean <= 0.2, mean, found))
    return claims


def _mission_table(runs: Sequence[Row], series: Sequence[Row]) -> Table:
    lines: list[list[Cell]] = []
    for scenario in distinct(runs, "scenario"):
        for rate_bps in rates(runs):
            mine = chosen(runs, scenario=scenario, rate_bps=rate_bps)
            if not mine:
                continue
            path = _estimated(mine, "safe_path_s") if scenario == "cliff" else ""
            coverage = mean_coverage(series, scenario, rate_bps)
            lines.append(
                [
                    scenario,
                    rate_name(rate_bps),
                    path,
                    100 * float(coverage[1][-1]),
                    estimate([100 * share for share in values(mine, "lacking_share")]),
                    _estimated(mine, "map_kb_per_robot_min"),
                    _estimated(mine, "digest_kb_per_robot_min"),
                    _estimated(mine, "kb_per_robot_min"),
                ]
            )
    title = "The mission by link (policy `value`)"
    columns = [
        "scenario", "link", "safe path, s", "mapped at the end, %", "lacking, %",
        "maps, kB/robot/min", "reports", "all",
    ]  # fmt: skip
    formats = ["", "", ".0f", ".1f", ".2f", ".2f", ".3f", ".2f"]
    return Table("mission", title, columns, lines, formats)


def mean_coverage(
    series: Sequence[Row], scenario: str, rate_bps: float
) -> tuple[list[float], list[float]]:
    """Return times and the mean over seeds of the share mapped; a run that is over stays."""
    mine = chosen(series, scenario=scenario, rate_bps=rate_bps)
    by_seed: dict[float, dict[float, float]] = {}
    for row in mine:
        told = by_seed.setdefault(float(row["seed"]), {})
        told[float(row["t_s"])] = float(row["coverage"])
    times = sorted({float(row["t_s"]) for row in mine})
    means: list[float] = []
    last = dict.fromkeys(by_seed, 0.0)
    for t_s in times:
        for seed, told in by_seed.items():
            last[seed] = told.get(t_s, last[seed])
        means.append(float(np.mean(list(last.values()))))
    return times, means


def _mission_claims(runs: Sequence[Row], series: Sequence[Row]) -> list[Claim]:
    claims: list[Claim] = []
    free = chosen(runs, scenario="cliff", rate_bps=math.inf)
    base = {row["seed"]: float(row["safe_path_s"]) for row in free}
    for rate_bps, limit in ((9600.0, 1.05), (2400.0, 1.2)):
        ratios = [
            float(row["safe_path_s"]) / base[row["seed"]]
            for row in chosen(runs, scenario="cliff", rate_bps=rate_bps)
            if math.isfinite(base[row["seed"]])
        ]
        if ratios:
            mean = float(np.mean(ratios))
            text = f"at {rate_name(rate_bps)} the safe path is found within {limit:g} of the time"
            found = f"mean over {len(ratios)} seeds with a path {mean:.3f} (max {max(ratios):.3f})"
            claims.append(Claim(text, "ours", mean <= limit, mean, found))
    claims += _coverage_claims(series)
    return claims


def _coverage_claims(series: Sequence[Row]) -> list[Claim]:
    curves = {rate: mean_coverage(series, "pair", rate)[1] for rate in rates(series)}
    if not {math.inf, 2400.0} <= curves.keys() or not curves[math.inf]:
        return []
    free, thin = curves[math.inf], curves[2400.0]
    count = min(len(free), len(thin))
    later = range(count // 4, count)
    worst = min(thin[i] / free[i] for i in later if free[i] > 0)
    claims = [
        Claim(
            "`pair` at 2400 bps has 95 % of the coverage at every moment after the first quarter",
            "ours",
            worst >= 0.95,
            worst,
            f"the least share, mean over seeds, is {worst:.3f}",
        )
    ]
    if 0.0 in curves and (gain := sum(free[i] - curves[0.0][i] for i in later)) > 0:
        kept = sum(thin[i] - curves[0.0][i] for i in later) / gain
        text = "`pair` at 2400 bps keeps most of what a link without limit gains over none"
        found = f"{100 * kept:.1f} % of the gain in coverage, mean over the later three quarters"
        claims.append(Claim(text, "ours", kept >= 0.95, kept, found))
    return claims
