"""`ropeteam report`: a run's report.html, made again from its files."""

import argparse
from pathlib import Path

from scenarios.commands.parsing import OK, Commands


def add(commands: Commands) -> None:
    """Add the command."""
    report = commands.add_parser(
        "report",
        help="make a run's report.html again",
        description="Makes report.html of a run from its files: a playback with a time slider, "
        "curves, tables, the scenario. One file, which needs no network.",
        allow_abbrev=False,
    )
    report.add_argument("folder", metavar="RUN", help="a run's folder")
    report.add_argument("--out", metavar="FILE", help="where it goes (RUN/report.html)")
    report.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    from scenarios.view.report import write_report

    print(write_report(Path(args.folder), None if args.out is None else Path(args.out)))
    return OK
