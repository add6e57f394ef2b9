"""Tables of an experiment: means with their intervals, as text and as CSV."""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

Value = str | int | float | bool
"""What a row of measurements holds under each of its names."""
Row = dict[str, Value]


@dataclass(frozen=True)
class Estimate:
    """The mean of a number over seeds, and how far its 95 % interval reaches to either side."""

    mean: float
    half_width: float | None
    """None: a single trial tells nothing of the spread."""
    count: int

    def __format__(self, spec: str) -> str:
        """Return `mean ± half width`, both in the format that is asked for."""
        if self.half_width is None or self.half_width == 0.0:
            return format(self.mean, spec)
        return f"{format(self.mean, spec)} ± {format(self.half_width, spec)}"


def estimate(values: Sequence[float]) -> Estimate:
    """Return the mean of one value or more and its 95 % interval (Student's t)."""
    assert len(values) > 0, "an estimate of nothing"
    array = np.asarray(values, dtype=np.float64)
    if array.size == 1:
        return Estimate(float(array[0]), None, 1)
    factor = float(stats.t.ppf(0.975, array.size - 1))
    half_width = factor * float(array.std(ddof=1)) / math.sqrt(array.size)
    return Estimate(float(array.mean()), half_width, array.size)


Cell = str | int | float | bool | Estimate
"""What a table holds."""


@dataclass(frozen=True)
class Table:
    """One result of an experiment: `name` becomes the name of its file."""

    name: str
    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    formats: Sequence[str] = ()
    """How each column's numbers are written, e.g. `,.0f`; none given: as they are."""

    def __post_init__(self) -> None:
        """Hold the table to its shape."""
        assert all(len(row) == len(self.columns) for row in self.rows), self.name
        assert len(self.formats) in (0, len(self.columns)), self.name


def as_text(table: Table) -> str:
    """Return a table for a person: its title, then aligned columns, words left, numbers right."""
    formats = table.formats or [""] * len(table.columns)
    cells = [
        [_written(cell, spec) for cell, spec in zip(row, formats, strict=True)]
        for row in table.rows
    ]
    lines = [list(table.columns), *cells]
    widths = [max(len(line[i]) for line in lines) for i in range(len(table.columns))]
    words = [all(isinstance(row[i], str) for row in table.rows) for i in range(len(widths))]
    written = [
        "  ".join(
            text.ljust(width) if left else text.rjust(width)
            for text, width, left in zip(line, widths, words, strict=True)
        ).rstrip()
        for line in lines
    ]
    return "\n".join([table.title, *written])


def _written(cell: Cell, spec: str) -> str:
    return cell if isinstance(cell, str) else format(cell, spec)


def as_csv(table: Table) -> str:
    """Return a table for a program: an estimate takes three columns, the interval's ends named."""
    estimated = [any(isinstance(row[i], Estimate) for row in table.rows) for i in _span(table)]
    header: list[str] = []
    for name, is_estimate in zip(table.columns, estimated, strict=True):
        header += [name, f"{name} low", f"{name} high"] if is_estimate else [name]
    lines = [
        [
            value
            for cell, is_estimate in zip(row, estimated, strict=True)
            for value in (_parts(cell) if is_estimate else [cell])
        ]
        for row in table.rows
    ]
    return _csv(header, lines)


def _span(table: Table) -> range:
    return range(len(table.columns))


def _parts(cell: Cell) -> list[Value]:
    """Return mean, low and high; the last two empty where there is no interval."""
    if not isinstance(cell, Estimate):
        return [cell, "", ""]
    if cell.half_width is None:
        return [cell.mean, "", ""]
    return [cell.mean, cell.mean - cell.half_width, cell.mean + cell.half_width]


def rows_csv(rows: Sequence[Row]) -> str:
    """Return all that was measured: one column for each name, in order of appearance."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return _csv(names, [[row.get(name, "") for name in names] for row in rows])


def _csv(header: Sequence[str], lines: Sequence[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(lines)
    return text.getvalue()


def as_data(table: Table) -> dict[str, object]:
    """Return a table as plain values for JSON."""
    rows = [[_plain(cell) for cell in row] for row in table.rows]
    return {
        "name": table.name,
        "title": table.title,
        "columns": list(table.columns),
        "rows": rows,
    }


def _plain(cell: Cell) -> object:
    if isinstance(cell, Estimate):
        return {"mean": cell.mean, "half_width_95": cell.half_width, "count": cell.count}
    return cell
