"""Writes the tables of `docs/scenarios.md` from the settings themselves (`make scenario-keys`).

A key, its default, what is allowed and what it means are defined once, beside the code that reads
them; a test holds that the page says the same.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from comms.linksettings import AllLinks
from comms.profiles import PROFILES, LinkProfile
from scenarios.jsonschema import scenario_schema

PAGE = Path(__file__).with_name("scenarios.md")
BEGIN, END = "<!-- keys: begin -->", "<!-- keys: end -->"

# What the settings leave to the key's name, said for readers of the page.
MEANINGS = {
    "world.landmarks.NAME.x_m": "Where it stands, from the west edge of the window.",
    "world.landmarks.NAME.y_m": "The same from the south edge.",
    "robots.NAME.role": "What it does: recon and explorer map; a cliffbot needs two anchors.",
    "drive.speed_mps": "Driving speed.",
    "drive.turn_rate_radps": "Turning speed, on the spot.",
    "drive.yaw_sigma_deg_per_m": "Heading error along the way, per metre driven.",
    "planner.max_candidates": "Most candidate positions that are rated for one look.",
    "planner.max_looks": "A robot stops exploring after so many looks.",
    "sensor.fov_vertical_deg": "Vertical field of view.",
    "sensor.near_m": "Nothing is measured nearer than this.",
    "sensor.columns": "Rays across one look.",
    "sensor.rows": "Rays down one look.",
    "sensor.stereo.width_px": "Width of each image.",
    "sensor.stereo.height_px": "Height of each image.",
    "sensor.stereo.baseline_m": "Distance between the two cameras.",
    "world.light.sun_elevation_deg": "Height of the sun over the horizon.",
    "world.light.ground_albedo": "Mean share of the light that the ground gives back.",
    "sensor.noise_n": "n of Eq. 4: noise grows with range to this power.",
    "sharing.policy": "What is sent first: what is worth most per byte, or what is newest.",
    "links.profile": "The radio to start from: one of the table above.",
    "world.terrain.swell_wavelength_m": "Length of a plain's swells.",
    "world.terrain.rock_max_m": "Largest rock that is placed (diameter).",
    "tether.rate_mps": "Fastest that a winch pays out or takes in.",
    "tether.max_length_m": "Tether on a winch's drum.",
}
TITLES = {
    "": "The scenario itself",
    "clock": "Clock",
    "robots.NAME": "One robot",
    "robots.NAME.recording": "A recording in a robot's place",
    "links": "Links",
    "events": "Events",
    "world": "World",
    "world.terrain": "Terrain",
    "world.light": "Light",
    "world.landmarks.NAME": "One landmark",
    "world.cave": "Cave",
    "map": "Map",
    "sensor": "Sensor",
    "sensor.stereo": "Stereo cameras",
    "drive": "Drive",
    "planner": "Planner",
    "sharing": "Sharing",
    "tether": "Tethers",
}
LINK_KEYS = frozenset(AllLinks.model_fields)


def page_tables() -> str:
    """Return all tables as Markdown: radios first, then every table of a scenario file."""
    schema = scenario_schema()
    found = dict(_tables("", schema, schema["$defs"]))
    assert found.keys() == TITLES.keys(), found.keys() ^ TITLES.keys()
    parts = ["### Radios", "", *_radios(), ""]
    for table, title in TITLES.items():
        parts += [f"### {title}", "", *_intro(table), *_rows(table, found[table]), ""]
    return "\n".join(parts).rstrip() + "\n"


def _tables(
    table: str, schema: dict[str, Any], definitions: dict[str, Any]
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every table of a scenario file with its plain keys, by the table's name."""
    keys: dict[str, Any] = {}
    for key, entry in schema["properties"].items():
        maybe = next((one for one in entry.get("anyOf", ()) if "$ref" in one), {})
        inner = entry.get("$ref") or entry.get("items", {}).get("$ref") or maybe.get("$ref")
        path = f"{table}.{key}" if table else key
        if path in ("robots", "world.landmarks"):
            inner = next(iter(entry["patternProperties"].values()))["$ref"]
            path = f"{path}.NAME"
        if inner:
            yield from _tables(path, definitions[inner.rsplit("/", 1)[1]], definitions)
        elif "additionalProperties" not in entry:
            keys[key] = entry | {"required": key in schema.get("required", ())}
    if table == "events":
        keys = {key: entry for key, entry in keys.items() if key not in LINK_KEYS}
    yield table, keys


INTROS = {
    "": "At the top of the file, before any table.",
    "robots.NAME": (
        "`[robots.NAME]` for each robot. Or `[robots]` with `count = 3` (and `role`, which is"
        " `explorer` if left out) for explorer-1, explorer-2, explorer-3."
    ),
    "robots.NAME.recording": (
        "`[robots.NAME.recording]`: a log of a real robot, or of a run, [leads this"
        " robot](recordings.md)."
    ),
    "world.landmarks.NAME": (
        "`[world.landmarks.NAME]` for each: a thing of a robot's size that bears its fiducials,"
        " and whose place everybody knows. Cameras on rough ground see it as they see a robot."
    ),
    "links": (
        '`[links]` for all; the same keys in `[links.robots.NAME]` and `[links.pairs."A>B"]`.'
        " What is left out is the radio's own."
    ),
    "events": "`[[events]]`, one for each. Beside `link` stand any keys of `[links]`.",
}


def _intro(table: str) -> list[str]:
    return [INTROS.get(table, f"`[{table}]`"), ""]


def _rows(table: str, keys: dict[str, Any]) -> list[str]:
    rows = ["| Key | Default | Allowed | Meaning |", "|---|---|---|---|"]
    for key, entry in keys.items():
        path = f"{table}.{key}" if table else key
        said = entry.get("description") or MEANINGS.get(path, "")
        assert said, f"{path} has no docstring, and MEANINGS says nothing of it either"
        allowed = _allowed(entry)
        rows.append(
            f"| `{key}` | {_default(entry)} | {allowed} | {_cell(' '.join(said.split()))} |"
        )
    return rows


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _default(entry: dict[str, Any]) -> str:
    if entry["required"]:
        return "must be given"
    value = entry.get("default")
    return "" if value is None else f"`{json.dumps(value)}`"


def _allowed(entry: dict[str, Any]) -> str:
    """Say in words what a key takes."""
    entry = next((e for e in entry.get("anyOf", ()) if e.get("type") != "null"), entry)
    choices = entry.get("enum", ())
    if "const" in entry:
        choices = (entry["const"],)
    if choices:
        return ", ".join(f"`{choice}`" for choice in choices)
    if entry["type"] == "array":
        several = entry.get("prefixItems", ())
        head = f"{len(several)} of: " if several else "list of: "
        return head + _allowed(several[0] if several else entry["items"])
    words = {"string": "text", "boolean": "true, false", "integer": "whole number"}
    return " ".join([words.get(entry["type"], "number"), *_limits(entry)])


def _limits(entry: dict[str, Any]) -> list[str]:
    signs = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    said = [f"{sign} {_number(entry[key])}" for key, sign in signs.items() if key in entry]
    return [", ".join(said)] if said else []


def _number(value: float) -> str:
    return "2^63" if value == 2**63 else f"{value:.10g}"


def _radios() -> list[str]:
    rows = [
        "| `links.profile` | Rate | Latency | Longest frame | Charged on top of each frame |",
        "|---|---|---|---|---|",
    ]
    return rows + [_radio(profile) for profile in PROFILES.values()]


def _radio(profile: LinkProfile) -> str:
    rate = (
        "frames take no time" if profile.rate_bps == float("inf") else f"{profile.rate_bps:g} bps"
    )
    latency_ms = profile.latency_ns / 1_000_000
    return (
        f"| `{profile.name}` | {rate} | {latency_ms:g} ms | {profile.frame_bytes} bytes |"
        f" {profile.overhead_bytes} bytes |"
    )


def with_tables(page: str) -> str:
    """Return a page with its tables written anew."""
    before, rest = page.split(BEGIN)
    after = rest.split(END)[1]
    return f"{before}{BEGIN}\n\n{page_tables()}\n{END}{after}"


def main() -> int:
    """Write the tables into the page."""
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
