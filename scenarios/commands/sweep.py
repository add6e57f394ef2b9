"""`ropeteam sweep`: a study, its trials side by side, into one table."""

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.commands.parsing import OK, Commands, whole

if TYPE_CHECKING:
    from scenarios.studies.study import Study
    from scenarios.studies.sweep import Progress, Swept

_DESCRIPTION = """\
Runs a study: a scenario, varied along axes, some seeds of each, side by side on Dask. Leaves in
DIR: trials.parquet (one row for each trial), trials/ID (summary.json and the complete scenario.toml
of each), study.toml, figure.png. The same command again goes on where it was stopped: what has
ended is kept, also when seeds or values were added to the study.
"""
_EXAMPLES = """\
examples:
  ropeteam sweep bandwidth --out runs/bandwidth
  ropeteam sweep bandwidth --out runs/bandwidth --seeds 20
  ropeteam sweep mine.toml --scheduler tcp://10.0.0.7:8786
  ropeteam plot runs/bandwidth --x links.rate_bps --y team.coverage --by sharing.policy

exit codes: 0 all trials have ended (those that failed are told, and stand in the table); 1 a fault
of the program; 2 bad input (nothing was started); 130 Ctrl-C (what has ended is kept)
"""
LINE_S = 10.0
"""Wall seconds between two lines where there is no terminal."""


def add(commands: Commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "sweep",
        help="run a study: a scenario, varied along axes",
        description=_DESCRIPTION,
        epilog=_EXAMPLES + "\nwhat there is: ropeteam list",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_argument("study", metavar="STUDY", help="a name of `ropeteam list`, or a file")
    command.add_argument("--out", metavar="DIR", help="where its files go (runs/study-NAME)")
    command.add_argument("--seeds", type=whole, metavar="N", help="seeds 1 to N of everything")
    command.add_argument(
        "--jobs", type=whole, metavar="N", help="trials at a time (as many as processors)"
    )
    command.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask cluster, e.g. tcp://10.0.0.7:8786"
    )
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="sets",
        help="change any key of the scenario in all trials; may be repeated",
    )
    command.add_argument("--retry", action="store_true", help="run those again that failed")
    command.add_argument("--overwrite", action="store_true", help="start anew in DIR")
    command.add_argument("--quiet", action="store_true", help="say nothing but errors")
    command.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    from scenarios.errors import UsageError
    from scenarios.studies import study as studies
    from scenarios.studies.engine import on_dask
    from scenarios.studies.sweep import sweep

    if args.jobs is not None and args.jobs < 1:
        raise UsageError(f"--jobs {args.jobs}: must be at least 1")
    if args.jobs is not None and args.scheduler is not None:
        raise UsageError("--jobs and --scheduler: the cluster has its own number of workers")
    path = studies.find(args.study)
    study = studies.read_study(path, seeds=args.seeds)
    trials = studies.trials(study, path, args.sets)
    out = Path(args.out) if args.out is not None else Path("runs") / f"study-{study.name}"
    show = _Progress(study.name, quiet=args.quiet)
    try:
        swept = sweep(
            study,
            trials,
            out,
            on_dask(args.jobs, args.scheduler or ""),
            source=path.read_text(),
            overwrite=args.overwrite,
            retry=args.retry,
            tell=show.tell,
        )
    except KeyboardInterrupt:
        show.done()
        if not args.quiet:
            print(f"What has ended is kept in {out}; the same command goes on from there.")
        raise
    show.done()
    _conclude(study, swept, quiet=args.quiet)
    return OK


def _conclude(study: "Study", swept: "Swept", *, quiet: bool) -> None:
    """Draw the study's own picture, and say what there is."""
    from scenarios.errors import UsageError
    from scenarios.experiments.tables import as_text
    from scenarios.studies.figure import draw_study
    from scenarios.studies.table import read_table

    said = [
        f"{swept.done} of {swept.total} trials have ended, {swept.failed} of them failed"
        f" ({swept.kept} were there already)."
    ]
    if study.plot is not None:
        x, y, by = study.plot.x, study.plot.y, study.plot.by
        try:
            tables = draw_study(
                swept.out / "figure.png", read_table(swept.out), x=x, y=y, by=by, title=study.title
            )
            said += [as_text(table) for table in tables]
        except UsageError as error:
            said.append(f"No picture: {error}")
    if swept.failed:
        said.append(f"Why they failed: {swept.out / 'trials'}/*/error.log; again: --retry")
    if not quiet:
        print("\n\n".join([*said, f"Files: {swept.out}"]))


class _Progress:
    """One line, written over and over on a terminal, now and then elsewhere."""

    def __init__(self, name: str, *, quiet: bool) -> None:
        self._name, self._quiet = name, quiet
        self._terminal = sys.stderr.isatty()
        self._next_s = 0.0

    def tell(self, progress: "Progress") -> None:
        """Show how far it is."""
        now_s = time.monotonic()
        if self._quiet or (not self._terminal and now_s < self._next_s):
            return
        self._next_s = now_s + LINE_S
        line = f"{self._name}: {progress.done} of {progress.total} trials"
        if progress.failed:
            line += f", {progress.failed} failed"
        if progress.left_s is not None and progress.done < progress.total:
            line += f", {time_left(progress.left_s)} left"
        if self._terminal:
            print(f"\r{line}\x1b[K", end="", file=sys.stderr, flush=True)
        else:
            print(line, file=sys.stderr, flush=True)

    def done(self) -> None:
        """Take the line away."""
        if self._terminal and not self._quiet:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def time_left(seconds: float) -> str:
    """Write a time as people do."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 90 * 60:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
