"""Writes the JSON Schemas that the shipped files refer to (`make scenario-keys`)."""

import sys
from pathlib import Path

from scenarios.jsonschema import scenario_schema, study_schema, text

LIBRARY = Path(__file__).parents[1] / "scenarios" / "library"
FILES = {
    LIBRARY / "scenario.schema.json": scenario_schema,
    LIBRARY / "studies" / "study.schema.json": study_schema,
}


def main() -> int:
    """Write the files."""
    for path, schema in FILES.items():
        path.write_text(text(schema()), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
