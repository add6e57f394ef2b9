"""`ropeteam replay`: one robot of a run once more, alone, from its own log."""

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.commands.parsing import FAULT, OK, Commands, number

if TYPE_CHECKING:
    from scenarios.host import Host
    from scenarios.replay import Replayed

_DESCRIPTION = """\
Runs one robot of a former run once more, alone, in this process and on one thread, from what its
log says that it was handed: it takes the same decisions at the same times. Its new log is held
against the old one, record by record.
"""
_EPILOG = """\
examples:
  ropeteam replay runs/cliff-1 --robot recon                  does it decide as it did?
  ropeteam replay runs/cliff-1 --robot recon --break-at 455   look at it in the debugger, at 455 s

At a break, `host` is the robot in its simulated world: host.robot is its program, host.robot.team
its map. PYTHONBREAKPOINT chooses the debugger.

exit codes: 0 the same decisions; 1 others (the program was changed since, or has a fault); 2 bad
input
"""


def add(commands: Commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "replay",
        help="run one robot of a former run alone, from its log",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_argument("folder", metavar="RUN", help="the folder that the run left")
    command.add_argument("--robot", required=True, metavar="NAME", help="which of its robots")
    command.add_argument("--out", metavar="DIR", help="keep its new log and disk here")
    command.add_argument(
        "--break-at",
        type=number,
        metavar="S",
        help="stop in the debugger at this simulated second",
    )
    command.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    from scenarios.replay import replay

    run, robot = Path(args.folder), str(args.robot)
    if args.out is not None:
        told = replay(run, robot, Path(args.out), break_s=args.break_at, halt=_break)
    else:
        with tempfile.TemporaryDirectory(prefix="ropeteam-replay-") as out:
            told = replay(run, robot, Path(out), break_s=args.break_at, halt=_break)
    print(_report(told))
    return OK if told.same else FAULT


def _break(host: "Host") -> None:
    """Stop in the debugger, `host` at hand."""
    print(f"{host.name} at {host.now_ns() / 1e9:g} s: `host` is the robot in its world")
    breakpoint()


def _report(told: "Replayed") -> str:
    records = dict(told.records)
    named = {
        "looks": "looks",
        "frames_sent": "frames sent",
        "frames_heard": "frames heard",
    }
    counts = ", ".join(f"{records.get(topic, 0)} {words}" for topic, words in named.items())
    lives = "1 life" if told.lives == 1 else f"{told.lives} lives"
    lines = [f"{told.robot}: {lives}, {told.windows} windows; {counts}"]
    if told.difference:
        lines.append(f"It does not decide as it did then. First difference, {told.difference}")
    else:
        lines.append("Every record of its log is the same: it decides as it did then.")
    if told.digest_then and told.digest_then != told.digest:
        lines.append(f"Its map's digest was {told.digest_then}, is {told.digest}.")
    else:
        lines.append(f"Its map's digest: {told.digest}")
    return "\n".join(lines)
