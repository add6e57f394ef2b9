"""Where scenario files are found: the library that comes with the program, and paths.

Kept free of heavy imports: `ropeteam list` reads names and titles only.
"""

import difflib
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenarios.errors import ScenarioError

LIBRARY = Path(__file__).parent / "library"
STUDIES = LIBRARY / "studies"
MAX_FILE_BYTES = 1_000_000
"""A scenario file is written by hand; what is larger is something else."""


@dataclass(frozen=True)
class Entry:
    """One scenario or study of the library."""

    name: str
    title: str
    path: Path


def names(shelf: Path = LIBRARY) -> list[str]:
    """Return the names of the library's scenarios (or of its `STUDIES`), sorted."""
    return sorted(path.stem for path in shelf.glob("*.toml"))


def entries(shelf: Path = LIBRARY) -> list[Entry]:
    """Return the library's scenarios (or its `STUDIES`) with their titles, by name."""
    paths = [shelf / f"{name}.toml" for name in names(shelf)]
    return [Entry(path.stem, str(read(path).get("title", "")), path) for path in paths]


def find(name_or_path: str) -> Path:
    """Return the file that a user means: a name of the library, or a path.

    What ends in .toml or has a folder is a path.

    Raises:
        ScenarioError: there is no such file, or no such name in the library.

    """
    path = Path(name_or_path)
    if path.suffix == ".toml" or len(path.parts) > 1:
        if path.is_file():
            return path
        why = "is a folder" if path.is_dir() else "there is no such file"
        raise ScenarioError([f"{name_or_path}: {why}; allowed: a scenario file (.toml)"])
    if name_or_path in names():
        return LIBRARY / f"{name_or_path}.toml"
    if path.is_file():
        return path
    close = difflib.get_close_matches(name_or_path, names(), n=1)
    hint = f", did you mean {close[0]}?" if close else "."
    allowed = f"Allowed: {', '.join(names())}, or a path to a .toml file"
    raise ScenarioError([f"{name_or_path}: there is no scenario of this name{hint} {allowed}"])


def read(path: Path) -> dict[str, Any]:
    """Read a scenario file into plain tables.

    Raises:
        ScenarioError: it can't be read, or it is no TOML.

    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ScenarioError([f"{path}: can't be read: {error.strerror}"]) from error
    if len(data) > MAX_FILE_BYTES:
        raise ScenarioError(
            [f"{path}: has {len(data)} bytes; a scenario file has at most {MAX_FILE_BYTES}"]
        )
    try:
        return tomllib.loads(data.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ScenarioError([f"{path}: is no text in UTF-8 (byte {error.start})"]) from error
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError([f"{path}: is no TOML: {error}"]) from error
    except RecursionError as error:
        raise ScenarioError([f"{path}: is no scenario: its tables are nested too deep"]) from error
