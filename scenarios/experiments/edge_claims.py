"""What became of the paper's numbers on the cliff edge (Figs. 8 and 9)."""

from collections.abc import Sequence

import numpy as np

from scenarios.experiments.edge_ground import FOOTPRINT_M
from scenarios.experiments.frame import Claim, Findings
from scenarios.experiments.tables import Row, Table, estimate

SAID_PX = {0.02: (2.6, 4.99), 0.01: (4.8, 9.65)}
"""Mean and largest tolerance of Fig. 9, by cell size."""
SAID_WHEEL_M = 0.1


def conclude(rows: Sequence[Row]) -> Findings:
    """Return a table of deviations and one of shapes, and what became of each claim."""
    papers = [row for row in rows if row["way"] == "paper"]
    cells_m = sorted({float(row["cell_m"]) for row in rows}, reverse=True)
    claims = [
        *(_bound_claim(papers, cell_m) for cell_m in cells_m),
        *(_mean_claim(papers, cell_m) for cell_m in cells_m if _as_said(papers, cell_m)),
        _anew_claim(rows),
        _simple_claim(rows),
        _shape_claim(rows),
        _beyond_claim(rows),
        _plateau_claim(rows),
    ]
    return Findings((_deviation_table(rows), _shape_table(rows)), claims)


def groups(rows: Sequence[Row]) -> list[tuple[str, float, str, list[Row]]]:
    """Return the rows by site, cell size and way."""
    keys = dict.fromkeys((str(r["site"]), float(r["cell_m"]), str(r["way"])) for r in rows)
    return [(*key, [r for r in rows if (r["site"], r["cell_m"], r["way"]) == key]) for key in keys]


def values(rows: Sequence[Row], key: str) -> list[float]:
    """Return the values of a key in all rows."""
    return [float(row[key]) for row in rows]


def _table(
    rows: Sequence[Row], name: str, title: str, columns: dict[str, tuple[str, str]]
) -> Table:
    """Return a table of means by site, cell size and way: a column for each key."""
    cells = [
        [site, f"{100 * cell_m:g}", way, *(estimate(values(mine, key)) for key in columns)]
        for site, cell_m, way, mine in groups(rows)
    ]
    names = ["rocks", "cm per pixel", "way", *(words for words, _ in columns.values())]
    return Table(name, title, names, cells, ["", "", "", *(spec for _, spec in columns.values())])


def _deviation_table(rows: Sequence[Row]) -> Table:
    columns = {
        "bound_px": ("bound", ".0f"),
        "mean_px": ("mean", ".2f"),
        "rim_mean_px": ("mean off the map's border", ".2f"),
        "segment_mean_px": ("mean of segments' largest", ".2f"),
        "max_px": ("largest", ".2f"),
        "anew_max_px": ("measured anew", ".2f"),
    }
    return _table(rows, "deviations", "Plateau's pixels from the polygon, in pixels", columns)


def _shape_table(rows: Sequence[Row]) -> Table:
    columns = {
        "corners": ("corners", ".0f"),
        "hull_share": ("share of its hull", ".3f"),
        "overlap": ("overlap with the plateau", ".3f"),
        "hull_overlap": ("the hull's", ".3f"),
        "true_overlap": ("overlap with the true plateau", ".3f"),
        "beyond_px": ("beyond the true lip, pixels", ".2f"),
    }
    return _table(rows, "shapes", "The polygon's shape (overlap: intersection over union)", columns)


def _as_said(papers: Sequence[Row], cell_m: float) -> bool:
    """Say whether Fig. 9 has numbers of this cell size and these wheels."""
    return cell_m in SAID_PX and float(papers[0]["wheel_m"]) == SAID_WHEEL_M


def _bound_claim(papers: Sequence[Row], cell_m: float) -> Claim:
    mine = [row for row in papers if row["cell_m"] == cell_m]
    bound, worst = float(mine[0]["bound_px"]), max(values(mine, "max_px"))
    said = f"; Fig. 9 has {SAID_PX[cell_m][1]}" if _as_said(papers, cell_m) else ""
    return Claim(
        f"No boundary pixel is farther than a wheel, {bound:g} pixels, at {100 * cell_m:g} cm per"
        " pixel",
        "section 2.2, Fig. 9",
        worst <= bound,
        worst,
        f"The largest of {len(mine)} maps was {worst:.2f} pixels,"
        f" {estimate(values(mine, 'max_px')):.2f} on average{said}.",
    )


def _mean_claim(papers: Sequence[Row], cell_m: float) -> Claim:
    mine = [row for row in papers if row["cell_m"] == cell_m]
    said = SAID_PX[cell_m][0]
    mean = estimate(values(mine, "rim_mean_px"))
    segments = estimate(values(mine, "segment_mean_px"))
    return Claim(
        f"The mean tolerance is about {said:g} pixels at {100 * cell_m:g} cm per pixel (taken as:"
        " the mean over segments of their largest deviations, within 15 %)",
        "Fig. 9",
        abs(segments.mean / said - 1) <= 0.15,
        segments.mean,
        f"It was {segments:.2f} pixels; the mean over all pixels off the map's border {mean:.2f}.",
    )


def _anew_claim(rows: Sequence[Row]) -> Claim:
    over = max(float(row["anew_max_px"]) - float(row["bound_px"]) for row in rows)
    return Claim(
        "Measured anew from pixels and corners, no deviation exceeds the bound (by half a pixel,"
        " that lies between a pixel's centre and its rim)",
        "ours",
        over <= 0.5,
        over,
        f"The largest deviation less its bound was {over:.2f} pixels.",
    )


def _simple_claim(rows: Sequence[Row]) -> Claim:
    share = float(np.mean([bool(row["simple"]) for row in rows]))
    return Claim(
        "The polygon is a single closed loop that doesn't cross itself",
        "section 2.2",
        share == 1.0,
        share,
        f"{100 * share:.0f} % of {len(rows)} polygons were simple.",
    )


def _shape_claim(rows: Sequence[Row]) -> Claim:
    share = max(values(rows, "hull_share"))
    gains = [float(row["overlap"]) - float(row["hull_overlap"]) for row in rows]
    return Claim(
        "The polygon is non-convex where the terrain is",
        "section 2.2",
        share < 0.99 and min(gains) > 0,
        share,
        f"It fills {100 * share:.1f} % of its convex hull at most, and overlaps the plateau by"
        f" {np.mean(values(rows, 'overlap')):.3f}, its hull by"
        f" {np.mean(values(rows, 'hull_overlap')):.3f} (means).",
    )


def _beyond_claim(rows: Sequence[Row]) -> Claim:
    over = [float(row["beyond_px"]) / float(row["bound_px"]) for row in rows]
    inset = 1 + 0.5 * FOOTPRINT_M / float(rows[0]["wheel_m"])
    return Claim(
        "The RECON-bot can move along the edge without falling over it (taken as: the polygon"
        " reaches beyond the true lip by less than driving keeps away from the polygon, a wheel and"
        " half a footprint)",
        "section 2.2",
        max(over) < inset,
        max(over),
        f"It reached beyond the lip by {np.mean(over):.2f} wheels on average, {max(over):.2f} at"
        f" most; driving keeps {inset:.1f} away.",
    )


def _plateau_claim(rows: Sequence[Row]) -> Claim:
    ours, papers = (
        [float(row["true_overlap"]) for row in rows if row["way"] == way]
        for way in ("ours", "paper")
    )
    return Claim(
        "Where gentle ground counts whatever its height, more of the true plateau is found",
        "ours",
        float(np.mean(ours)) >= float(np.mean(papers)),
        float(np.mean(ours)),
        f"Its overlap with the true plateau was {estimate(ours):.3f} against"
        f" {estimate(papers):.3f} by the threshold.",
    )
