"""`ropeteam export`: a run's maps and ways in the formats of others."""

import argparse
from pathlib import Path

from scenarios.commands.parsing import OK, Commands

FORMATS = ("geotiff", "npz", "ply", "map_server", "octomap", "tum", "mcap")
_DESCRIPTION = """\
Writes a robot's team map as it was at the end of a run, or its way, into RUN/export.

  geotiff     ROBOT.tif: elevation and sigma, m (of a floor: probability of being occupied)
  npz         ROBOT.npz: the same for numpy; `world.terrain.file` reads it
  ply         ROBOT.ply: points x, y, z, sigma
  map_server  ROBOT.yaml and .png: free, occupied, unknown
  octomap     ROBOT.bt: OctoMap tree
  tum         ROBOT-true.tum, ROBOT-believed.tum: its way, as it was and as it believed
  mcap        RUN/run.mcap: the whole run for ROS 2 viewers, once more from the robots' logs
"""
_EXAMPLES = """\
examples:
  ropeteam export runs/cliff-1 --robot recon --format geotiff
  ropeteam export runs/cliff-1 --format tum
"""


def add(commands: Commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "export",
        help="maps and ways of a run as GeoTIFF, PLY, OctoMap, TUM ...",
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_argument("folder", metavar="RUN", type=Path, help="the folder of a run")
    command.add_argument("--robot", metavar="NAME", help="whose; left out: of all")
    command.add_argument(
        "--format", required=True, action="append", choices=FORMATS, help="may be repeated"
    )
    command.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    from scenarios.exports import export
    from scenarios.ros2.bag import write_bag

    formats = [name for name in args.format if name != "mcap"]
    paths = [write_bag(args.folder)] if "mcap" in args.format else []
    paths += export(args.folder, formats, args.robot) if formats else []
    for path in paths:
        print(f"{path}: {path.stat().st_size:,} bytes")
    return OK
