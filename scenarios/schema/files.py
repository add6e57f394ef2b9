"""Files that a scenario names (ground, recorded traces): found, and their paths made absolute."""

import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

from comms.traces import TraceError, read_trace
from scenarios.errors import ScenarioError
from scenarios.schema.overrides import Override

Tables = dict[str, Any]


def place_files(tables: Tables, scenario: Path, changes: Sequence[Override]) -> None:
    """Make the paths in a scenario's tables absolute, in place.

    A relative path is looked for beside the scenario file and in the folder where the user is; the
    latter first, where the path was given on the command line.

    Raises:
        ScenarioError: there is no such file, or a trace can't be read; one sentence per problem.

    """
    options = {change.path: change.option for change in changes}
    problems: list[str] = []
    for path in _places(tables):
        holder = _table(tables, path[:-1])
        value: Any = holder.get(path[-1])
        if not isinstance(value, str) or not value:
            continue  # none, or for the schema to refuse
        option = options.get(path)
        try:
            is_bag = "recording" in path
            found = _found(value, scenario, from_here=option is not None, or_folder=is_bag)
            if path[-1] == "trace_file":
                read_trace(found)
        except (FileNotFoundError, TraceError) as error:
            place = scenario if option is None else option
            problems.append(f"{place}: {'.'.join(path)} = {json.dumps(value)}: {error}")
        else:
            holder[path[-1]] = found
    if problems:
        raise ScenarioError(problems)


def _places(tables: Tables) -> Iterator[tuple[str, ...]]:
    """Yield the key, part by part, of all that may be a file's path."""
    yield ("world", "terrain", "file")
    yield ("world", "map")
    yield ("world", "cave", "file")
    yield ("links", "trace_file")
    for group in ("robots", "pairs"):
        for name in _table(tables, ("links", group)):
            yield ("links", group, name, "trace_file")
    for name in _table(tables, ("robots",)):
        yield ("robots", name, "recording", "file")
    events = tables.get("events")
    for index in range(len(cast("list[Any]", events)) if isinstance(events, list) else 0):
        yield ("events", str(index), "trace_file")


def _table(tables: Tables, path: Sequence[str]) -> Tables:
    """Return the table at a key; an empty one where there is none."""
    node: Any = tables
    for part in path:
        if isinstance(node, list):
            node = cast("list[Any]", node)[int(part)]
        else:
            node = cast("Tables", node).get(part) if isinstance(node, dict) else None
    return cast("Tables", node) if isinstance(node, dict) else {}


def _found(file: str, scenario: Path, *, from_here: bool, or_folder: bool = False) -> str:
    folders = [scenario.parent.absolute(), Path.cwd()]
    if from_here:
        folders.reverse()
    for folder in folders:
        place = folder / file
        if place.is_file() or (or_folder and place.is_dir()):
            return os.path.normpath(place)
    places = " and ".join(dict.fromkeys(str(folder) for folder in folders))
    raise FileNotFoundError(f"no such file (from {places})")
