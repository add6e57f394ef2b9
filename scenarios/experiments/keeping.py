"""What finished trials of an experiment found, kept beside it: what was stopped can go on."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from scenarios.errors import FolderError
from scenarios.experiments.tables import Row
from scenarios.records import folder
from scenarios.records.tables import write_atomic

FOLDER = "trials"


class Keeper:
    """The trials in an experiment's folder, each in a file of its own."""

    def __init__(self, out: Path, name: str) -> None:
        """Keep the trials of the experiment of a name in its folder."""
        self._path, self._name = out / FOLDER, name

    def check(self) -> None:
        """Refuse to go on in a folder of something else.

        Raises FolderError.
        """
        told = self._path / "experiment"
        marked = (self._path.parent / folder.MARK).is_file() and told.is_file()
        if not marked or told.read_text() != self._name:
            out, name = self._path.parent, self._name
            raise FolderError(f"--resume --out {out}: holds no experiment {name!r} to go on with")

    def start(self) -> None:
        """Make the folder."""
        self._path.mkdir(exist_ok=True)
        write_atomic(self._path / "experiment", self._name)

    def keep(self, trial: object, rows: Sequence[Row]) -> None:
        """Keep what a trial found."""
        told = {"trial": repr(trial), "rows": rows}
        write_atomic(self._file(trial), json.dumps(told, default=_plain) + "\n")

    def rows(self, trial: object) -> Sequence[Row] | None:
        """Return what a trial found, or None where it was not run."""
        file = self._file(trial)
        return json.loads(file.read_text())["rows"] if file.is_file() else None

    def _file(self, trial: object) -> Path:
        return self._path / f"{hashlib.sha256(repr(trial).encode()).hexdigest()[:16]}.json"


def _plain(value: Any) -> object:
    """Return a number of numpy's as one of Python's."""
    return value.item()
