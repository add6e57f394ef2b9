"""Scenarios read from files and written to them, with one sentence for each thing that is wrong."""

import json
from collections.abc import Sequence
from typing import Any

import tomli_w
from pydantic import ValidationError

from scenarios.errors import ScenarioError
from scenarios.schema.files import place_files
from scenarios.schema.overrides import Override, apply_overrides, parse_override
from scenarios.schema.problems import sentences
from scenarios.schema.scenario import Scenario
from scenarios.schema.team import expand_team
from scenarios.shelf import find, read


def load(
    name_or_path: str,
    overrides: Sequence[str | Override] = (),
    seed: int | None = None,
) -> Scenario:
    """Return the scenario of a library name or file, changed by `key=value` overrides.

    Raises:
        ScenarioError: with one sentence per problem.

    """
    path = find(name_or_path)
    changes = [parse_override(o) if isinstance(o, str) else o for o in overrides]
    if seed is not None:
        changes.append(Override(f"--seed {seed}", ("seed",), seed))
    tables = read(path)
    apply_overrides(tables, changes)
    place_files(tables, path, changes)
    return parse(tables, str(path), changes)


def parse(tables: dict[str, Any], source: str, changes: Sequence[Override] = ()) -> Scenario:
    """Check a scenario's tables; `source` and `changes` say in errors where a key came from.

    Raises:
        ScenarioError: with one sentence per problem.

    """

    def place(key: str) -> str:
        whole = [c.option for c in changes if f"{key}.".startswith(f"{c.key}.")]
        parts = [c.option for c in changes if c.key.startswith(f"{key}.")]
        return whole[-1] if whole else " with ".join([source, *parts])

    try:
        tables = (
            {**tables, "robots": expand_team(tables["robots"])} if "robots" in tables else tables
        )
    except ValueError as error:
        raise ScenarioError([f"{place('robots')}: robots: {error}"]) from error
    try:
        # As JSON: strict about types, and lists are taken for tuples.
        return Scenario.model_validate_json(json.dumps(tables, default=_refuse_date))
    except ValueError as error:
        if not isinstance(error, ValidationError):
            raise ScenarioError([f"{source}: {error}"]) from error
        raise ScenarioError(sentences(error, Scenario, place)) from error


def _refuse_date(value: object) -> str:
    raise ValueError(f"holds the date {value}; no key takes one (text stands in quotes)")


def dump(scenario: Scenario) -> str:
    """Return a scenario as TOML that loads back equal.

    Every key is written out, and events come last: more `[[events]]` may be added at the end.
    """
    tables = scenario.model_dump(mode="json", exclude_none=True)
    events: list[dict[str, Any]] = tables.pop("events")
    tables["links"] = {key: value for key, value in tables["links"].items() if value != {}}
    head = "# The complete scenario, defaults included. [[events]] may be added at the end.\n"
    parts = [
        head,
        tomli_w.dumps(tables),
        *(f"[[events]]\n{tomli_w.dumps(event)}" for event in events),
    ]
    return "\n".join(parts)
