"""Maps and ways of a run in the formats of others: one function a format, all in `FORMATS`."""

from collections.abc import Callable
from pathlib import Path

from scenarios.errors import UsageError
from scenarios.exports.grids import write_geotiff, write_map_server, write_npz
from scenarios.exports.kept import Kept, keepsakes
from scenarios.exports.octomap import write_octomap
from scenarios.exports.points import write_ply
from scenarios.exports.tum import write_tum

Format = Callable[[Kept, Path], list[Path]]
"""Writes what is kept of a robot into a folder; returns the files."""

FORMATS: dict[str, Format] = {
    "geotiff": write_geotiff,
    "npz": write_npz,
    "ply": write_ply,
    "map_server": write_map_server,
    "octomap": write_octomap,
    "tum": write_tum,
}
FOLDER = "export"


def export(run: Path, formats: list[str], robot: str | None = None) -> list[Path]:
    """Write what is kept of one robot of a run, or of all, into RUN/export; return the files.

    Raises:
        StudyError: this is no run, there is no such robot, or nothing of it is kept.

    """
    kept = keepsakes(run)
    names = [name for name, one in kept.items() if robot == name or (not robot and one.true)]
    if not names:
        raise UsageError(
            f"--robot {robot}: there is no such robot; must be one of {', '.join(kept)}"
        )
    folder = run / FOLDER
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: can't be made: {error.strerror}") from error
    return [path for name in names for one in formats for path in FORMATS[one](kept[name], folder)]
