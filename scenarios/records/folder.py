"""Where a run leaves its files: a folder that is new, empty, or holds a former run."""

import os
import shutil
import tempfile
from pathlib import Path

from scenarios.errors import FolderError

MEMORY_FOLDER = Path("/dev/shm")
"""Where files cost no disk, on Linux."""
MARK = ".ropeteam-run"
"""File that tells a run's folder from any other; it is written first."""
RUN_FILES = (
    "summary.json",
    "host.json",
    "looks.csv",
    "frames.csv",
    "maps.csv",
    "events.csv",
    "scenario.toml",
    "overview.png",
    "playback.bin",
    "report.html",
    "rows.csv",
    "experiment.json",
    "figure.png",
    "study.toml",
    "trials.parquet",
)
RUN_PATTERNS = ("*.mcap", "*.log", ".*.part")
RUN_FOLDERS = ("robots", "trials", "export")
"""What robots keep to outlive a crash, one folder each; trials of a sweep; what was exported."""


def choose(name: str, seed: int) -> Path:
    """Return the folder of a run that was given none: runs/NAME-SEED, or the first free -2, -3."""
    first = Path("runs") / f"{name}-{seed}"
    number, path = 1, first
    while path.exists() and not _is_empty(path):
        number += 1
        path = first.with_name(f"{first.name}-{number}")
    return path


def check(path: Path, *, overwrite: bool) -> None:
    """Refuse a folder that a run may not be written to; nothing is changed.

    Raises:
        FolderError: it is a file, holds something and `overwrite` is not asked for, or holds
            something that is no former run.

    """
    try:
        above = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
        if not above.is_dir():
            raise FolderError(f"--out {path}: {above} is a file; must be a folder")
        if not path.exists() or _is_empty(path):
            return
        former = (path / MARK).is_file()
    except OSError as error:
        raise FolderError(f"--out {path}: can't be read: {error.strerror}") from error
    if not former:
        raise FolderError(f"--out {path}: holds files that are no former run; must be new or empty")
    if not overwrite:
        raise FolderError(f"--out {path}: holds a former run; must be empty, or add --overwrite")


def prepare(path: Path, *, overwrite: bool) -> None:
    """Make the folder of a run, rid of a former run's files (and of no others).

    Raises:
        FolderError: as `check`, or the folder can't be made.

    """
    check(path, overwrite=overwrite)
    try:
        path.mkdir(parents=True, exist_ok=True)
        (path / MARK).write_text("A run of ropeteam; --overwrite may replace its files.\n")
        for name in RUN_FOLDERS:
            shutil.rmtree(path / name, ignore_errors=True)
        for file in _files_of_a_run(path):
            file.unlink()
    except OSError as error:
        raise FolderError(f"--out {path}: can't be written: {error.strerror}") from error


def prepare_file(path: Path) -> None:
    """Make the folder of a file, and see that it can be written, before the hours that fill it.

    Raises:
        FolderError: it can't be.

    """
    if path.is_dir():
        raise FolderError(f"--out {path}: is a folder; must be a file")
    trial = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        trial.touch()
        trial.unlink()
    except OSError as error:
        raise FolderError(f"--out {path}: can't be written: {error.strerror}") from error


def _is_empty(path: Path) -> bool:
    return path.is_dir() and not any(path.iterdir())


def _files_of_a_run(path: Path) -> list[Path]:
    named = [path / name for name in RUN_FILES]
    matching = [file for pattern in RUN_PATTERNS for file in path.glob(pattern)]
    return sorted(file for file in {*named, *matching} if file.is_file())


def make_folder_in_memory() -> Path:
    """Make a folder of this user alone, in memory where that can be; its maker removes it."""
    base = MEMORY_FOLDER if os.access(MEMORY_FOLDER, os.W_OK) else None
    return Path(tempfile.mkdtemp(prefix="ropeteam-", dir=base))
