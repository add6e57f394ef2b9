"""A run's folder, read back: what a report and a comparison are made of."""

import csv
import json
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenarios.errors import UsageError
from scenarios.records.tables import EVENT_COLUMNS, FRAME_COLUMNS, LOOK_COLUMNS, MAP_COLUMNS

Table = list[dict[str, str]]


@dataclass(frozen=True)
class Run:
    """What is kept of one run."""

    path: Path
    summary: dict[str, Any]
    looks: Table
    frames: Table
    maps: Table
    events: Table
    scenario: str
    """Text of its scenario.toml."""
    host: dict[str, Any]
    """What it cost the computer; empty where that was not kept."""

    @property
    def name(self) -> str:
        """How to call it."""
        return self.path.resolve().name


def read_run(path: Path) -> Run:
    """Read a run's tables.

    Raises:
        UsageError: it is no run's folder, or a file of it can't be read.

    """
    if not path.is_dir():
        raise UsageError(f"{path}: is no folder; must be a run's folder, such as runs/cliff-1")
    if not (path / "summary.json").is_file():
        raise UsageError(f"{path}: is no run: there is no summary.json in it")
    try:
        host = path / "host.json"
        return Run(
            path=path,
            summary=_json(path / "summary.json"),
            looks=_table(path / "looks.csv", LOOK_COLUMNS),
            frames=_table(path / "frames.csv", FRAME_COLUMNS),
            maps=_table(path / "maps.csv", MAP_COLUMNS),
            events=_table(path / "events.csv", EVENT_COLUMNS),
            scenario=(path / "scenario.toml").read_text(encoding="utf-8"),
            host=_json(host) if host.is_file() else {},
        )
    except OSError as error:
        raise UsageError(f"{error.filename}: can't be read: {error.strerror}") from error


@contextmanager
def fitting(path: Path) -> Generator[None]:
    """Refuse a run whose files don't fit together, while they are put together.

    Raises:
        UsageError: something is missing in one of them, or is no number.

    """
    try:
        yield
    except (KeyError, ValueError, TypeError) as error:
        said = f"{type(error).__name__}: {error}"
        raise UsageError(f"{path}: its files don't fit together ({said})") from error


def _json(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise UsageError(f"{path}: is no JSON: {error}") from error


def _table(path: Path, columns: tuple[str, ...]) -> Table:
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if tuple(reader.fieldnames or ()) != columns:
            raise UsageError(f"{path}: is no table of a run; must have columns {','.join(columns)}")
        return list(reader)
