"""`ropeteam plot`: what came out of a study against what was varied."""

import argparse
from pathlib import Path

from scenarios.commands.parsing import OK, Commands

_DESCRIPTION = """\
Draws columns of a study's table: the mean over trials, with its 95 % interval (Student's t), and
prints the numbers. An unknown column lists all that there are.
"""
_EXAMPLES = """\
examples:
  ropeteam plot runs/bandwidth --x links.rate_bps --y team.coverage --by sharing.policy
  ropeteam plot runs/team-size --x robots.count --y team.mapped_80_s --y robots.sent_bytes.mean
  ropeteam plot runs/failure --x lost --y team.coverage --where lost_at_s=300
"""


def add(commands: Commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "plot",
        help="draw what came out of a study",
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_argument("folder", metavar="DIR", help="what `ropeteam sweep` left")
    command.add_argument("--x", required=True, metavar="COLUMN", help="along the picture")
    command.add_argument(
        "--y", required=True, action="append", metavar="COLUMN", help="up; may be repeated"
    )
    command.add_argument("--by", metavar="COLUMN", help="a line for each of its values")
    command.add_argument(
        "--where",
        action="append",
        default=[],
        metavar="COLUMN=VALUE",
        help="only these trials; may be repeated",
    )
    command.add_argument("--title", default="", metavar="TEXT", help="over the picture")
    command.add_argument("--out", metavar="FILE.png", help="the picture (DIR/X-Y.png)")
    command.add_argument("--quiet", action="store_true", help="say nothing but errors")
    command.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    from scenarios.experiments.tables import as_text
    from scenarios.studies.figure import chosen, draw_study
    from scenarios.studies.table import read_table

    source = Path(args.folder)
    rows = chosen(read_table(source), args.where)
    home = source if source.is_dir() else source.parent
    named = "-".join(name.replace("/", "_") for name in (args.x, *args.y))
    out = Path(args.out) if args.out is not None else home / f"{named}.png"
    tables = draw_study(out, rows, x=args.x, y=args.y, by=args.by, title=args.title)
    if not args.quiet:
        print("\n\n".join([*(as_text(table) for table in tables), f"Picture: {out}"]))
    return OK
