"""What became of the paper's words about unknown cells (section 2.2, Fig. 7), and of our sigmas."""

from collections.abc import Sequence

import numpy as np

from scenarios.experiments.frame import Claim, Findings
from scenarios.experiments.markov_surfaces import SIDE
from scenarios.experiments.tables import Row, Table, estimate

MM = 1000.0


def conclude(rows: Sequence[Row]) -> Findings:
    """Return tables of fixed points, times, errors and sigmas, and what became of each claim."""
    samples = chosen(rows, part="sample")
    return Findings(
        (_sample_table(samples), _work_table(samples), _size_table(rows), _sigma_table(rows)),
        (
            _known_claim(samples),
            _harmonic_claim(samples),
            _worst_case_claim(samples),
            _early_claim(samples),
            _size_claim(chosen(rows, part="size")),
            *_sigma_claims(chosen(rows, part="ground")),
        ),
    )


def chosen(rows: Sequence[Row], **wanted: str | float) -> list[Row]:
    """Return the rows that hold these values."""
    return [row for row in rows if all(row.get(key) == value for key, value in wanted.items())]


def distinct(rows: Sequence[Row], key: str) -> list[str | float]:
    """Return the values of a key, in the order in which they come."""
    return list(dict.fromkeys(row[key] for row in rows if key in row))


def values(rows: Sequence[Row], key: str) -> list[float]:
    """Return the values of a key in all rows."""
    return [float(row[key]) for row in rows]


def _sample_table(samples: Sequence[Row]) -> Table:
    keys = ("known_moved_m", "residual_m", "from_sweeps_m", "loose_m", "early_m", "rmse_m")
    cells = [
        [str(name), *(estimate([MM * v for v in values(mine, key)]) for key in keys)]
        for name in distinct(samples, "surface")
        for mine in [chosen(samples, surface=name)]
    ]
    columns = [
        "surface", "known cells moved", "residual", "from Jacobi's fixed point",
        "ours at 1 mm", "sweeps at 1 mm", "rms from the truth",
    ]  # fmt: skip
    formats = ["", ".1f", ".1e", ".1e", ".3f", ".1f", ".1f"]
    return Table("samples", "Fig. 7's samples, mm: largest of the cells", columns, cells, formats)


def _work_table(samples: Sequence[Row]) -> Table:
    keys = (
        ("fixed_sweeps", 1.0), ("early_sweeps", 1.0), ("fixed_cpu_s", MM), ("early_cpu_s", MM),
        ("ours_cpu_s", MM), ("ours_512_cpu_s", MM),
    )  # fmt: skip
    cells = [
        [str(name), *(estimate([scale * v for v in values(mine, key)]) for key, scale in keys)]
        for name in distinct(samples, "surface")
        for mine in [chosen(samples, surface=name)]
    ]
    columns = [
        "surface", "sweeps to 1 nm", "sweeps to 1 mm", "ms", "ms at 1 mm", "ours, ms",
        "ours at 512 x 512, ms",
    ]  # fmt: skip
    formats = ["", ",.0f", ",.0f", ",.0f", ",.1f", ".2f", ".1f"]
    return Table("work", f"Work on {SIDE} x {SIDE} cells, processor time", columns, cells, formats)


def _size_table(rows: Sequence[Row]) -> Table:
    sizes = chosen(rows, part="size")
    cells = [
        [
            float(diameter),
            *(
                estimate([MM * v for v in values(mine, key)])
                for key in ("rmse_m", "nearest_rmse_m", "worst_m")
            ),
        ]
        for diameter in distinct(sizes, "diameter_cells")
        for mine in [chosen(sizes, diameter_cells=diameter)]
    ]
    columns = ["diameter of holes, cells", "rms", "rms of the nearest cell's height", "worst"]
    title = "Error in holes of the sinusoid (two crossing waves of 32 cells and 0.5 m), mm"
    return Table("sizes", title, columns, cells, [".0f", ".1f", ".1f", ".0f"])


def pooled(rows: Sequence[Row], key: str) -> float:
    """Return the mean of a value over all cells of these rows."""
    return float(np.average(values(rows, key), weights=values(rows, "cells")))


def _sigma_table(rows: Sequence[Row]) -> Table:
    ground = chosen(rows, part="ground")
    laws = [str(law) for law in distinct(ground, "law")]
    cells = [
        [
            str(surface),
            str(kind),
            f"{float(mine[0]['from_cells']):g} to {float(mine[0]['to_cells']):g}",
            estimate(values(chosen(mine, law=laws[0]), "rmse_m")),
            *(estimate(values(chosen(mine, law=law), "sigma_m")) for law in laws),
            *(estimate(values(chosen(mine, law=law), "within_2")) for law in laws),
        ]
        for surface in distinct(ground, "surface")
        for kind in distinct(ground, "unknown")
        for low in distinct(ground, "from_cells")
        for mine in [chosen(ground, surface=surface, unknown=kind, from_cells=low)]
        if mine
    ]
    columns = [
        "ground", "unknown", "cells from known", "rms error, m",
        *(f"sigma {law}, m" for law in laws), *(f"within 2, {law}" for law in laws),
    ]  # fmt: skip
    formats = ["", "", "", *([".3f"] * (1 + 2 * len(laws)))]
    return Table("sigmas", "Errors of estimated cells and their sigmas", columns, cells, formats)


def _known_claim(samples: Sequence[Row]) -> Claim:
    most = max(values(samples, "known_moved_m"))
    return Claim(
        "Known cells are left as they were measured",
        "section 2.2",
        most == 0.0,
        most,
        f"The largest change of a known cell was {most:g} m.",
    )


def _harmonic_claim(samples: Sequence[Row]) -> Claim:
    residual, apart = (max(values(samples, key)) for key in ("residual_m", "from_sweeps_m"))
    return Claim(
        "Every unknown cell is the mean of its neighbours, as the paper's sweeps would leave it",
        "section 2.2",
        residual < 1e-6 and apart < 1e-5,
        residual,
        f"No cell is farther than {residual:.1e} m from its neighbours' mean, nor than"
        f" {apart:.1e} m from where {max(values(samples, 'fixed_sweeps')):,.0f} sweeps of Jacobi's"
        " at most leave it.",
    )


def _worst_case_claim(samples: Sequence[Row]) -> Claim:
    matters = max(values(samples, "start_matters_m"))
    low = chosen(samples, surface="step, low half")
    bias = float(np.mean(values(low, "bias_m")))
    return Claim(
        "To start from the lowest elevation makes the estimate a worst case (taken as: an unseen"
        " drop is not filled up to the plateau)",
        "section 2.2",
        matters > 0.1 and bias < 0.5,
        bias,
        f"Swept to the end, the start matters by {matters:.1e} m at most; an unseen drop of 1 m"
        f" comes out {bias:.2f} m too high. Edges and planning therefore fix the map's border at"
        " the lowest elevation.",
    )


def _early_claim(samples: Sequence[Row]) -> Claim:
    worst, ours = (max(values(samples, key)) for key in ("early_m", "loose_m"))
    return Claim(
        "A solver's tolerance bounds its error (sweeps that stop when no cell moves by 1 mm don't)",
        "ours",
        ours <= 1e-3 < worst,
        worst,
        f"Sweeps that stopped so were up to {MM * worst:.0f} mm from the fixed point; our solver"
        f" at 1 mm was {MM * ours:.3f} mm from it.",
    )


def _size_claim(sizes: Sequence[Row]) -> Claim:
    diameters = [float(d) for d in distinct(sizes, "diameter_cells")]
    means = [float(np.mean(values(chosen(sizes, diameter_cells=d), "rmse_m"))) for d in diameters]
    better = [
        float(np.mean(values(chosen(sizes, diameter_cells=d), "nearest_rmse_m"))) / mean
        for d, mean in zip(diameters, means, strict=True)
    ]
    return Claim(
        "The estimate is closer than the nearest known height for holes of every size",
        "ours",
        min(better) > 1.0,
        min(better),
        f"The nearest height errs {min(better):.1f} to {max(better):.1f} times as much. Rms error"
        f" grows from {MM * means[0]:.0f} mm for single cells to {MM * means[-1]:.0f} mm for holes"
        f" as wide as a wave is long.",
    )


def _sigma_claims(ground: Sequence[Row]) -> list[Claim]:
    places = (("holes", "in holes"), ("beyond", "beyond the rim of what is known"))
    return [
        _sigma_claim(chosen(ground, unknown=kind, law=law), words, str(law))
        for kind, words in places
        for law in distinct(ground, "law")
    ]


def _sigma_claim(ground: Sequence[Row], where: str, law: str) -> Claim:
    by_ground = {str(name): chosen(ground, surface=name) for name in distinct(ground, "surface")}
    covered = {name: pooled(mine, "within_2") for name, mine in by_ground.items()}
    told = ", ".join(
        f"{covered[name]:.2f} on {name} (error / sigma about {pooled(mine, 'z_rms'):.1f})"
        for name, mine in by_ground.items()
    )
    words = "the law in use" if law == "in use" else "the median's law"
    return Claim(
        f"Estimated cells {where} keep within two sigmas by {words} (at least 95 %)",
        "ours",
        min(covered.values()) >= 0.95,
        min(covered.values()),
        f"Share within two sigmas: {told}.",
    )
