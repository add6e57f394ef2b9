"""A world so small that twenty runs fit into a second: few tiles, a cheap sensor and planner.

Everything else is what always runs: codec, radio, sharing, repair, disk, fusion, clock.
"""

from scenarios.overrides import Override, parse_override
from scenarios.schema import MAPPERS

SMALL = (
    "air=memory",
    "method=wander",
    "sample_s=30",
    "world.seed=1",
    "world.window_m=[8.0, 8.0]",
    "world.terrain.rock_fraction=0",
    "world.terrain.jumble_m=0",
    "world.terrain.roughness_m=0.05",
    "map.cell_m=0.25",
    "map.tile_cells=16",
    "map.max_error_m=0.02",
    "sensor.columns=12",
    "sensor.rows=8",
    "sensor.range_m=4",
    "sensor.look_s=4",
    "planner.first_looks=2",
    "planner.max_looks=4",
    "planner.candidate_step_m=1",
    "drive.speed_mps=0.3",
    "drive.turn_rate_radps=0.6",
    "drive.footprint_m=0.5",
    "sharing.status_s=20",
)
