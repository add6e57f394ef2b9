"""In which settings the scenarios of several runs differ."""

import math
import tomllib
from collections.abc import Iterator, Sequence
from typing import Any, cast

Value = bool | int | float | str | None
SHOWN_ABOVE = frozenset({"name", "title", "seed"})
"""Said elsewhere on the page."""


def settings_of(scenario: str) -> dict[str, Value]:
    """Return all settings of a complete scenario file, by key: "links.rate_bps", "event 1".

    Raises:
        ValueError: it is no TOML.

    """
    return dict(_flat(tomllib.loads(scenario), ""))


def varied(runs: Sequence[dict[str, Value]]) -> list[tuple[str, list[Value]]]:
    """Return (key, its value in each run) where they are not all the same; None: it has none."""
    keys = {key: None for settings in runs for key in settings}
    rows = [(key, [settings.get(key) for settings in runs]) for key in keys]
    return [(key, values) for key, values in rows if len({repr(value) for value in values}) > 1]


def _flat(table: dict[str, Any], above: str) -> Iterator[tuple[str, Value]]:
    for key, value in table.items():
        if not above and key in SHOWN_ABOVE:
            continue
        if isinstance(value, dict):
            yield from _flat(cast("dict[str, Any]", value), f"{above}{key}.")
        elif key == "events" and not above:
            yield from ((f"event {n}", _line(event)) for n, event in enumerate(value, start=1))
        else:
            yield f"{above}{key}", _line(value)


def _line(value: object) -> Value:
    """Return a value as it is if JSON has its like, and else in words on one line."""
    match value:
        case bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else str(value)
        case dict():
            pairs = cast("dict[str, object]", value).items()
            return ", ".join(f"{key} = {_line(one)}" for key, one in pairs)
        case list():
            return f"[{', '.join(str(_line(one)) for one in cast('list[object]', value))}]"
        case _:  # a date
            return str(value)
