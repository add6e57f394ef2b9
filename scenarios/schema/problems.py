"""What is wrong with a scenario, told in plain sentences.

Every sentence has the place (file or option), the key, the value found, and what is allowed; the
last is read off the schema itself, so that it can't go stale.
"""

import difflib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, cast

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

CONFLICT = "conflict"
_MAX_VALUE_CHARS = 80


@dataclass(frozen=True)
class Conflict:
    """Two settings that are allowed each by itself, but not together."""

    key: str
    value: Any
    sentence: str


def refuse(conflicts: Sequence[Conflict]) -> None:
    """Refuse a scenario, from a pydantic validator, if there are conflicts in it."""
    if conflicts:
        raise PydanticCustomError(CONFLICT, "conflicts", {"conflicts": list(conflicts)})


def sentences(
    error: ValidationError, model: type[BaseModel], place: Callable[[str], str]
) -> list[str]:
    """Return one sentence per problem; `place` says where a dotted key was written."""
    schema = _schema(model)
    found = [line for one in error.errors() for line in _translate(one, schema, place)]
    return list(dict.fromkeys(found))


@cache
def _schema(model: type[BaseModel]) -> dict[str, Any]:
    return model.model_json_schema()


def show(value: Any) -> str:
    """Write a value as it might stand in the file, cut where it is long."""
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= _MAX_VALUE_CHARS else text[: _MAX_VALUE_CHARS - 3] + "..."


def _translate(one: ErrorDetails, schema: dict[str, Any], place: Callable[[str], str]) -> list[str]:
    if one["type"] == CONFLICT:
        conflicts = cast("list[Conflict]", one.get("ctx", {})["conflicts"])
        return [f"{place(c.key)}: {c.key} = {show(c.value)}: {c.sentence}" for c in conflicts]
    loc = [part for part in one["loc"] if part != "[key]"]
    if one["type"] == "missing" and isinstance(loc[-1], int):
        loc.pop()  # a list that is too short is told as a whole
        one["type"] = "too_short"
    key = ".".join(map(str, loc))
    if one["type"] == "missing":
        return [f"{place(key)}: {key}: is missing; must be {_allowed(schema, loc)}"]
    head = f"{place(key)}: {key} = {show(one['input'])}"
    if one["type"] == "extra_forbidden":
        return [f"{head}: {_unknown(schema, loc)}"]
    if one["type"] in ("value_error", "assertion_error"):
        return [f"{head}: {one.get('ctx', {}).get('error', one['msg'])}"]
    if "[key]" in one["loc"]:
        return [f"{place(key)}: {key}: is no name; {NAME_RULE}"]
    return [f"{head}: must be {_allowed(schema, loc)}"]


NAME_RULE = "a name has letters, digits, '-' and '_', starts with a letter, and has at most 32"


def _unknown(schema: dict[str, Any], loc: Sequence[str | int]) -> str:
    keys = sorted(_node(schema, loc[:-1]).get("properties", {}))
    close = difflib.get_close_matches(str(loc[-1]), keys, n=1)
    hint = f", did you mean {close[0]}?" if close else ";"
    return f"there is no such key{hint} allowed here: {', '.join(keys)}"


def _allowed(schema: dict[str, Any], loc: Sequence[str | int]) -> str:
    return describe(_node(schema, loc), schema)


def _resolve(node: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    while "$ref" in node:
        node = schema["$defs"][node["$ref"].rpartition("/")[2]]
    return node


def _options(node: dict[str, Any], schema: dict[str, Any]) -> list[dict[str, Any]]:
    options = [_resolve(option, schema) for option in node.get("anyOf", [node])]
    return [option for option in options if option.get("type") != "null"]


def _child(node: dict[str, Any], part: str | int) -> dict[str, Any] | None:
    if isinstance(part, int):
        items = node.get("prefixItems", [])
        return items[part] if part < len(items) else node.get("items")
    named = node.get("properties", {}).get(part)
    patterns = list(node.get("patternProperties", {}).values())
    return named or node.get("additionalProperties") or (patterns[0] if patterns else None)


def _node(schema: dict[str, Any], loc: Sequence[str | int]) -> dict[str, Any]:
    """Return the schema of the value at a location; where pydantic adds a part, its parent's."""
    node = schema
    for part in loc:
        options = _options(_resolve(node, schema), schema)
        children = [child for option in options if (child := _child(option, part))]
        if not children:
            break
        node = children[0]
    return _resolve(node, schema)


def describe(node: dict[str, Any], schema: dict[str, Any]) -> str:
    """Say in words which values a schema allows."""
    node = _resolve(node, schema)
    if "anyOf" in node:
        return " or ".join(describe(option, schema) for option in _options(node, schema))
    if "enum" in node:
        return f"one of {', '.join(map(str, node['enum']))}"
    match node.get("type"):
        case "number" | "integer":
            return _describe_number(node)
        case "array":
            return _describe_array(node, schema)
        case "string":
            return f"text ({node['description']})" if "pattern" in node else "text"
        case kind:
            names = {"boolean": "true or false", "object": "a table"}
            return names.get(str(kind), str(node.get("const")))


def _describe_number(node: dict[str, Any]) -> str:
    words = ["a whole number" if node["type"] == "integer" else "a number"]
    bounds = {
        "exclusiveMinimum": "above",
        "minimum": "of at least",
        "exclusiveMaximum": "below",
        "maximum": "at most",
    }
    limits = [f"{word} {plain(node[key])}" for key, word in bounds.items() if key in node]
    return " ".join([*words, " and ".join(limits)]).strip()


def plain(number: float) -> str:
    """Write a number the way people do: 7200, not 7200.0 or 7.2e+03."""
    return str(int(number)) if number == int(number) else repr(number)


def _describe_array(node: dict[str, Any], schema: dict[str, Any]) -> str:
    if "prefixItems" in node:
        items = [describe(item, schema) for item in node["prefixItems"]]
        return f"a list of {len(items)} values, each {items[0]}"
    return f"a list of values, each {describe(node.get('items', {}), schema)}"
