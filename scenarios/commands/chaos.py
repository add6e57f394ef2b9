"""`ropeteam chaos`: many short runs, each under faults drawn from its seed, all held to account."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.commands.parsing import FAULT, OK, Commands, number, whole
from scenarios.errors import UsageError

if TYPE_CHECKING:
    from scenarios.chaos.series import Failure, Series, Tally

HORIZON_S = {True: 90.0, False: 1800.0}
"""Faults happen before this in a small world, and in any other."""
SETTLE_S = {True: 3600.0, False: 7200.0}
"""Time that a team has afterwards to finish and to become of one mind."""


def add(commands: Commands) -> None:
    """Add the command's parser."""
    chaos = commands.add_parser(
        "chaos",
        help="run a scenario under random faults, and check what must hold all the same",
        description="Runs a scenario again and again, each time under faults drawn from the seed"
        " (run i has seed S + i), and checks from the records that nothing was lost, nothing"
        " counted twice, and that survivors agree. What breaks is told as one line that runs it"
        " again, and shrunk to the fewest faults that still break it. Exit code 1 where anything"
        " broke.",
        allow_abbrev=False,
    )
    chaos.add_argument("scenario", metavar="SCENARIO", help="a name of the library, or a file")
    chaos.add_argument("--runs", type=whole, default=100, metavar="N", help="how many (100)")
    chaos.add_argument("--seed", type=whole, default=1, metavar="S", help="of the first run (1)")
    chaos.add_argument("--faults", default="", metavar="A,B", help="only these kinds of faults")
    chaos.add_argument("--small", action="store_true", help="in a world of a few tiles, fast")
    chaos.add_argument("--jobs", type=whole, default=1, metavar="N", help="processes (1)")
    chaos.add_argument("--until", type=number, metavar="T", help="faults are over by T s")
    chaos.add_argument("--air", choices=("memory", "zenoh"), help="all in one process, or each its")
    chaos.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="sets")
    chaos.add_argument("--out", metavar="FILE", help="also write what came of it as JSON")
    chaos.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    series = _series(args)
    from scenarios.chaos.series import run_series
    from scenarios.records.folder import prepare_file
    from scenarios.records.summary import write_json

    out = None if args.out is None else Path(args.out)
    if out is not None:
        prepare_file(out)
    tally = run_series(series, args.seed, args.runs, jobs=args.jobs, told=_tell)
    for failure in tally.failures:
        print("\n".join(_lines(args, failure)))
    print(_last_words(tally))
    if out is not None:
        write_json(out, tally.facts())
    return FAULT if tally.failures else OK


def _series(args: argparse.Namespace) -> "Series":
    from scenarios.chaos.draw import known_kinds
    from scenarios.chaos.series import Series
    from scenarios.chaos.small import small_changes
    from scenarios.schema import load
    from scenarios.schema.overrides import parse_override

    if args.runs < 1 or args.jobs < 1:
        raise UsageError(f"--runs {args.runs} --jobs {args.jobs}: both must be at least 1")
    kinds = known_kinds([name for name in args.faults.split(",") if name])
    horizon_s = HORIZON_S[args.small] if args.until is None else args.until
    if not 1.0 <= horizon_s <= 1e6:
        raise UsageError(f"--until {horizon_s:g}: must be from 1 to 1000000 s")
    changes = small_changes(args.scenario) if args.small else [parse_override("air=memory")]
    changes.append(parse_override(f"limit_s={horizon_s + SETTLE_S[args.small]:g}"))
    if args.air is not None:
        changes.append(parse_override(f"air={args.air}"))
    changes += [parse_override(text) for text in args.sets]
    return Series(load(args.scenario, changes), kinds, horizon_s)


def _tell(tally: "Tally") -> None:
    rate = tally.runs / tally.wall_s
    line = f"{tally.runs} runs, {rate:.1f} a second, {len(tally.failures)} broke"
    print(line, file=sys.stderr, flush=True)


def _lines(args: argparse.Namespace, failure: "Failure") -> list[str]:
    """Return what is said of a failure: how to run it again, what broke, what it takes."""
    lines = [_again(args, failure.seed)]
    lines += [f"  broke {violation}" for violation in failure.broken]
    lines += [f"  needs {fault}" for fault in failure.shrunk] or ["  needs no fault at all"]
    return lines


def _again(args: argparse.Namespace, seed: int) -> str:
    words = ["ropeteam", "chaos", args.scenario, "--seed", str(seed), "--runs", "1"]
    words += ["--small"] if args.small else []
    words += ["--faults", args.faults] if args.faults else []
    words += ["--until", f"{args.until:g}"] if args.until is not None else []
    words += ["--air", args.air] if args.air else []
    words += [word for text in args.sets for word in ("--set", text)]
    return " ".join(words)


def _last_words(tally: "Tally") -> str:
    injected = ", ".join(f"{kind} {count}" for kind, count in sorted(tally.injected.items()))
    broken = ", ".join(f"{name} {count}" for name, count in sorted(tally.broken.items()))
    endings = ", ".join(f"{name} {count}" for name, count in sorted(tally.endings.items()))
    return (
        f"{tally.runs} runs in {tally.wall_s:.1f} s ({tally.runs / tally.wall_s:.1f} a second),"
        f" {tally.simulated_s:.0f} simulated s\n"
        f"ended: {endings}\n"
        f"faults injected: {sum(tally.injected.values())} ({injected})\n"
        f"violations: {broken or 'none'}"
    )
