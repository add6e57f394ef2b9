"""`ropeteam show`: what a robot's stereo eyes saw in one look of a finished run."""

import argparse
from pathlib import Path

from scenarios.commands.parsing import OK, Commands, whole

_DESCRIPTION = """\
Draws one look of a finished run with sensor.kind = stereo: the left image with the tags found in
it, disparity, the points from above with the team-mates that were recognised, and the error of
depth against the truth. The images were not kept; the robot lives its run once more, from its own
log, up to that look, and takes the same pair.
"""
_EXAMPLES = """\
examples:
  ropeteam run cliff --set sensor.kind=stereo --out runs/eyes
  ropeteam show runs/eyes --robot recon --look 7
"""


def add(commands: Commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "show",
        help="draw what stereo eyes saw in one look of a run",
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_argument("folder", metavar="RUN", help="the folder that the run left")
    command.add_argument("--robot", required=True, metavar="NAME", help="which of its robots")
    command.add_argument(
        "--look", required=True, type=whole, metavar="N", help="which of its looks, from 1"
    )
    command.add_argument("--out", metavar="OUT.png", help="the picture (RUN/NAME-look-N.png)")
    command.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    from scenarios.onelook import look_again, save_picture

    run, robot = Path(args.folder), str(args.robot)
    out = Path(args.out) if args.out else run / f"{robot}-look-{args.look}.png"
    look = look_again(run, robot, args.look)
    save_picture(look, out)
    exposure, matched = look.seen.exposure, look.seen.matched
    mates = ", ".join(mate.name for mate in exposure.sightings) or "no team-mate"
    print(f"{robot}, look {args.look} at {exposure.t_s:.1f} s: {matched.density:.1%} matched,")
    print(f"  {len(exposure.points_m):,} points, recognised {mates}")
    for reason in exposure.ill:
        print(f"  {reason}")
    print(f"picture: {out}")
    return OK
