"""A world so small that twenty runs fit into a second: few tiles, a cheap sensor and planner.

Everything else is what always runs: codec, radio, sharing, repair, disk, fusion, clock.
"""

from scenarios.schema.overrides import Override, parse_override
from scenarios.shelf import find, read

SMALL = (
    "air=memory",
    "method=wander",
    "sample_s=15",
    "world.seed=1",
    "world.window_m=[12.0, 4.0]",
    "world.terrain.rock_fraction=0",
    "world.terrain.jumble_m=0",
    "world.terrain.roughness_m=0.05",
    "map.cell_m=0.25",
    "map.tile_cells=16",
    "map.max_error_m=0.02",
    "sensor.columns=12",
    "sensor.rows=8",
    "sensor.fov_deg=110",
    "sensor.range_m=3",
    "sensor.look_s=4",
    "planner.first_looks=1",
    "planner.max_looks=3",
    "planner.candidate_step_m=1",
    "drive.speed_mps=0.3",
    "drive.turn_rate_radps=0.6",
    "drive.footprint_m=0.5",
    "sharing.status_s=20",
)

LEDGE = (
    "world.window_m=[10.0, 9.0]",
    "world.terrain.drop_m=1",
    "world.terrain.slope_deg=30",
    "world.terrain.lip_m=1",
    "world.terrain.edge_meander_m=0",
    "world.terrain.roughness_m=0",
    "world.terrain.texture_poor=0",
    "map.cell_m=0.5",
    "sensor.fov_deg=140",
    "sensor.columns=64",
    "sensor.rows=48",
    "sensor.range_m=9",
    "sensor.noise_s=0.0002",
    "sensor.look_s=10",
    "planner.first_looks=3",
    "planner.max_looks=3",
    "tether.rate_mps=0.3",
)
"""For a team with a Cliff-bot: a bank, and a camera that shows the way down it in one round."""


def small_changes(name_or_path: str) -> list[Override]:
    """Return what makes a scenario small; a team that is only counted has three robots."""
    robots = read(find(name_or_path)).get("robots", {})
    changes: list[str] = list(SMALL)
    if "count" in robots:
        changes.append("robots.count=3")
    tables = [table for table in robots.values() if isinstance(table, dict)]
    if any(table.get("role") == "cliffbot" for table in tables):
        changes += LEDGE
    return [parse_override(change) for change in changes]
