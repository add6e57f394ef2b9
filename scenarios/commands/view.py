"""`ropeteam view`: a run in the viewer that one already uses."""

import argparse
import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

from scenarios.commands.parsing import OK, Commands
from scenarios.errors import UsageError

_DESCRIPTION = """\
Opens run.mcap of a former run in the Rerun viewer (`pip install rerun-sdk`), and makes it first
from the robots' logs where it is not there.
"""


def add(commands: Commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "view",
        help="open a run in Rerun",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_argument("folder", metavar="RUN", type=Path, help="the folder of a run")
    command.add_argument("--rerun", action="store_true", required=True, help="in Rerun")
    command.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    from scenarios.ros2.bag import NAME, write_bag

    folder: Path = args.folder
    bag = folder / NAME if (folder / NAME).is_file() else write_bag(folder)
    # Left to itself it listens on all interfaces.
    subprocess.run([*_viewer(bag), "--bind", "127.0.0.1", str(bag)], check=False)
    return OK


def _viewer(bag: Path) -> list[str]:
    """Return how Rerun is called here."""
    if importlib.util.find_spec("rerun") is not None:
        return [sys.executable, "-m", "rerun"]
    found = shutil.which("rerun")
    if found is None:
        raise UsageError(f"--rerun: Rerun is not installed (pip install rerun-sdk); {bag} is there")
    return [found]
