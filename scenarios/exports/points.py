"""Maps as points: PLY (binary, little-endian)."""

from pathlib import Path

from scenarios.exports.kept import Kept
from scenarios.formats.rtm import write_file
from scenarios.ros2.messages import map_points


def write_ply(kept: Kept, folder: Path) -> list[Path]:
    """Write ROBOT.ply: a vertex per known cell, x, y, z and sigma in m.

    Of a floor a vertex per solid cell, at z = 0, and the probability that it is solid.
    """
    points = map_points(kept.chart).astype("<f4")
    fourth = "sigma" if "elevation" in kept.chart.layers else "occupied"
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {kept.robot}'s team map; metres, x east, y north, z up",
        f"element vertex {len(points)}",
        *(f"property float {name}" for name in ("x", "y", "z", fourth)),
        "end_header",
    ]
    path = folder / f"{kept.robot}.ply"
    write_file(path, "\n".join(lines).encode() + b"\n" + points.tobytes())
    return [path]
