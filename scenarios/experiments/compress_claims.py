"""What became of the paper's claims about compression, and the tables that say so."""

from collections.abc import Callable, Sequence

import numpy as np

from comms.paper.entropy import PASSES
from comms.papercode import COMPRESSORS
from scenarios.experiments.frame import Claim, Findings
from scenarios.experiments.tables import Row, Table, estimate

CUTOFFS_BITS = (0.0, 0.5, 1.0, 2.0)
"""At 0 a leaf's cells all lie in one bin, and the error is bounded by half of it."""
Choice = Callable[[Row], bool]


def conclude(rows: Sequence[Row]) -> Findings:
    """Return tables of bytes, errors and information, and what became of the paper's claims."""
    tables = (
        _bytes_table(rows),
        _error_table(rows, "errors", "Largest error, m", "error_m"),
        _error_table(rows, "rmse", "Root mean square error, m", "rmse_m"),
        _information_table(rows),
    )
    claims = (
        _order_claim(rows, [name for name in PASSES[1:] if name != "huffman"]),
        _order_claim(rows, ["huffman"]),
        _lzw_claim(rows),
        _reduction_claim(rows),
        _bound_claim(rows),
        _same_bins_claim(rows),
        _same_error_claim(rows),
    )
    return Findings(tables, claims)


def _mean_table(
    rows: Sequence[Row], name: str, title: str, lines: Sequence[tuple[str, str, Choice]], value: str
) -> Table:
    """Return a table of means of a value: a line for each choice of rows, a column for a bound."""
    cells = [
        [
            ground,
            label,
            *(estimate(values_of(rows, value, ground, m, choice)) for m in bounds_m(rows)),
        ]
        for ground, label, choice in lines
    ]
    columns = ["ground", "way", *(f"{m:g} m" for m in bounds_m(rows))]
    spec = {"bytes": ",.0f", "error_m": ".3f", "rmse_m": ".4f"}.get(value, ".2f")
    return Table(name, title, columns, cells, ["", "", *([spec] * len(columns[2:]))])


def values_of(
    rows: Sequence[Row], value: str, ground: str, max_error_m: float, choice: Choice
) -> list[float]:
    """Return a value of the chosen rows of one ground at one width of bins, in order."""
    return [
        float(row[value])
        for row in rows
        if row["ground"] == ground and row["max_error_m"] == max_error_m and choice(row)
    ]


def bounds_m(rows: Sequence[Row]) -> list[float]:
    """Return the half widths of bins that were measured, rising."""
    return sorted({float(row["max_error_m"]) for row in rows})


def grounds(rows: Sequence[Row]) -> list[str]:
    """Return the grounds that were measured, in order."""
    return list(dict.fromkeys(str(row["ground"]) for row in rows))


def is_paper(cutoff_bits: float, compressor: str) -> Choice:
    """Return the choice of the paper's codec with a cut-off and a compressor."""

    def choice(row: Row) -> bool:
        wanted = (row["codec"], row.get("cutoff_bits"), row.get("compressor"))
        return wanted == ("paper", cutoff_bits, compressor)

    return choice


def is_way(codec: str, compressor: str | None = None) -> Choice:
    """Return the choice of another way, or of a pass of the information."""
    return lambda row: row["codec"] == codec and row.get("compressor") == compressor


def _bytes_table(rows: Sequence[Row]) -> Table:
    lines = [
        *(
            (f"paper, {cutoff:g} bit, {name}", is_paper(cutoff, name))
            for cutoff in CUTOFFS_BITS
            for name in COMPRESSORS
        ),
        ("ours", is_way("ours")),
    ]
    every = [(ground, *line) for ground in grounds(rows) for line in lines]
    return _mean_table(rows, "bytes", "Bytes of a map, by half the width of bins", every, "bytes")


def _error_table(rows: Sequence[Row], name: str, title: str, value: str) -> Table:
    lines = [(f"paper, {cutoff:g} bit", is_paper(cutoff, "lzw")) for cutoff in CUTOFFS_BITS]
    every = [
        (ground, *line) for ground in grounds(rows) for line in [*lines, ("ours", is_way("ours"))]
    ]
    return _mean_table(rows, name, title, every, value)


def _information_table(rows: Sequence[Row]) -> Table:
    every = [
        (ground, name, is_way("information", name)) for ground in grounds(rows) for name in PASSES
    ]
    title = "Information after a lossless pass, bits per cell (Eqs. 1, 2)"
    return _mean_table(rows, "information", title, every, "bits_per_cell")


def _order_claim(rows: Sequence[Row], passes: Sequence[str]) -> Claim:
    ratios = {name: _shuffled_ratio(rows, name) for name in ("none", *passes)}
    least = min(passes, key=lambda name: ratios[name])
    told = ", ".join(f"{ratios[name]:.2f} after {name}" for name in passes)
    return Claim(
        "A histogram can't tell order from disorder; what is left after lossless compression can"
        f" ({', '.join(passes)})",
        "section 2.3",
        abs(ratios["none"] - 1) < 1e-9 and ratios[least] > 1.05,
        ratios[least],
        f"Ground with its cells shuffled has {ratios['none']:.2f} times the information of the"
        f" ground by its histogram, {told}.",
    )


def _shuffled_ratio(rows: Sequence[Row], name: str) -> float:
    """Return how much more information shuffled ground has than the ground (mean of ratios)."""
    chosen = [row for row in rows if is_way("information", name)(row)]
    pairs = [(float(r["shuffled_bits_per_cell"]), float(r["bits_per_cell"])) for r in chosen]
    return float(np.mean([shuffled / ordered for shuffled, ordered in pairs if ordered > 0]))


def _lzw_claim(rows: Sequence[Row]) -> Claim:
    ratios = [_ratio_to_least(rows, row) for row in rows if is_paper(0.5, "lzw")(row)]
    mean = float(np.mean(ratios))
    return Claim(
        "LZW comes near the best that can be (taken as: within 10 % of the best of the four)",
        "section 2.3",
        mean <= 1.1,
        mean,
        f"LZW took {mean:.2f} times the bytes of the smallest of the four on the same leaves"
        f" (cut-off 0.5 bit; {min(ratios):.2f} to {max(ratios):.2f}).",
    )


def _ratio_to_least(rows: Sequence[Row], lzw: Row) -> float:
    same = ("ground", "seed", "max_error_m", "codec", "cutoff_bits")
    sizes = [
        float(row["bytes"]) for row in rows if all(row.get(key) == lzw.get(key) for key in same)
    ]
    return float(lzw["bytes"]) / min(sizes)


def _reduction_claim(rows: Sequence[Row]) -> Claim:
    lzw = [row for row in rows if is_paper(0.5, "lzw")(row)]
    shares = [
        float(np.mean([float(r["leaves"]) / float(r["cells"]) for r in lzw if _at(r, bound_m)]))
        for bound_m in bounds_m(rows)
    ]
    told = ", ".join(
        f"{share:.2f} at {bound_m:g} m"
        for share, bound_m in zip(shares, bounds_m(rows), strict=True)
    )
    return Claim(
        "The quadtree is a significantly reduced data set (taken as: half the cells at most)",
        "section 2.4",
        max(shares) <= 0.5,
        max(shares),
        f"At a cut-off of 0.5 bit there were so many leaves to a known cell: {told}.",
    )


def _at(row: Row, max_error_m: float) -> bool:
    return row["max_error_m"] == max_error_m


def _bound_claim(rows: Sequence[Row]) -> Claim:
    worst = [
        max(
            float(row["error_m"]) / float(row["max_error_m"])
            for row in rows
            if is_paper(cutoff, "lzw")(row)
        )
        for cutoff in CUTOFFS_BITS[1:]
    ]
    told = ", ".join(
        f"{ratio:.1f} at {cutoff:g} bit"
        for ratio, cutoff in zip(worst, CUTOFFS_BITS[1:], strict=True)
    )
    return Claim(
        "What the cut-off leaves out is insignificant (taken as: no error above half a bin)",
        "section 2.4",
        max(worst) <= 1.0,
        worst[0],
        f"The entropy cut-off bounds no error: the largest was so many half bins: {told}.",
    )


def _same_bins_claim(rows: Sequence[Row]) -> Claim:
    """Ours, bounded by half a bin, is the better of the two in bytes and in both errors."""
    places = ("ground", "seed", "max_error_m")
    ours = {tuple(r[key] for key in places): r for r in rows if is_way("ours")(r)}
    pairs = [(ours[tuple(r[key] for key in places)], r) for r in rows if is_paper(0.5, "lzw")(r)]
    size, rmse = (
        [float(mine[key]) / float(paper[key]) for mine, paper in pairs if float(paper[key]) > 0]
        for key in ("bytes", "rmse_m")
    )
    return Claim(
        "Bounded by half a bin, ours takes fewer bytes than the paper's codec, and errs less",
        "ours",
        max(size) < 1.0 and max(rmse) < 1.0,
        float(np.mean(size)),
        f"Ours took {np.mean(size):.2f} times the bytes of the paper's at 0.5 bit with LZW"
        f" ({min(size):.2f} to {max(size):.2f}), with {np.mean(rmse):.2f} times its rms error"
        f" ({min(rmse):.2f} to {max(rmse):.2f}).",
    )


def _same_error_claim(rows: Sequence[Row]) -> Claim:
    """Ours is given the largest error that the paper's turned out to make."""
    ratios = [
        float(row["ours_at_this_error_bytes"]) / float(row["bytes"])
        for row in rows
        if is_paper(0.5, "lzw")(row)
    ]
    mean = float(np.mean(ratios))
    return Claim(
        "Bounded by the error that the paper's codec turns out to make, ours takes fewer bytes",
        "ours",
        max(ratios) < 1.0,
        mean,
        f"Ours took {mean:.2f} times the bytes of the paper's at 0.5 bit with LZW, at equal largest"
        f" error ({min(ratios):.2f} to {max(ratios):.2f}).",
    )
