"""`ropeteam ros2`: a run's maps live in ROS 2."""

import argparse
import os
from pathlib import Path

from scenarios.commands.parsing import OK, Commands, whole
from scenarios.errors import UsageError

ROUTER = "tcp/127.0.0.1:7447"
_DESCRIPTION = """\
Publishes a run, one that goes on or one that has ended, as ROS 2 messages over Zenoh, as rmw_zenoh
does (Jazzy or later; RMW_IMPLEMENTATION=rmw_zenoh_cpp). ROS's router must run:

  ros2 run rmw_zenoh_cpp rmw_zenohd

Ends with Ctrl-C. `ropeteam run NAME --ros2` does the same from the start of a run to its end.
"""


def add(commands: Commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "ros2",
        help="publish a run's maps live into ROS 2",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_argument("folder", metavar="RUN", type=Path, help="the folder of a run")
    command.add_argument("--router", default=ROUTER, metavar="ENDPOINT", help=f"({ROUTER})")
    command.add_argument("--domain", type=whole, metavar="N", help="(ROS_DOMAIN_ID, or 0)")
    command.add_argument("--until-eof", action="store_true", help="end with standard input")
    command.set_defaults(run=_run)


def domain_of(asked: int | None) -> int:
    """Return the ROS domain that was asked for, or that the environment names, or 0."""
    text = os.environ.get("ROS_DOMAIN_ID", "0") if asked is None else str(asked)
    if not (text.isdecimal() and int(text) <= 232):
        raise UsageError(f"ROS domain {text!r}: must be a number from 0 to 232")
    return int(text)


def check(router: str) -> None:
    """Refuse a router that does not answer, before anything is started."""
    from comms.errors import CommsError
    from comms.ros2_zenoh import check_router

    try:
        check_router(router)
    except CommsError as error:
        raise UsageError(str(error)) from error


def _run(args: argparse.Namespace) -> int:
    from scenarios.ros2.bridge import serve

    domain = domain_of(args.domain)
    if not (args.folder / "scenario.toml").is_file():
        raise UsageError(f"{args.folder}: is no run: there is no scenario.toml in it")
    check(args.router)
    serve(args.folder, args.router, domain, until_eof=args.until_eof)
    return OK
