"""The four rooms import one way only, and Zenoh is known only to what carries bytes over it."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("comms", "agents", "sim", "scenarios")
"""Each may import itself and those before it."""


def imported(source: str, package: str) -> set[str]:
    """Return the full names of all modules that a source imports, wherever in it."""
    return {name for node in ast.walk(ast.parse(source)) for name in _names(node, package)}


def _names(node: ast.AST, package: str) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        yield ".".join(part for part in (package if node.level else "", node.module) if part)
    elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
        yield from (str(arg.value) for arg in node.args if isinstance(arg, ast.Constant))


def files(room: str) -> list[Path]:
    return sorted((ROOT / room).rglob("*.py"))


def tops(path: Path, room: str) -> set[str]:
    return {name.split(".")[0] for name in imported(path.read_text(encoding="utf-8"), room)}


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_no_room_after_it(room: str) -> None:
    later = set(ROOMS[ROOMS.index(room) + 1 :])
    wrong = {str(path.relative_to(ROOT)): tops(path, room) & later for path in files(room)}
    assert not {path: rooms for path, rooms in wrong.items() if rooms}


def test_only_the_two_carriers_import_zenoh() -> None:
    knowing = [path for room in ROOMS for path in files(room) if "zenoh" in tops(path, room)]
    assert [str(path.relative_to(ROOT)) for path in knowing] == [
        "comms/ros2_zenoh.py",
        "comms/zenoh_air.py",
    ]


def test_agents_know_neither_wall_clock_nor_processes() -> None:
    # A robot's time is its loop's, and its team-mates are behind its radio.
    banned = {"time", "datetime", "random", "threading", "multiprocessing", "subprocess", "socket"}
    wrong = {str(path.relative_to(ROOT)): tops(path, "agents") & banned for path in files("agents")}
    assert not {path: names for path, names in wrong.items() if names}


def test_all_ways_to_import_are_seen() -> None:
    source = (
        "import sim.clock\n"
        "def f():\n    from scenarios import cli\n"
        "if x:\n    from . import near\n"
        "importlib.import_module('zenoh')\n"
    )
    assert imported(source, "agents") == {"sim.clock", "scenarios", "agents", "zenoh"}


def test_every_room_has_files() -> None:
    assert all(len(files(room)) > 5 for room in ROOMS)
