"""`ropeteam run`: a scenario, from a name or a file to its records."""

import argparse
import errno
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.commands.parsing import OK, Commands, number, whole
from scenarios.commands.places import add_places, crew_on_hosts
from scenarios.errors import FolderError, ScenarioError, UsageError

if TYPE_CHECKING:
    from scenarios.runner import Beside
    from scenarios.schema import Scenario
    from scenarios.schema.overrides import Override
    from scenarios.view.livepage import LivePage

DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
"""What a disk says that takes no more."""
EXAMPLES = """\
examples:
  ropeteam list                               what can be run
  ropeteam run cliff                          four robots at a cliff, over 9600-baud radios
  ropeteam run cliff --seed 2 --out runs/two  other ground, other noise
  ropeteam run cliff --set links.profile=sojourner --set sharing.policy=latest-first
  ropeteam run cliff --set world.terrain.file=ground.npz
  ropeteam run cliff --view                   watch it in the browser, and meddle
  ropeteam run pair --clock real --speed 20   on the wall clock, twenty times as fast
  ropeteam run runs/cliff-1/scenario.toml     once more, exactly
  ropeteam check mine.toml                    is my scenario file right?
"""
_RUN_HELP = """\
Runs a scenario and leaves in DIR: overview.png (a picture of it), report.html (a page that plays
it back), summary.json (what came out), looks.csv, frames.csv, maps.csv, events.csv (what happened),
run.mcap (maps, poses and links for ROS viewers), one log per robot, host.json (what it cost this
computer) and scenario.toml (the complete scenario: it can be run again).
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
    run.add_argument(
        "--no-merge", action="store_true", help="write no run.mcap (each robot's own log stays)"
    )
    run.add_argument(
        "--ros2", action="store_true", help="publish its maps live into ROS 2 (see ropeteam ros2)"
    )
    add_places(run)
    run.add_argument("--quiet", action="store_true", help="say nothing but errors")
    view = run.add_argument_group("live view")
    view.add_argument("--view", action="store_true", help="show the run in the browser")
    view.add_argument("--no-browser", action="store_true", help="only say where the page is")
    view.add_argument("--paused", action="store_true", help="wait for the page to let it go on")
    view.add_argument("--port", type=whole, metavar="N", help="of the page (any free one)")
    run.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    scenario = _load(args)
    crew_of = crew_on_hosts(args, scenario)
    out = _folder(args, scenario)
    from scenarios.runner import RunOptions, run
    from sim.errors import WorldError

    page = _page(args)
    beside = _in_ros2() if args.ros2 else None
    how = {"quiet": args.quiet, "overwrite": args.overwrite, "merge": not args.no_merge}
    try:
        run(scenario, out, RunOptions(**how, page=page, beside=beside, crew_of=crew_of))
    except WorldError as error:
        raise ScenarioError([f"{args.scenario}: {error}"]) from error
    except OSError as error:
        if error.errno not in DISK:
            raise
        raise FolderError(f"{out}: takes no more files of this run: {error.strerror}") from error
    return OK


def _page(args: argparse.Namespace) -> "LivePage | None":
    given = {"--no-browser": args.no_browser, "--paused": args.paused, "--port": args.port}
    if not args.view:
        for option, value in given.items():
            if value not in (None, False):
                raise UsageError(f"{option}: is for the live view; add --view")
        return None
    if args.port is not None and args.port > 65535:
        raise UsageError(f"--port {args.port}: must be from 0 to 65535")
    from scenarios.view.livepage import LivePage

    return LivePage(port=args.port or 0, opens=not args.no_browser, paused=args.paused)


def _in_ros2() -> "Beside":
    """Return what publishes a run into ROS 2; refuse where no router answers."""
    from functools import partial

    from scenarios.commands.ros2 import ROUTER, check, domain_of
    from scenarios.ros2.bridge import beside

    domain = domain_of(None)
    check(ROUTER)
    return partial(beside, endpoint=ROUTER, domain=domain)


def _load(args: argparse.Namespace) -> "Scenario":
    from scenarios.schema import load
    from scenarios.schema.overrides import parse_override

    changes = [*_clock_changes(args), *(parse_override(text) for text in args.sets)]
    scenario = load(args.scenario, changes, seed=args.seed)
    if args.speed is not None and scenario.clock.mode != "real":
        raise UsageError(f"--speed {args.speed:g}: only the real clock has one; add --clock real")
    return scenario


def _clock_changes(args: argparse.Namespace) -> "list[Override]":
    from scenarios.schema.overrides import Override

    changes: list[Override] = []
    if args.clock is not None:
        changes.append(Override(f"--clock {args.clock}", ("clock", "mode"), args.clock))
    if args.clock == "virtual" and args.speed is None:
        changes.append(Override("--clock virtual", ("clock", "speed"), 1.0))
    if args.speed is not None:
        changes.append(Override(f"--speed {args.speed:g}", ("clock", "speed"), args.speed))
    return changes


def _folder(args: argparse.Namespace, scenario: "Scenario") -> Path:
    from scenarios.records import folder

    if args.out is not None:
        out = Path(args.out)
    elif args.overwrite:
        out = Path("runs") / f"{scenario.name}-{scenario.seed}"
    else:
        out = folder.choose(scenario.name, scenario.seed)
    folder.check(out, overwrite=args.overwrite)
    return out
