"""`ropeteam view`: a run in the browser, or in the viewer that one already uses."""

import argparse
import importlib.util
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from scenarios.commands.parsing import FAULT, OK, Commands
from scenarios.errors import UsageError

_DESCRIPTION = """\
Opens a former run's report.html in the browser. With --rerun: its run.mcap in the Rerun viewer
(`pip install rerun-sdk`). What is not there is made first from the run's other files.
"""


def add(commands: Commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "view",
        help="open a run in the browser, or in Rerun",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_argument("folder", metavar="RUN", type=Path, help="the folder of a run")
    command.add_argument("--rerun", action="store_true", help="in Rerun")
    command.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    return _rerun(args.folder) if args.rerun else _browser(args.folder)


def _browser(folder: Path) -> int:
    from scenarios.view.report import FILE, write_report
    from scenarios.view.window import open_page

    page = folder / FILE if (folder / FILE).is_file() else write_report(folder)
    if open_page(page.resolve().as_uri()):
        print(f"In the browser: {page}")
    else:
        print(f"No browser can be opened here: open {page} yourself.")
    return OK


def _rerun(folder: Path) -> int:
    from scenarios.ros2.bag import NAME, write_bag
    from scenarios.view.window import has_window

    bag = folder / NAME if (folder / NAME).is_file() else write_bag(folder)
    words = [*_viewer(bag), "--bind", "127.0.0.1"]  # left to itself it listens on all interfaces
    if not has_window():
        print("No window can be opened here. To see it in a browser:")
        print(shlex.join([*words, "--serve-web", str(bag)]))
        return OK
    return OK if subprocess.run([*words, str(bag)], check=False).returncode == 0 else FAULT


def _viewer(bag: Path) -> list[str]:
    """Return how Rerun is called here."""
    found = shutil.which("rerun")
    if found is not None:
        return [found]
    if importlib.util.find_spec("rerun") is not None:
        return [sys.executable, "-m", "rerun"]
    raise UsageError(f"--rerun: Rerun is not installed (pip install rerun-sdk); {bag} is there")
