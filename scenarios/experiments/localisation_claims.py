"""What became of the paper's claims about a camera's error on its way (Fig. 19)."""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from scenarios.experiments.frame import Claim, Findings
from scenarios.experiments.localisation_walk import WAYS
from scenarios.experiments.tables import Row, Table, estimate

MM = 1000.0
OURS = f"{WAYS[0]} error_m"
PAPERS = f"{WAYS[-1]} error_m"


def conclude(rows: Sequence[Row]) -> Findings:
    """Return tables of errors, and what became of each claim."""
    return Findings(
        (_end_table(rows), _step_table(rows)),
        (
            _drift_claim(rows),
            _growth_claim(rows),
            _nearer_claim(rows),
            _more_claim(rows),
            _spread_claim(rows),
            _said_claim(rows),
            _papers_claim(rows),
        ),
    )


def chosen(rows: Sequence[Row], kind: str, **wanted: float) -> list[Row]:
    """Return the rows of a kind that hold these values."""
    return [
        row for row in rows if row["kind"] == kind and all(row[k] == v for k, v in wanted.items())
    ]


def distinct(rows: Sequence[Row], key: str) -> list[float]:
    """Return the values of a key, rising."""
    return sorted({float(row[key]) for row in rows if key in row})


def typical(rows: Sequence[Row], key: str) -> float:
    """Return the median over seeds: one walk that lost its way doesn't stand for all."""
    return float(np.median([float(row[key]) for row in rows]))


def curve(rows: Sequence[Row], key: str, distance_m: float, count: float) -> list[float]:
    """Return the median over seeds of a value, along the way."""
    mine = chosen(rows, "path", distance_m=distance_m, fiducials=count)
    return [
        typical(chosen(mine, "path", travelled_m=at), key) for at in distinct(rows, "travelled_m")
    ]


def _ends(rows: Sequence[Row]) -> list[Row]:
    return chosen(rows, "path", travelled_m=distinct(rows, "travelled_m")[-1])


def _pairs(rows: Sequence[Row]) -> list[tuple[float, float]]:
    return [(d, n) for d in distinct(rows, "distance_m") for n in distinct(rows, "fiducials")]


def _end_table(rows: Sequence[Row]) -> Table:
    ends, far_m = _ends(rows), distinct(rows, "travelled_m")[-1]
    cells = [
        [
            f"{MM * d:.0f}",
            int(n),
            *(
                estimate([MM * float(row[key]) for row in mine])
                for key in (*(f"{way} error_m" for way in WAYS), "said_m")
            ),
            estimate([100 * float(row[OURS]) / far_m for row in mine]),
        ]
        for d, n in _pairs(rows)
        for mine in [chosen(ends, "path", distance_m=d, fiducials=n)]
    ]
    title = f"R.m.s. translation error after {far_m:g} m, mm (mean over seeds)"
    columns = ["mean distance, mm", "fiducials", *WAYS, "said by covariance", "refined, % of way"]
    return Table("errors", title, columns, cells, ["", "", ".2f", ".2f", ".2f", ".2f", ".3f"])


def _step_table(rows: Sequence[Row]) -> Table:
    keys = ("refined error_m", "refined said_m", "running error_m", "running said_m")
    cells = [
        [
            f"{MM * d:.0f}",
            int(n),
            *(estimate([MM * float(row[f"step {key}"]) for row in mine]) for key in keys),
            sum(int(row["lost"]) for row in mine),
        ]
        for d, n in _pairs(rows)
        for mine in [chosen(rows, "step", distance_m=d, fiducials=n)]
    ]
    title = "One motion: r.m.s. translation error and what its covariance says, mm"
    columns = [
        "mean distance, mm", "fiducials", "refined", "it says", "Eq. 13's mean", "it says", "lost"
    ]  # fmt: skip
    return Table("steps", title, columns, cells, ["", "", ".3f", ".3f", ".3f", ".3f", ""])


def _slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Return the power of x with which y grows."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def _drift_claim(rows: Sequence[Row]) -> Claim:
    ends, near = _ends(rows), distinct(rows, "distance_m")[0]
    far_m = distinct(rows, "travelled_m")[-1]
    shares = [
        100 * typical(chosen(ends, "path", distance_m=near, fiducials=n), OURS) / far_m
        for n in distinct(rows, "fiducials")
    ]
    told = ", ".join(
        f"{share:.2f} % with {n:.0f}"
        for share, n in zip(shares, distinct(rows, "fiducials"), strict=True)
    )
    return Claim(
        f"With the most fiducials at {MM * near:.0f} mm the drift is below 1 % of the way",
        "ours",
        shares[-1] < 1.0,
        shares[-1],
        f"After {far_m:g} m it was {told} fiducials (medians over seeds).",
    )


def _growth_claim(rows: Sequence[Row]) -> Claim:
    way_m = distinct(rows, "travelled_m")
    powers = [_slope(way_m, curve(rows, OURS, d, n)) for d, n in _pairs(rows)]
    return Claim(
        "The error accumulates with the distance travelled",
        "Fig. 19",
        min(powers) > 0.25,
        float(np.mean(powers)),
        f"It grows with the distance to the power {np.mean(powers):.2f} ({min(powers):.2f} to"
        f" {max(powers):.2f}; 0.5 for a random walk, 1.5 for one of the heading).",
    )


def _nearer_claim(rows: Sequence[Row]) -> Claim:
    ends, (near, *_, far) = _ends(rows), distinct(rows, "distance_m")
    ratios = [
        typical(chosen(ends, "path", distance_m=far, fiducials=n), OURS)
        / typical(chosen(ends, "path", distance_m=near, fiducials=n), OURS)
        for n in distinct(rows, "fiducials")
    ]
    told = ", ".join(
        f"{ratio:.1f} with {n:.0f}"
        for ratio, n in zip(ratios, distinct(rows, "fiducials"), strict=True)
    )
    return Claim(
        "The error decreases substantially with the proximity of fiducials",
        "section 3.1, Fig. 19",
        min(ratios) > 1.5,
        min(ratios),
        f"At {MM * far:.0f} mm it was so many times that at {MM * near:.0f} mm: {told} fiducials"
        " (medians over seeds).",
    )


def _more_claim(rows: Sequence[Row]) -> Claim:
    ends, counts = _ends(rows), distinct(rows, "fiducials")
    told: list[str] = []
    ratios: list[float] = []
    falls = True
    for d in distinct(rows, "distance_m"):
        errors = [typical(chosen(ends, "path", distance_m=d, fiducials=n), OURS) for n in counts]
        falls &= all(more < few for few, more in itertools.pairwise(errors))
        ratios.append(errors[0] / errors[-1])
        told.append(f"{ratios[-1]:.1f} at {MM * d:.0f} mm")
    return Claim(
        "The error decreases substantially with redundancy of fiducials",
        "section 3.1, Fig. 19",
        falls and min(ratios) > 1.5,
        min(ratios),
        f"With {counts[0]:.0f} it was so many times that with {counts[-1]:.0f}: {', '.join(told)};"
        f" it fell {'at' if falls else 'not at'} every doubling.",
    )


def _spread_claim(rows: Sequence[Row]) -> Claim:
    """Eq. 13's covariance against the error of its mean, over single motions."""
    single = [row for row in rows if row["kind"] == "step"]
    ratios = [
        typical(mine, "step running said_m") / typical(mine, "step running error_m")
        for d, n in _pairs(rows)
        for mine in [chosen(single, "step", distance_m=d, fiducials=n)]
    ]
    return Claim(
        "The running covariance (Eq. 13) measures how certain the motion is (taken as: its sigma"
        " is within a factor of 1.5 of the error)",
        "section 2.3.4",
        max(ratios) <= 1.5 and min(ratios) >= 1 / 1.5,
        max(ratios, key=lambda ratio: abs(math.log(ratio))),
        f"Its sigma is {min(ratios):.2f} to {max(ratios):.2f} times the error of one motion"
        f" ({np.mean(ratios):.2f} on average). It tells how far the estimates wandered as points"
        " were added, the first of three points most of all.",
    )


def _said_claim(rows: Sequence[Row]) -> Claim:
    single = [row for row in rows if row["kind"] == "step"]
    steps, ways = (
        [
            typical(mine, error) / typical(mine, said)
            for d, n in _pairs(rows)
            for mine in [chosen(part, kind, distance_m=d, fiducials=n)]
        ]
        for part, kind, error, said in (
            (single, "step", "step refined error_m", "step refined said_m"),
            (_ends(rows), "path", OURS, "said_m"),
        )
    )
    return Claim(
        "Our covariance tells the error: of one motion within 15 %, and it is not too small by"
        " more than a quarter over the whole way",
        "ours",
        max(steps) <= 1.15 and min(steps) >= 0.85 and max(ways) <= 1.25,
        max(ways),
        f"The error was {min(steps):.2f} to {max(steps):.2f} of what it says of one motion, and"
        f" {min(ways):.2f} to {max(ways):.2f} over the way (a frame's noise spoils the motion"
        " before it and the one after by opposite amounts, which adding them up doesn't know).",
    )


def _papers_claim(rows: Sequence[Row]) -> Claim:
    ends = _ends(rows)
    ratios = [
        typical(mine, PAPERS) / typical(mine, OURS)
        for d, n in _pairs(rows)
        for mine in [chosen(ends, "path", distance_m=d, fiducials=n)]
    ]
    return Claim(
        "Weighing each point by its covariance errs less than Eq. 12 on the same points",
        "ours",
        min(ratios) > 1.0,
        float(np.mean(ratios)),
        f"Eq. 12 erred {np.mean(ratios):.1f} times as much ({min(ratios):.1f} to"
        f" {max(ratios):.1f}).",
    )
