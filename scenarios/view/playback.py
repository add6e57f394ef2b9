"""`playback.bin`: what a report needs of a run and no table of it has.

Rows are short lists (see `scenarios.view.reel`). This imports nothing that flies a run, so that a
former run's page is there at once.
"""

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import msgpack

from scenarios.errors import UsageError

FORMAT = 1
FILE = "playback.bin"
KEPT = ("moves", "growth", "plans", "states")
"""Rows that no table has: these are written."""
Rows = dict[str, list[Any]]


def write_playback(folder: Path, head: dict[str, Any], rows: Rows) -> None:
    """Write `playback.bin`, whole or not at all."""
    # A robot's own rows stay in the order in which they came: a later motion overrules.
    kept = {key: sorted(rows[key], key=_robot) for key in KEPT}
    packed = msgpack.packb({"head": head, **kept})
    assert packed is not None
    part = folder / f".{FILE}.part"
    part.write_bytes(zlib.compress(packed, 6))
    part.replace(folder / FILE)


def read_playback(folder: Path) -> tuple[dict[str, Any], Rows]:
    """Return what the runner kept for a playback: the head, and the rows that no table has.

    Raises:
        UsageError: there is none, or it can't be read.

    """
    file = folder / FILE
    try:
        kept = cast("dict[str, Any]", msgpack.unpackb(zlib.decompress(file.read_bytes())))
        head = cast("dict[str, Any]", kept.pop("head"))
        if head["format"] != FORMAT:
            raise UsageError(f"{file}: is of format {head['format']}; must be {FORMAT}")
        return head, kept
    except FileNotFoundError as error:
        raise UsageError(f"{folder}: has no {FILE}: it was run without a report") from error
    except OSError as error:
        raise UsageError(f"{file}: can't be read: {error.strerror}") from error
    except (zlib.error, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UsageError(f"{file}: is no playback of a run") from error


def _robot(row: Sequence[Any]) -> int:
    return row[0]
