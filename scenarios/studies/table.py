"""The table of a study: one row for each trial, its columns named and typed, as Parquet.

Columns, in this order: `trial`; what the trial has on each axis; `seed`; `state` (done, failed,
missing: not run yet) and `error`; then what came out, dotted as in `summary.json`. Of what the
summary tells for each robot there are `.sum`, `.mean` and `.max` over the team.
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from scenarios.errors import UsageError
from scenarios.studies.study import Trial
from scenarios.studies.trial import Number, Told

FILE = "trials.parquet"
Row = dict[str, Number]
_LEFT_OUT = ("schema", "scenario", "seed", "clock")
"""What the summary tells that is the same for all trials, or stands in the row already."""


def row_of(trial: Trial, told: Told | None) -> Row:
    """Return a trial's row; `told` is None where it was not run."""
    row: Row = {"trial": trial.id, **trial.values}
    row["state"] = "missing" if told is None else told.state
    row["error"] = told.error if told else ""
    if told is not None and told.summary:
        row |= _flat(json.loads(told.summary)) | told.measures
    return row


def _flat(summary: Mapping[str, Any]) -> Row:
    """Return a summary's values under dotted names, those of robots over the team."""
    row: Row = {}
    for key, value in summary.items():
        if key == "robots":
            row |= _fleet(list(cast("dict[str, dict[str, Any]]", value).values()))
        elif isinstance(value, dict):
            inner = cast("dict[str, Any]", value).items()
            row |= {f"{key}.{name}": one for name, one in inner if _is_plain(one)}
        elif key not in _LEFT_OUT and _is_plain(value):
            row[key] = value
    return row


def _is_plain(value: Any) -> bool:
    return value is None or isinstance(value, int | float | bool | str)


def _fleet(robots: Sequence[Mapping[str, Any]]) -> Row:
    """Return what the robots' values come to: nobody has it in a name of its own."""
    row: Row = {"robots.count": len(robots)}
    row["robots.alive"] = sum(robot["state"] == "alive" for robot in robots)
    for key in robots[0]:
        values = [_amount(robot.get(key)) for robot in robots]
        told = [value for value in values if value is not None]
        if told:
            total = math.fsum(told)
            row[f"robots.{key}.sum"] = total
            row[f"robots.{key}.mean"] = total / len(told)
            row[f"robots.{key}.max"] = max(told)
    return row


def _amount(value: Any) -> float | None:
    """Return a number; of counts by reason their sum; None of what is none."""
    if isinstance(value, dict):
        return float(sum(cast("dict[str, int]", value).values()))
    return float(value) if isinstance(value, int | float) else None


def write_table(path: Path, rows: Sequence[Row], facts: Mapping[str, str]) -> None:
    """Write rows as Parquet, whole or not at all; `facts` go into the file's own metadata.

    A column whose values are of several kinds becomes text; a number that is missing is null.
    """
    import pyarrow as pa  # noqa: PLC0415  (large, and only sweeps need it)
    import pyarrow.parquet as pq  # noqa: PLC0415

    columns = list(dict.fromkeys(name for row in rows for name in row))
    arrays = {name: pa.array(_of_one_kind([row.get(name) for row in rows])) for name in columns}
    told = {key.encode(): value.encode() for key, value in facts.items()}
    part = path.with_name(f".{path.name}.part")
    pq.write_table(pa.table(arrays).replace_schema_metadata(told), part)
    part.replace(path)


def _of_one_kind(values: Sequence[Number]) -> list[Number]:
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int, float}:
        return [None if value is None else float(value) for value in values]
    if len(kinds) > 1:
        return [None if value is None else str(value) for value in values]
    return list(values)


def read_table(path: Path) -> list[Row]:
    """Read the rows of a study's folder or of its Parquet file.

    Raises:
        UsageError: there is none, or it can't be read.

    """
    import pyarrow as pa  # noqa: PLC0415
    import pyarrow.parquet as pq  # noqa: PLC0415

    file = path / FILE if path.is_dir() else path
    if not file.is_file():
        raise UsageError(f"{path}: holds no study: there is no {FILE}; make one: ropeteam sweep")
    try:
        return cast("list[Row]", pq.read_table(file).to_pylist())
    except (pa.ArrowException, OSError) as error:
        raise UsageError(f"{file}: can't be read as Parquet: {error}") from error
