"""The command line: `ropeteam run`, `list`, `check`.

Imports what a command needs when it needs it: help and lists are there at once. Exit codes: 0 the
run ended in order, whatever its outcome; 1 a fault of ours; 2 bad input; 130 Ctrl-C.
"""

import argparse
import os
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from scenarios.errors import ScenarioError, StudyError, UsageError

if TYPE_CHECKING:
    from scenarios.overrides import Override
    from scenarios.schema import Scenario

OK, FAULT, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

_EXAMPLES = """\
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
_EXITS = """\
exit codes: 0 ended in order, whatever the outcome; 1 a fault of the program; 2 bad input (nothing
was started, nothing written); 130 Ctrl-C (records are kept)
"""


class _Parser(argparse.ArgumentParser):
    """Refuses with one sentence and exit code 2."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong, where help is, and leave."""
        self.exit(BAD_INPUT, f"{self.prog}: {message} (help: {self.prog} --help)\n")


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object, **__: object) -> None:
        """Print the version and leave."""
        from importlib.metadata import version

        print(f"ropeteam {version('ropeteam')}")
        parser.exit(OK)


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number") from None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no number") from None


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = _Parser(
        prog="ropeteam",
        description="Teams of mapping robots that share what they see over very thin radio links.",
        epilog=_EXAMPLES + "\n" + _EXITS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and leave")
    commands = parser.add_subparsers(
        title="commands", dest="command", metavar="COMMAND", required=True, parser_class=_Parser
    )
    _add_run(commands)
    commands.add_parser("list", help="list the scenarios that come with the program")
    check = commands.add_parser("check", help="check scenario files without running them")
    check.add_argument("files", nargs="+", metavar="FILE", help="a scenario file, or a name")
    return parser


def _add_run(commands: "argparse._SubParsersAction[_Parser]") -> None:  # pyright: ignore[reportPrivateUsage]  (argparse has no public name for it)
    run = commands.add_parser(
        "run",
        help="run a scenario",
        description=_RUN_HELP,
        epilog=_EXAMPLES + "\n" + _EXITS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    run.add_argument("scenario", metavar="NAME|FILE", help="a name of `ropeteam list`, or a file")
    run.add_argument("--seed", type=_whole, metavar="N", help="of all randomness")
    run.add_argument("--out", metavar="DIR", help="where its files go (runs/NAME-SEED)")
    run.add_argument("--overwrite", action="store_true", help="replace a former run in DIR")
    clocks = ("virtual", "real")
    run.add_argument("--clock", choices=clocks, help="simulated time, or the wall clock")
    run.add_argument(
        "--speed", type=_number, metavar="X", help="simulated s to one wall s (with --clock real)"
    )
    run.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="sets",
        help="change any key of the scenario, e.g. links.rate_bps=5000; may be repeated",
    )
    run.add_argument("--quiet", action="store_true", help="say nothing but errors")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    try:
        args = make_parser().parse_args(argv)
        return _COMMANDS[args.command](args)
    except StudyError as error:
        print(error, file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has left (`ropeteam list | head`); nothing is to be said to it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    except Exception:
        traceback.print_exc()
        print("ropeteam: this is a fault of the program, not of your input", file=sys.stderr)
        return FAULT


def _list(_: argparse.Namespace) -> int:
    from scenarios.shelf import entries

    found = entries()
    width = max(len(entry.name) for entry in found)
    for entry in found:
        print(f"{entry.name:{width}}  {entry.title}")
    return OK


def _check(args: argparse.Namespace) -> int:
    codes = [_check_one(file) for file in args.files]
    return max(codes)


def _check_one(file: str) -> int:
    """Check a scenario, its ground included."""
    from numpy.random import default_rng

    from scenarios.schema import load
    from sim.errors import WorldError
    from sim.terrain import make_terrain

    try:
        scenario = load(file)
        roles = [robot.role for robot in scenario.robots.values()]
        ground = (scenario.world, scenario.map.cell_m, default_rng(scenario.seed), roles)
        make_terrain(*ground, footprint_m=scenario.drive.footprint_m)
    except ScenarioError as error:
        print(error, file=sys.stderr)
    except WorldError as error:
        print(f"{file}: {error}", file=sys.stderr)
    else:
        print(f"{file}: fine ({', '.join(scenario.robots)})")
        return OK
    return BAD_INPUT


def _run(args: argparse.Namespace) -> int:
    scenario = _load(args)
    out = _folder(args, scenario)
    from scenarios.runner import run
    from sim.errors import WorldError

    try:
        run(scenario, out, quiet=args.quiet, overwrite=args.overwrite)
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


_COMMANDS = {"run": _run, "list": _list, "check": _check}


if __name__ == "__main__":
    sys.exit(main())
