"""Small runs on occupancy maps: two explorers on a floor or in a cave, seconds of computing."""

from scenarios.schema import Scenario, load

PAIR = ("explorer-1", "explorer-2")
SMALL = {
    "planar": (
        "robots.count=2", "world.window_m=[16.0, 16.0]", "sensor.fov_deg=75", "sensor.range_m=5",
        "sensor.columns=96", "planner.max_candidates=40",
    ),
    "cave": (
        "world.window_m=[11.0, 10.0]", "world.cave.chambers=1", "world.cave.height_m=5.0",
        "world.cell_m=0.35", "drive.climb_m=0.4", "sensor.range_m=5", "sensor.columns=40",
        "sensor.rows=34", "planner.max_candidates=20", "planner.headings=8",
        "planner.min_gain_cells=80",
    ),
}  # fmt: skip


def small(name: str, *overrides: str) -> Scenario:
    """Return a scenario of the library, `planar` or `cave`, in small; explorers see 5 m far."""
    return load(name, [*SMALL[name], "air=memory", "limit_s=2400", *overrides])
