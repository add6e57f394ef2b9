"""JSON Schema of scenario and study files: editors complete keys, and mark what is wrong."""

import json
from typing import Any

from agents import planar
from agents.planning.strategies import STRATEGIES
from agents.sharing import WAYS
from agents.voxel import choosing
from comms.plugins import Plugins
from scenarios.schema import MAPPERS, MAX_ROBOTS, Scenario
from scenarios.studies.study import Study
from sim.sensors import SENSORS
from sim.terrain import TERRAINS

DIALECT = "https://json-schema.org/draft/2020-12/schema"
NAMED: dict[tuple[str, str], tuple[tuple[Plugins[Any], ...], tuple[str, ...]]] = {
    ("", "method"): ((STRATEGIES, planar.METHODS, choosing.METHODS), ()),
    ("SharingSettings", "policy"): ((WAYS,), ()),
    ("SensorSettings", "kind"): ((SENSORS,), ()),
    ("TerrainSettings", "kind"): ((TERRAINS,), ("file",)),
}
"""By settings class and key: the parts that a key names, and names that stand for none."""


def scenario_schema(*, installed: bool = False) -> dict[str, Any]:
    """Return the schema of scenario files; `installed`: with the parts of installed packages."""
    schema = Scenario.model_json_schema()
    for (table, key), (kinds, more) in NAMED.items():
        node = schema["$defs"][table] if table else schema
        names = [n for kind in kinds for n in (kind.names() if installed else kind.own)]
        node["properties"][key]["enum"] = list(dict.fromkeys((*names, *more)))
    robots = schema["properties"]["robots"]
    robots.pop("minProperties", None)
    (pattern, table), *_ = robots.pop("patternProperties").items()
    robots["patternProperties"] = {f"^(?!(count|role)$){pattern.removeprefix('^')}": table}
    robots["additionalProperties"] = False
    robots["properties"] = {
        "count": {"type": "integer", "minimum": 1, "maximum": MAX_ROBOTS},
        "role": {"enum": list(MAPPERS)},
    }
    return _headed(schema, "A scenario of ropeteam")


def study_schema() -> dict[str, Any]:
    """Return the schema of study files."""
    return _headed(Study.model_json_schema(), "A study of ropeteam")


def _headed(schema: dict[str, Any], title: str) -> dict[str, Any]:
    return {"$schema": DIALECT, **schema, "title": title, "description": title}


SCHEMAS = {"scenario": scenario_schema, "study": study_schema}


def text(schema: dict[str, Any]) -> str:
    """Return a schema as it stands in a file."""
    return json.dumps(schema, indent=1) + "\n"
