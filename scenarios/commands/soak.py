"""`ropeteam soak`: hours of a team under faults, and whether any process grows."""

import argparse
from pathlib import Path

from scenarios.commands.parsing import FAULT, OK, Commands, number, whole
from scenarios.errors import UsageError

MOST_GROWTH = 0.05
"""In the second half of the run."""


def add(commands: Commands) -> None:
    """Add the command."""
    soak = commands.add_parser(
        "soak",
        help="run a small team for hours under faults, and watch its memory",
        description="Runs three robots in a small world for simulated hours, something going wrong"
        " in every half hour, and tells how much each process grew in the second half. Exit code 1"
        " where one grew by 5 % or more, or the run did not last.",
        allow_abbrev=False,
    )
    soak.add_argument("--hours", type=number, default=24.0, metavar="H", help="simulated (24)")
    soak.add_argument("--seed", type=whole, default=1, metavar="S", help="of all randomness (1)")
    soak.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="sets")
    soak.add_argument("--out", metavar="FILE", help="also write what came of it as JSON")
    soak.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    from scenarios.chaos.soak import soak, soak_scenario
    from scenarios.records.folder import prepare_file
    from scenarios.records.summary import write_json
    from scenarios.schema.overrides import parse_override

    if not 0.5 <= args.hours <= 700:
        raise UsageError(f"--hours {args.hours:g}: must be from 0.5 to 700")
    changes = [parse_override(text) for text in args.sets]
    out = None if args.out is None else Path(args.out)
    if out is not None:
        prepare_file(out)
    soaked = soak(soak_scenario(args.hours, args.seed, changes), args.seed)
    growth = soaked.growth()
    print(
        f"{soaked.simulated_s / 3600:.1f} simulated hours, {soaked.looks} looks, {soaked.frames}"
        f" frames, {len(soaked.faults)} faults; ended: {soaked.ending}"
    )
    for name, share in growth.items():
        size_mb = soaked.memory[name][-1][1] / 1e6
        print(f"{name:12} {size_mb:6.1f} MB of its own, {share:+.1%} in the second half")
    if out is not None:
        write_json(out, soaked.facts())
    sound = soaked.ending == "limit" and max(growth.values(), default=1.0) < MOST_GROWTH
    return OK if sound else FAULT
