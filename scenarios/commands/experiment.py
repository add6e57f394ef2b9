"""`ropeteam experiment`: the paper's experiments, each from one command to its claims."""

import argparse
import sys
from pathlib import Path

from scenarios.commands.parsing import OK, Commands, whole
from scenarios.experiments import EXPERIMENTS

_DESCRIPTION = """\
Measures what the paper claims, over some seeds, and says of each claim whether it held. Leaves in
DIR: rows.csv (all that was measured), a .csv for each table, experiment.json (claims and tables),
figure.png; and in trials/ what each trial found, so that a stopped experiment can go on (--resume),
with more seeds if you like.
"""


def add(commands: Commands) -> None:
    """Add the command."""
    width = max(len(name) for name in EXPERIMENTS)
    lines = [f"  {name:{width}}  {title}" for name, title in EXPERIMENTS.items()]
    command = commands.add_parser(
        "experiment",
        help="measure what the paper claims",
        description=_DESCRIPTION,
        epilog="experiments:\n" + "\n".join(lines),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_argument("name", metavar="NAME", help="one of those below")
    command.add_argument("--seeds", type=whole, default=10, metavar="N", help="how many (10)")
    command.add_argument("--out", metavar="DIR", help="where its files go (runs/experiment-NAME-N)")
    command.add_argument("--overwrite", action="store_true", help="replace a former run in DIR")
    command.add_argument(
        "--resume", action="store_true", help="go on in DIR: run only the trials that it lacks"
    )
    command.add_argument(
        "--jobs", type=whole, metavar="N", help="trials at a time (as many as processors)"
    )
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="sets",
        help="change what the experiment lets you change (an unknown key lists them)",
    )
    command.add_argument(
        "--sensor", metavar="KIND", help="range or stereo, where it sees: as --set sensor=KIND"
    )
    command.add_argument("--quiet", action="store_true", help="say nothing but errors")
    command.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    from scenarios.experiments import frame

    sensor = [] if args.sensor is None else [f"sensor={args.sensor}"]
    sets = frame.checked_sets(frame.load(args.name), [*args.sets, *sensor])
    options = frame.Options(args.seeds, sets)
    out = _folder(args)
    jobs = frame.default_jobs() if args.jobs is None else args.jobs
    show = _Progress(quiet=args.quiet)
    findings = frame.run(
        args.name,
        options,
        out,
        jobs=jobs,
        overwrite=args.overwrite,
        resume=args.resume,
        tell=show.line,
    )
    show.done()
    if not args.quiet:
        print(frame.told(findings))
        print(f"\nFiles: {out}")
    return OK


def _folder(args: argparse.Namespace) -> Path:
    from scenarios.records import folder

    if args.out is not None:
        return Path(args.out)
    name = f"experiment-{args.name}"
    if args.overwrite or args.resume:
        return Path("runs") / f"{name}-{args.seeds}"
    return folder.choose(name, args.seeds)


class _Progress:
    """One line on a terminal, written over and over; nothing elsewhere."""

    def __init__(self, *, quiet: bool) -> None:
        self._shown = sys.stderr.isatty() and not quiet

    def line(self, text: str) -> None:
        """Show a line in place of the one before."""
        if self._shown:
            print(f"\r{text}\x1b[K", end="", file=sys.stderr, flush=True)

    def done(self) -> None:
        """Take the line away."""
        self.line("")
