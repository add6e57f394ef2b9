"""`ropeteam run`: a scenario, from a name or a file to its records."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.commands.parsing import OK, Commands, number, whole
from scenarios.commands.places import add_places, crew_on_hosts
from scenarios.errors import ScenarioError, UsageError

if TYPE_CHECKING:
    from scenarios.overrides import Override
    from scenarios.schema import Scenario

EXAMPLES = """\
examples:
  ropeteam list                               what can be run
  ropeteam run cliff                          four robots at a cliff, over 9600-baud radios
  ropeteam run cliff --seed 2 --out runs/two  other ground, other noise
  ropeteam run cliff --set links.profile=sojourner --set sharing.policy=latest-first
  ropeteam run cliff --set world.terrain.file=ground.npz
  ropeteam run pair --clock real --speed 20   on the wall clock, twenty times as fast
  ropeteam run runs/cliff-1/scenario.toml     once more, exactly
  ropeteam check mine.toml                    is my scenario file right?
"""
_RUN_HELP = """\
Runs a scenario and leaves in DIR: overview.png (a picture of it), summary.json (what came out),
looks.csv, frames.csv, maps.csv, events.csv (what happened), one log per robot, host.json (what it
cost this computer) and scenario.toml (the complete scenario: it can be run again).
"""
EXITS = """\
exit codes: 0 ended in order, whatever the outcome; 1 a fault of the program; 2 bad input (nothing
was started, nothing written); 130 Ctrl-C (records are kept)
"""


def add(commands: Commands) -> None:
    """Add the command."""
    run = commands.add_parser(
        "run",
        help="run a scenario",
        description=_RUN_HELP,
        epilog=EXAMPLES + "\n" + EXITS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    run.add_argument("scenario", metavar="NAME|FILE", help="a name of `ropeteam list`, or a file")
    run.add_argument("--seed", type=whole, metavar="N", help="of all randomness")
    run.add_argument("--out", metavar="DIR", help="where its files go (runs/NAME-SEED)")
    run.add_argument("--overwrite", action="store_true", help="replace a former run in DIR")
    clocks = ("virtual", "real")
    run.add_argument("--clock", choices=clocks, help="simulated time, or the wall clock")
    run.add_argument(
        "--speed", type=number, metavar="X", help="simulated s to one wall s (with --clock real)"
    )
    run.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="sets",
        help="change any key of the scenario, e.g. links.rate_bps=5000; may be repeated",
    )
    add_places(run)
    run.add_argument("--quiet", action="store_true", help="say nothing but errors")
    run.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    scenario = _load(args)
    crew_of = crew_on_hosts(args, scenario)
    out = _folder(args, scenario)
    from scenarios.runner import run
    from sim.errors import WorldError

    try:
        run(scenario, out, quiet=args.quiet, overwrite=args.overwrite, crew_of=crew_of)
    except WorldError as error:
        raise ScenarioError([f"{args.scenario}: {error}"]) from error
    return OK


def _load(args: argparse.Namespace) -> "Scenario":
    from scenarios.overrides import parse_override
    from scenarios.schema import load

    changes = [*_clock_changes(args), *(parse_override(text) for text in args.sets)]
    scenario = load(args.scenario, changes, seed=args.seed)
    if args.speed is not None and scenario.clock.mode != "real":
        raise UsageError(f"--speed {args.speed:g}: only the real clock has one; add --clock real")
    return scenario


def _clock_changes(args: argparse.Namespace) -> "list[Override]":
    from scenarios.overrides import Override

    changes: list[Override] = []
    if args.clock is not None:
        changes.append(Override(f"--clock {args.clock}", ("clock", "mode"), args.clock))
    if args.clock == "virtual" and args.speed is None:
        changes.append(Override("--clock virtual", ("clock", "speed"), 1.0))
    if args.speed is not None:
        changes.append(Override(f"--speed {args.speed:g}", ("clock", "speed"), args.speed))
    return changes


def _folder(args: argparse.Namespace, scenario: "Scenario") -> Path:
    from scenarios import folder

    if args.out is not None:
        out = Path(args.out)
    elif args.overwrite:
        out = Path("runs") / f"{scenario.name}-{scenario.seed}"
    else:
        out = folder.choose(scenario.name, scenario.seed)
    folder.check(out, overwrite=args.overwrite)
    return out
