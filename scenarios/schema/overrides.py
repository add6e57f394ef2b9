"""`--set key=value`: changes to a scenario's tables before they are checked.

A key is dotted (`links.rate_bps`), may name an entry of a list by its number (`events.0.at_s`),
and may quote a part (`links.pairs."recon>cliffbot".up`). A value is read as TOML; what is no TOML
is text, so that `links.profile=sojourner` needs no quotes.
"""

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

from scenarios.errors import ScenarioError

_PART = re.compile(r'"([^"]+)"|\'([^\']+)\'|([^."\'\s]+)')
_TERRAIN = ("world", "terrain")


@dataclass(frozen=True)
class Override:
    """One change: the option that asked for it, the key's parts, and the new value."""

    option: str
    path: tuple[str, ...]
    value: Any

    @property
    def key(self) -> str:
        """The dotted key."""
        return ".".join(self.path)


def parse_override(text: str) -> Override:
    """Read the KEY=VALUE of one `--set`.

    Raises:
        ScenarioError: there is no `=`, or the key is not a dotted one.

    """
    key, equals, value = text.partition("=")
    option = f"--set {text}"
    if not equals:
        raise ScenarioError([f"{option}: must be KEY=VALUE, e.g. links.profile=sojourner"])
    return Override(option, split_key(key.strip(), option), parse_value(value.strip()))


def split_key(key: str, option: str) -> tuple[str, ...]:
    """Return the parts of a dotted key; `option` names in an error where it stands.

    Raises:
        ScenarioError: it is none.

    """
    parts: list[str] = []
    at = 0
    while True:
        match = _PART.match(key, at)
        if match is None:
            raise ScenarioError([f"{option}: {key!r} is no key; must be like links.rate_bps"])
        parts.append(match[1] or match[2] or match[3])
        at = match.end()
        if at == len(key):
            return tuple(parts)
        if key[at] != ".":
            raise ScenarioError([f"{option}: {key!r} is no key; must be like links.rate_bps"])
        at += 1


def parse_value(text: str) -> Any:
    """Read a value as TOML; what is none, and a date (no key takes one), is text."""
    try:
        table = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError):
        return text
    value = table["value"]
    plain = table.keys() == {"value"} and isinstance(value, bool | int | float | str | list | dict)
    return value if plain else text


def apply_overrides(tables: dict[str, Any], overrides: Sequence[Override]) -> None:
    """Change a scenario's tables in place, in order; tables that are missing are made.

    Raises:
        ScenarioError: a key leads through something that is no table.

    """
    for override in overrides:
        _put(tables, override)
    _settle_terrain(tables, {override.path for override in overrides})


def _put(tables: dict[str, Any], override: Override) -> None:
    node: Any = tables
    for depth, part in enumerate(override.path[:-1]):
        node = _step(node, part, override, depth)
    last = override.path[-1]
    if isinstance(node, list):
        items = cast("list[Any]", node)
        items[_index(items, last, override, len(override.path) - 1)] = override.value
    else:
        node[last] = override.value


def _step(node: Any, part: str, override: Override, depth: int) -> Any:
    if isinstance(node, list):
        items = cast("list[Any]", node)
        node = items[_index(items, part, override, depth)]
    else:
        node = node.setdefault(part, {})
    if isinstance(node, dict | list):
        return cast("Any", node)
    key = ".".join(override.path[: depth + 1])
    raise ScenarioError([f"{override.option}: {key} is no table, it holds {node!r}"])


def _index(items: list[Any], part: str, override: Override, depth: int) -> int:
    if part.isdecimal() and int(part) < len(items):
        return int(part)
    key = ".".join(override.path[:depth])
    raise ScenarioError(
        [f"{override.option}: {key} is a list of {len(items)}; {part!r} names none of them"]
    )


def _settle_terrain(tables: dict[str, Any], paths: set[tuple[str, ...]]) -> None:
    """Let a terrain file say that the ground comes from a file, and a made ground drop the file.

    So `--set world.terrain.file=x.npz` alone turns any scenario to measured ground, and
    `--set world.terrain.kind=plain` turns it back.
    """
    kind_set, file_set, scale_set = (
        (*_TERRAIN, key) in paths for key in ("kind", "file", "cell_m")
    )
    if not (kind_set or file_set):
        return
    terrain: dict[str, Any] = tables["world"]["terrain"]
    if file_set and not kind_set:
        if terrain["file"]:
            terrain["kind"] = "file"
        elif terrain.get("kind") == "file":
            del terrain["kind"]
    if kind_set and not file_set and terrain["kind"] != "file":
        terrain.pop("file", None)
    if not terrain.get("file") and not scale_set:
        terrain.pop("cell_m", None)
