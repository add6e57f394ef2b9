"""`ropeteam list` and `ropeteam check`: what there is to run, and whether it is right."""

import argparse
import sys

from scenarios.commands.parsing import BAD_INPUT, OK, Commands
from scenarios.errors import ScenarioError


def add(commands: Commands) -> None:
    """Add the commands."""
    listing = commands.add_parser("list", help="list what comes with the program")
    listing.set_defaults(run=_list)
    check = commands.add_parser("check", help="check scenario files without running them")
    check.add_argument("files", nargs="+", metavar="FILE", help="a scenario file, or a name")
    check.set_defaults(run=_check)


def _list(_: argparse.Namespace) -> int:
    from scenarios.shelf import STUDIES, entries

    found, studies = entries(), entries(STUDIES)
    width = max(len(entry.name) for entry in [*found, *studies])
    for title, some in (
        ("scenarios (ropeteam run):", found),
        ("studies (ropeteam sweep):", studies),
    ):
        print(title)
        for entry in some:
            print(f"{entry.name:{width}}  {entry.title}")
    return OK


def _check(args: argparse.Namespace) -> int:
    codes = [_check_one(file) for file in args.files]
    return max(codes)


def _check_one(file: str) -> int:
    """Check a scenario, its ground or floor and the team's places on it included."""
    from scenarios.schema import load
    from scenarios.stage import set_stage
    from sim.errors import WorldError

    try:
        scenario = load(file)
        set_stage(scenario)
    except ScenarioError as error:
        print(error, file=sys.stderr)
    except WorldError as error:
        print(f"{file}: {error}", file=sys.stderr)
    else:
        print(f"{file}: fine ({', '.join(scenario.robots)})")
        return OK
    return BAD_INPUT
