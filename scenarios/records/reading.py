"""A run that has ended, read back from its folder."""

import csv
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

from scenarios.errors import UsageError
from scenarios.schema import Scenario, load

Row = dict[str, float | str | None]
"""A row of a table by column: numbers as floats, an empty field as None, the rest as text."""


@dataclass(frozen=True)
class Run:
    """What a run left; its tables are read when they are asked for (docs/scenarios.md)."""

    folder: Path

    @cached_property
    def summary(self) -> dict[str, Any]:
        """What came out, by `summary.json`."""
        return cast("dict[str, Any]", json.loads(_text(self.folder / "summary.json")))

    @cached_property
    def scenario(self) -> Scenario:
        """The complete scenario, defaults included."""
        return load(str(self.folder / "scenario.toml"))

    @cached_property
    def looks(self) -> list[Row]:
        """Every look of every robot, by time."""
        return self._table("looks.csv")

    @cached_property
    def frames(self) -> list[Row]:
        """Every frame and what became of it at every team-mate."""
        return self._table("frames.csv")

    @cached_property
    def maps(self) -> list[Row]:
        """What each robot's map held at each sample."""
        return self._table("maps.csv")

    @cached_property
    def events(self) -> list[Row]:
        """What happened."""
        return self._table("events.csv")

    def _table(self, name: str) -> list[Row]:
        rows = csv.DictReader(_text(self.folder / name).splitlines())
        return [{key: _value(value) for key, value in row.items()} for row in rows]


def open_run(folder: str | Path) -> Run:
    """Return the run that a folder holds.

    Raises:
        UsageError: it holds none, or one that has not ended.

    """
    path = Path(folder)
    if not (path / "summary.json").is_file():
        raise UsageError(f"{path}: holds no run that has ended: there is no summary.json in it")
    return Run(path)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: can't be read: {error}") from error


def _value(text: str) -> float | str | None:
    try:
        return float(text) if text else None
    except ValueError:
        return text
