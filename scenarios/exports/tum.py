"""Ways as TUM files: `t x y z qx qy qz qw` per line, in s and m, as `evo` reads them."""

import math
from collections.abc import Mapping
from pathlib import Path

from agents.geometry import Pose
from comms.timebase import to_s
from scenarios.exports.kept import Kept, NothingKeptError
from scenarios.formats.rtm import write_file


def write_tum(kept: Kept, folder: Path) -> list[Path]:
    """Write ROBOT-true.tum, and ROBOT-believed.tum of the times at which it stood."""
    if not kept.true:
        raise NothingKeptError(f"{kept.run}: {kept.robot}'s log holds no poses")
    paths = [folder / f"{kept.robot}-{name}.tum" for name in ("true", "believed")]
    for path, way in zip(paths, (kept.true, kept.believed), strict=True):
        write_file(path, _lines(way).encode())
    return paths


def _lines(way: Mapping[int, Pose]) -> str:
    return "".join(_line(t_ns, way[t_ns]) for t_ns in sorted(way))


def _line(t_ns: int, pose: Pose) -> str:
    z, w = math.sin(pose.yaw_rad / 2), math.cos(pose.yaw_rad / 2)
    numbers = (pose.x_m, pose.y_m, pose.z_m, 0.0, 0.0, z, w)
    return " ".join([f"{to_s(t_ns):.9f}", *(f"{number:.9g}" for number in numbers)]) + "\n"
