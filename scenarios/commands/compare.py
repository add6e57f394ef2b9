"""`ropeteam compare`: runs side by side, in the terminal and as a page."""

import argparse
from pathlib import Path

from scenarios.commands.parsing import OK, Commands
from scenarios.errors import UsageError


def add(commands: Commands) -> None:
    """Add the command."""
    compare = commands.add_parser(
        "compare",
        help="set runs side by side",
        description="Sets runs side by side: prints the main figures, each with its difference "
        "from the first run's, and writes a page with all figures and all curves.",
        allow_abbrev=False,
    )
    compare.add_argument("folders", metavar="RUN", nargs="+", help="runs' folders, two or more")
    compare.add_argument("--out", metavar="FILE", default="compare.html", help="(compare.html)")
    compare.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    from scenarios.view.compare import as_text, read_all, write_comparison

    if len(args.folders) < 2:
        raise UsageError(f"compare {args.folders[0]}: one run only; must be two or more")
    runs = read_all([Path(folder) for folder in args.folders])
    print(as_text(runs))
    print(f"\nPage: {write_comparison(runs, Path(args.out))}")
    return OK
